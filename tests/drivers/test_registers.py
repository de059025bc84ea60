"""Register maps: the words on the wire, and refusal of everything that cannot be right."""

from __future__ import annotations

import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymodbus.client.mixin import ModbusClientMixin

from drivers.errors import ConfigError, LimitError
from drivers.registers import Register, list_maps, load_map, parse_map

MAP = """\
model: Small
registers:
  temperature: {address: 100, type: int16, scale: 0.1, unit: degC, low: -80, high: 200, meaning: air, source: F4 manual}
  setpoint: {address: 101, type: int16, scale: 0.1, write: 6, unit: degC, low: -80, high: 200, meaning: t, source: F4}
  mode: {address: 102, type: uint16, write: 6, values: {off: 0, on: 1}, meaning: run, source: F4}
poll: [temperature, setpoint, mode]
run: {register: mode, on: on, off: off, state: mode}
identify: []
"""


def register(**keys: object) -> Register:
    return Register(**({"name": "x", "address": 0, "type": "float32", "meaning": "m", "source": "s"} | keys))


def test_float_low_word_first_is_what_the_f4t_expects():
    setpoint = load_map("watlow_f4t")["setpoint"]
    # IEEE 754: -40.5 = 0xC2220000; pymodbus' own conversion as the independent witness
    assert setpoint.encode(-40.5) == (0x0000, 0xC222)
    assert list(setpoint.encode(-40.5)) == ModbusClientMixin.convert_to_registers(
        -40.5, ModbusClientMixin.DATATYPE.FLOAT32, word_order="little"
    )
    assert setpoint.decode([0x0000, 0xC222]) == -40.5


def test_float_high_word_first():
    assert register().encode(25.0) == (0x41C8, 0x0000)


def test_scaled_int16_carries_the_sign():
    temperature = parse_map(MAP, "small")["temperature"]
    assert temperature.decode([65306]) == pytest.approx(-23.0)  # Watlow F4 manual: "-230 is -23.0"
    assert temperature.encode(-23.0) == (65306,)


def test_32_bit_integers_follow_the_word_order():
    assert register(type="uint32").encode(65537) == (1, 1)
    assert register(type="int32", word_order="low_first").encode(-2) == (0xFFFE, 0xFFFF)


def test_a_controller_in_kelvin_is_read_and_written_in_degc():
    setpoint = register(type="uint16", scale=0.01, offset=-273.15, low=-70, high=180)
    assert setpoint.encode(25.0) == (29815,)
    assert setpoint.encode(-40.0) == (23315,)
    assert setpoint.decode([29815]) == pytest.approx(25.0, abs=1e-9)
    assert setpoint.agrees(25.004, setpoint.decode(setpoint.encode(25.004)))
    fahrenheit = register(scale=5 / 9, offset=-160 / 9)
    assert fahrenheit.agrees(-40.1, fahrenheit.decode(fahrenheit.encode(-40.1)))
    assert fahrenheit.decode(register().encode(212.0)) == pytest.approx(100.0)


@pytest.mark.parametrize("word_order", ["high_first", "low_first"])
@pytest.mark.parametrize("byte_order", ["high_first", "low_first"])
def test_each_order_of_words_and_bytes_is_that_of_struct(word_order: str, byte_order: str):
    big = struct.pack(">f", -40.5)
    pairs = [big[:2], big[2:]][:: -1 if word_order == "low_first" else 1]
    wire = b"".join(pair[:: -1 if byte_order == "low_first" else 1] for pair in pairs)
    one = register(word_order=word_order, byte_order=byte_order)
    assert one.encode(-40.5) == struct.unpack(">HH", wire)
    assert one.decode(one.encode(-40.5)) == -40.5


def test_text_is_one_character_a_register():
    text = register(type="ascii", words=5)
    assert text.encode("F4T") == (70, 52, 84, 0, 0)
    assert text.decode([70, 52, 84, 32, 0]) == "F4T"
    with pytest.raises(LimitError):
        text.decode([7, 0, 0, 0, 0])


