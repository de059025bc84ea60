"""`bench doctor`: a sound station agrees, each fault is named, and nothing is ever written."""

from __future__ import annotations

import json
from contextlib import contextmanager
from importlib.resources import files
from pathlib import Path

import pytest

from bench.acquisition.station.doctor import examine
from bench.acquisition.station.serve import serve_station
from bench.acquisition.station.settings.station import StationSettings
from bench.commands.acquisition import load_station
from drivers.errors import ConfigError
from drivers.registers import load_map
from tests.support import acquisition
from tests.support.commands import bench


@contextmanager
def live():
    """The servers of `bench sim`, running, and the station file that drives them as equipment."""
    with acquisition.elsewhere(load_station(None)) as served:
        yield served, served.station_file()


def look(content, listen_s=0.5):
    return examine(StationSettings.model_validate_json(json.dumps(content)), listen_s)


def said(found, what):
    return next(finding for finding in found.findings if finding.what.startswith(what))


def test_a_simulated_station_agrees_with_itself():
    found = examine(load_station(None))
    assert found.exit_code == 0
    assert said(found, "unit SIM-0001").detail.endswith("as number 0, serial number 1")
    assert said(found, "register compressor").uncertain


@pytest.mark.parametrize(
    "station", sorted((Path(__file__).parents[2] / "profiles" / "stations").glob("*.yaml")), ids=lambda p: p.stem
)
def test_every_shipped_simulated_station_agrees_with_itself(station):
    settings = load_station(station)
    if not settings.simulated:
        pytest.skip("describes real equipment")
    found = examine(settings, 0.3)
    assert found.exit_code == 0, [one for one in found.findings if one.verdict in {"disagrees", "no link"}]


def test_the_servers_of_bench_sim_agree_with_their_station_file_and_nothing_is_written():
    with live() as (served, content):
        chamber = served.station.chamber
        before = {name: chamber.words(name) for name in ("setpoint", "mode", "ramp_action", "ramp_rate")}
        found = look(content)
        assert found.exit_code == 0, found.findings
        assert {name: chamber.words(name) for name in before} == before
    assert said(found, "bus can0").verdict == "agrees"
    assert set(found.latency_s) == {"worst", "median", "timeout"}
    registers = {finding.what.split()[1] for finding in found.findings if finding.what.startswith("register ")}
    assert registers == set(load_map("watlow_f4t").registers)


@pytest.mark.parametrize(
    ("register", "value", "what", "text"),
    [
        ("temperature_unit", "fahrenheit", "rule temperature_unit", "degF"),
        ("setpoint_high", 60.0, "setpoint_high", "controller 60 degC"),
        ("profile_state", "running", "register profile_state", "alarm"),
    ],
)
def test_what_disagrees_is_named(register, value, what, text):
    with serve_station(load_station(None)) as served:
        served.station.chamber.set_value(register, value)
        found = look(served.station_file(), 0.1)
    assert (said(found, what).verdict, found.exit_code) == ("disagrees", 1)
    assert text in said(found, what).detail


def test_a_value_that_cannot_be_true_is_named_and_all_else_still_told():
    with serve_station(load_station(None)) as served:
        served.station.chamber.set_words("temperature", (0x41C8, 0x0000))
        found = look(served.station_file(), 0.1)
    assert "word order" in said(found, "register temperature (").detail
    assert said(found, "identification").verdict == "disagrees"
    assert said(found, "register alarm_4").verdict == "told"


@pytest.mark.slow
def test_a_unit_that_is_not_heard_or_is_another_one_is_named():
    with live() as (_, content):
        content["units"][0]["identity"] = 4711
        assert "4711" in said(look(content), "unit SIM-0001").detail
        content["units"][0]["number"] = 3
        found = look(content)
    assert said(found, "unit SIM-0001").detail.startswith("0 samples")
    assert found.exit_code == 1


def test_equipment_that_is_not_there_is_no_link():
    with serve_station(load_station(None)) as served:
        content = served.station_file()
    found = look(content, 0.1)
    assert said(found, "chamber").verdict == "no link"
    assert said(found, "bus can0").verdict == "no link"
    assert found.exit_code == 4


def test_the_command_answers_in_json_and_by_its_exit_code(tmp_path):
    result = bench("doctor", "--json", "--listen", "0.2")
    assert result.exit_code == 0
    assert json.loads(result.stdout)["agrees"] is True
    assert bench("doctor", tmp_path / "absent.yaml").exit_code == 2


@pytest.fixture
def own_map(tmp_path):
    """A station file with a register map beside it."""
    folder = tmp_path / "mine"
    folder.mkdir()
    text = (files("drivers") / "chambers" / "watlow_f4t.yaml").read_text()
    (folder / "mine.yaml").write_text(text.replace("Watlow F4T", "My chamber"))
    content = load_station(None).model_dump(mode="json", exclude_defaults=True)
    content["chamber"]["map"] = "mine.yaml"
    (folder / "station.yaml").write_text(json.dumps(content))
    return folder


def test_a_map_is_looked_for_beside_the_station_file(own_map):
    station = load_station(own_map / "station.yaml")
    assert load_map(station.chamber.map).model == "My chamber"
    assert said(examine(station, 0.2), "identification").detail.startswith("My chamber")


def test_the_contract_is_tried_on_a_map_of_ones_own(own_map):
    arguments = ["doctor", str(own_map / "station.yaml"), "--contract", "--json"]
    good = bench(*arguments)
    assert (good.exit_code, json.loads(good.stdout)["agrees"]) == (0, True)
    text = (own_map / "mine.yaml").read_text()
    (own_map / "mine.yaml").write_text(text.replace("pattern: ^celsius$", "pattern: ."))
    assert bench(*arguments).exit_code == 1
    (own_map / "mine.yaml").write_text(text.replace("address: 2782", "adress: 2782"))
    refused = bench(*arguments)
    assert refused.exit_code == 2
    assert "did you mean address?" in refused.stderr


def test_a_map_that_is_missing_says_where_it_was_looked_for(own_map):
    (own_map / "mine.yaml").unlink()
    with pytest.raises(ConfigError, match=r"mine/mine\.yaml"):
        examine(load_station(own_map / "station.yaml"))
