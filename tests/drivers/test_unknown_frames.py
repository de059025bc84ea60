"""Frames that nobody described: what cantools encoded is found again, in either byte order, and nothing else is."""

import struct

import cantools
import numpy as np
import pytest

from drivers.can_record import frame_type
from drivers.framing import Check, Framing
from drivers.unknown_frames import heard, thermometers, values

AXES = """VERSION ""
NS_ :
BS_:
BU_: Imu
BO_ 416 AXES: 8 Imu
 SG_ X : {x}@{order}- (1,0) [0|0] "" Imu
 SG_ Y : {y}@{order}- (1,0) [0|0] "" Imu
 SG_ Z : {z}@{order}- (1,0) [0|0] "" Imu
 SG_ Tick : {tick}@{order}+ (1,0) [0|0] "" Imu
BO_ 512 SLOW: 3 Imu
 SG_ Warm : {warm}@{order}- (1,0) [0|0] "" Imu
 SG_ Mode : {mode}@{order}+ (1,0) [0|0] "" Imu
"""
LITTLE = {"x": "0|16", "y": "16|16", "z": "32|16", "tick": "48|16", "warm": "0|16", "mode": "16|8", "order": "1"}
BIG = {"x": "7|16", "y": "23|16", "z": "39|16", "tick": "55|16", "warm": "7|16", "mode": "23|8", "order": "0"}


def frames(places, count=1500, degc=2340):
    """A fast message with three noisy numbers and a counter, a slow one with a thermometer near 23.4 degC x 100."""
    database = cantools.database.load_string(AXES.format(**places), "dbc")
    random = np.random.default_rng(1)
    axes = random.normal((900, -20, -1500), 40, (count, 3))
    rows = []
    for k in range(count):
        told = dict(zip("XYZ", np.round(axes[k]).astype(int).tolist(), strict=True)) | {"Tick": (k + 65000) & 0xFFFF}
        rows.append((k * 4_000_000, 416, database.encode_message("AXES", told, strict=False)))
        if k % 10 == 0:
            warm = {"Warm": degc + int(random.integers(-3, 4)), "Mode": 5}
            rows.append((k * 4_000_000 + 7, 512, database.encode_message("SLOW", warm, strict=False)))
    made = np.zeros(len(rows), dtype=frame_type(8))
    for row, (t_ns, identifier, data) in zip(made, rows, strict=True):
        row["t_ns"], row["id"], row["len"] = t_ns, identifier, len(data)
        row["data"][: len(data)] = np.frombuffer(data, np.uint8)
    return made, axes


@pytest.mark.parametrize(("places", "big"), [(LITTLE, False), (BIG, True)])
def test_numbers_and_counters_are_found_in_their_byte_order(places, big):
    made, axes = frames(places)
    fast, slow = heard(made, 6.0)
    assert (fast.id, slow.id) == (416, 512)
    assert fast.rate_hz == pytest.approx(250.0)
    numbers, (counter,) = fast.of_kind("number"), fast.of_kind("counter")
    assert [(one.first, one.size, one.big, one.signed) for one in numbers] == [(k, 2, big, True) for k in (0, 2, 4)]
    assert (counter.first, counter.size, counter.big, counter.mean) == (6, 2, big, 1.0)
    data = np.ascontiguousarray(made[made["id"] == 416]["data"])
    np.testing.assert_array_equal(values(data, 2, 2, big=big, signed=True), np.round(axes[:, 1]))
    (((identifier, _), (field, scale, unit)),) = thermometers((fast, slow), 23.0).items()
    assert (identifier, field.first, field.size, field.big, scale, unit) == (512, 0, 2, big, 0.01, "degC")


def test_a_thermometer_in_kelvin_is_found():
    made, _ = frames(LITTLE, degc=29655)
    ((_, scale, unit),) = thermometers(heard(made, 6.0), 23.0).values()
    assert (scale, unit) == (0.01, "K")


def test_bytes_that_the_framing_knows_are_no_numbers():
    """Header, counter, a noisy rate of three bytes, a thermometer of two, a status, CRC."""
    random, framing = np.random.default_rng(1), Framing("header", b"\x7e\xa5", 12, crc=Check(16, 0x1021))
    made = np.zeros(400, dtype=frame_type(16))
    for k, row in enumerate(made):
        rate, warm = int(random.normal(400, 40)), 2970 + int(random.normal(0, 2))
        packet = struct.pack(">2xHxHHB2x", 2 * k, rate, warm, 1)
        row["t_ns"], row["len"] = k * 10_000_000, 12
        row["data"][:12] = np.frombuffer(framing.encode(0, packet), np.uint8)
    (one,) = heard(made, 4.0, framing)
    (counter,), numbers = one.of_kind("counter"), one.of_kind("number")
    assert (counter.first, counter.size, counter.mean) == (2, 2, 2.0)
    assert max(number.first + number.size for number in numbers) <= 10
    assert min(number.first for number in numbers) >= 4
    warm = [(window.first, window.big, scale, unit) for window, scale, unit in thermometers([one], 23.0).values()]
    assert (7, True, 1 / 128, "degC") in warm


def test_too_few_frames_tell_nothing():
    made, _ = frames(LITTLE, 15)
    assert [one.fields for one in heard(made, 0.06)] == [(), ()]
