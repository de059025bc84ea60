"""Signals and checksums on the wire agree with cantools and crccheck."""

from pathlib import Path

import cantools
import numpy as np
import pytest
from cantools.database.can import Message as CantoolsMessage
from cantools.database.can import Signal as CantoolsSignal
from cantools.database.conversion import BaseConversion
from crccheck.crc import Crc8SaeJ1850
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from drivers.errors import ConfigError, LimitError
from drivers.wire import _message as layout_of
from drivers.wire import load_dbc

FAMILY = Path(__file__).parents[2] / "drivers" / "gyros" / "vibratory.dbc"
quick = settings(max_examples=200)


@st.composite
def layouts(draw, floats=True, most_bits=64):
    """One message with one signal of any place, length, byte order, type and scale."""
    big = draw(st.booleans())
    is_float = floats and draw(st.booleans())
    length = draw(st.sampled_from([16, 32, 64])) if is_float else draw(st.integers(1, most_bits))
    from_first = draw(st.integers(0, 64 - length))
    start = 8 * (from_first // 8) + 7 - from_first % 8 if big else from_first
    scale = draw(st.sampled_from([1, 2, 0.5, 1e-6, 0.005, -0.1]))
    conversion = BaseConversion.factory(scale=scale, offset=draw(st.sampled_from([0, 40, -273.15])), is_float=is_float)
    order = "big_endian" if big else "little_endian"
    signed = draw(st.booleans())
    return CantoolsMessage(
        1, "M", 8, [CantoolsSignal("S", start, length, order, signed, conversion=conversion)], strict=True
    )


@quick
@given(message=layouts(), payloads=st.lists(st.binary(min_size=8, max_size=8), min_size=1, max_size=20))
def test_any_signal_decodes_as_cantools_decodes_it(message, payloads):
    signal = layout_of(message).signals["S"]
    values = signal.physical(np.frombuffer(b"".join(payloads), dtype=np.uint8).reshape(-1, 8))
    expected = [float(message.decode(payload)["S"]) for payload in payloads]
    np.testing.assert_allclose(values, expected, rtol=3e-16)


@quick
@given(
    message=layouts(floats=False, most_bits=50),
    payloads=st.lists(st.binary(min_size=8, max_size=8), min_size=1, max_size=20),
)
def test_any_integer_signal_is_packed_as_cantools_packs_it(message, payloads):
    signal = message.signals[0]
    raw = [message.decode(payload, scaling=False)["S"] for payload in payloads]
    layout = layout_of(message)
    packed = layout.pack(len(raw), {"S": np.array(raw) * float(signal.scale) + float(signal.offset)})
    expected = [message.encode({"S": value}, scaling=False) for value in raw]
    assume(abs(signal.offset) == 0 or signal.length <= 30)  # beyond that the offset costs the last bits of a float
    assert [bytes(row) for row in packed] == expected


@quick
@given(data=st.data())
def test_the_shipped_family_packs_and_unpacks_as_cantools_does(data):
    database = cantools.database.load_file(FAMILY, strict=True)
    message = data.draw(st.sampled_from(database.messages))
    payload = data.draw(st.binary(min_size=message.length, max_size=message.length))
    layout = load_dbc("vibratory")[message.name]
    padded = np.frombuffer(payload.ljust(8, b"\0"), dtype=np.uint8).reshape(1, 8)
    expected = message.decode(payload, decode_choices=False)
    values = {name: signal.physical(padded) for name, signal in layout.signals.items()}
    assert {name: value[0] for name, value in values.items()} == pytest.approx(expected, rel=1e-15)
    assert bytes(layout.pack(1, values)[0])[: message.length] == message.encode(expected)


def test_the_family_names_the_unit_of_every_physical_signal():
    units = {
        name: signal.unit for message in load_dbc("vibratory").values() for name, signal in message.signals.items()
    }
    assert {units[n] for n in ("DriveAmplitude", "QuadratureAmplitude", "SupplyVoltage")} == {"V"}
    assert (units["Rate"], units["Temperature"], units["ResonanceFrequency"]) == ("deg/s", "degC", "Hz")


@pytest.mark.parametrize("name", ["GYRO_RATE", "GYRO_RES", "GYRO_SUPPLY"])
def test_the_checksum_is_sae_j1850(name):
    message = load_dbc("vibratory")[name]
    data = np.random.default_rng(1).integers(0, 256, (64, 8), dtype=np.uint8)
    for data_id in (0, 0x23, 0x1FF):
        expected = [Crc8SaeJ1850.calc(bytes(row[: message.length - 1]) + bytes([data_id & 0xFF])) for row in data]
        assert message.crc(data, data_id).tolist() == expected


@pytest.mark.parametrize("value", [164.0, -164.0, np.nan, np.inf])
def test_a_value_that_does_not_fit_is_refused_and_named(value):
    with pytest.raises(LimitError, match=r"Temperature = .*\[degC\] does not fit its signal \(-163.84 to 163.835\)"):
        load_dbc("vibratory")["GYRO_RES"].signals["Temperature"].raw([0.0, value])


def test_the_limits_themselves_fit():
    signal = load_dbc("vibratory")["GYRO_RATE"].signals["Rate"]
    assert signal.raw([-2147.483648, 2147.483647]).tolist() == [-(2**31), 2**31 - 1]


def test_wrong_names_are_refused():
    with pytest.raises(ConfigError, match="SlowCounter"):
        load_dbc("vibratory")["GYRO_SUPPLY"].pack(1, {"SupplyVoltage": 5.0})
    with pytest.raises(ConfigError, match="Volts"):
        load_dbc("vibratory")["GYRO_SUPPLY"].pack(1, {"SupplyVoltage": 5.0, "SlowCounter": 0, "Volts": 1})


def test_a_file_that_cannot_be_used_is_named(tmp_path):
    with pytest.raises(ConfigError, match=r"'nothing' is shipped: vibratory"):
        load_dbc("nothing")
    (tmp_path / "bad.dbc").write_text("BO_ what is this")
    with pytest.raises(ConfigError, match=r"bad\.dbc"):
        load_dbc(tmp_path / "bad.dbc")


MUX = (
    'VERSION ""\nBU_: A\nBO_ 1 GYRO: 8 A\n SG_ Rate : 0|16@1- (1,0) [0|0] "deg/s" A\n'
    ' SG_ SampleCounter : 16|16@1+ (1,0) [0|0] "" A\n SG_ Which M : 32|8@1+ (1,0) [0|0] "" A\n'
    ' SG_ Warm m0 : 40|8@1- (0.5,0) [0|0] "degC" A\n SG_ Supply m3 : 40|16@1+ (0.001,0) [0|0] "V" A\n'
)


def test_multiplexed_messages_are_not_sent(tmp_path):
    path = tmp_path / "mux.dbc"
    path.write_text(MUX)
    with pytest.raises(ConfigError, match="GYRO: is multiplexed"):
        load_dbc(path)["GYRO"].pack(1, {})


def test_a_multiplexed_signal_has_the_rows_that_carry_it(tmp_path):
    path = tmp_path / "mux.dbc"
    path.write_text(MUX)
    data = np.zeros((4, 8), dtype=np.uint8)
    data[:, 4], data[:, 5] = [0, 3, 7, 0], [10, 100, 0, 256 - 4]
    columns = load_dbc(path)["GYRO"].decode(data)
    assert columns["Which"].rows is None
    assert (columns["Warm"].rows.tolist(), columns["Warm"].values.tolist()) == ([0, 3], [5.0, -2.0])
    assert (columns["Supply"].rows.tolist(), columns["Supply"].values.tolist()) == ([1], [0.1])


@st.composite
def crowded(draw):
    """A message of any length with several signals that do not overlap, some of them chosen by another one's value."""
    length = draw(st.sampled_from([1, 3, 5, 7, 8, 12, 13, 24, 48, 64]))
    free, signals = np.ones(8 * length, dtype=bool), []
    for k in range(draw(st.integers(1, 6))):
        big, is_float = draw(st.booleans()), draw(st.booleans())
        bits = draw(st.sampled_from([16, 32, 64])) if is_float else draw(st.integers(1, 64))
        place = draw(st.integers(0, 8 * length - 1))
        own = np.arange(place, place + bits)
        if own[-1] >= 8 * length:
            continue
        own = 8 * (own // 8) + 7 - own % 8 if big else own
        if not free[own].all():
            continue
        free[own] = False
        scale = draw(st.sampled_from([1, 0.25, -1e-3]))
        conversion = BaseConversion.factory(scale=scale, offset=0, is_float=is_float)
        selector = next((s for s in signals if s.is_multiplexer), None)
        more = {}
        if selector is not None and draw(st.booleans()):
            ids = draw(st.sets(st.integers(0, (1 << selector.length) - 1), min_size=1, max_size=3))
            more = {"multiplexer_signal": selector.name, "multiplexer_ids": sorted(ids)}
        elif selector is None and not is_float and bits <= 3 and scale == 1:  # cantools chooses by the scaled value
            more = {"is_multiplexer": True}
        signed = not more and draw(st.booleans())
        order = "big_endian" if big else "little_endian"
        signals.append(CantoolsSignal(f"S{k}", int(own[0]), bits, order, signed, conversion=conversion, **more))
    assume(signals)
    return CantoolsMessage(1, "M", length, signals, is_fd=length > 8, strict=True)


@settings(max_examples=400)
@given(message=crowded(), data=st.data())
def test_any_message_decodes_as_cantools_decodes_it(message, data):
    """Big endian, signed, float, odd lengths, over nine bytes of a CAN FD frame, multiplexed: row by row the same."""
    payloads = data.draw(st.lists(st.binary(min_size=message.length, max_size=message.length), max_size=12))
    expected = []
    for payload in payloads:
        try:
            expected.append(message.decode(payload, decode_choices=False))
        except cantools.database.DecodeError:  # a value of the selector that the layout does not know
            expected.append(None)
    layout = layout_of(message)
    rows = b"".join(payload.ljust(layout.width, b"\0") for payload in payloads)
    columns = layout.decode(np.frombuffer(rows, dtype=np.uint8).reshape(-1, layout.width))
    found = [{} for _ in payloads]
    for name, (values, at) in columns.items():
        for row, value in zip(range(len(payloads)) if at is None else at, values.tolist(), strict=True):
            found[row][name] = value
    for mine, theirs in zip(found, expected, strict=True):
        if theirs is not None:
            assert mine == pytest.approx({name: float(v) for name, v in theirs.items()}, rel=3e-16, nan_ok=True)
