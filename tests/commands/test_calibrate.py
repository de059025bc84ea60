"""A calibration job: every step once, whatever is killed when; doubt is never shipped in silence; CI sees all of it."""

import os
import shutil
import subprocess
import sys
from dataclasses import dataclass, field, replace
from pathlib import Path
from xml.etree.ElementTree import fromstring

import pytest

from bench.base.errors import EquipmentError, InputError, RunAborted
from bench.commands.acquisition import station_of
from bench.commands.calibration.calibrate import calibrate
from bench.commands.calibration.doubts import decided, doubts, judged, verdict_of
from bench.commands.calibration.job import Case, Done
from bench.commands.calibration.junit import junit
from bench.commands.calibration.order import Order
from bench.commands.calibration.plan import Policy
from bench.commands.calibration.recording import JOB_MARK, AgainError
from bench.commands.calibration.steps import STEP_NAMES, STEPS, check_order, check_papers
from bench.record import DiagnosisRecord
from tests.support.commands import bench

PROFILES = Path(__file__).parents[2] / "profiles"
QUICK = PROFILES / "plans" / "quick.yaml"


class Killed(BaseException):
    """The bench is gone, at once."""


@dataclass
class Fake:
    """A step that counts how often it was done."""

    name: str
    done: Done = field(default_factory=lambda: Done("fine"))
    errors: list = field(default_factory=list)
    count: int = 0

    def do(self, order, job):
        self.count += 1
        if self.errors:
            raise self.errors.pop(0)
        return replace(self.done, facts={**self.done.facts, "count": self.count})


@pytest.fixture
def order(tmp_path):
    return Order.load(QUICK, None, "SIM-0001", tmp_path / "reports", quiet=True)


def fakes(**changes):
    return [changes.get(name, Fake(name)) for name in ("one", "two", "three")]


BOUNDARIES = [(name, state) for name in ("one", "two", "three") for state in ("begun", "done")]


@pytest.mark.parametrize("at", BOUNDARIES, ids=" ".join)
def test_a_kill_at_any_boundary_repeats_no_step_that_was_done(order, at):
    steps = fakes()

    def kill(*boundary):
        if boundary == at:
            raise Killed

    with pytest.raises(Killed):
        calibrate(order, steps=steps, boundary=kill)
    job = calibrate(order, steps=steps)
    assert (job.state, job.content["verdict"], job.content["exit_code"]) == ("ended", "PASS", 0)
    assert [step.count for step in steps] == [1, 1, 1]
    name, state = at
    assert job.step(name)["attempts"] == (2 if state == "begun" else 1)
    assert len(list((order.out / "SIM-0001").glob("*/job.json"))) == 1


def test_a_job_that_ended_is_answered_and_not_done_again_unless_asked(order):
    steps = fakes()
    first = calibrate(order, steps=steps)
    assert calibrate(order, steps=steps).folder == first.folder
    assert [step.count for step in steps] == [1, 1, 1]
    assert calibrate(order, steps=steps, anew=True).folder != first.folder
    assert [step.count for step in steps] == [2, 2, 2]


def test_another_plan_is_another_job(order, tmp_path):
    first = calibrate(order, steps=fakes())
    folder = shutil.copytree(PROFILES, tmp_path / "profiles")
    path = folder / "plans" / "quick.yaml"
    path.write_text(path.read_text() + "# other\n")
    assert calibrate(Order.load(path, None, order.serial, order.out, quiet=True), steps=fakes()).folder != first.folder


@pytest.mark.parametrize(
    ("error", "code"),
    [(InputError("no such file"), 2), (RunAborted("guard"), 3), (EquipmentError("chamber"), 4)],
)
def test_a_step_that_fails_is_the_next_to_be_done(order, error, code):
    steps = fakes(two=Fake("two", errors=[error]))
    job = calibrate(order, steps=steps)
    assert (job.state, job.content["exit_code"], job.content["sentence"]) == ("failed", code, str(error))
    assert calibrate(order, steps=steps).content["exit_code"] == 0
    assert [step.count for step in steps] == [1, 2, 1]


