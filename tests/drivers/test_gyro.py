"""Frames become samples; every rejected frame is counted, and its place is a gap."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from drivers.errors import ConfigError
from drivers.frames import NO_FRAMES
from drivers.gyro import GyroDecoder, Identity, SampleClock
from drivers.samples import ClockEstimate
from drivers.sim.can_gyro import CanGyro

MS = 1_000_000


class Wire:
    """Takes what a unit sends."""

    def __init__(self) -> None:
        self.blocks: list[np.ndarray] = []

    def send_block(self, frames: np.ndarray) -> None:
        self.blocks.append(frames)


class Unit:
    """A simulated unit whose rate [deg/h] is its sample number, and the frames that it has sent."""

    def __init__(self, number: int = 2) -> None:
        self.wire = Wire()
        self.gyro = CanGyro(self.wire, number, 77, coefficient_set=1)
        self.sent = 0

    def run(self, samples: int, t0_s: float | None = None) -> np.ndarray:
        slow = samples // 10
        self.gyro.send(
            self.sent * 0.002 if t0_s is None else t0_s,
            SimpleNamespace(
                rate_dph=(self.sent + np.arange(samples)) * 0.0036,
                temperature=20 + 0.005 * (self.sent // 10 + np.arange(slow)) % 50,
                frequency=np.full(slow, 14000.0),
                drive=np.full(slow, 1.2),
                quadrature=np.full(slow, 0.01),
                supply=5.0,
            ),
        )
        self.sent += samples
        return self.wire.blocks.pop()


@pytest.fixture
def unit():
    return Unit()


@pytest.fixture
def decoder():
    return GyroDecoder("vibratory", 2)


def rate_rows(frames: np.ndarray) -> np.ndarray:
    return np.flatnonzero(frames["id"] == 0x122)


def counts(decoder: GyroDecoder) -> dict[str, int]:
    return {name: count for name, count in decoder.losses.as_dict().items() if count and name != "received"}


def check_places(block) -> None:
    """Every sample that was delivered carries the rate of its place."""
    good = block.valid
    np.testing.assert_allclose(block.rate_dph[good], block.index[good] * 0.0036, atol=1e-9)
    assert np.all(np.diff(block.index) > 0)


def test_a_clean_block_is_delivered_whole(unit, decoder):
    block = decoder.decode(unit.run(1000))
    assert block.index.tolist() == list(range(1000))
    assert block.t_ns.tolist() == [k * 2 * MS for k in range(1000)]
    assert np.all(block.valid)
    check_places(block)
    assert counts(decoder) == {}
    assert decoder.identity == Identity(serial=77, firmware=0x100, coefficient_set=1, state=5)
    assert decoder.last == pytest.approx(
        {"temperature": 20.495, "frequency": 14000.0, "drive": 1.2, "quadrature": 0.01, "supply": 5.0}
    )
    assert decoder.samples == 1000
    assert decoder.rate_step_dph == pytest.approx(0.0036)


def test_the_counter_wraps_and_time_goes_on(unit, decoder):
    for second in range(140):
        block = decoder.decode(unit.run(500))
        assert block.index[[0, -1]].tolist() == [500 * second, 500 * second + 499]
        assert block.slow["temperature"].index[0] == 500 * second
    assert counts(decoder) == {}


def test_frames_of_other_units_and_other_devices_are_left_alone(unit, decoder):
    other = Unit(number=3).run(100)
    foreign = other.copy()
    foreign["id"] = 0x555
    block = decoder.decode(np.concatenate((other, unit.run(100), foreign)))
    assert block.index.tolist() == list(range(100))
    assert decoder.losses.received == 123


def test_lost_frames_are_gaps_and_counted(unit, decoder):
    frames = unit.run(500)
    drop = rate_rows(frames)[[10, 11, 12, 200, 499]]
    block = decoder.decode(np.delete(frames, drop))
    assert sorted(set(range(500)) - set(block.index.tolist())) == [10, 11, 12, 200, 499]
    check_places(block)
    assert counts(decoder) == {"lost": 4}
    decoder.decode(unit.run(500))
    assert counts(decoder) == {"lost": 5}, "the last one shows when the next block arrives"


@pytest.mark.parametrize("outage_s", [1, 60, 131, 132, 200, 600])
def test_an_outage_longer_than_the_counter_is_counted_exactly(unit, decoder, outage_s):
    decoder.decode(unit.run(500))
    unit.run(500 * outage_s)
    block = decoder.decode(unit.run(500))
    assert block.index[0] == 500 * (1 + outage_s)
    assert block.slow["supply"].index.tolist() == [500 * (1 + outage_s)]
    assert decoder.losses.lost == 500 * outage_s
    assert decoder.losses.slow_lost == 101 * outage_s
    assert decoder.losses.resets == 0


def test_repeated_frames_are_counted_once_as_data(unit, decoder):
    frames = unit.run(500)
    rows = rate_rows(frames)
    twice = np.insert(frames, rows[7] + 1, frames[rows[7]])
    block = decoder.decode(np.insert(twice, len(twice), frames[rows[499]]))
    assert block.index.tolist() == list(range(500))
    assert counts(decoder) == {"repeated": 2}
    block = decoder.decode(np.concatenate((frames[rows[498:]], unit.run(500))))
    assert block.index.tolist() == list(range(500, 1000))
    assert counts(decoder) == {"repeated": 4}


def test_a_wrong_crc_costs_the_frame(unit, decoder):
    frames = unit.run(500)
    rows = rate_rows(frames)
    frames["data"][rows[5], 0] ^= 1
    frames["data"][rows[6], 7] ^= 0x80
    slow = np.flatnonzero(frames["id"] == 0x132)[3]
    frames["data"][slow, 4] ^= 4
    block = decoder.decode(frames)
    assert {5, 6}.isdisjoint(block.index.tolist())
    assert 30 not in block.slow["temperature"].index
    assert 30 in block.slow["drive"].index
    assert counts(decoder) == {"corrupt": 3, "lost": 2, "slow_lost": 1}
    check_places(block)


def test_a_frame_of_another_identifier_fails_its_crc(decoder):
    frames = Unit(number=1).run(10)
    frames["id"] += 1  # the right bytes under the identifier of another unit
    decoder.decode(frames)
    assert decoder.losses.corrupt == decoder.losses.received - 2, "all but the heartbeats, which carry no CRC"


def test_a_wrong_length_costs_the_frame(unit, decoder):
    frames = unit.run(100)
    frames["len"][rate_rows(frames)[4]] = 7
    assert 4 not in decoder.decode(frames).index
    assert counts(decoder) == {"corrupt": 1, "lost": 1}


def test_overtaken_frames_are_put_back_in_their_place(unit, decoder):
    frames = unit.run(500)
    rows = rate_rows(frames)
    swapped = frames.copy()
    swapped[[rows[20], rows[21], rows[22]]] = frames[[rows[22], rows[20], rows[21]]]
    block = decoder.decode(swapped)
    assert block.index.tolist() == list(range(500))
    check_places(block)
    assert counts(decoder) == {"out_of_order": 2}


def test_a_frame_that_arrives_after_its_block_was_delivered_stays_a_gap(unit, decoder):
    first, second = unit.run(500), unit.run(500)
    last = rate_rows(first)[498]
    decoder.decode(np.delete(first, last))
    block = decoder.decode(np.insert(second, 1, first[last]))
    assert block.index.tolist() == list(range(500, 1000))
    assert counts(decoder) == {"out_of_order": 1, "lost": 1}


def test_late_frames_are_kept_out(unit, decoder):
    decoder.decode(unit.run(500))
    frames = unit.run(500)
    frames["t_ns"] = np.maximum(frames["t_ns"], 1_900 * MS)  # the bus stalls for 0.9 s, then catches up
    block = decoder.decode(frames)
    assert block.index.tolist() == list(range(700, 1000)), "those within half a second are data"
    check_places(block)
    assert counts(decoder) == {"late": 200}


@pytest.mark.parametrize(("ran", "silent_s"), [(300, 0.1), (700, 1.0), (40_000, 0.3), (65_400, 3.0), (65_400, 0.1)])
@pytest.mark.parametrize("announced", [True, False])
def test_a_reset_is_counted_and_time_goes_on(unit, decoder, ran, silent_s, announced):
    decoder.decode(unit.run(ran - ran % 10))
    unit.gyro.reboot()
    t0_s = ran * 0.002 + silent_s
    frames = unit.run(500, t0_s)
    block = decoder.decode(frames if announced else frames[1:])
    assert block.index[0] == pytest.approx(t0_s / 0.002, abs=1)
    assert np.all(np.diff(block.index) == 1)
    assert block.slow["temperature"].index[:3].tolist() == [block.index[0], block.index[10], block.index[20]]
    assert decoder.losses.resets == 1
    assert decoder.losses.corrupt == 0


@pytest.mark.parametrize("blocks", [1, 4, 20])
@pytest.mark.parametrize("silent_s", [0.4, 1.0, 1.9])
def test_a_silent_reset_that_looks_like_lateness_is_told_within_seconds(unit, decoder, silent_s, blocks):
    """The counter is close to its wrap, so that starting at 0 agrees with host time to a second or two."""
    decoder.decode(unit.run(65_500))
    unit.gyro.reboot()
    t0_s = 131.0 + silent_s
    frames = unit.run(10_000, t0_s)[1:]
    index = np.concatenate([decoder.decode(part).index for part in np.array_split(frames, blocks)])
    assert np.all(np.diff(index) > 0)
    assert index[-1] == pytest.approx((t0_s + 20.0) / 0.002, abs=2)
    assert decoder.losses.resets == 1
    assert decoder.losses.late <= 3.0 / 0.002 + 500


def test_a_stall_with_losses_that_catches_up_is_no_reset(unit, decoder):
    decoder.decode(unit.run(500))
    frames = unit.run(5000)
    stalled = frames["t_ns"] < 3_000 * MS
    frames["t_ns"][stalled] = 3_000 * MS
    rng = np.random.default_rng(2)
    kept = frames[~stalled | (rng.random(len(frames)) < 0.5)]
    for part in np.array_split(kept, 7):
        check_places(decoder.decode(part))
    assert decoder.losses.resets == 0


def test_a_reset_announced_at_the_end_of_a_block_is_seen_in_the_next(unit, decoder):
    decoder.decode(unit.run(100))
    unit.gyro.reboot()
    frames = unit.run(100, 1.0)
    decoder.decode(frames[:1])
    block = decoder.decode(frames[1:])
    assert block.index[0] == 500
    assert decoder.losses.resets == 1


def test_what_the_unit_calls_invalid_is_a_gap(unit, decoder):
    frames = unit.run(100)
    rows = rate_rows(frames)
    message = decoder._rate
    for row, flip in ((3, 0x10), (4, 0x20), (5, 0x80)):  # not valid, not locked, saturated
        frames["data"][rows[row], 6] ^= flip
    frames["data"][rows, 7] = message.crc(frames["data"][rows], 0x122)
    block = decoder.decode(frames)
    assert np.flatnonzero(~block.valid).tolist() == [3, 4, 5]
    assert np.isnan(block.rate_dph[3:6]).all()
    check_places(block)
    assert counts(decoder) == {"invalid": 3}


@settings(max_examples=150)
@given(data=st.data())
def test_whatever_happens_on_the_wire_samples_stand_in_their_place_and_the_sum_is_right(data):
    unit, decoder = Unit(), GyroDecoder("vibratory", 2)
    frames = np.concatenate([unit.run(500) for _ in range(3)])
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    frames = frames[rng.random(len(frames)) > data.draw(st.sampled_from([0.0, 0.01, 0.5]))]
    frames = np.repeat(frames, 1 + (rng.random(len(frames)) < data.draw(st.sampled_from([0.0, 0.05]))))
    flips = rng.random(len(frames)) < data.draw(st.sampled_from([0.0, 0.02]))
    frames["data"][flips, rng.integers(0, 4)] ^= np.uint8(1 << rng.integers(0, 8))  # one bit never passes a CRC
    cuts = sorted(data.draw(st.lists(st.integers(0, len(frames)), max_size=5)))
    blocks = [decoder.decode(part) for part in np.split(frames, cuts)]
    index = np.concatenate([block.index for block in blocks])
    for block in blocks:
        check_places(block)
    assert np.all(np.diff(index) > 0)
    losses = decoder.losses
    if len(index):
        assert losses.lost == index[-1] - index[0] + 1 - len(index)
    assert losses.resets == losses.late == losses.out_of_order == 0
    for name, series in {k: v for b in blocks for k, v in b.slow.items()}.items():
        assert np.all(series.index % (500 if name == "supply" else 10) == 0)


@settings(max_examples=100)
@given(noise=st.lists(st.binary(min_size=8, max_size=8), max_size=40), seed=st.integers(0, 1000))
def test_noise_under_the_right_identifier_never_moves_the_time_axis(noise, seed):
    """Random bytes pass an 8-bit CRC once in 256; a counter from such a frame must not be trusted."""
    unit, decoder = Unit(), GyroDecoder("vibratory", 2)
    frames = unit.run(1000)
    rng = np.random.default_rng(seed)
    for payload in noise:
        row = rng.choice(rate_rows(frames))
        frames["data"][row] = np.frombuffer(payload, dtype=np.uint8)
        frames["data"][row, 7] = decoder._rate.crc(frames["data"][row : row + 1], 0x122)[0]  # and passes
    block = decoder.decode(frames)
    assert np.all(np.diff(block.index) > 0)
    later = decoder.decode(unit.run(500))
    if not decoder.losses.resets:
        assert later.index[-1] == 1499


@st.composite
def silences(draw):
    """Samples before a reset, and a silence [ms] after which the counter is often almost what it would have been."""
    ran = draw(st.integers(10, 6_600)) * 10
    near = (-2 * ran) % 131_072 + draw(st.integers(-150, 150))
    return ran, draw(st.just(near) if 20 <= near <= 140_000 else st.integers(20, 140_000))


@settings(max_examples=60)
@example((100, 130_960), False, [1], 0.0)  # proven in the middle of a long block
@given(
    silence=silences() | st.tuples(st.just(1000), st.integers(20, 140_000)),
    announced=st.booleans(),
    cuts=st.lists(st.integers(0, 5000), max_size=6),
    loss=st.sampled_from([0.0, 0.1]),
)
def test_wherever_a_unit_resets_its_samples_follow_host_time_again(silence, announced, cuts, loss):
    """Within 50 ms and the drift of the silence, or exactly if it is announced; and no time occurs twice."""
    ran, silent_ms = silence
    unit, decoder = Unit(), GyroDecoder("vibratory", 2)
    blocks = [decoder.decode(unit.run(ran))]
    unit.gyro.reboot()
    t0_s = ran * 0.002 + silent_ms * 0.001
    frames = unit.run(4000, t0_s)[0 if announced else 1 :]
    kept = frames[np.random.default_rng(1).random(len(frames)) >= loss]
    if announced:
        kept = np.concatenate((frames[:1], kept[1:] if kept[0] == frames[0] else kept))
    blocks += [decoder.decode(part) for part in np.split(kept, sorted(min(cut, len(kept)) for cut in cuts))]
    index = np.concatenate([block.index for block in blocks])
    assert np.all(np.diff(index) > 0)
    off = index[-1] - (blocks[-1].t_ns[-1] / (2 * MS) if len(blocks[-1].t_ns) else index[-1])
    assert abs(off) <= (1 if announced else (50 + 200e-6 * silent_ms) / 2)
    assert decoder.losses.resets == 1 or not announced
    assert decoder.losses.resets <= 1


def test_an_empty_block_is_empty(decoder):
    block = decoder.decode(NO_FRAMES)
    assert len(block.index) == len(block.slow["temperature"].index) == 0
    assert decoder.identity is None


def test_a_dbc_without_what_a_gyro_needs_is_refused(tmp_path):
    family = (Path(__file__).parents[2] / "drivers" / "gyros" / "vibratory.dbc").read_text()
    for text, complaint in (
        (family.replace(" SG_ Rate ", " SG_ Speed "), "0 messages with Rate, must be"),
        (family.replace('"deg/s"', '"mph"'), "GYRO_RATE.Rate has the unit 'mph'"),
        (family.replace('BA_ "GenMsgCycleTime" BO_ 288 2;', ""), "no cycle time"),
    ):
        path = tmp_path / f"{len(complaint)}.dbc"
        path.write_text(text)
        with pytest.raises(ConfigError, match=complaint):
            GyroDecoder(path, 0)


def test_the_clock_is_exact_when_stamps_are():
    clock = SampleClock(0.002)
    index = np.arange(0, 500_000)
    for part in np.split(index, 1000):
        clock.add(part, 7_000_000_000 + part * 2 * MS)
    assert clock.estimate().drift_ppm == 0.0
    np.testing.assert_allclose(clock.time(index), 7.0 + index * 0.002, rtol=1e-14)


def test_the_clock_finds_drift_and_offset_under_host_delays():
    rng = np.random.default_rng(4)
    index = np.arange(0, 3600 * 500)
    true_s = 3.0 + index * 0.002 * (1 + 35e-6)
    delay_s = rng.exponential(0.002, len(index)) + 0.3 * (rng.random(len(index)) < 1e-4)
    clock = SampleClock(0.002)
    for rows in np.split(index, 3600):
        clock.add(rows, np.round((true_s[rows] + delay_s[rows]) * 1e9).astype(np.int64))
    assert clock.estimate().drift_ppm == pytest.approx(35.0, abs=0.05)
    assert np.max(np.abs(clock.time(index) - true_s)) < 50e-6


def host_delays(kind, random, count):
    """Delays of host stamps [s]: a busy host, one that stalls, stamps of whole milliseconds, load from then on."""
    delay_s = random.exponential(0.001, count)
    if kind == "stalls":
        delay_s += 0.2 * (random.random(count) < 1e-3)
    elif kind == "load":
        delay_s += np.where(np.arange(count) > 0.6 * count, random.exponential(0.02, count), 0.0)
    return delay_s


@pytest.mark.parametrize("kind", ["busy", "stalls", "milliseconds", "load"])
def test_the_uncertainty_of_the_clock_covers_the_truth(kind):
    """Drift and offset are within twice their standard uncertainties, in at least 19 of 20 runs."""
    within = []
    for seed in range(60):
        random = np.random.default_rng(seed)
        drift_ppm = random.uniform(-100, 100)
        index = np.arange(12_000, dtype=np.int64) * 5
        t_s = 3.0 + index * 0.002 * (1 + drift_ppm * 1e-6) + host_delays(kind, random, len(index))
        t_ns = np.round(t_s * 1e9).astype(np.int64)
        if kind == "milliseconds":
            t_ns = -(-t_ns // 1_000_000) * 1_000_000
        clock = SampleClock(0.002)
        clock.add(index, t_ns)
        found = clock.estimate()
        assert found.drift_u_ppm < 20
        within.append(
            (
                abs(found.drift_ppm - drift_ppm) <= 2 * found.drift_u_ppm + 1e-6,
                abs(found.offset_s - 3.0) <= 2 * found.offset_u_s + 0.0012,  # the least delay cannot be told
            )
        )
    assert np.mean(within, axis=0).min() >= 0.95


def test_a_drift_that_changes_shows_in_the_spread_of_the_clock():
    index = np.arange(500_000, dtype=np.int64)
    bend_ns = np.round(20e6 * np.sin(np.pi * index / len(index))).astype(np.int64)
    straight, bent = SampleClock(0.002), SampleClock(0.002)
    straight.add(index, index * 2 * MS)
    bent.add(index, index * 2 * MS + bend_ns)
    assert (straight.estimate().drift_u_ppm, straight.estimate().spread_s) == (0.0, 0.0)
    assert bent.estimate().spread_s == pytest.approx(0.02, rel=0.02)


def test_a_short_record_does_not_claim_to_know_its_clock():
    clock = SampleClock(0.002)
    clock.add(np.arange(1000), np.arange(1000) * 2 * MS + 5 * MS)
    assert clock.estimate() == ClockEstimate(0.005, None, 0.0, None, None)


def test_the_clock_without_frames_is_an_error():
    with pytest.raises(ValueError, match="no frame yet"):
        SampleClock(0.002).time([0])


def test_the_clock_of_a_unit_does_not_depend_on_how_its_frames_were_cut_into_blocks():
    random = np.random.default_rng(5)
    index = np.arange(200_000, dtype=np.int64)
    late_ns = random.exponential(300e3, index.size).astype(np.int64) + 20_000 * (random.random(index.size) < 0.01)
    t_ns = index * 2_000_000 + index * 37 // 1000 + late_ns
    found = []
    for cuts in ([], np.sort(random.integers(0, index.size, 3000)), np.arange(0, index.size, 7)):
        clock = SampleClock(0.002)
        for indices, stamps in zip(np.split(index, cuts), np.split(t_ns, cuts), strict=True):
            clock.add(indices, stamps)
        found.append((clock.time(index).tobytes(), clock.estimate()))
    assert len(set(found)) == 1
