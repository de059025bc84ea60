"""Identity of the unit that answers under a number, and detection of two units with one number."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

IntArray = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Identity:
    """Identity of a unit, from its heartbeat."""

    serial: int
    firmware: int
    coefficient_set: int | None
    """None where the heartbeat does not tell."""
    state: int


class Impostors:
    """Detects a second unit with the same number on the bus, whatever its counter, by one of these:

    * serial numbers that alternate in the heartbeats;
    * samples that arrive twice with different values; a repeated frame has the same values;
    * far more rate frames than one unit sends, for some seconds, and more than a stall can have delayed.

    Implausible frames are only a doubt: a worn connector causes them too.
    """

    SHARE = 0.2
    FRAMES = 500
    DOUBLE = 20
    """So many samples with two values, within a few seconds, are proof."""
    FLOOD_S, FLOOD = 5, 1.4
    """In each of so many seconds more than this times the frames of one unit …"""
    BEFORE_S, MEAN = 15, 1.2
    """… and together with the seconds before more than this: what was held back was missing there."""

    def __init__(self, number: int, interval_ns: int) -> None:
        self.serials: list[int] = []
        """Serial numbers that answered, one entry per change. A new one counts after two of the last four heartbeats:
        heartbeats need not carry a CRC."""
        self.twins: str | None = None
        """Why it is certain that two units send with this number; None while it is not."""
        self._last: deque[int] = deque(maxlen=4)
        self._number = number
        self._recent: deque[tuple[int, int]] = deque()  # frames, and those among them that are implausible or repeated
        self._counters: str | None = None
        self._doubles: deque[tuple[int, int]] = deque()  # host second, samples with two values
        self._per_s = 1e9 / interval_ns
        self._seconds: deque[list[int]] = deque(maxlen=self.BEFORE_S + 1)  # host second, frames

    def heard(self, serials: Sequence[int]) -> bool:
        """Add the serial numbers of the heartbeats of a block; returns whether all are that of the unit."""
        for serial in serials:
            self._last.append(serial)
            if not self.serials or (self.serials[-1] != serial and self._last.count(serial) > 1):
                self.serials = [*self.serials[-7:], serial]
        return {*serials} == {self.serials[-1]}

    def counted(self, frames: int, misfits: int) -> None:
        """Add the number of rate frames of a block, and how many carried a second counter or a repeated sample."""
        self._recent.append((frames, misfits))
        while sum(count for count, _ in self._recent) - self._recent[0][0] >= self.FRAMES:
            self._recent.popleft()
        total, wrong = (sum(column) for column in zip(*self._recent, strict=True))
        if total >= self.FRAMES and wrong > self.SHARE * total:
            self._counters = (
                f"{wrong} of {total} rate frames under number {self._number} carry a second sample counter or repeat a "
                f"sample: two units with this number on one bus, or an adapter that repeats frames"
            )

    def arrived(self, t_ns: IntArray, index: IntArray, payload: IntArray) -> None:
        """Rate frames (n,) of a block in the order of arrival: host time [ns], place (0: none), everything they say."""
        if self.twins is not None or not len(t_ns):
            return
        if not (index[1:] > index[:-1]).all():
            t_ns = t_ns[~self._compare(t_ns, index, payload)]
        self._flood(t_ns)

    def _compare(self, t_ns: IntArray, index: IntArray, payload: IntArray) -> npt.NDArray[np.bool_]:
        """Which frames (n,) repeat another one; counts samples with two values."""
        order = np.lexsort((payload, index))
        same = (np.diff(index[order]) == 0) & (index[order[1:]] > 0)
        alike = np.diff(payload[order]) == 0
        again = np.zeros(len(t_ns), dtype=np.bool_)
        again[order[1:][same & alike]] = True
        seconds, counts = np.unique(t_ns[order[1:][same & ~alike]] // 1_000_000_000, return_counts=True)
        for second, count in zip(seconds.tolist(), counts.tolist(), strict=True):
            self._doubles.append((second, count))
            while self._doubles[0][0] < second - self.FLOOD_S:
                self._doubles.popleft()
            total = sum(number for _, number in self._doubles)
            if total >= self.DOUBLE and self.twins is None:
                self.twins = f"{total} samples within {self.FLOOD_S} s came twice, with different values"
        return again

    def _flood(self, t_ns: IntArray) -> None:
        if not len(t_ns):
            return
        first, last = int(t_ns[0]) // 1_000_000_000, int(t_ns[-1]) // 1_000_000_000
        counts, most = deque([(first, len(t_ns))]), len(t_ns)
        if first != last:
            seconds, numbers = np.unique(t_ns // 1_000_000_000, return_counts=True)
            counts, most = deque(zip(seconds.tolist(), numbers.tolist(), strict=True)), int(numbers.max())
        calm = most <= self.FLOOD * self._per_s
        while counts:
            second, count = counts.popleft()
            if self._seconds and self._seconds[-1][0] >= second:
                self._seconds[-1][1] += count
                continue
            self._judge(second)
            self._seconds.append([second, count])
            if calm:  # only the second before this block can have been a flood
                self._seconds.extend(map(list, counts))
                return

    def _judge(self, now: int) -> None:
        """The seconds before `now` are complete."""
        if not self._seconds or self._seconds[-1][1] <= self.FLOOD * self._per_s:
            return
        counts = {second: count for second, count in self._seconds}
        last = [counts.get(now - back, 0) for back in range(1, self.BEFORE_S + 1)]
        heard = min(now - self._seconds[0][0], self.BEFORE_S) if self._seconds else 0
        if heard <= self.FLOOD_S or min(last[: self.FLOOD_S]) <= self.FLOOD * self._per_s:
            return
        if sum(last[:heard]) > self.MEAN * heard * self._per_s and self.twins is None:
            each = sum(last[: self.FLOOD_S]) / self.FLOOD_S
            self.twins = f"{each:.0f} rate frames a second, one unit sends {self._per_s:.0f}"

    @property
    def conflict(self) -> str | None:
        """Text for the user; None while one unit answers. A conflict remains until the end of the run."""
        serials = self.serials
        cure = "two units with this number on one bus; disconnect one or give it another number"
        if len(serials) > 2 and serials[-3] == serials[-1]:
            return f"serial numbers {serials[-2]} and {serials[-1]} answer in turn as number {self._number}: {cure}"
        if self.twins is not None:
            return f"number {self._number}: {self.twins}: {cure}"
        if len(serials) > 1:
            return f"serial number {serials[-1]} answers as number {self._number}; before, {serials[-2]} did"
        return self._counters

    @property
    def certain(self) -> bool:
        """Whether another unit, or a second one, sends for certain."""
        return self.twins is not None or len(self.serials) > 1
