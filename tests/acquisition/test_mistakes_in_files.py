"""Mistakes in the files of a station: check, doctor and run refuse them in the same words, and leave nothing."""

import re
from pathlib import Path

import pytest

from bench.record import load
from drivers.errors import ConfigError
from drivers.wire import load_dbc
from tests.support.commands import bench

NEWCOMER = Path(__file__).parents[1] / "testing" / "newcomer"
DBC = """VERSION ""
NS_ :
BS_:
BU_: BENCH
BO_ 768 AXES: 8 GYRO
 SG_ X : 7|16@0- (0.002,0) [-65|65] "deg/s" BENCH
 SG_ Y : 23|16@0- (0.002,0) [-65|65] "deg/s" BENCH
 SG_ T : 39|16@0- (0.01,0) [-100|150] "degC" BENCH
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_ "GenMsgCycleTime" BO_ 768 2;
"""
STATION = """name: own
simulated: true
chamber: {map: chamber.yaml, lowest_degc: -42, highest_degc: 95, heating_degc_per_min: 5, cooling_degc_per_min: 2}
guards: [{name: hot, signal: chamber_temperature, above: 90}]
buses:
  can0: {interface: virtual, channel: own, bitrate: 1000000}
  line0:
    interface: packets
    channel: /dev/ttyUSB0
    bitrate: 921600
    framing: {kind: header, header: "AA 55", length: 12, crc: {width: 16, poly: 0x1021, start: 2}}
  udp0: {interface: packets, channel: "udp://127.0.0.1:5005", framing: {kind: datagram, length: 12}}
units:
  - {serial: AXES-1, bus: can0, gyro: own.dbc, signals: {rate_x: X, rate_y: Y, temperature: T}}
  - serial: LINE-2
    bus: line0
    signals:
      rate: {id: 0, start: 16, length: 32, type: signed, scale: 1.0e-6, unit: deg/s, bytes: 12}
      temperature: {id: 0, start: 48, length: 32, type: float, unit: degC}
      cycle_ms: 2
  - serial: UDP-3
    bus: udp0
    signals:
      rate: {id: 0, start: 0, length: 32, type: signed, scale: 1.0e-6, unit: deg/s, bytes: 12}
      counter: {id: 0, start: 64, length: 16}
      cycle_ms: 2
"""
FILES = {
    "own.dbc": DBC,
    "station.yaml": STATION,
    "chamber.yaml": (NEWCOMER / "chamber.yaml").read_text(),
    "short.yaml": "name: short\nsegments:\n  - {kind: soak, duration_min: 0.1}\n",
}


REAL = [
    ("simulated: true", "simulated: false"),
    ("chamber: {map:", 'chamber: {connection: {url: "tcp://127.0.0.1:1"}, map:'),
    ("interface: virtual, channel: own", "interface: socketcan, channel: can17"),
]
"""Changes that make equipment of the simulated station; nothing of it is there."""


def answers(folder, monkeypatch, changed, equipment=False):
    """What check, doctor and run say of the files with these changes, each with its exit code."""
    texts = dict(FILES)
    for old, new in [*(REAL if equipment else []), *changed]:
        (name,) = [name for name, text in texts.items() if text.count(old) == 1]
        texts[name] = texts[name].replace(old, new)
    for name, text in texts.items():
        (folder / name).write_text(text)
    monkeypatch.chdir(folder)
    profile = ["short.yaml", "--station", "station.yaml"]
    commands = (["check", *profile], ["doctor", "station.yaml", "--listen", "0.2"], ["run", *profile, "--out", "out"])
    done = [bench(*command) for command in commands]
    return [(one.exit_code, one.output) for one in done]


def test_the_files_without_a_mistake_are_taken(tmp_path, monkeypatch):
    (checked, said), (examined, told), (ran, _) = answers(tmp_path, monkeypatch, [])
    assert (checked, examined, ran) == (0, 0, 1)  # a run that short has no verdict
    (run,) = (tmp_path / "out" / "UDP-3").iterdir()
    assert load(run, 1.0).has("temperature"), "of a unit without a thermometer, the air of the chamber"
    for text in (said, told):
        assert re.search(r"AXES-1:? .*no CRC: a frame", text)
        assert re.search(r"UDP-3:? .*no CRC and no sum: a packet", text)
        assert not re.search(r"LINE-2:? .*no CRC", text)