@given(st.floats(-100, 250, width=32).filter(lambda value: value == 0 or abs(value) >= 1e-30))
def test_every_float32_survives_the_wire(value: float):
    for order in ("high_first", "low_first"):
        x = register(word_order=order, low=-100, high=250)
        assert x.decode(x.encode(value)) == value


@given(st.integers(-800, 2000))
def test_every_count_of_a_scaled_integer_survives_the_wire(count: int):
    x = parse_map(MAP, "small")["setpoint"]
    assert x.encode(x.decode([count & 0xFFFF])) == (count & 0xFFFF,)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, -80.1, 200.1, 1e-40, "25", True])
def test_a_value_outside_the_limits_is_refused_not_clipped(value: float):
    with pytest.raises(LimitError):
        parse_map(MAP, "small")["setpoint"].encode(value)


def test_overflow_of_the_type_is_refused():
    for kind, value in [("int16", 32768), ("uint16", -1), ("float32", 1e39), ("uint32", 2**32)]:
        with pytest.raises(LimitError):
            register(type=kind).encode(value)


@pytest.mark.parametrize("words", [(0, 0x7FC0), (0, 0x7F80), (0, 0x4461), (0x41CA, 0x6666), (0x41C8, 0x0000)])
def test_a_measurement_that_cannot_be_true_is_refused(words: tuple[int, int]):
    """NaN, infinity, 900 degC, and 25.3 and 25.0 degC with their words swapped."""
    with pytest.raises(LimitError):
        load_map("watlow_f4t")["temperature"].decode(words)


def test_a_target_that_somebody_left_outside_our_limits_still_reads():
    assert load_map("watlow_f4t")["ramp_rate"].decode((0, 0)) == 0.0


def test_enumerations_speak_names_and_unknown_codes_are_visible():
    mode = load_map("watlow_f4t")["mode"]
    assert mode.encode("auto") == (10,)
    assert mode.decode([62]) == "off"
    assert mode.decode([77]) == "code 77"
    with pytest.raises(LimitError, match="off, auto, manual"):
        mode.encode("automatic")


def test_alarm_states_by_the_map():
    chamber = load_map("watlow_f4t")
    assert not chamber["alarm_1"].is_alarm("none")
    assert chamber["alarm_1"].is_alarm("code 66")
    assert chamber["profile_state"].is_alarm("running")
    assert not chamber["profile_state"].is_alarm("code 0")


def test_read_back_agrees_within_the_tolerance_only():
    setpoint = load_map("watlow_f4t")["setpoint"]
    assert setpoint.agrees(25.03, 25.0)
    assert not setpoint.agrees(25.1, 25.0)
    assert register(type="int16", scale=0.1).agrees(25.04, 25.0)
    assert not register(type="int16", scale=0.1).agrees(25.04, 25.1)
    assert register().agrees(25.1, register().decode(register().encode(25.1)))


