"""Each fault of the CAN bus: delivered samples, counts, and that data continue afterwards."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import can
import numpy as np
import pytest

from drivers.canbus import BusSettings, InProcessCapture, open_bus
from drivers.errors import ConfigError
from drivers.gyro import GyroBlock, GyroDecoder
from drivers.journal import FLAG_ERROR, JournalWriter, Kind, read_blocks
from drivers.sim.can_gyro import CanGyro
from drivers.sim.faults.bus import FaultyBus
from drivers.sim.faults.named import ON_BUS
from drivers.sim.faults.units import Layout

NUMBER, SERIAL = 2, 77
FAMILY = Path(__file__).parents[2] / "drivers" / "gyros" / "vibratory.dbc"


class Bench:
    """A unit at 500 Hz on a simulated bus, a capture behind a faulty bus, and a decoder."""

    def __init__(self, path, interface: str = "blocks", seed: int = 1) -> None:
        settings = BusSettings(interface, f"faults {path}", options={"preserve_timestamps": True})
        self.sender = open_bus(settings)
        self.bus = FaultyBus(open_bus(settings), seed=seed, number=NUMBER)
        self.gyro = CanGyro(self.sender, NUMBER, SERIAL)
        self.journal = path / "j"
        self.writer = JournalWriter(self.journal)
        self.capture = InProcessCapture(self.bus, self.writer)
        self.decoder = GyroDecoder("vibratory", NUMBER)
        self.sent = 0
        self.blocks: list[GyroBlock] = []

    def run(self, seconds: int, piece: int = 500) -> np.ndarray:
        """Let the unit send and the bench receive; the sample indices that came out."""
        before = len(self.blocks)
        for _ in range(seconds * 500 // piece):
            slow = np.zeros(piece // 10)
            signals = SimpleNamespace(
                rate_dph=(self.sent + np.arange(piece)) * 0.0036,
                temperature=slow,
                frequency=slow,
                drive=slow,
                quadrature=slow,
                supply=5.0,
            )
            self.gyro.send(self.sent * 0.002, signals)
            self.sent += piece
            self.blocks.append(self.decoder.decode(self.capture.poll()))
        return np.concatenate([block.index for block in self.blocks[before:]])

    def counts(self) -> dict[str, int]:
        return {k: v for k, v in self.decoder.losses.as_dict().items() if v and k not in ("received", "slow_lost")}

    def check(self) -> None:
        """Indices increase strictly, and each sample has the rate of its place."""
        index = np.concatenate([block.index for block in self.blocks])
        rate = np.concatenate([block.rate_dph for block in self.blocks])
        assert np.all(np.diff(index) > 0)
        np.testing.assert_allclose(rate, index * 0.0036, atol=1e-9)

    def close(self) -> None:
        self.writer.close()
        self.bus.shutdown()
        self.sender.shutdown()


@pytest.fixture
def bench(tmp_path):
    bench = Bench(tmp_path)
    bench.run(2)
    yield bench
    bench.close()


def test_without_faults_the_wrapper_is_not_noticed(bench):
    assert bench.run(3).tolist() == list(range(1000, 2500))
    assert bench.counts() == {}
    assert not bench.bus.counts


@pytest.mark.parametrize("share", [0.01, 0.3, 1.0])
def test_lost_frames_are_gaps_of_their_length(bench, share: float):
    bench.bus.inject("loss", share=share)
    kept = bench.run(4)
    bench.bus.clear()
    after = bench.run(1)
    assert after.tolist() == list(range(3000, 3500))
    assert len(kept) + bench.decoder.losses.lost == 2000
    assert set(bench.counts()) == {"lost"}
    bench.check()


def test_silence_is_one_gap(bench):
    bench.bus.inject("silence")
    assert len(bench.run(30)) == 0
    bench.bus.clear()
    assert bench.run(1)[0] == 16_000
    assert bench.counts() == {"lost": 15_000}


def test_duplicates_are_counted_and_no_data(bench):
    bench.bus.inject("duplicate", share=0.1)
    assert bench.run(4).tolist() == list(range(1000, 3000))
    counts = bench.counts()
    assert set(counts) == {"repeated"}
    assert 0 < counts["repeated"] <= bench.bus.counts["duplicate"]
    assert bench.decoder.conflict is None
    bench.check()


def test_overtaken_frames_are_put_back(bench):
    bench.bus.inject("reorder", share=0.05)
    kept = bench.run(4)
    assert set(bench.counts()) <= {"out_of_order", "lost"}, "lost: its block was delivered already"
    assert bench.counts()["out_of_order"] > 0
    assert len(kept) >= 1990
    bench.check()


def test_corrupt_frames_cost_themselves_alone(bench):
    bench.bus.inject("corrupt", share=0.1)
    bench.run(4)
    bench.bus.clear()
    bench.run(1)
    losses = bench.decoder.losses
    assert set(bench.counts()) == {"corrupt", "lost"}
    assert 0 < losses.lost < losses.corrupt <= bench.bus.counts["corrupt"]
    bench.check()


def test_a_burst_that_is_late_is_kept_out_beyond_half_a_second(bench):
    bench.bus.inject("burst", seconds=2.0)
    assert len(bench.run(2)) == 0
    got = bench.run(2)
    assert got[0] == 1000 + 750, "what is younger than half a second when the burst comes is data"
    assert got[-1] == 2999
    assert bench.counts() == {"late": 750}
    bench.check()


def test_error_frames_are_counted_and_harmless(bench):
    bench.bus.inject("error_frames", share=0.05)
    assert bench.run(4).tolist() == list(range(1000, 3000))
    struck = bench.bus.counts["error_frames"]
    assert bench.capture.health().error_frames == struck > 0
    assert bench.counts() == {}
    journalled = np.concatenate([b.frames() for b in read_blocks(bench.journal) if b.kind is Kind.FRAMES])
    assert np.count_nonzero(journalled["flags"] & FLAG_ERROR) == struck


@pytest.mark.parametrize("name", ["reset", "silent_reset"])
def test_a_reset_is_one_gap_and_time_goes_on(bench, name: str):
    bench.bus.inject(name, seconds=0.3)
    got = bench.run(3)
    assert np.all(np.diff(got) > 0)
    assert got[0] == pytest.approx(1150, abs=1)
    assert len(got) == pytest.approx(1350, abs=1)
    assert bench.decoder.losses.resets == 1
    assert bench.decoder.losses.lost == pytest.approx(150, abs=1)
    assert bench.decoder.identity.serial == SERIAL
    assert bench.decoder.conflict is None
    bench.check()


@pytest.mark.parametrize("name", ["reset", "silent_reset"])
def test_a_unit_that_resets_again_and_again_never_gets_the_same_time_twice(bench, name: str):
    for _ in range(4):
        bench.bus.inject(name, seconds=0.5)
        bench.run(3)
    assert bench.decoder.losses.resets == 4
    bench.check()


def test_two_units_under_one_number_are_said_clearly(bench):
    bench.bus.inject("twin")
    got = bench.run(4)
    assert "serial numbers 77 and 78 answer in turn as number 2" in (bench.decoder.conflict or "").replace(
        "78 and 77", "77 and 78"
    )
    assert got.tolist() == list(range(1000, 3000)), "the first unit's samples, and only those"
    assert bench.decoder.losses.corrupt >= 1999


def test_two_counters_without_heartbeats_are_a_conflict_too(bench):
    bench.bus.inject("twin")
    bench.gyro.serial = 0
    bench.decoder._heartbeat = bench.decoder._rate  # a family whose heartbeats nobody hears
    bench.decoder._read_heartbeat = lambda words: np.zeros(0, dtype=np.int64)
    bench.run(4)
    assert "second sample counter" in bench.decoder.conflict


def test_bus_off_is_an_error_until_it_is_over_and_an_event_each(bench):
    bench.bus.inject("bus_off")
    assert len(bench.run(2)) == 0
    health = bench.capture.health()
    assert (health.state, health.since_s) == ("degraded", pytest.approx(2.0, abs=0.01))
    assert "bus off" in health.error
    with pytest.raises(can.CanOperationError):
        bench.bus.send(can.Message())
    bench.bus.clear()
    bench.run(1)
    health = bench.capture.health()
    assert (health.state, health.error, health.since_s, health.recoveries) == ("ok", None, None, 1)
    events = [block.payload.decode() for block in read_blocks(bench.journal) if block.kind is Kind.EVENT]
    assert len(events) == 2
    assert "bus off" in events[0]
    assert "open again" in events[1]
    bench.check()


def test_single_messages_meet_the_same_faults(tmp_path):
    bench = Bench(tmp_path, "virtual")
    bench.run(1, piece=50)
    bench.bus.inject("loss", share=0.2)
    bench.bus.inject("reorder", share=0.1)
    bench.run(1, piece=50)
    bench.bus.clear()
    bench.run(1, piece=50)
    assert set(bench.counts()) == {"lost", "out_of_order"}
    bench.check()
    bench.close()


def test_faults_repeat_with_their_seed(tmp_path):
    def struck(seed: int) -> list[int]:
        (folder := tmp_path / f"{seed}{len(list(tmp_path.iterdir()))}").mkdir()
        bench = Bench(folder, seed=seed)
        bench.bus.inject("loss", share=0.2)
        index = bench.run(2).tolist()
        bench.close()
        return index

    assert struck(1) == struck(1) != struck(2)


def test_a_fault_that_does_not_exist_is_refused(bench):
    with pytest.raises(ValueError, match="must be one of loss"):
        bench.bus.inject("nonsense")
    assert len(ON_BUS) == 11


def test_a_heartbeat_with_a_flipped_bit_is_not_believed_and_one_that_comes_again_is(bench):
    def say(serial: int, coefficient_set: int, times: int) -> None:
        bench.gyro.serial, bench.gyro.coefficient_set = serial, coefficient_set
        bench.run(times)
        bench.gyro.serial, bench.gyro.coefficient_set = SERIAL, 0

    for serial, coefficients in ((SERIAL + 256, 0), (SERIAL, 64), (SERIAL + 256, 0)):
        say(serial, coefficients, 1)
        bench.run(4)
        assert (bench.decoder.identity.serial, bench.decoder.identity.coefficient_set) == (SERIAL, 0)
    assert bench.decoder.conflict is None
    say(SERIAL, 64, 2)
    assert bench.decoder.identity.coefficient_set == 64
    bench.run(2)
    say(SERIAL + 1, 0, 2)
    assert bench.decoder.identity.serial == SERIAL + 1
    assert bench.decoder.conflict is not None


@pytest.mark.parametrize("name", ["SampleCounter", "Serial"])
def test_a_dbc_without_what_faults_forge_is_refused_by_name(tmp_path, name):
    own = tmp_path / "own.dbc"
    own.write_text(FAMILY.read_text().replace(name, "Other"))
    with pytest.raises(ConfigError, match=f"own.dbc: no message has '{name}'"):
        Layout(own, 0)
