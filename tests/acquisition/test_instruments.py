"""Instruments of a station: recorded, guarded, off in the safe state, a fault when they fall silent."""

import json
import subprocess
import sys
import threading
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner

from bench.acquisition.recording.assemble import assemble
from bench.acquisition.run.runner import run_job
from bench.acquisition.station.doctor import Examination, examine
from bench.acquisition.station.doctor import _instrument as _instrument_of
from bench.acquisition.station.instruments import Instruments, switch_off
from bench.acquisition.station.serve import serve_station
from bench.acquisition.station.settings.instrument import InstrumentSettings
from bench.acquisition.station.settings.station import StationSettings
from bench.analysis.effects.expression import Expression
from bench.base import EquipmentError, InputError, load_config, parse_yaml
from bench.cli import main
from bench.record import RunFolder, load, open_run
from drivers.clock import WallClock
from drivers.instrument import Instrument
from drivers.sim.instrument import ScpiInstrument
from tests.support import acquisition

ROOT = Path(__file__).parents[2]

THERMOMETER = {
    "name": "thermometer",
    "identity": "2210001",
    "read": [
        {"channel": "reference_temperature", "query": "READ? 1", "answer": "{any},{value},K", "unit": "K",
         "offset": 0.01, "low": -80, "high": 150},
    ],
}  # fmt: skip
HEATER = {
    "name": "heater",
    "set": [{"command": "VOLT 12.0", "query": "VOLT?", "value": 12, "tolerance": 0.01}],
    "on": {"command": "OUTP ON,(@2)", "query": "OUTP? (@2)", "value": 1},
    "off": {"command": "OUTP OFF,(@2)", "query": "OUTP? (@2)", "value": 0},
    "read": [
        {"channel": "voltage", "query": "MEAS:VOLT? (@2)", "period_s": 2},
        {"channel": "current", "query": "MEAS:CURR? (@2)", "unit": "mA"},
    ],
}
HYGROMETER = {
    "name": "hygrometer",
    "optional": True,
    "link": {"degraded_after_s": 2, "lost_after_s": 5},
    "read": [{"channel": "humidity", "modbus": {"address": 3, "type": "int16", "read": 4, "scale": 0.1}}],
}
ALL = [THERMOMETER, HEATER, HYGROMETER]


def station(*instruments, **more):
    return acquisition.station(instruments=list(instruments or ALL), **more)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    result = run_job(acquisition.job(tmp_path_factory.mktemp("measured"), settings=station()))
    assert result.error is None
    return open_run(result.run.path)


def test_what_instruments_measure_stands_beside_the_chamber(run):
    data = load(run.path, 5.0)
    for channel, value in {"voltage": 5.0, "current": 0.02, "humidity": 12.0}.items():
        assert data.channel(channel) == pytest.approx(value)
    apart = data.channel("reference_temperature") - data.channel("chamber_temperature")
    assert np.nanmax(np.abs(apart)) < 0.6  # the chamber's own sensor lags and shows tenths
    read = pq.read_table(run.path / "means.parquet")["voltage"].to_numpy()
    assert 0.45 < np.mean(np.isfinite(read)) < 0.55  # every 2 s: the recording has what was read alone
    again = assemble(RunFolder(run.path))
    assert again.files == run.manifest().files


def test_a_formula_may_use_them(run):
    effect = Expression(formula="a*(reference_temperature - 25) + b*humidity")
    assert effect.needs == ("reference_temperature", "humidity")
    record = load(run.path, 5.0)
    columns = effect.columns(record, {})
    assert columns[:, 0] == pytest.approx(record.channel("reference_temperature") - 25)