@pytest.mark.parametrize("name", list_maps())
def test_every_shipped_map_loads_and_cites_its_sources(name: str):
    chamber = load_map(name)
    assert all(entry.source for entry in chamber.registers.values())
    assert {"temperature", "setpoint"} <= set(chamber.poll)
    assert all(a.end <= b.address or b.end <= a.address or a is b for a in chamber.writable for b in chamber.writable)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "scale: 0.1, unit",
            "scael: 0.1, unit",
            "small:3: registers.temperature.scael: unknown key; did you mean scale?",
        ),
        ("poll:", "pol: 1\npoll:", "small:6: pol: unknown key; did you mean poll?"),
        ("address: 102", "address: 70000", "small:5: registers.mode.address: .*65535"),
        ("low: -80", "low: .nan", "small:3: .*finite number"),
        ("source: F4 manual", "source: ''", "small:3: registers.temperature.source"),
        ("write: 6, values", "values", "mode must be writable"),
        ("poll: [temperature, ", "poll: [", "poll must contain"),
        ("on: on, off", "on: go, off", "'go' is not one of off, on"),
        ("state: mode", "state: mood", "no register mood"),
        ("identify: []", "identify: []\nidentify: []", "small:9: duplicate key 'identify'"),
        ("type: uint16, write: 6", "type: uint16, scale: 2, write: 6", "small:5: .*scale and offset"),
        ("model: Small", "model: [", "small:"),
        ("address: 102, ", "", "^small:5: registers.mode.address: is missing$"),
        (
            "type: int16, scale: 0.1, unit",
            "type: in16, scale: 0.1, unit",
            "small:3: .*is 'in16'; it must be 'int16', 'u",
        ),
        (
            "scale: 0.1, write",
            "scale: tenth, write",
            "^small:4: .*scale: is 'tenth'; it must be a number$",
        ),
        (
            "poll: [temperature, setpoint, mode]",
            "poll: air",
            "^small:6: poll: is 'air'; it must be a list$",
        ),
        (
            "type: uint16, write: 6",
            "type: bit, write: 6",
            "^small:5: registers.mode: a coil has type: bit",
        ),
        ("address: 102", "address: 101", "^small:5: registers.mode.address: takes address 101, as setpoint does"),
        ("scale: 0.1, unit: degC", "scale: 0.1, unit: degF", "^small:3: .*temperature.unit: is 'degF': the bench"),
        ("low: -80", "low: 980", "^small:3: registers.temperature: low is 980, above high"),
        ("poll: [temperature, ", "poll: [temprature, ", "^small:6: poll: no register temprature; described are temp"),
        (
            "type: int16, scale: 0.1, write: 6",
            "type: int17, scael: 0.1, write: 6",
            "^small:4: .*scael: unknown key.*\nsmall:4: registers.setpoint.type: is 'int17'",
        ),
    ],
)
def test_a_wrong_map_is_refused_with_its_place(old: str, new: str, message: str):
    assert old in MAP
    with pytest.raises(ConfigError, match=message):
        parse_map(MAP.replace(old, new, 1), "small")


def test_a_poll_is_as_few_requests_as_the_controller_reads():
    assert [[r.name for r in block] for block in parse_map(MAP, "small").blocks] == [
        ["temperature", "setpoint", "mode"]
    ]
    far = parse_map(MAP.replace("address: 101", "address: 300"), "small")
    assert [[r.name for r in block] for block in far.blocks] == [["temperature", "mode"], ["setpoint"]]
    short = parse_map(MAP + "block_words: 2\n", "small")
    assert [len(block) for block in short.blocks] == [2, 1]


def test_an_unknown_model_names_the_known_ones(tmp_path):
    with pytest.raises(ConfigError, match="watlow_f4t"):
        load_map("watlow_f5")
    with pytest.raises(ConfigError, match=r"absent\.yaml"):
        load_map(tmp_path / "absent.yaml")
    (tmp_path / "mine.yaml").write_text(MAP)
    assert load_map(tmp_path / "mine.yaml").model == "Small"


def test_a_bit_is_a_coil_or_a_discrete_input_with_two_names():
    coil = register(type="bit", read=1, write=5, values={"off": 0, "on": 1})
    assert (coil.encode("on"), coil.decode([0])) == ((1,), "off")
    for wrong in ({"read": 3}, {"read": 2, "write": 5}, {"write": 6}, {"values": {"on": 2, "off": 0}}, {"values": {}}):
        with pytest.raises(ValueError, match=r"a coil has type|a bit needs two values"):
            register(**{"type": "bit", "read": 1, "write": None, "values": {"off": 0, "on": 1}} | wrong)


def test_coils_and_registers_are_read_in_requests_of_their_own():
    text = MAP.replace(
        "  mode: {address: 102, type: uint16, write: 6", "  mode: {address: 102, type: bit, read: 1, write: 5"
    )
    assert [[r.name for r in block] for block in parse_map(text, "small").blocks] == [
        ["mode"],
        ["temperature", "setpoint"],
    ]


@pytest.mark.parametrize("name", list_maps())
def test_a_shipped_map_leaves_no_word_order_open(name):
    assert [*load_map(name).doubts()] == []
