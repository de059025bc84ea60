"""Every shipped register map, on every wire, against our simulated controller and against servers and clients that
are not ours."""

from __future__ import annotations

import shutil
import subprocess
from contextlib import closing
from functools import partial
from pathlib import Path

import minimalmodbus
import pytest

from drivers.contract import BEHAVIOURS, Outcome, try_map
from drivers.errors import RefusedError
from drivers.modbus import ModbusLink
from drivers.registers import list_maps, load_map, parse_map
from drivers.sim.modbus_chamber import ModbusChamber
from drivers.sim.ptys import PtyPair
from tests.support.foreign_chamber import ForeignChamber

MAPS = list_maps()
NEVER_HERE = {
    "refuses another model": {"binder_mb2", "eurotherm_3500"},
    "refuses every unit but degC": {"binder_mb1", "binder_mb2"},
    "follows the controller's implied decimals": set(MAPS) - {"watlow_f4"},
    "limits writes to a memory that wears out": set(MAPS) - {"eurotherm_2400", "eurotherm_3500"},
    "shows every alarm and clears none": {"binder_mb2"},
    "shows its door": set(MAPS) - {"binder_mb1"},
}
"""What a controller does not have; anything else has to work."""


def failed(outcomes: list[Outcome]) -> list[Outcome]:
    return [outcome for outcome in outcomes if outcome.verdict == "failed"]


@pytest.mark.parametrize("wire", ["tcp", "rtu+tcp", "rtu"])
@pytest.mark.parametrize("name", MAPS)
@pytest.mark.slow
def test_a_shipped_map_does_what_every_map_has_to_do(name: str, wire: str):
    outcomes = try_map(load_map(name), partial(ModbusChamber, wire=wire))
    assert not failed(outcomes)
    missing = {outcome.behaviour for outcome in outcomes if outcome.verdict == "not applicable"}
    assert missing == {behaviour for behaviour, maps in NEVER_HERE.items() if name in maps}


@pytest.mark.parametrize("wire", ["tcp", "rtu"])
@pytest.mark.parametrize("name", MAPS)
@pytest.mark.slow
def test_a_shipped_map_does_so_against_a_server_that_is_not_ours(name: str, wire: str):
    outcomes = try_map(load_map(name), partial(ForeignChamber, wire=wire))
    assert not failed(outcomes)
    assert len(outcomes) == len(BEHAVIOURS)


@pytest.mark.parametrize("wire", ["tcp", "rtu"])
def test_coils_discrete_inputs_and_bit_fields_do_what_every_map_has_to_do(wire: str):
    registers = load_map(Path(__file__).parents[2] / "profiles" / "chambers" / "example.yaml")
    for serve in (ModbusChamber, ForeignChamber):
        outcomes = try_map(registers, partial(serve, wire=wire))
        assert not failed(outcomes)
        works = {outcome.behaviour for outcome in outcomes if outcome.verdict == "ok"}
        assert {"starts after a set point, stops, and protects its compressor", "shows every alarm and clears none",
                "shows its door", "detects set points and switches changed by others"} <= works  # fmt: skip


def test_a_controller_in_hundredths_of_a_kelvin_does_what_every_map_has_to_do():
    text = (Path(__file__).parents[2] / "profiles" / "chambers" / "example.yaml").read_text()
    kelvin = "scale: 0.01, offset: -273.15, "
    text = text.replace("type: float32, ", f"type: int32, {kelvin}").replace(
        "type: int16, scale: 0.1, ", f"type: uint16, {kelvin}"
    )
    assert text.count(kelvin) == 2
    assert not failed(try_map(parse_map(text, "kelvin"), ModbusChamber))


@pytest.mark.parametrize(
    ("old", "new", "behaviour"),
    [
        ("word_order: low_first", "word_order: high_first", None),  # consistent with itself: only a real one tells
        ("pattern: ^F4T\n", "pattern: .\n", "refuses another model"),
        ("pattern: ^celsius$", "pattern: .", "refuses every unit but degC"),
        ("    normal: [startup, none, inactive]\n", "", None),
    ],
)
def test_a_careless_map_is_caught(old: str, new: str, behaviour: str | None):
    from importlib.resources import files

    text = (files("drivers") / "chambers" / "watlow_f4t.yaml").read_text()
    assert old in text
    broken = [outcome.behaviour for outcome in failed(try_map(parse_map(text.replace(old, new), "careless")))]
    assert any(behaviour in name for name in broken) if behaviour else not broken


