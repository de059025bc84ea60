"""`until` of a profile in every command that makes a run: one simulated unit and a lot that is like it."""

import json

import numpy as np
import pytest

from bench.acquisition import Continue, profile_from_text
from bench.base import InputError, RunAborted
from bench.commands.calibration.calibrate import calibrate
from bench.commands.calibration.order import Order
from bench.commands.calibration.steps import STEPS
from bench.commands.ending_early import EndingEarly, followed, lot_of
from bench.record import LotRecord, Manifest, RunFolder, UntilRecord, load
from tests.support.bench_project import BRIEF_PLAN
from tests.support.commands import bench, undiagnosed
from tests.support.run_folders import make_run

SWEEP = """
name: sweep
start: {temperature_degc: 25}
settle: {dwell_min: 0.5, slope_degc_per_min: 0.5}
segments:
  - {kind: ramp, to_degc: 39, rate_degc_per_min: 1.2}
  - {kind: ramp, to_degc: 19, rate_degc_per_min: 1.5}
  - {kind: ramp, to_degc: 22, rate_degc_per_min: 0.3}
"""
UNTIL = SWEEP.replace("start:", "until: {error_dph: 2.0, lot: LOT, audit_every: 2}\nstart:")
CHECK = SWEEP.replace("sweep", "sweep_check").partition("  - {kind: ramp, to_degc: 22")[0]
MODEL = "name: line\neffects: [{polynomial: {order: 3}}]\n"
LIMITS = """
name: brief
limits:
  - {quantity: samples_lost, unit: "1", upper: 0, reason: every sample counts}
"""
PLAN = BRIEF_PLAN.replace("brief.yaml\nver", "sweep.yaml\nver") + "certificate: false\n"


def invoked(*words):
    return bench(*words, "--quiet", "--json")


pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    """Profiles, a plan, and a lot of twelve units that scatter about the simulated one."""
    root = tmp_path_factory.mktemp("until")
    for folder in ("profiles/plans", "profiles/limits"):
        (root / folder).mkdir(parents=True)
    texts = {"whole.yaml": SWEEP, "sweep.yaml": UNTIL, "brief_check.yaml": CHECK, "line.yaml": MODEL}
    texts |= {"plans/brief.yaml": PLAN, "limits/brief.yaml": LIMITS}
    for name, text in texts.items():
        (root / "profiles" / name).write_text(text)
    with undiagnosed():
        said = invoked("run", root / "profiles" / "whole.yaml", "--model", "polynomial", "--out", root / "first")
    first = load(json.loads(said.stdout)["run"], 1.0)
    runs = [made(root / "lot", f"L-{seed:02d}", first, seed) for seed in range(12)]
    lot = ["lot", "calibrate", "LOT", *map(str, runs), "--model", str(root / "profiles" / "line.yaml")]
    bench(*lot, "--out", root / "reports", "--json")
    return root


def made(root, name, like, seed):
    """A run of a unit of the lot: the rows of `like`, and a curve and noise of its own."""
    random = np.random.default_rng(seed)
    x = (like.channel("temperature") - 29.0) / 8.0
    level, slope = random.normal(0.0, (1.0, 0.3))
    columns = {"time": like.time - like.time[0] + 0.5, "temperature": like.channel("temperature")}
    columns["rate"] = like.channel("rate") + level + slope * x + random.normal(0.0, 0.5, x.size)
    columns["segment"] = np.zeros(x.size)
    end = float(columns["time"][-1])
    segments = [{"index": 0, "name": "all", "kind": "ramp", "from_s": 0.0, "to_s": end, "outcome": "done"}]
    return make_run(root / name / "r1", columns, segments, unit=name, run="r1", created="2026-11-01T00:00:00+00:00")


@pytest.fixture(autouse=True)
def looked_at_every_two_minutes(monkeypatch):
    monkeypatch.setattr("bench.commands.ending_early.LOOK_S", 120.0)
    with undiagnosed():
        yield


def decisions(run):
    return [event for event in RunFolder(run).events() if event["kind"] == "decision"]


def test_a_calibration_ends_its_run_early_and_delivers_what_the_lot_makes_of_it(project):
    order = Order.load(project / "profiles" / "plans" / "brief.yaml", None, "SIM-0001", project / "reports", quiet=True)
    steps = [step for step in STEPS if step.name in {"run", "fit", "flash"}]
    job = calibrate(order, steps=steps)
    assert (job.state, job.content["verdict"]) == ("ended", "PASS"), job.content["sentence"]
    run = job.folder.parent / job.facts("run")["run"]
    assert UntilRecord.read(run).outcome == "stopped"
    assert decisions(run)[-1]["units"]["SIM-0001"]["high_dph"] <= 2.0
    made = job.folder.parent / job.facts("fit")["record"]
    assert Manifest.read(made).profile == "lot"
    flashed = json.loads((made / "flash.json").read_text())
    assert flashed["calibration_id"] == job.facts("flash")["calibration_id"]


def test_a_run_that_goes_on_after_an_interruption_ends_early_by_the_rows_of_both_parts(project, monkeypatch):
    def cut(self, status):
        if status.t_s > 200.0:
            raise RunAborted("the power is gone")
        return Continue()

    with monkeypatch.context() as patch:
        patch.setattr(EndingEarly, "decide", cut)
        out = ("--out", project / "resumed")
        lot = next((project / "reports" / "LOT").iterdir())
        invoked("run", project / "profiles" / "sweep.yaml", "--model", "polynomial", "--lot", lot, *out)
    (run,) = (project / "resumed" / "SIM-0001").iterdir()
    assert Manifest.read(run).state == "aborted"
    assert invoked("resume", run).exit_code in (0, 1)
    assert UntilRecord.read(run).outcome == "stopped"
    last = decisions(run)[-1]
    assert last["reason"].startswith("error expected up to")
    assert last["units"]["SIM-0001"]["at_s"] > 3600.0  # since its first row, before the interruption


def test_a_lot_is_found_by_name_or_by_name_and_run_and_one_that_is_not_there_is_told(project, tmp_path):
    (lot,) = (project / "reports" / "LOT").iterdir()
    for name in ("LOT", f"LOT/{lot.name}"):
        kept = followed(profile_from_text(UNTIL.replace("lot: LOT", f"lot: {name}")), None, project / "reports")
        (tmp_path / "lot.yaml").write_text(kept["lot.yaml"])
        found, _ = lot_of(tmp_path)
        assert LotRecord.read(found).lot == "LOT"
    with pytest.raises(InputError, match=r"until\.lot: no lot 'LOT' was calibrated in"):
        followed(profile_from_text(UNTIL), None, tmp_path)
    assert followed(profile_from_text(SWEEP), None, tmp_path) == {}


def test_a_plan_with_a_certificate_is_refused_before_its_run_may_end_early(project):
    plan = project / "profiles" / "plans" / "certified.yaml"
    plan.write_text(PLAN.replace("certificate: false\n", ""))
    order = Order.load(plan, None, "SIM-0001", project / "reports", quiet=True)
    job = calibrate(order)
    assert job.state == "failed"
    assert "set `certificate: false`" in job.content["sentence"]
