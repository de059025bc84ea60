"""`until` of a profile: a run that stops by itself, goes on as an audit, or goes the whole way."""

import json

import numpy as np
import pytest

from bench.acquisition import Continue, Stop, Until, profile_from_text
from bench.acquisition.run.status import Status
from bench.base import InputError, library
from bench.commands import complete_unit
from bench.commands.ending_early import EndingEarly, audit_due, records_of
from bench.record import CalibrationRecord, Manifest, UntilRecord, load
from tests.support.commands import bench
from tests.support.run_folders import make_run

LEGS = [("ramp", -10.0), ("ramp", 50.0), ("ramp", 20.0), ("ramp", 50.0), ("ramp", -10.0), ("ramp", 20.0)]


def schedule():
    """One row a second for the way through the legs at 1 degC/min."""
    ends = np.array([20.0, *(to for _, to in LEGS)])
    times = 60.0 * np.concatenate([[0.0], np.cumsum(np.abs(np.diff(ends)))])
    time = np.arange(0.5, times[-1], 1.0)
    return time, np.interp(time, times, ends)


def unit(seed, kink=0.0, way=None):
    """Columns of a unit of the lot: its curve, and noise."""
    random = np.random.default_rng(seed)
    time, temperature = schedule() if way is None else way
    x = (temperature - 20.0) / 30.0
    level, slope, bend = random.normal((5.0, 2.0, 0.5), (0.5, 0.3, 0.1))
    rate = level + slope * x + bend * x**2 + kink * np.exp(-(((temperature - 40.0) / 5.0) ** 2))
    rate += random.normal(0.0, 0.5, time.size)
    return {"time": time, "temperature": temperature, "rate": rate, "segment": np.zeros(time.size)}


def folder(root, name, columns):
    end = float(columns["time"][-1])
    segments = [{"index": 0, "name": "all", "kind": "ramp", "from_s": 0.0, "to_s": end, "outcome": "done"}]
    return make_run(root / name / "r1", columns, segments, unit=name, run="r1", created="2026-11-01T00:00:00+00:00")


@pytest.fixture(scope="module")
def lot(tmp_path_factory):
    root = tmp_path_factory.mktemp("lot")
    runs = [str(folder(root, f"L-{i:02d}", unit(i))) for i in range(12)]
    model = root / "lot.yaml"
    model.write_text("name: lot\neffects: [{spline: {intervals: 3}}]\n")
    said = bench("lot", "calibrate", "LOT", *runs, "--model", model, "--out", root / "out", "--json")
    return root / "out" / "LOT" / json.loads(said.stdout)["run"].rpartition("/")[2]


def followed(lot, columns, *, limit=0.2, audit=False):
    """A run told to the decider second by second: it, and what it decided when it said something."""
    early = EndingEarly(lot, Until(error_dph=limit), None, audit=audit)
    said = []
    for row in range(columns["time"].size):
        now = float(columns["time"][row])
        early.heard("U-1", now, float(columns["temperature"][row]), float(columns["rate"][row]))
        decision = early.decide(Status(now, None, 0.0, 1, None, 20.0, (), "running"))
        if isinstance(decision, Stop) or decision.text:
            said.append((now, decision))
        if isinstance(decision, Stop):
            break
    return early, said


def test_a_run_stops_when_its_calibration_is_good_enough_and_says_by_which_figures(lot):
    columns = unit(50)
    _, said = followed(lot, columns)
    at_s, last = said[-1]
    assert isinstance(last, Stop)
    assert at_s < 0.75 * columns["time"][-1]
    figures = last.facts["units"]["U-1"]
    assert figures["high_dph"] <= 0.2
    assert figures["seen"] == 1.0
    assert figures["level"] <= 1.0
    assert all(isinstance(one, Continue) and one.facts["units"]["U-1"]["error_dph"] > 0 for _, one in said[:-1])


def test_a_limit_that_is_not_met_lets_the_run_go_to_its_end(lot):
    _, said = followed(lot, unit(51), limit=1e-4)
    assert all(isinstance(one, Continue) for _, one in said)


def test_a_unit_unlike_its_lot_goes_the_whole_way(lot):
    _, said = followed(lot, unit(52, kink=1.5))
    assert not any(isinstance(one, Stop) for _, one in said)
    assert "U-1 unlike the lot" in said[-1][1].text


class Ended:
    """A run result as far as the record of its end needs it."""

    def __init__(self, path):
        self.serial, self.run, self.units = "U-1", self, (self,)
        self.path = path


