"""Isothermal runs of sister units have the same meaning wherever a run is diagnosed."""

import json
from pathlib import Path

import pytest

from tests.support.commands import bench
from tests.support.run_folders import Leg, make_run, ramp_run

LOOP = [("up", "ramp", 60.0, 2.0), ("down", "ramp", 0.0, 2.0), ("back", "ramp", 25.0, 2.0)]
STILL = [("soak at 25", "soak", 25.0, 2400.0)]
COMMANDS = {
    "diagnose": ("--model", "polynomial"),
    "decide": ("--model", "polynomial", "--quiet"),
    "report": ("--model", "polynomial"),
}


def folder_of(out: Path, unit: str, number: int, legs: list[Leg]) -> Path:
    return make_run(out / unit / f"r{number}", **ramp_run(legs, seed=number), unit=unit, run=f"r{number}")


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Path]:
    out = tmp_path_factory.mktemp("sisters")
    return folder_of(out, "U-1", 1, LOOP), folder_of(out, "U-1", 2, STILL), folder_of(out, "U-2", 3, STILL)


@pytest.mark.parametrize("command", COMMANDS)
def test_the_answer_says_which_sisters_told_the_noise(command: str, runs: tuple[Path, Path, Path]) -> None:
    run, still, sister = runs
    (run / "diagnosis.json").unlink(missing_ok=True)
    words = (command, run, *COMMANDS[command], "--static", still, "--sister", sister)
    bench(*words)  # the station that `decide` asks for has no such unit
    kept = json.loads((run / "diagnosis.json").read_text())
    assert (kept["static"], kept["sisters"]) == (still.name, [sister.name])


@pytest.mark.parametrize("command", COMMANDS)
def test_sisters_need_an_isothermal_run_of_the_unit(command: str, runs: tuple[Path, Path, Path]) -> None:
    run, _, sister = runs
    result = bench(command, run, *COMMANDS[command], "--sister", sister)
    assert result.exit_code == 2
    assert "compared with one of the unit itself; name it (--static)" in result.stderr
