"""Parts of a run before and after a gap: one calibration only where they are shown to be one unit."""

import json

import numpy as np
import pytest

from bench.analysis.judging.completeness import completeness
from bench.analysis.judging.joints import joints
from bench.analysis.judging.judge import analyse
from bench.record.folder import RunFolder
from bench.record.reading import load
from tests.support.run_folders import CYCLE, make_run, ramp_run

FLOOR_DPH = 0.06
GAP = {"duration_s": 1800.0, "text": "1800 s without a record", "before": {}, "after": {}}


def parted(folder, step_dph=0.0, power="lost", cut=0.5, overlap=True):
    """A run that was cut at a share of its length, an hour's gap, and `step_dph` on what came after."""
    run = ramp_run(CYCLE if overlap else CYCLE[:4], loop_dph=0.0)
    columns = run["columns"]
    at = int(cut * len(columns["time"]))
    at_s = float(columns["time"][at])
    columns["time"] = np.where(np.arange(len(columns["time"])) < at, columns["time"], columns["time"] + 3600.0)
    columns["rate"] = columns["rate"] + np.where(np.arange(len(columns["time"])) < at, 0.0, step_dph)
    after_s = float(columns["time"][at])
    last_s = float(columns["time"][-1])
    parts = [
        {"part": 1, "from_s": 0.0, "to_s": at_s, "state": "aborted", "cause": "the bench was killed"},
        {"part": 2, "from_s": after_s, "to_s": last_s, "state": "done", "gap": {**GAP, "unit_power": power}},
    ]
    moved = [{**s, **{k: s[k] + 3600.0 * (s[k] > at_s) for k in ("from_s", "to_s")}} for s in run["segments"]]
    return make_run(folder, columns, moved, parts=parts)


def joint(folder, floor_dph=FLOOR_DPH):
    (found,) = joints(RunFolder(folder).manifest(), load(folder, 30.0), floor_dph)
    return found


def test_a_unit_that_kept_its_power_is_the_same_unit(tmp_path):
    found = joint(parted(tmp_path / "r", power="kept"))
    assert found.admissible
    assert "the unit kept its power" in found.sentence
    assert "is not recorded" in found.sentence


@pytest.mark.parametrize("power", ["lost", "unknown"])
def test_parts_that_agree_are_admissible_though_the_power_was_off(tmp_path, power):
    found = joint(parted(tmp_path / "r", 0.0, power))
    assert found.admissible
    assert found.step.error_dph < FLOOR_DPH
    assert abs(found.step.dph) < 3 * found.step.error_dph
    assert "its parts agree" in found.sentence


@pytest.mark.parametrize("step_dph", [1.0, -0.5])
def test_a_new_turn_on_bias_is_found_with_its_size(tmp_path, step_dph):
    found = joint(parted(tmp_path / "r", step_dph))
    assert not found.admissible
    assert found.step.dph == pytest.approx(step_dph, abs=3 * found.step.error_dph)
    assert "NOT ADMISSIBLE" in found.sentence


def test_without_common_temperatures_nothing_is_shown_and_nothing_assumed(tmp_path):
    folder = parted(tmp_path / "r", 0.0, cut=0.9, overlap=False)  # up to 85 and never back
    found = joint(folder)
    assert (found.step, found.admissible) == (None, False)


def test_a_step_that_is_less_certain_than_the_floor_proves_nothing(tmp_path):
    found = joint(parted(tmp_path / "r", 0.0), floor_dph=1e-6)
    assert not found.admissible
    assert "too uncertain" in found.sentence


def test_a_run_of_one_piece_has_no_gap(tmp_path):
    folder = make_run(tmp_path / "r", **ramp_run())
    assert joints(RunFolder(folder).manifest(), load(folder, 30.0), FLOOR_DPH) == ()
    assert analyse(folder, diagnose=False).admissible


@pytest.mark.slow
def test_the_report_warns_and_the_calibration_says_that_it_is_not_admissible(tmp_path):
    folder = parted(tmp_path / "r", 1.0)
    result = analyse(folder, diagnose=False)
    assert "NOT ADMISSIBLE" in result.warnings[0]
    assert not result.within_limits
    assert json.loads((folder / "calibration.json").read_text())["verdict"]["admissible"] is False
    assert result.to_json()["gaps"][0]["unit_power"] == "lost"


def test_a_segment_that_was_cut_off_and_went_on_has_not_failed(tmp_path):
    run = ramp_run()
    cut = {**run["segments"][1], "outcome": "interrupted", "settled": False, "reason": "the bench was killed"}
    on = {**run["segments"][2], "name": f"{cut['name']} (resumed)"}
    segments = [run["segments"][0], cut, on, *run["segments"][3:]]
    folder = RunFolder(make_run(tmp_path / "r", run["columns"], segments))
    assert completeness(folder, folder.manifest(), None).failed == ()
    alone = RunFolder(make_run(tmp_path / "s", run["columns"], [run["segments"][0], cut]))
    assert len(completeness(alone, alone.manifest(), None).failed) == 1
