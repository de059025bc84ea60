"""Two runs side by side: what differs, worst first, and nothing else."""

import json
import shutil
from types import SimpleNamespace

import pytest

from bench.archive.difference.results import quantities
from bench.record import StoredQuantity
from tests.support.commands import bench
from tests.support.report_runs import quick
from tests.support.run_folders import CYCLE, keep, make_run, ramp_run


def diff(a, b):
    answer = bench("diff", a, b, "--json")
    assert answer.exit_code == 0
    return json.loads(answer.stdout)


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """One unit twice with other noise, and another unit with another profile; not to be changed."""
    folder = tmp_path_factory.mktemp("diff")
    first = quick(make_run(folder / "a", **ramp_run(loop_dph=0.0)))
    second = quick(make_run(folder / "b", **ramp_run(loop_dph=0.0, seed=2)))
    made = ramp_run((*CYCLE[:-1], ("soak at 25 again", "soak", 25.0, 2400.0)), loop_dph=0.0, seed=3)
    made["columns"]["rate"] = made["columns"]["rate"] + 5.0 + 0.02 * made["columns"]["temperature"]
    third = quick(make_run(folder / "c", **made, unit="SIM-0009"))
    return first.run.path, second.run.path, third.run.path


def test_a_run_and_itself_differ_in_nothing(runs):
    found = diff(runs[0], runs[0])
    for key in ("facts", "profile", "station", "versions", "segments", "losses", "quantities"):
        assert found[key] == [], key
    assert found["coefficients"]["differ"] == []
    assert (found["curves"]["rms_dph"], found["curves"]["max_dph"]) == (0.0, 0.0)


def test_two_runs_that_differ_by_noise_agree(runs):
    found = diff(runs[0], runs[1])
    assert found["quantities"] == []
    assert found["coefficients"]["differ"] == []
    assert found["coefficients"]["agree"] >= 4
    assert found["curves"]["over_floor"] < 0.5


def test_another_unit_is_told_by_its_curve_its_coefficients_and_its_quantities(runs):
    found = diff(runs[0], runs[2])
    curves, coefficients = found["curves"], found["coefficients"]
    assert curves["offset_dph"] == pytest.approx(5.4, abs=0.3)
    assert curves["max_dph"] == pytest.approx(5.0 + 0.02 * 85, abs=0.2)
    assert curves["max_at_degc"][1] > 70
    assert curves["shape_rms_dph"] < curves["rms_dph"]
    z = [abs(entry["z"]) for entry in coefficients["differ"]]
    assert z == sorted(z, reverse=True)
    assert z[-1] > 3
    assert {"where": "unit", "a": "SIM-0001", "b": "SIM-0009"} in found["facts"]
    assert "bias_max_dph" in {entry["quantity"] for entry in found["quantities"]}
    assert [entry["segment"] for entry in found["segments"]] == ["soak at 25 again"]


def test_how_far_quantities_are_apart_has_one_unit_and_no_number_without_one():
    def told(value, half):
        ends = {} if half is None else {"low": value - half, "high": value + half}
        return SimpleNamespace(quantities=[StoredQuantity(name="residual_rms_dph", value=value, **ends)])

    def apart(a, b):
        return [entry["apart"] for entry in quantities(a, b)]

    assert apart(told(1.0, 0.1), told(1.4, 0.1)) == [pytest.approx(2.0)], "half-widths of the intervals"
    assert apart(told(1.0, None), told(1.4, None)) == [None]
    assert apart(told(1.0, 0.1), told(1.1, 0.1)) == []


def test_settings_are_compared_by_what_they_say_and_not_by_how(runs, tmp_path):
    one, other = (shutil.copytree(run, tmp_path / run.name) for run in runs[:2])
    keep(one, "profile.yaml", "name: p\nsegments:\n  - {kind: soak, duration_min: 3}\n")
    keep(other, "profile.yaml", "# a comment\nname: p\nsegments:\n  - kind: soak\n    duration_min: 4\n")
    assert diff(one, other)["profile"] == [{"where": "segments[0].duration_min", "a": 3, "b": 4}]
    assert "segments[0].duration_min: 3 | 4" in bench("diff", one, other).stdout


def test_models_that_mean_other_things_are_compared_by_their_curves_only(runs, tmp_path):
    other = quick(shutil.copytree(runs[1], tmp_path / "b"), "spline").run.path
    found = diff(runs[0], other)
    assert not found["coefficients"]["comparable"]
    assert "the models differ" in found["coefficients"]["reason"]
    assert found["curves"]["rms_dph"] > 0


def test_runs_without_results_are_compared_by_what_they_have(runs, tmp_path):
    bare = make_run(tmp_path / "bare", **ramp_run())
    answer = bench("diff", runs[0], bare)
    assert answer.exit_code == 0
    assert "Models not compared: " in answer.stdout
    assert "Coefficients not compared: B has no calibration" in answer.stdout
    twice = bench("diff", bare, make_run(tmp_path / "other", **ramp_run()))
    assert "Coefficients not compared: neither A nor B has a calibration" in twice.stdout


def test_what_is_no_run_is_bad_input(runs, tmp_path):
    assert bench("diff", runs[0], tmp_path).exit_code == 2