def test_a_job_that_is_held_goes_on_only_with_a_reason_which_stands_in_it(order):
    steps = fakes(two=Fake("two", Done("doubt", hold="an unknown effect")))
    job = calibrate(order, steps=steps)
    assert (job.state, job.content["verdict"], job.content["exit_code"]) == ("held", "HOLD", 1)
    assert calibrate(order, steps=steps).state == "held"
    assert steps[2].count == 0
    job = calibrate(order, steps=steps, release="ann: seen before, harmless")
    assert (job.content["verdict"], job.content["exit_code"]) == ("PASS", 0)
    assert job.content["releases"][0]["reason"] == "ann: seen before, harmless"
    assert "ann: seen before" in job.content["sentence"]
    assert [step.count for step in steps] == [1, 1, 1]
    with pytest.raises(InputError, match="not held: nothing to release"):
        calibrate(order, steps=steps, release="again")


@pytest.mark.parametrize("found", [Done("x", hold="doubt"), Done("x", stop="it failed", verdict="FAIL")])
def test_a_kill_between_a_finding_and_its_consequence_ships_nothing(order, found):
    steps = fakes(two=Fake("two", found))

    def kill(*boundary):
        if boundary == ("two", "done"):
            raise Killed

    with pytest.raises(Killed):
        calibrate(order, steps=steps, boundary=kill)
    job = calibrate(order, steps=steps)
    assert job.content["verdict"] == ("FAIL" if found.stop else "HOLD")
    assert job.content["exit_code"] == 1
    assert steps[2].count == 0


def test_a_step_may_send_the_job_back_once(order):
    steps = fakes(three=Fake("three", errors=[AgainError("two", "the unit holds another calibration")]))
    job = calibrate(order, steps=steps)
    assert job.content["verdict"] == "PASS"
    assert [step.count for step in steps] == [1, 2, 2]
    assert job.epoch("two") == 2
    again = [AgainError("two", "the unit holds another calibration") for _ in range(2)]
    job = calibrate(order, steps=fakes(three=Fake("three", errors=again)), anew=True)
    assert (job.state, job.content["exit_code"]) == ("failed", 4)


def test_two_benches_never_work_on_one_job(order):
    steps = fakes()

    def another(*boundary):
        if boundary == ("one", "begun"):
            with pytest.raises(InputError, match="another bench is at work"):
                calibrate(order, steps=fakes())

    assert calibrate(order, steps=steps, boundary=another).content["verdict"] == "PASS"


def test_marginal_is_told_in_the_verdict_that_is_shipped(order):
    job = calibrate(order, steps=fakes(two=Fake("two", Done("close", verdict="MARGINAL"))))
    assert (job.content["verdict"], job.content["exit_code"]) == ("MARGINAL", 0)


def test_junit_counts_steps_limits_and_doubts(order):
    cases = (Case("residual_rms_dph", "FAIL", text="FAIL: 2"), Case("floor", skipped=True), Case("tie"))
    job = calibrate(
        order, steps=fakes(two=Fake("two", Done("bad \x00", cases=cases, verdict="FAIL", stop="it is FAIL")))
    )
    suite = fromstring(junit([job], ("one", "two", "three"))).find("testsuite")
    counts = {key: int(suite.get(key)) for key in ("tests", "failures", "errors", "skipped")}
    assert counts == {"tests": 6, "failures": 2, "errors": 0, "skipped": 2}
    failed = [case.get("name") for case in suite.findall("testcase") if case.find("failure") is not None]
    assert failed == ["two", "residual_rms_dph"]
    failing = calibrate(order, steps=fakes(one=Fake("one", errors=[EquipmentError("gone")])), anew=True)
    assert fromstring(junit([failing], ("one", "two"))).get("errors") == "1"


SUSPECT = {"effect": "thermal_lag", "found": True, "look_alikes": ["temperature_rate"]}


