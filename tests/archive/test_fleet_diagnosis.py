"""Diagnosis of a fleet: each unit once, kept in its folder and in the registry; one unit's failure is its own."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from bench.archive.fleet import diagnosing, engines
from bench.archive.fleet.diagnosing import Told, by_lot, in_common
from bench.base.errors import InputError
from bench.cli import main
from bench.record import DiagnosisRecord
from tests.support.fleet_runs import station, uncalibrated
from tests.support.run_folders import keep


def diagnosis(run, model="spline", lacks=(), verdict="missing_effect"):
    suspects = [{"effect": name, "found": True, "proved": True} for name in lacks]
    return DiagnosisRecord.model_validate(
        {"format": 1, "verdict": verdict, "model": model, "runs": [run], "suspects": suspects}
    )


@pytest.fixture
def line(tmp_path):
    """Three registered units of two lots; two have diagnoses from their reports."""
    root = tmp_path / "reports"
    for number, unit in enumerate(("A-1", "A-2", "B-1")):
        folder = station(root, unit, "S", number / 10, residual=0.1)
        if unit != "A-2":
            diagnosis(folder.name, lacks=("thermal_lag",) if unit == "A-1" else ()).write(folder)
    invoke("registry", "rebuild", "--out", root)
    return root


def invoke(*words, code=0):
    said = CliRunner().invoke(main, [*map(str, words), "--json"], catch_exceptions=False)
    assert said.exit_code == code, said.output
    return json.loads(said.stdout)


@pytest.fixture
def asked(monkeypatch):
    """Folders that were diagnosed, with an answer that costs nothing."""
    folders = []

    def answer(model, folder):
        folders.append(folder)
        run = folder.rpartition("/")[2]
        return diagnosing.Answer(folder, diagnosis(run, model.name, ("hysteresis",)).text())

    monkeypatch.setattr(diagnosing, "diagnose_folder", answer)
    return folders


def test_what_reports_found_serves_and_only_the_rest_is_diagnosed(line, asked):
    done = invoke("fleet", "diagnose", "--model", "spline", "--out", line)
    assert [folder.split("/")[-2] for folder in asked] == ["A-2"]
    assert done["lots"]["A"] == {
        "units": 2,
        "verdicts": {"missing_effect": 2},
        "lacks": {"thermal_lag": 1, "hysteresis": 1},
    }
    assert (done["units"], done["made"], done["lots"]["B"]["units"]) == (3, 1, 1)
    rows = {row["unit"]: row["lacks"] for row in invoke("registry", "list", "--out", line)["runs"]}
    assert rows == {"A-1": "thermal_lag", "A-2": "hysteresis", "B-1": ""}
    assert invoke("fleet", "diagnose", "--model", "spline", "--out", line)["made"] == 0
    assert len(asked) == 1


def test_the_plan_is_that_of_the_figures_of_the_fleet_whatever_was_run_besides(line, asked):
    for number in range(4):  # more units than were calibrated have run the other plan
        uncalibrated(line, f"C-{number}", "S", 9.0, profile="soak")
    uncalibrated(line, "B-1", "S", 9.5)  # the newest of the plan, not calibrated yet
    invoke("registry", "rebuild", "--out", line)
    done = invoke("fleet", "diagnose", "--model", "spline", "--out", line)
    assert (invoke("fleet", "--out", line)["units"], done["units"], sorted(done["lots"])) == (3, 3, ["A", "B"])
    assert done["left_out"] == ["4 of other profiles (soak; --profile)"]
    refitted = CliRunner().invoke(main, ["fleet", "refit", "--model", "spline", "--out", str(line)])
    assert "4 of other profiles (soak; --profile)" in refitted.output
    assert invoke("fleet", "diagnose", "--model", "spline", "--out", line, "--profile", "soak")["units"] == 4


def test_a_unit_is_diagnosed_by_its_newest_judged_run_as_it_is_counted_in_the_fleet(line, asked):
    (judged,) = (line / "A-2").iterdir()
    for folder, verdict in ((judged, "PASS"), (station(line, "A-2", "S", 5.0, residual=0.1), "INVALID")):
        keep(folder, "limits.json", {"name": "line", "verdict": verdict, "results": []})
    invoke("registry", "rebuild", "--out", line)
    assert invoke("fleet", "diagnose", "--model", "spline", "--out", line)["lots"]["A"]["units"] == 2
    assert asked == [str(judged)]


def test_a_diagnosis_of_another_model_does_not_serve(line, asked):
    assert invoke("fleet", "diagnose", "--model", "polynomial", "--out", line)["made"] == 3
    assert invoke("fleet", "diagnose", "--model", "polynomial", "--again", "--out", line)["made"] == 3


def test_a_command_that_was_killed_goes_on_with_what_its_folders_have(line, asked, monkeypatch):
    def killed(folder, *more):
        raise SystemError

    with monkeypatch.context() as now:
        now.setattr(diagnosing, "_register", killed)  # as by a kill between folder and registry
        with pytest.raises(SystemError):
            invoke("fleet", "diagnose", "--model", "polynomial", "--out", line)
    done = invoke("fleet", "diagnose", "--model", "polynomial", "--out", line)
    assert (done["made"], done["units"], len(asked)) == (0, 3, 3)


def test_a_unit_that_cannot_be_diagnosed_is_named_and_stops_nothing(line):
    done = invoke("fleet", "diagnose", "--model", "spline", "--out", line, code=1)
    assert done["units"] == 2
    assert [text.startswith("A-2: ") for text in done["failed"]] == [True]
    assert "means.parquet" in done["failed"][0]


def test_a_unit_that_kills_its_process_is_named():
    (answer,) = engines._halved(("/line/B-1/r1",), lambda part: "its worker process died", diagnosing._lost)
    assert (answer.folder, answer.error) == ("/line/B-1/r1", "not diagnosed: its worker process died")


def test_workers_that_do_not_see_the_folder_end_the_command():
    class Client:
        def run(self, function, *given):
            return {"tcp://a:1": True, "tcp://b:1": False}

    with pytest.raises(InputError, match="worker tcp://b:1 does not see this folder"):
        engines._require_folder(Client(), "/somewhere")


def test_a_lot_that_lacks_an_effect_more_often_is_told():
    told = [Told(f"A-{i}", "A", "missing_effect", ("lag",) if i < 9 else ()) for i in range(10)]
    told += [Told(f"B-{i}", "B", "adequate", ("lag",) if i < 2 else ()) for i in range(40)]
    (common,) = in_common(told)
    assert (common.effect, common.lot, common.lacking, common.units) == ("lag", "A", 9, 10)
    assert (common.elsewhere, common.of_elsewhere) == (2, 40)
    from scipy.stats import fisher_exact

    assert common.p == pytest.approx(2 * fisher_exact([[9, 1], [2, 38]], alternative="greater").pvalue)
    assert by_lot(told)["A"].lacks == {"lag": 9}


def test_the_lots_of_chance_have_nothing_in_common():
    random = np.random.default_rng(4)
    alarms = 0
    for _ in range(200):
        told = [Told(str(i), f"L{i // 20}", "", ("lag",) * bool(random.random() < 0.3)) for i in range(200)]
        alarms += bool(in_common(told))
    assert alarms <= 6  # 1 % of 200 are 2; more than 6 have a chance of 0.5 %