def test_they_are_set_before_the_run_and_off_after_it(world, tmp_path):
    result = run_job(acquisition.job(tmp_path, settings=station()))
    assert result.error is None
    heater = world[0].instruments["heater"]
    written = [text for text in heater.server.told if "?" not in text]
    assert written == ["VOLT 12.0", "OUTP ON,(@2)", "OUTP OFF,(@2)"]
    assert not heater.on
    events = open_run(result.run.path).events()
    said = [event["text"] for event in events if event["kind"] == "instrument"]
    assert said[0] == "thermometer: BENCH,SIMULATED,2210001,1.0"
    assert "heater: VOLT 12.0, read back" in said
    steps = [event for event in events if event["kind"] == "safe_state" and "heater" in event["text"]]
    assert [(step["text"], step["ok"]) for step in steps] == [("instrument heater: OUTP OFF,(@2), read back", True)]


def test_one_that_stops_answering_ends_the_run_in_the_safe_state(world, tmp_path):
    def gone():
        world[0].instruments["thermometer"].close()

    settings = station(THERMOMETER | {"timeout_s": 0.2, "link": {"degraded_after_s": 2, "lost_after_s": 5}}, HEATER)
    result = run_job(
        acquisition.job(tmp_path, acquisition.LONG, settings), acquisition.at(20.0, lambda station: gone())
    )
    assert isinstance(result.error, EquipmentError)
    assert str(result.error).startswith("instrument thermometer link lost for 5 s: thermometer: ")
    assert not world[0].instruments["heater"].on
    events = open_run(result.run.path).events()
    assert all(event["ok"] for event in events if event["kind"] == "safe_state" and "ok" in event)


@pytest.mark.parametrize("said", ["garbage", "1,NAN,K", "1,1e400,K", "1,0,K", "", "9" * 5000])
def test_answers_that_are_none_end_the_run_as_silence_does(world, tmp_path, said):
    def spoil(_):
        world[0].instruments["thermometer"].server.take = lambda line: said

    settings = station(THERMOMETER | {"link": {"degraded_after_s": 2, "lost_after_s": 5}}, HEATER)
    result = run_job(acquisition.job(tmp_path, acquisition.LONG, settings), acquisition.at(20.0, spoil))
    assert result.error.exit_code == 4
    assert len(str(result.error)) < 200
    assert str(result.error).startswith("instrument thermometer link lost for 5 s: ")
    assert not world[0].instruments["heater"].on
    shown = load(result.run.path, 1.0).channels["reference_temperature"]
    assert np.isfinite(shown[5:18]).all()
    assert np.isnan(shown[22:]).all()


def test_the_silence_of_an_optional_one_is_noted(world, tmp_path):
    def gone():
        world[0].instruments["hygrometer"].close()

    result = run_job(acquisition.job(tmp_path, settings=station()), acquisition.at(10.0, lambda station: gone()))
    assert result.error is None
    states = [event["state"] for event in open_run(result.run.path).events() if event["kind"] == "link"]
    assert states[-1] == "lost"
    humidity = load(result.run.path, 1.0).channels["humidity"]
    assert np.isfinite(humidity).any()
    assert np.isnan(humidity[-10:]).all()


def test_one_that_does_not_obey_ends_the_run_before_anything_moves(world, tmp_path, monkeypatch):
    monkeypatch.setattr(
        ScpiInstrument, "disobeys", property(lambda self: True, lambda self, value: None), raising=False
    )
    result = run_job(acquisition.job(tmp_path, settings=station()))
    assert "heater: VOLT 12.0 was sent, and 0 is read back instead of 12.0" in str(result.error)


def test_another_instrument_at_the_address_is_refused(tmp_path, world):
    with serve_station(station(THERMOMETER)) as served:
        content = served.station_file()
        content["instruments"][0]["identity"] = "2210002"
        found = examine(StationSettings.model_validate_json(json.dumps(content)), 0.1)
    verdicts = {finding.what: (finding.verdict, finding.detail) for finding in found.findings}
    assert verdicts["instrument thermometer"] == (
        "disagrees", "thermometer is 'BENCH,SIMULATED,2210001,1.0', the station file says '2210002'",
    )  # fmt: skip


