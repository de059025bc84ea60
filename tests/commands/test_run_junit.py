"""JUnit XML of `bench run`: it says what the exit code says."""

import json
from pathlib import Path
from xml.etree import ElementTree

import pytest

from tests.support import acquisition
from tests.support.commands import bench

DOOR = {"at_s": 20, "fault": "alarm"}


def run(folder: Path, *options: str, **changes: object) -> tuple[int, ElementTree.Element]:
    profile, station, told = folder / "short.yaml", folder / "station.yaml", folder / "run.xml"
    profile.write_text(acquisition.SHORT)
    station.write_text(json.dumps(acquisition.station_content(**changes)))
    arguments = ["run", str(profile), "--station", str(station), "--out", str(folder), "--junit", str(told), *options]
    code = bench(*arguments, "--quiet").exit_code
    return code, ElementTree.parse(told).getroot()


def wrong(root: ElementTree.Element, tag: str) -> dict[str, str]:
    return {case.get("name"): found.get("message") for case in root.iter("testcase") for found in case.findall(tag)}


def test_a_run_that_proves_nothing_has_a_failing_verdict(tmp_path):
    code, root = run(tmp_path)
    assert code == 1
    assert (root.get("tests"), root.get("failures"), root.get("errors")) == ("5", "1", "0")
    assert "no model could be fitted" in wrong(root, "failure")["verdict"]
    names = [case.get("name") for case in root.iter("testcase")]
    assert names == ["run", "ramp to 24.5 at 2", "soak at 24.5", "record", "verdict"]
    assert float(root.get("time")) == pytest.approx(sum(float(case.get("time")) for case in root.iter("testcase")))


def test_a_run_that_a_guard_ended_has_an_error(tmp_path):
    code, root = run(tmp_path, faults=[DOOR])
    assert code == 3
    assert "chamber alarm" in wrong(root, "error")["run"]
    assert wrong(root, "failure").keys() == {"ramp to 24.5 at 2"}


def test_a_run_that_is_refused_has_an_error_and_takes_the_place_of_an_earlier_one(tmp_path):
    (tmp_path / "run.xml").write_text("of an earlier run")
    code, root = run(tmp_path, "--unit", "NOBODY")
    assert code == 2
    assert "unit 'NOBODY' is not in station" in wrong(root, "error")["run"]


def test_a_file_that_cannot_be_written_is_refused_before_anything_moves(tmp_path):
    (tmp_path / "file").write_text("")
    profile = tmp_path / "short.yaml"
    profile.write_text(acquisition.SHORT)
    told = str(tmp_path / "file" / "run.xml")
    answer = bench("run", profile, "--out", tmp_path / "out", "--junit", told)
    assert answer.exit_code == 2
    assert "cannot be written" in answer.stderr
    assert not (tmp_path / "out").exists()