def test_the_controllers_own_words_for_a_refusal_are_told():
    registers = load_map("eurotherm_2400")
    with ModbusChamber(registers) as served, closing(ModbusLink(served.url, timeout_s=5.0)) as link:
        from drivers.chamber import Chamber
        from drivers.clock import SimClock

        chamber = Chamber(link, registers, (-100.0, 200.0), SimClock())
        chamber.identify()
        served.set_value("setpoint_high", 150.0)
        chamber.identify()
        with pytest.raises(RefusedError, match="Eurotherm 2400: value not accepted"):
            chamber.set_point(140.0)  # the simulated controller still keeps to its 130


@pytest.fixture
def f4_line():
    """A Watlow F4 on a serial line: the controller, and the end for the client."""
    with ModbusChamber(load_map("watlow_f4"), wire="rtu") as chamber:
        yield chamber, chamber.url.removeprefix("rtu://").split("?")[0]


def test_minimalmodbus_reads_and_writes_an_f4_on_a_serial_line(f4_line):
    chamber, port = f4_line
    chamber.publish(temperature=-23.0, working_setpoint=25.0)
    client = minimalmodbus.Instrument(port, 1)
    client.serial.baudrate, client.serial.timeout = 19200, 5.0
    with closing(client.serial):
        assert client.read_register(0) == 5270
        assert client.read_register(100, 1, signed=True) == -23.0  # the manual: "-230 is -23.0"
        client.write_register(300, -40.5, 1, functioncode=6, signed=True)
    assert chamber.commands().setpoint == -40.5


def mbpoll(port: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    program = shutil.which("mbpoll")
    if program is None:
        pytest.skip("mbpoll (Debian package of that name) is not installed")
    command = [program, "-m", "rtu", "-b", "19200", "-P", "none", "-a", "1", "-0", "-1", "-q", "-o", "5", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=30, check=False)


def test_mbpoll_agrees_with_an_f4_on_a_serial_line(f4_line):
    chamber, port = f4_line
    chamber.publish(temperature=-23.0, working_setpoint=25.0, sensor_break=True)
    read = mbpoll(port, "-r", "100", "-c", "2", "-t", "4", port)
    assert read.returncode == 0, read.stderr
    assert "(-230)" in read.stdout
    assert "[101]: \t1" in read.stdout
    written = mbpoll(port, "-r", "300", "-t", "4", port, str(0x10000 - 405))
    assert written.returncode == 0, written.stderr
    assert chamber.commands().setpoint == -40.5
    refused = mbpoll(port, "-r", "300", "-t", "4", port, "1999")
    assert "Illegal data value" in refused.stdout + refused.stderr


def test_what_goes_into_one_end_of_a_serial_line_comes_out_of_the_other():
    import serial

    with closing(PtyPair()) as pair:
        with serial.Serial(pair.left, timeout=5) as left, serial.Serial(pair.right, timeout=5) as right:
            left.write(bytes(range(256)))
            assert right.read(256) == bytes(range(256))
            right.write(b"back")
            assert left.read(4) == b"back"
        pair.close()


def test_a_hole_is_never_read_across():
    text = """\
model: Holed
registers:
  temperature: {address: 10, type: int16, unit: degC, meaning: air, source: s}
  setpoint: {address: 14, type: int16, write: 6, unit: degC, meaning: target, source: s}
  mode: {address: 11, type: uint16, write: 6, values: {off: 0, on: 1}, meaning: run, source: s}
poll: [temperature, setpoint, mode]
run: {register: mode, on: on, off: off, state: mode}
identify: []
unreadable: [[12, 13]]
"""
    assert [[r.name for r in block] for block in parse_map(text, "holed").blocks] == [
        ["temperature", "mode"],
        ["setpoint"],
    ]
    whole = parse_map(text.replace("[[12, 13]]", "[]"), "whole")
    assert len(whole.blocks) == 1


def test_the_page_of_the_chambers_is_that_of_the_maps():
    from pathlib import Path

    from drivers.catalogue import markdown

    page = Path(__file__).parents[2] / "docs" / "chambers.md"
    assert page.read_text() == markdown(), "write it again: python -m drivers.catalogue > docs/chambers.md"


@pytest.mark.parametrize("name", MAPS)
def test_a_shipped_map_says_how_to_connect_and_where_each_address_is_from(name: str):
    registers = load_map(name)
    assert registers.connection
    assert registers.sources
