"""`bench decide`: the bench makes the runs that its diagnosis proposes, until the cause is known."""

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from click.testing import CliRunner

from bench.acquisition.run.runner import run_job
from bench.acquisition.station.settings.station import StationSettings
from bench.base import config
from bench.cli import main
from bench.commands import Diagnosed, deciding
from tests.support import acquisition
from tests.support.run_folders import make_run, ramp_run

STATION = """
name: loop
simulated: true
seed: 1
ambient_degc: 23
chamber:
  map: watlow_f4t
  lowest_degc: 5
  highest_degc: 55
  heating_degc_per_min: 5
  cooling_degc_per_min: [[0, 2.3], [23, 3.0], [55, 4.0]]
buses:
  can0: {interface: blocks, channel: bench}
units:
  - serial: U-1
    bus: can0
    number: 0
    signals:  # 25 samples a second: what is decided comes from means of many seconds
      rate: {id: 0x120, type: signed, start: 0, length: 32, scale: 1e-6, unit: deg/s}
      temperature: {id: 0x120, type: signed, start: 32, length: 16, scale: 0.01, unit: degC}
      counter: {id: 0x120, start: 48, length: 16}
      cycle_ms: 40
    simulation:
      rate:
        truth:
          - {mechanism: static_bias, coefficients_dph: [-6.5, 8.0, -1.6, 0.7], reference_degc: 25}
          - {mechanism: preisach, amplitude_dph: 3.5}
        noise: {angle_random_walk: 0.008, bias_instability: 0.02, rate_random_walk: 0.008}
"""
PROFILE = """
name: one_rate
start: {temperature_degc: 25}
settle: {dwell_min: 2, slope_degc_per_min: 0.2}
segments:
  - {kind: ramp, to_degc: 50, rate_degc_per_min: 0.8}
  - {kind: soak, duration_min: 10}
  - {kind: ramp, to_degc: 10, rate_degc_per_min: 0.8}
  - {kind: ramp, to_degc: 25, rate_degc_per_min: 0.8}
"""


def bench(*words: object) -> tuple[int, str, str]:
    result = CliRunner().invoke(main, list(map(str, words)))
    return result.exit_code, result.stdout, result.stderr


@pytest.mark.slow
def test_a_tie_is_decided_by_the_runs_that_the_bench_makes_itself(tmp_path: Path) -> None:
    station, out = tmp_path / "station.yaml", tmp_path / "reports"
    station.write_text(STATION)
    settings = config.load_config(config.read_yaml(station), StationSettings)
    first = run_job(acquisition.job(out, PROFILE, settings)).run.path

    common = ("--station", station, "--out", out, "--quiet")
    code, text, _ = bench("decide", first, "--model", "polynomial", *common, "--json")

    answer = json.loads(text)
    assert set(answer) == {"decided", "reason", "rounds", "diagnosis", "registry"}
    (made,) = [one for one in answer["rounds"] if one["run"]]
    assert (code, answer["decided"]) == (0, True)
    assert Path(made["run"]).parent == out / "U-1"
    assert answer["diagnosis"]["runs"] == [first.name, Path(made["run"]).name]
    assert [s["effect"] for s in answer["diagnosis"]["suspects"] if s["found"]] == ["hysteresis"]
    assert answer["diagnosis"]["next_experiment"] is None


def test_what_the_runs_decide_already_needs_no_station(tmp_path: Path) -> None:
    run = make_run(tmp_path / "reports" / "U-1" / "r1", **ramp_run(), unit="U-1", run="r1")
    code, text, error = bench("decide", run, "--model", "spline", "--json")
    assert not error
    answer = json.loads(text)
    assert answer["diagnosis"]["next_experiment"] is None
    assert (code, answer["decided"], answer["rounds"]) == (0, True, [])


def test_no_simulated_run_is_made_beside_real_ones(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run = make_run(tmp_path / "reports" / "U-1" / "r1", **ramp_run(), unit="U-1", run="r1", simulated=False)
    proposed = {"use": "run", "why": "it tells", "decides": True}
    open_ = Diagnosed(SimpleNamespace(next_experiment=proposed))
    monkeypatch.setattr(deciding, "diagnose", lambda *_, **__: open_)
    code, _, error = bench("decide", run, "--model", "spline", "--out", tmp_path / "reports")
    assert code == 2
    assert "r1 is of real equipment, and the proposed run would be simulated: name the station" in error
    assert len(error.splitlines()) == 1
    assert list((tmp_path / "reports" / "U-1").iterdir()) == [run]


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({}, "none.yaml: no such file"),
        ({"station.yaml": STATION.replace("U-1", "U-2")}, "unit 'U-1' is not in station 'loop'; choose from U-2"),
        ({"station.yaml": STATION.replace("seed: 1", "seed: x")}, "station.yaml:4: seed"),
        ({"station.yaml": STATION, "out": "a file"}, "out: cannot be written: it is no folder"),
        ({"station.yaml": STATION, "simulated": False}, "would be simulated: name the station that has the unit"),
    ],
)
def test_what_would_end_the_command_is_told_before_any_diagnosis(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, changed: dict[str, Any], words: str
) -> None:
    simulated = changed.pop("simulated", True)
    station = tmp_path / ("station.yaml" if changed else "none.yaml")
    for name, text in changed.items():
        (tmp_path / name).write_text(text)
    run = make_run(tmp_path / "reports" / "U-1" / "r1", **ramp_run(), unit="U-1", run="r1", simulated=simulated)
    monkeypatch.setattr(deciding, "diagnose", lambda *_, **__: pytest.fail("diagnosed"))
    code, _, error = bench("decide", run, "--model", "spline", "--station", station, "--out", tmp_path / "out")
    assert code == 2
    assert words in error
    assert len(error.splitlines()) == 1
    assert list((tmp_path / "reports" / "U-1").iterdir()) == [run]
