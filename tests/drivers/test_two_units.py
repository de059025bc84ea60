"""Two units under one number on one bus, whatever their counters and however their frames fall between each other."""

import numpy as np
import pytest

from drivers.gyro import GyroDecoder
from drivers.journal import FRAME
from drivers.wire import load_dbc

RATE = load_dbc("vibratory")["GYRO_RATE"]
BEAT = load_dbc("vibratory")["GYRO_HEARTBEAT"]
INTERVAL_NS = 2_000_000


def frames_of(identifier, message, t_ns, data):
    frames = np.zeros(len(t_ns), dtype=FRAME)
    frames["t_ns"], frames["id"], frames["len"], frames["data"] = t_ns, identifier, message.length, data
    return frames


def unit(seconds, from_s=0.0, counter=0, *, seed=1, serial=7, delay_ns=0, every=1):
    """Frames of one unit; `every`: it sends so many at once."""
    n = round(500 * (seconds - from_s))
    k = np.arange(n)
    values = {name: 0 for name in ("Status", "CompensationActive", "RateSaturated")}
    values |= {"RateValid": 1, "LoopLocked": 1, "SampleCounter": (k + counter) & 0xFFFF}
    values["Rate"] = np.random.default_rng(seed).normal(0.0, 0.004, n)
    data = RATE.pack(n, values)
    data[:, 7] = RATE.crc(data, RATE.id)
    t_ns = round(from_s * 1e9) + (k // every * every + every - 1) * INTERVAL_NS + delay_ns
    beats = np.arange(0, n, 500)
    said = BEAT.pack(len(beats), {"State": 5, "Serial": serial, "Firmware": 1, "CoefficientSet": 0})
    return [frames_of(RATE.id, RATE, t_ns, data), frames_of(BEAT.id, BEAT, t_ns[beats], said)]


def heard(*units, block_s=1.0):
    """What a decoder makes of all their frames, in blocks."""
    both = np.concatenate([part for one in units for part in one])
    both = both[np.argsort(both["t_ns"], kind="stable")]
    decoder = GyroDecoder("vibratory", 0)
    found_s = None
    for start in np.arange(0.0, both["t_ns"][-1] * 1e-9, block_s):
        at = (both["t_ns"] >= start * 1e9) & (both["t_ns"] < (start + block_s) * 1e9)
        decoder.decode(both[at])
        found_s = start + block_s if found_s is None and decoder.impostor else found_s
    return decoder, found_s


OFFSETS = [0, 1, -1, 7, -16, -17, 100, 900, 5000, 30_011, -20_000]


@pytest.mark.parametrize("offset", OFFSETS)
@pytest.mark.parametrize("every", [1, 5, 50])
def test_a_second_unit_is_certain_within_seconds_whatever_its_counter(offset, every):
    first, second = unit(30), unit(30, 10, 5000 + offset, seed=2, delay_ns=700_000, every=every)
    decoder, found_s = heard(first, second)
    assert found_s is not None
    assert found_s <= 19.0
    assert "two units with this number" in decoder.conflict


@pytest.mark.parametrize("offset", [0, 30_011])
def test_also_when_it_is_there_from_the_start_and_in_large_blocks(offset):
    decoder, found_s = heard(unit(60), unit(60, 0, offset, seed=2, delay_ns=900_000), block_s=30.0)
    assert found_s == 30.0
    assert decoder.twins_at is not None


def test_with_another_serial_number_it_is_certain_by_its_heartbeats():
    _, found_s = heard(unit(30), unit(30, 10, 0, seed=2, serial=8, delay_ns=10_000))
    assert found_s <= 14.0


def test_an_adapter_that_repeats_every_frame_is_not_a_second_unit():
    decoder, found_s = heard(unit(30), unit(30, delay_ns=500_000))
    assert found_s is None
    assert decoder.losses.repeated == pytest.approx(15_000, abs=2)


@pytest.mark.parametrize("stall_s", [1.0, 3.0, 6.0])
@pytest.mark.parametrize("catch_up", [1.5, 3.0, 1000.0])
def test_a_burst_after_a_stall_is_not_a_second_unit(stall_s, catch_up):
    rate, beats = unit(60)
    t_s = rate["t_ns"] * 1e-9
    late_s = np.maximum(stall_s - np.maximum(t_s - 20.0, 0.0) * (1 - 1 / catch_up), 0.0)
    rate["t_ns"] = np.where(t_s >= 20.0, (t_s + late_s) * 1e9, rate["t_ns"]).astype(np.int64)
    decoder, found_s = heard([rate, beats])
    assert found_s is None
    assert decoder.twins_at is None


def test_what_two_units_send_is_not_taken_once_it_is_certain():
    decoder, _ = heard(unit(200), unit(200, 10, 77, seed=2, delay_ns=700_000))
    assert decoder.samples < 20 * 500