MISTAKES = {
    "own.dbc -> no.dbc": r"station.yaml:14: unit AXES-1: DBC \S*no.dbc: No such file",
    "own.dbc -> own": r"station.yaml:14: unit AXES-1: no gyro 'own' is shipped: vibratory; a DBC of your own ends in",
    "BO_ 768 AXES -> BO_ many AXES": r"station.yaml:14: unit AXES-1: DBC \S*own.dbc: Invalid syntax at line 5",
    "AXES: 8 -> AXES: 16": r"station.yaml:14: unit AXES-1: AXES has 16 bytes, bus can0 is classical CAN",
    "rate_y: Y -> rate_y: X": r"station.yaml:14: .*rate_x and rate_y are the same signal, AXES.X",
    "temperature: T} -> counter: T}": r"station.yaml:14: .*counter: AXES.T must be an unsigned integer",
    "rate_x: X -> rate_x: Xx": r"station.yaml:14: .*'Xx' is not in the DBC; it has AXES.X, AXES.Y, AXES.T",
    '65] "deg/s" BENCH\n SG_ Y -> 65] "grad/s" BENCH\n SG_ Y': r"station.yaml:14: .*'grad/s' has two meanings",
    '65] "deg/s" BENCH\n SG_ Y -> 65] "" BENCH\n SG_ Y': r"station.yaml:14: .*state it in the DBC, or as `unit`",
    "own.dbc, -> own.dbc, simulation: {rate_z: {}},": r"station.yaml:14: .*rate_z is not an output of this unit",
    "own.dbc, -> own.dbc, simulation: {rate_x: {truth: [{x: 1}]}},": r"station.yaml:14: .*missing key mechanism",
    "own.dbc, -> own.dbc, identity: 7,": r"station.yaml:14: .*identity 7 is to be checked, but it says no serial",
    ' SG_ X : ->  SG_ M M : 55|8@0+ (1,0) [0|3] "" B\n SG_ X m0 :': r"station.yaml:14: .*no multiplexed messages",
    "start: 16, -> start: 0,": r"station.yaml:15: unit LINE-2: packet 0: .*bit0 is in byte 0, which is of the header",
    "start: 48, -> start: 56,": r"station.yaml:15: unit LINE-2: packet 0: .*in byte 10, which is of the CRC or sum",
    "length: 12, crc -> length: 14, crc": r"station.yaml:15: unit LINE-2: packet 0 has 12 bytes by its signals, 14",
    "bitrate: 921600 -> bitrate: 9600": r"station.yaml:7: bus line0: its units take \d+% of it, more than there is",
    "bitrate: 1000000 -> bitrate: 50000": r"station.yaml:6: bus can0: its units take \d+% of it, more than there is",
    "127.0.0.1:5005 -> 127.0.0.1": r"station.yaml:12: buses.udp0.channel: .*must name a port, as in udp:",
    "bitrate: 921600 -> bitrate: 921600\n    options: {parity: Q}": r"station.yaml:9: .*Not a valid parity: 'Q'",
    '"AA 55" -> "AA 5"': r"station.yaml:11: .*header is \"AA 5\": must be written like 'AA 55'",
    "type: float, unit: degC -> type: float, unit: V": r"station.yaml:15: .*'V' does not measure temperature",
    "map: chamber.yaml -> map: nowhere.yaml": r"station.yaml:3: register map \S*nowhere.yaml: No such file",
    "highest_degc: 95 -> highest_degc: 250": r"station.yaml:3: chamber.highest_degc is 250: .* -70 to 180 degC",
    "signal: chamber_temperature -> signal: humidity": r"station.yaml:4: guard 'hot' watches humidity",
    "name: own\n -> name: own\nlaboratory: none.yaml\n": r"station.yaml:2: laboratory: \S*none.yaml: no such file",
    "name: own\n -> name: own\nequipment: mine\n": r"station.yaml:2: no equipment file is called 'mine'",
    "setpoint: {address: 100 -> setpoint: {address: 300": r"chamber.yaml:13: .*takes address 300, as setpoint does",
    "poll: [temperature -> poll: [temprature": r"chamber.yaml:5: poll: no register temprature; described are",
    "(0.01,0) -> (0,0)": r"station.yaml:14: .*temperature: AXES.T has the scale 0: every value would be the offset",
    "int16, scale: 0.1 -> int16, scale: -0.1": r"chamber.yaml:10: registers.setpoint.scale: is -0.1: a temperature",
    "read: 4, unit: degC -> read: 4, unit: degF": r"chamber.yaml:9: .*unit: is 'degF': the bench reads degC",
}