def test_one_that_shows_the_same_is_rehearsed(tmp_path):
    faults = [{"at_s": 20, "on": "thermometer", "fault": "frozen", "for_s": 20}]
    result = run_job(acquisition.job(tmp_path, settings=station(THERMOMETER, faults=faults)))
    record = load(result.run.path, 1.0)
    shown = record.channels["reference_temperature"]
    frozen = (record.time > 23) & (record.time < 38) & np.isfinite(shown)
    assert np.ptp(shown[frozen]) == 0
    assert np.ptp(shown[np.isfinite(shown)]) > 0.1


def test_a_guard_watches_what_an_instrument_measures(world, tmp_path):
    def sag(station):
        world[0].instruments["heater"].shown["voltage"] = 3.0

    guard = {"name": "heater sags", "signal": "voltage", "below": 4.5, "max_age_s": 10, "action": "abort"}
    result = run_job(acquisition.job(tmp_path, settings=station(guards=[guard])), acquisition.at(20.0, sag))
    assert "aborted by guard: heater sags: voltage = 3 V is below 4.5 V" in str(result.error)
    assert not world[0].instruments["heater"].on


def test_doctor_asks_each_once(tmp_path):
    found = examine(station(), 0.1)
    told = {finding.what: (finding.verdict, finding.detail) for finding in found.findings if "instr" in finding.what}
    assert told["instrument thermometer"] == ("agrees", "BENCH,SIMULATED,2210001,1.0")
    verdict, detail = told["instrument thermometer reference_temperature"]
    assert (verdict, float(detail.removesuffix(" degC"))) == ("told", pytest.approx(23.0, abs=1.0))
    assert told["instrument hygrometer humidity"] == ("told", "12 %")
    assert told["instrument heater OUTP ON,(@2)"] == ("told", "is not set now; a run sets it")


@pytest.mark.parametrize(
    ("instruments", "said"),
    [
        ([THERMOMETER, {**HYGROMETER, "name": "thermometer"}], "'thermometer' stands twice"),
        ([THERMOMETER, {**THERMOMETER, "name": "second"}], "is measured by 'thermometer' already"),
        ([{**THERMOMETER, "address": "socket://h:1"}], "is simulated: remove the address"),
        ([{"name": "idle"}], "does nothing"),
        ([{**HEATER, "off": None}], "what is switched on needs an `off`"),
        ([{**HEATER, "optional": True}], "cannot be optional"),
        ([{**HYGROMETER, "read": [*HYGROMETER["read"], *THERMOMETER["read"]]}], "it speaks one of them"),
        ([{"name": "a", "powers_units": True}, {"name": "b", "powers_units": True}], "only one instrument switches"),
        ([{"name": "a", "read": [{"channel": "humidity", "query": "H?", "unit": "V"}]}], "'V' does not measure"),
        ([{"name": "a", "read": [{"channel": "rate", "query": "R?"}]}], "'supply', 'supply_current'"),
    ],
)  # fmt: skip
def test_a_wrong_section_is_refused_with_its_line(tmp_path, instruments, said):
    content = acquisition.station_content(instruments=instruments)
    (tmp_path / "station.yaml").write_text(json.dumps(content, indent=1))
    answer = CliRunner().invoke(main, ["doctor", str(tmp_path / "station.yaml")])
    assert answer.exit_code == 2, answer.output
    assert f"{tmp_path / 'station.yaml'}:" in answer.stderr
    assert said in answer.stderr


def test_a_guard_that_would_trip_between_two_readings_is_refused():
    slow = {"name": "meter", "read": [{"channel": "humidity", "query": "H?", "period_s": 60}]}
    guard = {"name": "moist", "signal": "humidity", "above": 60}
    with pytest.raises(InputError, match="max_age_s is 10, but humidity is read every 60 s"):
        station(slow, guards=[guard])
    assert station(slow, guards=[guard | {"max_age_s": 90}]).measured() == ("humidity",)


