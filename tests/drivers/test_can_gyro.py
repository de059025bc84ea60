"""The simulated unit sends valid frames: cantools reads them, and none is lost."""

from pathlib import Path
from types import SimpleNamespace

import can
import cantools
import numpy as np
import pytest
from crccheck.crc import Crc8SaeJ1850

from drivers.canbus import InProcessCapture
from drivers.errors import ConfigError, LimitError
from drivers.frames import to_frames, to_record
from drivers.gyro import GyroDecoder
from drivers.journal import JournalWriter, read_blocks
from drivers.sim.can_gyro import CanGyro

FAMILY = Path(__file__).parents[2] / "drivers" / "gyros" / "vibratory.dbc"


def signals(samples: int, seed: int = 0, **override):
    rng, slow = np.random.default_rng(seed), samples // 10
    values = {
        "rate_dph": rng.normal(0, 30, samples),
        "temperature": rng.uniform(-40, 85, slow),
        "frequency": rng.uniform(13990, 14010, slow),
        "drive": rng.uniform(1.1, 1.3, slow),
        "quadrature": rng.uniform(-0.02, 0.02, slow),
        "supply": 5.012,
    }
    return SimpleNamespace(**{**values, **override})


@pytest.fixture(params=["virtual", "blocks"])
def buses(request):
    buses = [can.Bus(interface=request.param, channel="gyro", preserve_timestamps=True) for _ in range(2)]
    yield buses
    for bus in buses:
        bus.shutdown()


def received(bus) -> list[can.Message]:
    return list(iter(lambda: bus.recv(0.0), None))


def test_cantools_reads_what_the_unit_sends(buses):
    truth = signals(500)
    CanGyro(buses[0], 3, 20260117, firmware=0x0203).send(100.0, truth)
    database = cantools.database.load_file(FAMILY)
    decoded: dict[str, list[dict]] = {}
    for message in received(buses[1]):
        layout = database.get_message_by_frame_id(message.arbitration_id - 3)
        decoded.setdefault(layout.name, []).append(layout.decode(bytes(message.data), decode_choices=False))
        if "Crc8" in decoded[layout.name][-1]:
            body = bytes(message.data[:-1]) + bytes([message.arbitration_id & 0xFF])
            assert message.data[-1] == Crc8SaeJ1850.calc(body)
    assert {name: len(rows) for name, rows in decoded.items()} == {
        "GYRO_RATE": 500, "GYRO_RES": 50, "GYRO_AMP": 50, "GYRO_SUPPLY": 1, "GYRO_HEARTBEAT": 2,
    }  # fmt: skip
    rate = [row["Rate"] * 3600 for row in decoded["GYRO_RATE"]]
    assert np.max(np.abs(rate - truth.rate_dph)) <= 0.0018 + 1e-9
    assert [row["SampleCounter"] for row in decoded["GYRO_RATE"]] == list(range(500))
    temperature = [row["Temperature"] for row in decoded["GYRO_RES"]]
    assert np.max(np.abs(temperature - truth.temperature)) <= 0.0025 + 1e-9
    assert [row["SlowCounter"] for row in decoded["GYRO_AMP"]] == [10 * k % 256 for k in range(50)]
    boot, alive = decoded["GYRO_HEARTBEAT"]
    assert boot == {"State": 0, "Serial": 20260117, "Firmware": 0x0203, "CoefficientSet": 0}
    assert alive == {**boot, "State": 5}


def test_frames_are_in_the_order_of_time_and_priority(buses):
    CanGyro(buses[0], 0, 1).send(7.0, signals(20))
    messages = received(buses[1])
    assert [m.arbitration_id for m in messages[:6]] == [0x700, 0x120, 0x130, 0x140, 0x150, 0x700]
    times = [m.timestamp for m in messages]
    assert times == sorted(times)
    assert times[0] == 7.0
    assert times[-1] == pytest.approx(7.0 + 19 * 0.002)


def test_ten_seconds_pass_the_bus_the_journal_and_the_decoder_without_loss(buses, tmp_path):
    writer = JournalWriter(tmp_path / "j")
    capture, unit, decoder = InProcessCapture(buses[1], writer), CanGyro(buses[0], 15, 42), GyroDecoder("vibratory", 15)
    rates = []
    for second in range(10):
        truth = signals(500, seed=second)
        unit.send(float(second), truth)
        block = decoder.decode(capture.poll())
        assert block.index.tolist() == list(range(500 * second, 500 * (second + 1)))
        assert np.max(np.abs(block.rate_dph - truth.rate_dph)) < 0.0019
        assert block.slow["temperature"].index.tolist() == list(range(500 * second, 500 * (second + 1), 10))
        assert np.max(np.abs(block.slow["frequency"].value - truth.frequency)) < 0.6e-5
        rates.append(block.rate_dph)
    losses = decoder.losses.as_dict()
    assert losses.pop("received") == 6021  # 10 x 602 and the boot-up heartbeat
    assert set(losses.values()) == {0}
    assert decoder.identity.serial == 42
    writer.close()
    again = GyroDecoder("vibratory", 15)
    replayed = [again.decode(block.frames()).rate_dph for block in read_blocks(tmp_path / "j")]
    assert np.array_equal(np.concatenate(replayed), np.concatenate(rates))


def test_a_piece_may_have_any_length(buses):
    unit, decoder = CanGyro(buses[0], 0, 1), GyroDecoder("vibratory", 0)
    sent = 0
    for samples in (1, 9, 10, 3, 497, 1480):
        slow = np.ones(sum(k % 10 == 0 for k in range(sent, sent + samples)))
        unit.send(sent * 0.002, signals(samples, temperature=slow, frequency=slow, drive=slow, quadrature=slow))
        sent += samples
    block = decoder.decode(to_frames(to_record(m, round(m.timestamp * 1e9)) for m in received(buses[1])))
    assert block.index.tolist() == list(range(2000))
    assert block.slow["drive"].index.tolist() == list(range(0, 2000, 10))
    assert block.slow["supply"].index.tolist() == [0, 500, 1000, 1500]


def test_a_rate_beyond_the_frame_is_refused_and_nothing_is_sent(buses):
    unit = CanGyro(buses[0], 0, 1)
    with pytest.raises(LimitError, match="Rate"):
        unit.send(0.0, signals(500, rate_dph=np.full(500, 2200 * 3600.0)))
    assert received(buses[1]) == []


def test_a_unit_number_beyond_the_identifiers_is_refused(buses):
    with pytest.raises(ConfigError, match="0 to 15"):
        CanGyro(buses[0], 16, 1)
