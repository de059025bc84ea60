"""Gyros that nobody described to the bench before: a DBC beside the station file, and what is said about it at once."""

import json
import re
from pathlib import Path

import pytest

from bench.acquisition.station.doctor import examine
from bench.base import read_yaml
from bench.commands.acquisition import load_station
from drivers.errors import ConfigError
from drivers.layout import layout_of
from tests.support.commands import bench

ROOT = Path(__file__).parents[2]
FAMILY = (ROOT / "drivers" / "gyros" / "vibratory.dbc").read_text()
REAL = """
name: own
chamber:
  map: watlow_f4t
  connection: {url: "tcp://192.0.2.17:502", device: 1}
  lowest_degc: -42
  highest_degc: 95
  heating_degc_per_min: 5
  cooling_degc_per_min: 3
buses:
  can0: {interface: socketcan, channel: can0}
units:
  - {serial: G-1, bus: can0, gyro: own.dbc}
"""


def check(station: Path, code: int) -> str:
    result = bench("check", ROOT / "profiles" / "quick.yaml", "--station", station)
    assert result.exit_code == code, result.output
    return result.output


@pytest.fixture
def station(tmp_path: Path) -> Path:
    (tmp_path / "own.dbc").write_text(FAMILY)
    (tmp_path / "station.yaml").write_text(REAL)
    return tmp_path / "station.yaml"


def test_the_station_that_the_page_describes_is_taken(tmp_path: Path) -> None:
    page = (ROOT / "docs" / "howto" / "equipment.md").read_text()
    (tmp_path / "station.yaml").write_text(page.split("```yaml\n")[1].split("```")[0])
    assert "units: G-1042" in check(tmp_path / "station.yaml", 0)


def test_the_dbc_is_beside_the_station_file(station: Path) -> None:
    assert load_station(station).units[0].gyro == str(station.parent / "own.dbc")
    (station.parent / "own.dbc").unlink()
    assert f"DBC {station.parent / 'own.dbc'}: No such file" in check(station, 2)


def test_check_counts_samples_at_the_rate_of_the_dbc(station: Path) -> None:
    (station.parent / "own.dbc").write_text(
        FAMILY.replace('"GenMsgCycleTime" BO_ 288 2', '"GenMsgCycleTime" BO_ 288 10')
    )
    said = check(station, 0)
    seconds = 3600 * 1.3
    count = int(said.partition(" samples (100 Hz)")[0].rpartition(" ")[2].replace(",", ""))
    assert count == pytest.approx(100 * seconds, rel=0.05)


def test_check_says_what_is_lost_by_what_the_unit_does_not_say(station: Path) -> None:
    (station.parent / "own.dbc").write_text(FAMILY.replace(" SG_ Temperature ", " SG_ Warmth "))
    assert "unit G-1: no thermometer: the air of the chamber takes its place" in check(station, 0)


SHORT = """
name: short
segments:
  - {kind: soak, duration_min: 0.3}
"""


def test_a_run_keeps_the_dbc_that_its_frames_are_read_by(tmp_path: Path) -> None:
    simulated = (ROOT / "profiles" / "stations" / "simulated.yaml").read_text()
    (tmp_path / "station.yaml").write_text(simulated.replace("identity: 1", "identity: 1\n    gyro: own.dbc"))
    (tmp_path / "short.yaml").write_text(SHORT)
    (tmp_path / "own.dbc").write_text(FAMILY)
    place = ("--station", tmp_path / "station.yaml", "--out", tmp_path / "out", "--quiet")
    bench("run", tmp_path / "short.yaml", *place)
    (run,) = (tmp_path / "out" / "SIM-0001").glob("2*")
    assert "layout.dbc" in json.loads((run / "manifest.json").read_text())["files"]
    assert re.search(r" SG_ Rate .*\(([^,]+),", FAMILY)
    (tmp_path / "own.dbc").write_text(re.sub(r"( SG_ Rate [^(]*\()[^,]+,", r"\g<1>2,", FAMILY))
    again = bench("replay", run)
    assert again.exit_code == 0, again.output
    (tmp_path / "own.dbc").unlink()
    assert bench("replay", run).exit_code == 0


def test_doctor_names_what_the_layout_has_and_nobody_sends(tmp_path: Path) -> None:
    simulated = (ROOT / "profiles" / "stations" / "simulated.yaml").read_text()
    (tmp_path / "station.yaml").write_text(simulated.replace("identity: 1", "identity: 1\n    gyro: own.dbc"))
    (tmp_path / "own.dbc").write_text(FAMILY)
    settings = load_station(tmp_path / "station.yaml")
    warmth = "\n".join(line for line in FAMILY.splitlines() if " SG_ Temperature " not in line)
    (tmp_path / "own.dbc").write_text(warmth)
    found = {(one.what, one.verdict): one.detail for one in examine(settings, 0.5).findings}
    assert "no thermometer" in found["unit SIM-0001", "unknown"]


def test_doctor_proposes_a_mapping_that_reads_as_the_dbc_does(tmp_path: Path) -> None:
    target = tmp_path / "units.yaml"
    answer = bench("doctor", "--listen", "1.5", "--propose", target, "--json")
    assert answer.exit_code == 0, answer.output
    assert json.loads(answer.stdout)["file"] == str(target)
    signals = read_yaml(target).content["units"][0]["signals"]
    rate = {"id": 0x120, "start": 0, "length": 32, "type": "signed", "scale": 1.0, "unit": "CONFIRM", "cycle_ms": 2.0}
    assert signals["rate"] == rate
    assert signals["temperature"]["id"] == 0x130
    assert (signals["temperature"]["start"], signals["temperature"]["scale"]) == (32, 0.005)
    assert signals["counter"][0] == {"id": 0x120, "start": 32, "length": 16}
    with pytest.raises(ConfigError, match=r"'CONFIRM' is not a unit that is known; rate may be in deg/h"):
        layout_of(None, signals)
    confirmed = layout_of(None, {**signals, "rate": {**rate, "scale": 1e-6, "unit": "deg/s"}})
    assert confirmed.interval_ms == layout_of("vibratory").interval_ms
