"""Station files are checked whole; a real station is driven through a process of its own on every bus."""

import json
import os
import signal
import time
from datetime import UTC, datetime

import pytest

from bench.acquisition.recording.journals import read_bench
from bench.acquisition.recording.recorder import Recorder
from bench.acquisition.station.serve import serve_station
from bench.acquisition.station.settings.station import StationSettings
from bench.acquisition.station.station import open_station
from bench.base import config
from bench.base.errors import EquipmentError, InputError
from bench.record import Begun, RunFolder, create_run
from drivers.clock import WallClock
from drivers.errors import LinkError
from drivers.journal import Damage
from tests.support import acquisition
from tests.support.waiting import PATIENCE_S, until

CHAMBER = {
    "map": "watlow_f4t",
    "connection": {"url": "tcp://127.0.0.1:1"},
    "lowest_degc": -40.0,
    "highest_degc": 85.0,
    "heating_degc_per_min": 3.0,
    "cooling_degc_per_min": [[-40, 1], [85, 3]],
}
REAL = {
    "name": "bench 3",
    "chamber": CHAMBER,
    "buses": {"can0": {"interface": "socketcan", "channel": "can0"}},
    "units": [{"serial": "G1", "bus": "can0"}, {"serial": "G2", "bus": "can0", "number": 1}],
}


def load(content):
    return config.load_config(config.parse_yaml(json.dumps(content, indent=1), "s.yaml"), StationSettings)


def test_a_real_station_is_read():
    station = load(REAL)
    assert not station.simulated
    assert station.seeds("") == {}
    assert [unit.number for unit in station.chosen(["G2"])] == [1]
    assert station.limits().low_degc == -40.0


@pytest.mark.parametrize(
    ("physics", "words"),
    [
        ({"heater_w": 900}, "only a simulated chamber has it; this station is real"),
        ({"ambient_degc": 20}, "the room has the station's ambient_degc; remove it here"),
        ({"heater_kw": 1}, "heater_kw"),
    ],
)
def test_the_physics_of_a_chamber_are_those_of_a_simulated_one(physics, words):
    with pytest.raises(InputError, match=words):
        load({**REAL, "chamber": {**CHAMBER, "simulation": physics}})


def test_a_watchdog_that_would_take_a_slow_chamber_for_a_hanging_bench_is_refused():
    slow = {**CHAMBER, "connection": {"url": "tcp://127.0.0.1:1", "timeout_s": 2.0}}
    text = json.dumps({**REAL, "chamber": slow, "watchdog": {"silent_s": 10.0}})
    with pytest.raises(InputError, match=r"silent_s is 10: .* up to 6 times its timeout_s, 2; raise it"):
        config.load_config(config.parse_yaml(text, "station.yaml"), StationSettings)


def test_the_embedded_station_has_one_unit_that_needs_no_naming():
    station = acquisition.station()
    assert [unit.serial for unit in station.chosen()] == ["SIM-0001"]
    assert station.seeds("")["station"] == 1


def test_all_units_run_where_none_is_named_and_a_name_has_to_be_known():
    station = load(REAL)
    assert [unit.serial for unit in station.chosen()] == ["G1", "G2"]
    assert [unit.serial for unit in station.chosen(["G2", "G1", "G2"])] == ["G2", "G1"]
    with pytest.raises(
        InputError,
        match=r"unit 'G3' is not in station 'bench 3'; choose from G1, G2, or write G3@G1 for a new unit",
    ):
        station.chosen(["G1", "G3"])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"ambient_degc": 100.0}, "ambient_degc is 100, outside the chamber's -40 to 85 degC: there would be no safe"),
        ({"chamber": {**CHAMBER, "connection": None}}, "a real station needs a `connection`"),
        ({"chamber": {**CHAMBER, "lowest_degc": 90.0}}, "must be below highest_degc"),
        ({"buses": {"can0": {"interface": "virtual", "channel": "x"}}}, "a real one never does; this one is on 'virt"),
        ({"simulated": True}, "a simulated station runs on virtual or blocks"),
        ({"units": [{"serial": "G1", "bus": "can1"}]}, "bus 'can1' is not in this station; known: can0"),
        ({"units": [{"serial": "G1", "bus": "can0"}] * 2}, "serial number G1 stands twice"),
        ({"units": [{"serial": s, "bus": "can0"} for s in "AB"]}, "B and A are both number 0 on can0"),
        (
            {"units": [{"serial": s, "bus": "can0", "number": n, "identity": 7} for n, s in enumerate("AB")]},
            "units[1].identity: identity is 7, as that of A on can0",
        ),
        ({"guards": [{"name": "g", "signal": "alarm"}]}, "at least one of above, below, rate_per_min"),
        (
            {"unit_silent_s": 9.0, "guards": [{"name": "unit silent", "signal": "frame_age", "above": 7.0}]},
            "unit_silent_s is 9: the guard `unit silent` ends the run of all units before, at 7 s",
        ),
        ({"untis": []}, "unknown key 'untis'; did you mean 'units'"),
    ],
)
def test_what_is_wrong_in_a_station_file_is_said_with_its_line(change, message):
    with pytest.raises(InputError) as caught:
        load({**REAL, **change})
    assert message in str(caught.value)
    assert str(caught.value).startswith("s.yaml:")


