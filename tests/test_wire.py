"""Signals and checksums on the wire agree with cantools and crccheck, which know nothing of this code."""

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

FAMILY = Path(__file__).parents[1] / "drivers" / "gyros" / "vibratory.dbc"
quick = settings(max_examples=200, deadline=None)


@st.composite
def layouts(draw):
    """One message with one signal of any place, length, byte order, type and scale."""
    big = draw(st.booleans())
    is_float = draw(st.booleans())
    length = draw(st.sampled_from([16, 32, 64])) if is_float else draw(st.integers(1, 64))
    start = draw(st.integers(0, 63))
    from_first = 8 * (start // 8) + 7 - start % 8 if big else start
    assume(from_first + length <= 64)
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
    signal = layout_of(Path("m.dbc"), message).signals["S"]
    values = signal.physical(np.frombuffer(b"".join(payloads), dtype=np.uint8).reshape(-1, 8))
    expected = [float(message.decode(payload)["S"]) for payload in payloads]
    np.testing.assert_allclose(values, expected, rtol=3e-16)


@quick
@given(message=layouts(), payloads=st.lists(st.binary(min_size=8, max_size=8), min_size=1, max_size=20))
def test_any_integer_signal_is_packed_as_cantools_packs_it(message, payloads):
    signal = message.signals[0]
    assume(not signal.is_float and signal.length <= 50)
    raw = [message.decode(payload, scaling=False)["S"] for payload in payloads]
    layout = layout_of(Path("m.dbc"), message)
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
    with pytest.raises(ConfigError, match=r"nothing.dbc: No such file.*vibratory"):
        load_dbc("nothing")
    (tmp_path / "bad.dbc").write_text("BO_ what is this")
    with pytest.raises(ConfigError, match=r"bad\.dbc"):
        load_dbc(tmp_path / "bad.dbc")


def test_multiplexed_messages_are_refused_not_misread(tmp_path):
    path = tmp_path / "mux.dbc"
    path.write_text(
        'VERSION ""\nBU_: A\nBO_ 1 M: 8 A\n SG_ S M : 0|8@1+ (1,0) [0|0] "" A\n SG_ T m0 : 8|8@1+ (1,0) [0|0] "" A\n'
    )
    with pytest.raises(ConfigError, match="multiplexed"):
        load_dbc(path)