def test_check_tells_what_is_recorded_and_refuses_what_a_unit_sends_itself(tmp_path):
    profile = str(tmp_path / "short.yaml")
    (tmp_path / "short.yaml").write_text(acquisition.SHORT)
    path = tmp_path / "station.yaml"
    path.write_text(json.dumps(acquisition.station_content(instruments=ALL)))
    answer = CliRunner().invoke(main, ["check", profile, "--station", str(path)])
    assert answer.exit_code == 0, answer.output
    assert "thermometer: reference_temperature every 1 s" in answer.output
    assert "off in the safe state by OUTP OFF,(@2)" in " ".join(answer.output.split())
    own = {"name": "meter", "read": [{"channel": "supply", "query": "V?"}]}
    path.write_text(json.dumps(acquisition.station_content(instruments=[own])))
    answer = CliRunner().invoke(main, ["check", profile, "--station", str(path)])
    assert answer.exit_code == 2
    assert "instrument meter: unit SIM-0001 sends supply itself" in answer.stderr
    path.write_text(json.dumps(acquisition.station_content(guards=[{"name": "x", "signal": "humidity", "above": 1}])))
    answer = CliRunner().invoke(main, ["check", profile, "--station", str(path)])
    assert answer.exit_code == 2
    assert "watches humidity, which nothing of this station tells" in answer.stderr


def _instrument(content):
    return InstrumentSettings.model_validate_json(json.dumps(content))


class Told:
    """A journal that waits until something was measured."""

    def __init__(self):
        self.events, self.values, self.some = [], [], threading.Event()

    def event(self, kind, text, **facts):
        self.events.append(text)

    def instrument(self, readings):
        self.values += [(row["channel"].decode(), float(row["value"])) for row in readings]
        self.some.set()


def test_a_slow_instrument_does_not_hold_up_the_loop():
    """The server answers only after the loop has gone on without it."""
    go = threading.Event()

    def late():
        assert go.wait(10.0)
        return "1.5"

    server = ScpiInstrument("M,M,1,1", {"V?": late})
    settings = _instrument(
        {"name": "slow", "address": server.address, "timeout_s": 10, "read": [{"channel": "voltage", "query": "V?"}]}
    )
    journal = Told()
    with ExitStack() as stack:
        stack.callback(server.close)
        instruments = Instruments([settings], WallClock(), journal, stack)
        for _ in range(3):
            instruments.poll()
        assert instruments.latest == {}
        assert server.told in (["*IDN?", "V?"], ["*IDN?"])
        go.set()
        while not journal.some.wait(0.01):
            instruments.poll()
        assert instruments.latest["voltage"].value == 1.5


@pytest.fixture
def stuck(monkeypatch):
    """An instrument whose library returns to nobody before the test is over."""
    go = threading.Event()

    class Library:
        def ask(self, query):
            go.wait()
            return "M,M,1,1"

        send = ask

        def close(self):
            self.ask("")

    monkeypatch.setattr(InstrumentSettings, "open", lambda settings: Instrument(settings.name, Library()))
    monkeypatch.setattr("bench.acquisition.station.instruments.PATIENCE_S", 0.0)
    one = [{"channel": "voltage", "query": "V?"}]
    yield _instrument({"name": "stuck", "identifies": False, "timeout_s": 0.1, "read": one, "off": HEATER["off"]})
    go.set()


def test_an_instrument_whose_library_does_not_return_is_lost_and_left_behind(stuck):
    clock = WallClock()
    with ExitStack() as stack:
        instruments = Instruments([stuck], clock, Told(), stack)
        clock.now = lambda: 2.0
        instruments.poll()
        clock.now = lambda: 48.0
        with pytest.raises(EquipmentError, match=r"instrument stuck is lost: no answer within 0\.4 s"):
            instruments.poll()
        assert [(step.ok, step.detail) for step in instruments.safe()] == [(False, "stuck: no answer within 0.4 s")]
    (left,) = [thread for thread in threading.enumerate() if thread.name == "instrument stuck"]
    assert left.daemon