def test_a_unit_on_udp_without_a_counter_is_told_what_the_network_can_do(tmp_path, monkeypatch):
    heard = "unit UDP-3: no counter and no time stamp: a datagram that the network repeats or delays"
    (_, said), *_ = answers(tmp_path, monkeypatch, [])
    assert heard not in said
    (code, said), *_ = answers(tmp_path, monkeypatch, [("      counter: {id: 0, start: 64, length: 16}\n", "")])
    assert (code, heard in said) == (0, True)


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_refused_by_all_in_the_same_words_and_nothing_is_left(tmp_path, monkeypatch, mistake):
    (code, said), *others = answers(tmp_path, monkeypatch, [mistake.split(" -> ")])
    assert code == 2
    assert len(said.splitlines()) == 1
    assert re.search(MISTAKES[mistake], said), said
    assert others == [(2, said), (2, said)]
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("equipment", [False, True], ids=["simulated", "equipment"])
def test_all_mistakes_are_told_at_once_each_with_its_line(tmp_path, monkeypatch, equipment):
    wrong = [("own.dbc", "no.dbc"), ("map: chamber.yaml", "map: nowhere.yaml"), ("bitrate: 921600", "bitrate: 9600")]
    wrong += [("length: 12}}", "length: 14}}")]
    (code, said), *others = answers(tmp_path, monkeypatch, wrong, equipment)
    assert code == 2
    assert others == [(2, said), (2, said)]
    assert not (tmp_path / "out").exists()
    assert re.findall(r"station.yaml:(\d+): ", said) == ["3", "14", "21", "7"]


ADDRESSES = {
    "tcp://127.0.0.1:1 -> tcp://127.0.0.1:99999": r"station.yaml:3: chamber.connection.url: .*Port out of range",
    "tcp://127.0.0.1:1 -> 127.0.0.1:502": r"station.yaml:3: chamber.connection.url: .*use tcp://host:port, rtu",
    "tcp://127.0.0.1:1 -> rtu:///dev/ttyUSB0?baud=9600": r"station.yaml:3: chamber.connection.url: .*\?baudrate=9600",
    "tcp://127.0.0.1:1 -> rtu:///dev/ttyUSB0?parity=X": r"station.yaml:3: .*Not a valid parity: 'X'",
    "udp://127.0.0.1:5005 -> udp://127.0.0.1:0": r"station.yaml:12: buses.udp0.channel: .*must name a port",
    "/dev/ttyUSB0 -> socket://192.0.2.7": r"station.yaml:9: buses.line0.channel: .*must name a port",
    'guards: [ -> instruments: [{name: m, address: "socket://h", read: [{channel: humidity, query: H}]}]\nguards: [':
        r"station.yaml:4: instrument m: address 'socket://h': must name a port, as in socket://",
}  # fmt: skip


@pytest.mark.parametrize("mistake", ADDRESSES)
def test_an_address_that_cannot_be_is_refused_before_anything_is_opened(tmp_path, monkeypatch, mistake):
    (code, said), *others = answers(tmp_path, monkeypatch, [mistake.split(" -> ")], equipment=True)
    assert code == 2
    assert re.search(ADDRESSES[mistake], said), said
    assert others == [(2, said), (2, said)]


def test_what_a_station_leaves_open_is_told(tmp_path, monkeypatch):
    open_ends = [("float32, word_order: low_first", "float32"), ("(0.01,0)", "(-0.01,0)")]
    open_ends += [("tcp://127.0.0.1:1", "tcp://chamber.invalid:502")]
    (code, said), _, (ran, why) = answers(tmp_path, monkeypatch, open_ends, equipment=True)
    assert (code, ran) == (0, 4)
    assert "station.yaml:3: warning: register temperature has two words and no `word_order`: high_first is as" in said
    assert "station.yaml:3: warning: tcp://chamber.invalid:502: host chamber.invalid is not known to this comp" in said
    assert "unit AXES-1: scale of temperature is -0.01: it falls as its number rises" in said
    assert "no connection: host chamber.invalid is not known to this computer" in why
    _, (_, examined), _ = answers(tmp_path, monkeypatch, open_ends[:2])
    assert "register temperature has two words and no `word_order`" in examined


def test_a_dbc_that_was_corrected_is_read_anew(tmp_path):
    path = tmp_path / "own.dbc"
    path.write_text(DBC)
    assert load_dbc(path)["AXES"].signals["X"].scale == 0.002
    path.write_text(DBC.replace("(0.002,0) [-65|65]", "(0.0020001,0) [-65|65]"))
    assert load_dbc(path)["AXES"].signals["X"].scale == 0.0020001
    path.unlink()
    with pytest.raises(ConfigError, match="No such file"):
        load_dbc(path)
