"""Logs of other programs, from `bench import` to report, export and certificate, as a user gives the commands."""

import json
from pathlib import Path

import numpy as np
import pytest

from tests.support.commands import bench

LABORATORY = """
laboratory: {name: Example Laboratory, address: 1 Example Road}
authorised_by: {name: A. Example, function: head of laboratory}
"""
EQUIPMENT = """
equipment:
  - {name: thermometer, model: Pt100, serial: T-1, certificate: C-1, calibrated: 2000-01-01, due: 2999-12-31,
     uncertainty: [{value: 0.1, unit: degC}]}
"""


def log(path: Path) -> Path:
    """A log of one loop 25 → -30 → 70 → 25 degC, one row a second, no soak: what a laboratory without the bench has."""
    time = np.arange(7200.0)
    degc = np.interp(time / time[-1], [0, 0.25, 0.75, 1], [25, -30, 70, 25])
    x, random = (degc - 20) / 50, np.random.default_rng(1)
    rate = 30 + 40 * x + 15 * x**2 - 8 * x**3 + random.normal(0, 25, time.size)
    table = np.column_stack([time, rate, degc + random.normal(0, 0.01, time.size)])
    np.savetxt(path, table, delimiter=",", header="time_s,rate_dph,temp_degC", comments="", fmt="%.4f")
    return path


def told(*args: object, code: int = 0) -> str:
    result = bench(*args)
    assert result.exit_code == code, result.output
    return result.output


@pytest.fixture(scope="module")
def imported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("imported")
    told("import", log(place / "loop.csv"), "--unit", "G-1042", "--out", place / "reports")
    run = next((place / "reports" / "G-1042").iterdir())
    told("report", run, "--model", "polynomial")
    return run


def test_a_log_over_a_whole_loop_is_proved_by_its_own_blocks(imported: Path) -> None:
    said = json.loads((imported / "calibration.json").read_text())
    assert said["verdict"]["sentence"].startswith("Imported, ")
    assert "on unseen data" in said["verdict"]["sentence"]
    assert said["refusals"] == []
    assert said["residual"]["held_out"][0]["rms_dph"] == pytest.approx(25 / np.sqrt(30), rel=0.2)


def test_the_calibration_of_a_log_is_exported(imported: Path, tmp_path: Path) -> None:
    told("export", imported, "--format", "c", "--out", tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"calibration.c", "calibration.h"}


def test_a_log_is_certified_where_a_laboratory_signs_for_it(imported: Path, tmp_path: Path) -> None:
    laboratory, equipment = tmp_path / "laboratory.yaml", tmp_path / "equipment.yaml"
    laboratory.write_text(LABORATORY)
    equipment.write_text(EQUIPMENT)
    said = told("certificate", imported, code=2)
    assert "no laboratory and no signatory" in said
    assert said.count("\n") == 1
    told("certificate", imported, "--laboratory", laboratory, "--equipment", equipment)
    assert (imported / "certificate.pdf").read_bytes().startswith(b"%PDF")