@pytest.mark.parametrize(
    ("diagnosis", "added", "kinds"),
    [
        ({"verdict": "adequate", "sentence": "", "suspects": []}, [], []),
        ({"verdict": "unknown_effect", "sentence": "s", "suspects": []}, [], ["unknown_effect"]),
        ({"verdict": "undecided", "sentence": "s", "suspects": []}, [], ["undecided"]),
        ({"verdict": "missing_effect", "sentence": "s", "suspects": [SUSPECT]}, [], ["missing_effect", "tie"]),
        ({"verdict": "adequate", "sentence": "", "suspects": []}, [SUSPECT], ["tie"]),
        (None, [], ["undiagnosed"]),
    ],
)
def test_every_doubt_holds_the_job_until_the_plan_says_otherwise(diagnosis, added, kinds):
    found = list(doubts(diagnosis and DiagnosisRecord.model_validate(diagnosis), "why", added))
    assert [doubt.kind for doubt in found] == kinds
    cases, hold, stop = decided(found, Policy())
    assert (bool(hold), stop) == (bool(kinds), "")
    assert {case.name for case in cases if case.failure} == set(kinds)
    told, hold, stop = decided(found, Policy(**dict.fromkeys(kinds, "ship")))
    assert (hold, stop) == ("", "")
    assert all("policy: ship" in case.text for case in told if case.name in kinds)


def test_the_verdict_against_limits_decides():
    assert verdict_of("PASS", Policy(), "it") == ("", "")
    assert verdict_of("MARGINAL", Policy(), "it") == ("it is MARGINAL", "")
    assert verdict_of("MARGINAL", Policy(marginal="stop"), "it") == ("", "it is MARGINAL")
    assert verdict_of("INVALID", Policy(marginal="ship"), "it") == ("", "it is INVALID")


def test_a_refusal_is_a_case_of_its_own():
    (case,) = judged({"refusals": ["two branches are not covered"], "results": []})
    assert (case.failure, case.text) == ("INVALID", "two branches are not covered")


@pytest.mark.slow
@pytest.mark.parametrize("path", sorted((PROFILES / "plans").glob("*.yaml")), ids=lambda path: path.stem)
def test_the_shipped_plans_can_be_carried_out_on_the_shipped_stations(path, tmp_path):
    name = path.stem if path.stem in {"rate_table", "imu"} else "simulated"
    unit = {"rate_table": "SIM-0002", "imu": "IMU-0001"}.get(path.stem, "SIM-0001")
    order = Order.load(path, PROFILES / "stations" / f"{name}.yaml", unit, tmp_path)
    told = check_order(order)  # a plan that cannot be carried out on its station is refused
    verification = Path(order.plan.verification).name  # to which nothing is fitted
    assert not [text for text in told if text.startswith(verification) and "hard to separate" in text]
    assert set(STEP_NAMES) == {step.name for step in STEPS}


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("improve", "improv", "did you mean 'improve'?"),
        ("ramp_-40_85.yaml", "nowhere.yaml", "nowhere.yaml"),
        ("check_turn_ons.yaml", "ramp_-40_85.yaml", "take another profile"),
        ("marginal: hold", "marginal: perhaps", "ship"),
        (
            "[spline_lag_loop, spline]",
            "[spline_lag_loop, expression]",
            "models that a unit can hold: mems, polynomial, regression, spline, spline_lag_loop",
        ),
        ("[spline_lag_loop, spline]", "[splin]", "unknown model 'splin'"),
    ],
)
def test_a_wrong_plan_is_refused_before_anything_moves(tmp_path, old, new, said):
    folder = shutil.copytree(PROFILES, tmp_path / "profiles")
    path = folder / "plans" / "vibratory.yaml"
    path.write_text(path.read_text().replace(old, new))
    answer = bench("calibrate", "--unit", "SIM-0001", "--plan", path, "--out", tmp_path / "reports", "--quiet")
    assert answer.exit_code == 2
    assert said in answer.output


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("equipment: simulated\n", "", "quick.yaml: no certificate: no equipment; give a file"),
        ("equipment: simulated\n", "", "in the plan or the station file (`equipment:`), or fill in"),
        ("equipment: simulated\n", "", "a plan with `certificate: false` calibrates without one"),
        ("laboratory: simulated ", "laboratory: mine.yaml ", "stations/mine.yaml:3: no certificate: no signatory"),
        ("laboratory: simulated ", "laboratory: simulatd ", "did you mean 'simulated'?"),
    ],
)
def test_what_the_certificate_would_lack_is_said_before_anything_moves(tmp_path, old, new, said):
    folder = shutil.copytree(PROFILES, tmp_path / "profiles")
    station = folder / "stations" / "simulated.yaml"
    station.write_text(station.read_text().replace(old, new))
    (folder / "stations" / "mine.yaml").write_text("# mine\nlaboratory: {name: My laboratory}\n")
    plan = folder / "plans" / "quick.yaml"
    options = ("--unit", "SIM-0001", "--station", station, "--out", tmp_path / "reports", "--quiet")
    answer = bench("calibrate", "--plan", plan, *options)
    assert answer.exit_code == 2
    assert said in answer.output
    assert "--" not in answer.output, "options of another command"
    assert not list(tmp_path.glob("reports/*/*/data.parquet"))
    text = plan.read_text()
    plan.write_text(f"{text}certificate: false\n")
    order = Order.load(plan, station, "SIM-0001", tmp_path / "reports", quiet=True)
    if "simulatd" not in new:
        assert calibrate(order, steps=STEPS[:1], anew=True).step("check")["state"] == "done"