def test_the_watchdog_goes_on_to_the_chamber_when_a_library_does_not_return(stuck):
    steps = switch_off(station().model_copy(update={"instruments": (stuck,)}))
    assert [(step.ok, step.detail) for step in steps] == [(False, "stuck: no answer within 0.4 s")]


def test_the_doctor_goes_on_when_a_library_does_not_return(stuck):
    found = Examination("station")
    _instrument_of(found, stuck.model_copy(update={"identifies": True, "address": "socket://127.0.0.1:1"}))
    assert [(one.verdict, one.detail) for one in found.findings] == [("no link", "stuck: no answer within 0.4 s")]


def test_the_watchdog_switches_off_what_a_killed_bench_left_on():
    with serve_station(station(HEATER)) as served:
        settings = StationSettings.model_validate_json(json.dumps(served.station_file()))
        heater = served.station.instruments["heater"]
        heater.server.take("OUTP ON,(@2)")
        assert heater.on
        steps = switch_off(settings)
        assert [(step.what, step.ok) for step in steps] == [("instrument heater", True)]
        assert not heater.on
    [step] = switch_off(settings)
    assert not step.ok


@pytest.mark.slow
def test_a_bench_that_is_killed_before_the_chamber_moved_leaves_no_instrument_on(tmp_path):
    """The unit is silent, so that the bench waits for it with the heater on."""
    with acquisition.elsewhere(station(HEATER)) as served:
        served.station.units[0].wire.send = lambda *given, **more: None
        (tmp_path / "station.yaml").write_text(served.station_yaml())
        (tmp_path / "long.yaml").write_text(acquisition.LONG)
        heater, chamber = served.station.instruments["heater"], served.station.chamber
        before = chamber.words("setpoint")
        command = ["from bench.cli import main; main()", "run", "long.yaml", "--station", "station.yaml"]
        with subprocess.Popen([sys.executable, "-c", *command], cwd=tmp_path, stderr=subprocess.PIPE) as bench:
            while not heater.on:
                with pytest.raises(subprocess.TimeoutExpired):  # it still runs
                    bench.wait(0.05)
            bench.kill()
            said = bench.stderr.read().decode()  # to its end: the watchdog, which writes there too, has ended
        assert "equipment is safe, verified" in said
        assert not heater.on
        assert chamber.words("setpoint") == before


@pytest.mark.slow
def test_a_real_station_records_them_too(tmp_path):
    with acquisition.elsewhere(station()) as served:
        settings = load_config(parse_yaml(served.station_yaml(), "remote.yaml"), StationSettings)
        text = "name: real\nsegments:\n  - {kind: soak, duration_min: 0.1}\n"
        result = run_job(acquisition.job(tmp_path, text, settings))
    assert result.error is None
    humidity = load(result.run.path, 1.0).channel("humidity")
    read = humidity[np.isfinite(humidity)]
    assert len(read) >= 4
    assert read == pytest.approx(12.0)


def test_the_example_of_the_page_is_a_station():
    page = (ROOT / "docs" / "howto" / "instruments.md").read_text()
    section = parse_yaml(page.split("```yaml")[1].split("```")[0], "page").content
    connection = {"url": "tcp://127.0.0.1:1"}
    content = acquisition.station_content(simulated=False, **section)
    content["chamber"] = content["chamber"] | {"connection": connection}
    content["buses"] = {"can0": {"interface": "socketcan", "channel": "can0"}}
    settings = load_config(parse_yaml(json.dumps(content), "station.yaml"), StationSettings)
    assert [one.name for one in settings.instruments] == ["thermometer", "hygrometer", "heater supply"]
    assert settings.instruments[0].open().name == "thermometer"
