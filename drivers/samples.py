"""From a wrapping sample counter and host time stamps to sample indices and bench time.

The counter identifies the sample in a frame; host stamps only show how often the counter has wrapped, whether the
unit restarted, and how its clock relates to bench time.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from drivers.doubt import PROOF_NS, Behind, Doubt
from drivers.envelope import Envelope

IntArray = npt.NDArray[np.int64]
FloatArray = npt.NDArray[np.float64]

REORDER = 16
"""Largest number of samples by which a frame may be out of order."""
COUNTS = ("lost", "repeated", "rogue", "late", "out_of_order", "resets")


@dataclass(frozen=True)
class Unwrapped:
    """Frames of one block, in the order of arrival, placed on the sample axis."""

    index: IntArray  # sample index (n,)
    take: IntArray  # rows that are data; their indices increase strictly, over blocks too
    lost: int = 0
    repeated: int = 0
    rogue: int = 0
    late: int = 0
    out_of_order: int = 0
    resets: int = 0

    def then(self, later: Unwrapped) -> Unwrapped:
        """Both as one block."""
        counts = {name: getattr(self, name) + getattr(later, name) for name in COUNTS}
        take = np.concatenate((self.take, later.take + len(self.index)))
        return Unwrapped(np.concatenate((self.index, later.index)), take, **counts)


class CounterTrack:
    """Unwraps a counter of `bits` bits that counts samples of `interval_ns` [ns]; stateful over blocks.

    A frame is late when its delay exceeds the least delay of the last ten seconds by more than `late_s` [s]. A counter
    that disagrees with host time by more than `jump_s` [s], and continues from there, means that the unit restarted:
    the index then follows host time. A single frame that disagrees is a rogue and dropped.

    A restart whose counter happens to lie near host time is also detected: ahead of host time, because a frame cannot
    arrive before its sample was taken; behind it, because a stall catches up and a restart does not. Within 50 ms a
    restart is detected only if the unit announces it; otherwise only the length of the gap is wrong.
    """

    WINDOW_NS = 10_000_000_000

    def __init__(self, bits: int, interval_ns: int, late_s: float = 0.5, jump_s: float = 2.0) -> None:
        self._mask = (1 << bits) - 1
        self._interval_ns = interval_ns
        self._late_ns = round(late_s * 1e9)
        self._jump = min(round(jump_s * 1e9 / interval_ns), self._mask // 4)
        self._last: tuple[int, int, int] | None = None  # index, counter, host time [ns] of the last intact frame
        self._delivered = -1
        self._recent = np.zeros(0, dtype=np.int64)
        self._delays: deque[tuple[int, int]] = deque()  # host time, least delay [ns] of each recent block
        self._behind: Behind | None = None
        self._planned = False
        self.planned_resets = 0
        """Restarts that were planned; no `resets` count them."""

    def power_on(self) -> None:
        """The unit is switched on again after it was switched off on purpose: what is missing before was not lost."""
        self._planned = True
        self._behind = None
        self._delays.clear()

    def unwrap(self, counter: IntArray, t_ns: IntArray, boot: IntArray) -> Unwrapped:
        """Place frames (n,) in the order of arrival; `boot` are the rows before which the unit announced a restart."""
        if not len(counter):
            return Unwrapped(counter, counter)
        if self._last is None:
            self._last = (int(counter[0]) - 1, int(counter[0]) - 1, int(t_ns[0]) - self._interval_ns)
            self._delivered, boot = self._last[0], boot[boot > 0]
        proven = int(np.searchsorted(t_ns, self._behind.since_ns + PROOF_NS)) if self._behind else 0
        if 0 < proven < len(t_ns):  # what follows the proof of a restart may have another place than what precedes it
            first = self.unwrap(counter[:proven], t_ns[:proven], boot[boot < proven])
            return first.then(self.unwrap(counter[proven:], t_ns[proven:], boot[boot >= proven] - proven))
        late_reset = self._catch_up(int(t_ns[0]))
        index, rows, resets = self._count(counter, t_ns, boot)
        resets += late_reset
        if not len(rows):
            return Unwrapped(index, rows, rogue=len(counter))
        last = rows[-1]
        self._last = (int(index[last]), int(counter[last]), int(t_ns[last]))
        late = self._delay_ns(index[rows], t_ns[rows]) > self._late_ns
        if self._planned:
            self._planned, self._delivered = False, max(self._delivered, int(index[rows].min()) - 1)
            self.planned_resets, resets = self.planned_resets + 1, max(resets - 1, 0)
        return self._ordered(index, rows, late, resets)

    def _count(self, counter: IntArray, t_ns: IntArray, boot: IntArray) -> tuple[IntArray, IntArray, int]:
        """Indices (n,), the rows that fit, and the number of resets."""
        assert self._last is not None
        index, rows = np.zeros(len(counter), dtype=np.int64), np.arange(len(counter))
        starts = boot
        while len(rows):
            counted = counter[rows]
            step = np.empty_like(counted)
            step[0], step[1:] = int(counted[0]) - self._last[1], counted[1:] - counted[:-1]
            step &= self._mask
            if not len(starts) and (step == 1).all():
                index[rows] = np.arange(self._last[0] + 1, self._last[0] + 1 + len(rows))
                self._watch(index[rows], t_ns[rows])
                return index, rows, 0
            started = np.isin(rows, starts)
            elapsed = self._elapsed(t_ns[rows], self._last[2])
            steps = np.where(started, np.maximum(elapsed, 1), self._steps(step, elapsed))
            place = self._last[0] + np.cumsum(steps)
            least_ns = min((least for _, least in self._delays), default=1 << 62)
            delay = t_ns[rows] - place * self._interval_ns
            last_ns = self._last[2] - self._last[0] * self._interval_ns
            doubt = Doubt(step, steps, t_ns[rows], delay, (last_ns, min(last_ns, least_ns)), self._interval_ns)
            moved = ~started & doubt.moved()
            jumped = ~started & (self._jumps(step, elapsed) | doubt.early()) & ~moved
            rogue = self._rogues(np.flatnonzero(jumped), counter[rows], t_ns[rows], doubt)
            if len(rogue):
                rows = np.delete(rows, rogue)
            elif jumped.any() or moved.any():
                starts = np.append(starts, rows[np.flatnonzero(jumped | moved)[0]])
            else:
                index[rows] = place
                self._behind = doubt.unproven() or (None if len(starts) else self._behind)
                self._watch(place, t_ns[rows])
                return index, rows, len(starts)
        return index, rows, 0

    def _rogues(self, jumped: IntArray, counter: IntArray, t_ns: IntArray, doubt: Doubt) -> list[int]:
        """Implausible rows whose neighbours fit each other; rogues are never neighbours."""
        rogues: list[int] = []
        for at in jumped.tolist():
            if not (rogues and rogues[-1] == at - 1) and self._returns(at, counter, t_ns, doubt):
                rogues.append(at)
            elif not rogues:
                break  # the first one is not a rogue: later rows are judged relative to it
        return rogues

    def _watch(self, index: IntArray, t_ns: IntArray) -> None:
        """Check whether a counter that fell behind host time has caught up; only a stall does."""
        if self._behind is not None:
            since = t_ns >= self._behind.since_ns
            delay = (t_ns - index * self._interval_ns)[since]
            self._behind = self._behind.seen(delay) if len(delay) else self._behind

    def _catch_up(self, now_ns: int) -> int:
        """Follow host time again after a restart that is proven only by time; returns 1 in this case, otherwise 0."""
        behind = self._behind
        if behind is None or now_ns < behind.since_ns + PROOF_NS:
            return 0
        assert self._last is not None
        samples = round((behind.least_ns - behind.floor_ns) / self._interval_ns)
        self._last = (self._last[0] + samples, *self._last[1:])
        self._behind = None
        self._delays.clear()
        return 1

    def _elapsed(self, t_ns: IntArray, before_ns: int) -> IntArray:
        """Samples between frames by host time."""
        return np.rint(np.diff(t_ns, prepend=before_ns) / self._interval_ns).astype(np.int64)

    def _steps(self, step: IntArray, elapsed: IntArray) -> IntArray:
        """The step that agrees with the counter and is nearest to host time."""
        half = (self._mask + 1) // 2
        near: IntArray = elapsed + ((step - elapsed + half) & self._mask) - half
        return near

    def _jumps(self, step: IntArray, elapsed: IntArray) -> npt.NDArray[np.bool_]:
        """Where the counter and host time disagree; a counter without a gap always agrees."""
        steps = self._steps(step, elapsed)
        wrong: npt.NDArray[np.bool_] = (step > 1) & ((np.abs(steps - elapsed) > self._jump) | (steps < -REORDER))
        return wrong

    def _returns(self, at: int, counter: IntArray, t_ns: IntArray, doubt: Doubt) -> bool:
        """Whether the frame after `at` continues from the one before it (or has not arrived yet)."""
        assert self._last is not None
        if at + 1 == len(counter):
            return True
        before = (doubt.place(at - 1), int(counter[at - 1]), int(t_ns[at - 1])) if at else self._last
        step = np.diff(counter[at + 1 : at + 2], prepend=before[1]) & self._mask
        elapsed = self._elapsed(t_ns[at + 1 : at + 2], before[2])
        place = before[0] + int(self._steps(step, elapsed)[0])
        return not self._jumps(step, elapsed)[0] and not doubt.comes_early(at, int(t_ns[at + 1]), place)

    def _delay_ns(self, index: IntArray, t_ns: IntArray) -> IntArray:
        """How much later than the fastest recent frames each frame arrived [ns]."""
        delay = t_ns - index * self._interval_ns
        now_ns = int(t_ns[-1])
        self._delays.append((now_ns, int(delay.min())))
        while self._delays[0][0] < now_ns - self.WINDOW_NS:
            self._delays.popleft()
        result: IntArray = delay - min(least for _, least in self._delays)
        return result

    def _ordered(self, index: IntArray, rows: IntArray, late: npt.NDArray[np.bool_], resets: int) -> Unwrapped:
        """Sort, and drop frames that were delivered before or arrived too late."""
        placed = index[rows]
        before = self._delivered
        counts = {"rogue": len(index) - len(rows), "late": int(np.count_nonzero(late)), "resets": resets}
        if placed[0] > before and (placed[1:] > placed[:-1]).all():
            take, fresh = rows, len(rows)
        else:
            highest = np.maximum.accumulate(np.concatenate(([before], placed[:-1])))
            _, first = np.unique(placed, return_index=True)
            is_first = np.zeros(len(rows), dtype=bool)
            is_first[first] = True
            is_first &= ~np.isin(placed, self._recent)
            counts["repeated"] = len(rows) - int(np.count_nonzero(is_first))
            counts["out_of_order"] = int(np.count_nonzero(is_first & (placed < highest)))
            keep = first[is_first[first] & (placed[first] > before)]
            take, late, fresh = rows[keep], late[keep], len(keep)
        self._delivered = max(before, int(placed.max()))
        self._recent = np.concatenate((self._recent, placed[-4 * REORDER :]))[-4 * REORDER :]
        if late.any():
            take = take[~late]
        return Unwrapped(index, take, lost=self._delivered - before - fresh, **counts)


@dataclass(frozen=True)
class ClockEstimate:
    """The unit's clock relative to the host's, with standard uncertainties; None: less than half a minute of frames.

    `offset_s`: bench time of index 0 by the fastest frames, so it includes the least transmission delay. `drift_ppm`:
    how much slower than nominal the unit's clock runs. `spread_s`: distance from that line within which the fastest
    frames of 95 % of all stretches lie; more than the jitter of the host means that the drift was not constant.
    """

    offset_s: float
    offset_u_s: float | None
    drift_ppm: float
    drift_u_ppm: float | None
    spread_s: float | None


class SampleClock:
    """Bench time of sample indices: offset and drift of the unit's clock, from host stamps.

    Host stamps are never early, only late, so the line follows the lower envelope of the stamps: the edge of their
    lower convex hull over the middle of the record. Stamps without delay (simulation) give exact times.
    """

    MIN_SPAN_S = 30.0

    def __init__(self, interval_s: float) -> None:
        self.interval_s = interval_s
        self._interval_ns = round(interval_s * 1e9)
        self._hull: list[tuple[int, int]] = []  # index, delay [ns]; lower convex hull, left to right
        self._envelope = Envelope()

    def add(self, index: IntArray, t_ns: IntArray) -> None:
        """Add frames (n,): sample index and host stamp [ns]; indices must be later than all before."""
        delay = t_ns - index * self._interval_ns
        self._envelope.add(index, delay)
        x, y = _below(index.astype(np.int64), delay.astype(np.int64))
        hull = self._hull
        for point in zip(x.tolist(), y.tolist(), strict=True):
            while len(hull) > 1 and _turns_down(hull[-2], hull[-1], point):
                hull.pop()
            hull.append(point)

    def estimate(self) -> ClockEstimate:
        """Estimate of the unit's clock; ValueError before the first frame."""
        offset_ns, slope_ns = self._line()
        known = self._envelope.known(offset_ns, slope_ns) if self._span_s() >= self.MIN_SPAN_S else None
        drift_ppm = slope_ns / self._interval_ns * 1e6
        if known is None:
            return ClockEstimate(offset_ns * 1e-9, None, drift_ppm, None, None)
        drift_u_ppm = known.slope / self._interval_ns * 1e6
        return ClockEstimate(offset_ns * 1e-9, known.start_ns * 1e-9, drift_ppm, drift_u_ppm, known.spread_ns * 1e-9)

    def time(self, index: npt.ArrayLike) -> FloatArray:
        """Bench time [s] of sample indices; ValueError before the first frame."""
        offset_ns, slope_ns = self._line()
        samples = np.asarray(index, dtype=np.int64)
        times: FloatArray = (samples * self._interval_ns + offset_ns + samples * slope_ns) * 1e-9
        return times

    def _span_s(self) -> float:
        return (self._hull[-1][0] - self._hull[0][0]) * self.interval_s

    def _line(self) -> tuple[float, float]:
        """Delay at index 0 [ns] and its growth per sample [ns]."""
        hull = self._hull
        if not hull:
            raise ValueError("no frame yet: the clock of the unit is unknown")
        first, last = hull[0][0], hull[-1][0]
        if self._span_s() < self.MIN_SPAN_S:
            return float(min(delay for _, delay in hull)), 0.0
        middle = (first + last) / 2
        right = next(k for k in range(1, len(hull)) if hull[k][0] >= middle)
        (x0, y0), (x1, y1) = hull[right - 1], hull[right]
        slope = (y1 - y0) / (x1 - x0)
        return y0 - slope * x0, slope


def _below(x: IntArray, y: IntArray) -> tuple[IntArray, IntArray]:
    """Points (n,) without those on or above the line between their neighbours; keeps all vertices of the lower hull.

    Exact, in integers: the clock must not depend on how the frames were divided into blocks; otherwise a replay of the
    journals would place samples differently by a rounding error.
    """
    if len(x) > 2 and (y == y[0]).all():  # stamps without delay, as of a simulation
        return x[[0, -1]], y[[0, -1]]
    while len(x) > 2:
        run, rise = np.diff(x), np.diff(y)
        kept = np.ones(len(x), dtype=bool)
        kept[1:-1] = rise[:-1] * run[1:] < rise[1:] * run[:-1]
        if np.count_nonzero(kept) > 0.9 * len(x):
            break
        x, y = x[kept], y[kept]
    return x, y


def _turns_down(a: tuple[int, int], b: tuple[int, int], c: tuple[int, int]) -> bool:
    """Whether `b` lies on or above the line from `a` to `c`; exact, in integers."""
    return (b[1] - a[1]) * (c[0] - a[0]) >= (c[1] - a[1]) * (b[0] - a[0])