def test_a_certificate_that_would_not_be_signed_is_told_before_anything_moves(tmp_path, monkeypatch):
    order = Order.load(QUICK, PROFILES / "stations" / "simulated.yaml", "SIM-0001", tmp_path)
    station, said = station_of(order.station_file()), "the certificate will not be signed: this bench has no key"
    real = station.model_copy(update={"simulated": False})
    assert not any(said in text for text in check_papers(order, station)), "its key is made"
    assert any(said in text for text in check_papers(order, real))
    monkeypatch.setenv("BENCH_KEYS", str(tmp_path))
    (tmp_path / "laboratory.pem").write_text("no certificate")
    (tmp_path / "laboratory.key").write_text("no key")
    with pytest.raises(InputError, match="no private key in PEM"):
        check_papers(order, real)


TINY = """\
name: {name}
segments:
  - {{kind: ramp, to_degc: {to}, rate_degc_per_min: 2}}
  - {{kind: soak, duration_min: {min}}}
  - {{kind: ramp, to_degc: 23, rate_degc_per_min: 2}}
"""
KILLED = """
import os, sys
from pathlib import Path
import bench.acquisition.run.runner
from bench.commands.calibration.calibrate import calibrate
from bench.commands.calibration.order import Order
import bench.commands.acquisition
original = bench.acquisition.run.runner.run_job
def run_job(job, onlooker, desk=None):
    def look(station, status):
        if status.t_s > float(sys.argv[3]):
            os._exit(9)
    return original(job, look, desk)
import bench.acquisition
bench.acquisition.run_job = run_job
calibrate(Order.load(Path(sys.argv[1]), None, "SIM-0001", Path(sys.argv[2]), quiet=True))
"""


@pytest.mark.parametrize("policy", ["resume", "repeat"])
@pytest.mark.slow
def test_a_run_that_was_killed_in_the_middle_goes_on_or_is_repeated(tmp_path, policy):
    folder = shutil.copytree(PROFILES, tmp_path / "profiles")
    (folder / "a.yaml").write_text(TINY.format(name="a", to=27, min=1))
    (folder / "b.yaml").write_text(TINY.format(name="b", to=26, min=2))
    plan = folder / "plans" / "quick.yaml"
    text = plan.read_text().replace("static: ../quick_static.yaml\n", "")
    text = text.replace("../quick_calibration.yaml", "../a.yaml").replace("../quick_check.yaml", "../b.yaml")
    plan.write_text(f"{text}interrupted: {policy}\n")
    out = tmp_path / "reports"
    command = [sys.executable, "-c", KILLED, str(plan), str(out), "60"]
    root = str(Path(__file__).parents[2])
    environment = {**os.environ, "PYTHONPATH": root}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 9, done.stderr
    (cut,) = (path.parent for path in out.glob(f"*/*/{JOB_MARK}"))
    order = Order.load(plan, None, "SIM-0001", out, quiet=True)
    job = calibrate(order, steps=STEPS[:3])
    assert job.step("run")["state"] == "done", job.content
    assert (job.facts("run")["run"] == cut.name) == (policy == "resume")
    assert (cut / "journal-2").is_dir() == (policy == "resume")
    assert [run.name for run in job.runs()][-1] == job.facts("run")["run"]
    assert (cut in job.runs()) == (cut / "manifest.json").is_file()
    assert job.step("run")["attempts"] == 2
    assert job.step("check")["attempts"] == 1