def test_every_so_many_runs_one_is_an_audit_that_shows_the_error_of_the_others(lot, tmp_path):
    columns = unit(53)
    until = Until(error_dph=0.2, audit_every=3)
    outcomes = []
    for number in range(4):
        audit = audit_due(tmp_path, lot, until.audit_every)
        early, _ = followed(lot, columns, audit=audit)
        run = make_run(
            tmp_path / "U-1" / f"r{number}", columns, unit="U-1", run=f"r{number}", created=f"2026-11-0{number + 1}"
        )
        early.write(Ended(run))
        outcomes.append(UntilRecord.read(run).outcome)
    assert outcomes == ["stopped", "stopped", "audit", "stopped"]
    (shown,) = [record for record in records_of(tmp_path, lot) if record.outcome == "audit"]
    assert shown.actual_dph < 0.2
    said = bench("lot", "audits", lot, "--out", tmp_path, "--json")
    found = json.loads(said.stdout)
    assert found["outcomes"] == {"stopped": 3, "audit": 1, "unlike": 0, "whole": 0}
    assert (found["audits"], found["held_to"]) == (1, 1.0)
    assert 0.1 < found["saved"] < 0.75


def test_a_run_that_ended_early_is_calibrated_with_its_lot(lot, tmp_path):
    columns = unit(54)
    _, said = followed(lot, columns)
    part = columns["time"] < said[-1][0]
    run = folder(tmp_path, "U-9", {name: values[part] for name, values in columns.items()})
    done = complete_unit(lot, run, tmp_path / "out")
    record = CalibrationRecord.read(done.run)
    assert Manifest.read(done.run).unit == "U-9"
    assert done.low_dph < done.error_dph < done.high_dph
    from bench.analysis import source_of

    fit = source_of(done.run).fit  # what export, flash and certificate read
    whole = load(folder(tmp_path, "U-8", columns), 30.0)
    assert float(np.sqrt(np.mean((fit.predict(whole).bias - whole.bias) ** 2))) < done.high_dph + 0.5 / np.sqrt(30.0)
    assert record.verdict.sentence.startswith("lot by the run and lot LOT")


def test_a_run_without_all_temperatures_or_of_another_unit_is_not_completed(lot, tmp_path):
    columns = unit(55)
    part = columns["time"] < 3000.0
    cold = folder(tmp_path, "U-7", {name: values[part] for name, values in columns.items()})
    with pytest.raises(InputError, match="of the temperatures of lot LOT; all are needed"):
        complete_unit(lot, cold, tmp_path / "out")
    with pytest.raises(InputError, match="U-6 is unlike lot LOT"):
        complete_unit(lot, folder(tmp_path, "U-6", unit(56, kink=1.5)), tmp_path / "out")


def test_until_stands_in_the_profile_and_a_lot_needs_it(tmp_path, lot):
    text = "name: p\nuntil: {error_dph: 0.2}\nsegments: [{kind: ramp, to_degc: 30, rate_degc_per_min: 1}]\n"
    assert profile_from_text(text).until == Until(error_dph=0.2, audit_every=10)
    with pytest.raises(InputError, match="error_dph"):
        profile_from_text(text.replace("0.2", "-1"))
    profile = tmp_path / "p.yaml"
    profile.write_text(text.replace("until: {error_dph: 0.2}\n", ""))
    said = bench("run", profile, "--lot", lot, "--out", tmp_path / "out", "--quiet")
    assert said.exit_code == 2
    assert "--lot needs `until: {error_dph: …}`" in said.stderr


def test_a_planned_profile_is_one_that_check_passes_and_the_unit_is_completed_by_it(lot, tmp_path):
    profile = tmp_path / "short.yaml"
    said = bench("lot", "plan", lot, "--target", "0.5", "--profile", profile, "--json")
    found = json.loads(said.stdout)
    assert set(found) == {"lot", "profile", "target_dph", "error_dph", "low_dph", "high_dph", "hours", "whole_hours"}
    assert found["high_dph"] <= 0.5
    assert found["hours"] < found["whole_hours"]
    plan = profile_from_text(profile.read_text())
    assert plan.duration_s == pytest.approx(3600.0 * found["hours"], rel=0.01)
    assert bench("check", profile).exit_code == 0
    time = np.arange(0.5, plan.duration_s, 1.0)
    run = folder(tmp_path, "G-07", unit(77, way=(time, plan.setpoint(time))))
    made = complete_unit(lot, run, tmp_path / "out")
    assert made.low_dph < made.error_dph < made.high_dph < 0.5


def test_a_plan_for_a_faster_chamber_may_be_faster_than_the_lot_was_driven(lot, tmp_path):
    station = library() / "stations" / "simulated.yaml"
    hours = []
    for more in ([], ["--station", str(station)]):
        words = ["lot", "plan", str(lot), "--target", "0.5", "--profile", str(tmp_path / "short.yaml"), *more, "--json"]
        hours.append(json.loads(bench(*words).stdout)["hours"])
    assert hours[1] < hours[0]
    legs = profile_from_text((tmp_path / "short.yaml").read_text()).legs()
    assert 1.0 < max(leg.rate_degc_per_min for leg in legs if leg.kind == "ramp") <= 5.0


def test_a_target_that_no_plan_meets_is_one_line(lot, tmp_path):
    said = bench("lot", "plan", lot, "--target", "0.0001")
    assert said.exit_code == 2
    assert "give a larger target" in said.stderr
    assert len(said.stderr.strip().splitlines()) == 1