@pytest.fixture
def real(tmp_path):
    """A station behind servers, opened as if it were real, captured into a run folder."""
    with serve_station(acquisition.station()) as served:
        settings = load(served.station_file())
        (tmp_path / "journal").mkdir()
        with open_station(settings, settings.units) as station:
            recorder = Recorder(RunFolder(tmp_path), station.clock, Begun(run="r"))
            station.start_capture(recorder)
            yield served.station, station
            station.stop_capture()
            recorder.close()


def poll_until(station, condition):
    """Poll as the sequencer does, without its second of waiting."""
    deadline_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline_s
        station.poll()


def test_a_real_bus_is_captured_in_a_process_and_decoded_here(real):
    world, station = real
    (unit,) = station.units
    assert isinstance(station.clock, WallClock)
    assert "SIM-0001: no sound rate frame as number 0 on bus can0 (loopcan" in station.missing_units()[0]
    for step in range(20):  # 0.4 s at once: more would look late to a bus on wall time
        world.advance(step * 0.02, (step + 1) * 0.02)
    poll_until(station, lambda: unit.decoder.samples == 200)
    assert station.missing_units() == []
    assert unit.decoder.identity.serial == 1
    assert 0 <= station.clock.now() - unit.newest_frame_s < 20  # bench time, not calendar time
    assert unit.temperature.value == pytest.approx(23, abs=3)
    assert station.losses()["received"] == 200 + 20 + 20 + 1 + 1 + 1


def test_what_arrives_last_is_taken_before_the_capture_ends(real):
    world, station = real
    (unit,) = station.units
    world.advance(0.0, 0.2)
    poll_until(station, lambda: unit.decoder.samples == 100)
    world.advance(0.2, 0.4)
    (capture,) = station._captures.values()
    until(lambda: capture.health().frames >= 240)
    station.stop_capture()
    assert unit.decoder.samples == 200
    station.stop_capture()


def test_the_chamber_is_driven_over_its_real_link(real):
    world, station = real
    station.chamber.set_point(30.0)
    station.chamber.start()
    station._recorder.sync()
    events = read_bench(station._recorder.run, Damage()).events
    assert (world.chamber.commands().setpoint, world.chamber.commands().on) == (30.0, True)
    assert [event["register"] for event in events if event["kind"] == "write"] == ["setpoint", "mode"]


def test_a_capture_that_dies_is_a_failure_of_the_equipment(real):
    _, station = real
    (capture,) = station._captures.values()
    os.kill(capture.pid, signal.SIGKILL)
    with pytest.raises(EquipmentError, match="bus can0 is lost: capture process ended"):
        poll_until(station, lambda: False)


def test_a_bus_whose_capture_dies_takes_its_units_with_it_and_leaves_the_others(tmp_path):
    folders = [create_run(tmp_path, serial, "p", datetime.now(UTC)) for serial in ("G1", "G2")]
    units = [{"serial": f"G{n}", "bus": f"can{n}", "identity": n} for n in (1, 2)]
    buses = {name: {"interface": "blocks", "channel": name} for name in ("can1", "can2")}
    with serve_station(acquisition.station(buses=buses, units=units)) as served:
        content = served.station_file()
        for bus in content["buses"].values():
            bus["link"] = {"degraded_after_s": 0.1, "lost_after_s": 0.2}
        settings = load(content)
        with open_station(settings, settings.units) as station:
            recorder = Recorder(folders[0], station.clock, Begun(), (folders[1], Begun()))
            station.start_capture(recorder)
            served.station.advance(0.0, 1.0)
            poll_until(station, lambda: all(unit.missing() is None for unit in station.units))
            os.kill(station._captures["can2"].pid, signal.SIGKILL)
            poll_until(station, lambda: station.dropped)
            assert [unit.serial for unit in station.units] == ["G1"]
            assert station.dropped[0].reason == "bus can2 is lost: capture process ended (exit code -9)"
            station.poll()
            station.stop_capture()
            recorder.close()
            events = read_bench(folders[0], Damage()).events
            assert [event["state"] for event in events if event["kind"] == "link"] == ["lost"]
            assert [event["unit"] for event in events if event["kind"] == "dropped"] == ["G2"]
            assert read_bench(folders[1], Damage()).end()["state"] == "failed"


def test_a_chamber_that_does_not_answer_is_known_before_a_run_folder_exists():
    settings = load(REAL)
    with pytest.raises(LinkError), open_station(settings, settings.units[:1]):
        pass


def test_the_supply_of_older_station_files_is_told_its_new_form():
    with pytest.raises(InputError, match=r"s.yaml:\d+: .*instruments: \[\{name: supply, address"):
        load({**REAL, "supply": {"port": "/dev/ttyUSB1"}})
