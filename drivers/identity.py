"""Identity of the unit that answers under a number, and detection of two units with one number."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Identity:
    """Identity of a unit, from its heartbeat."""

    serial: int
    firmware: int
    coefficient_set: int
    state: int


class Impostors:
    """Detects a second unit with the same number on the bus, by its heartbeats or by its sample counter.

    Two alternating serial numbers are proof. Frames with a second counter or a repeated sample are also proof when they
    are more than a fifth of the frames over some seconds; single stray or repeated frames are not.
    """

    SHARE = 0.2
    FRAMES = 500

    def __init__(self, number: int) -> None:
        self.serials: list[int] = []
        """Serial numbers that answered, one entry per change. A new one counts after two of the last four heartbeats:
        heartbeats need not carry a CRC."""
        self._last: deque[int] = deque(maxlen=4)
        self._number = number
        self._recent: deque[tuple[int, int]] = deque()  # frames, and those among them that are implausible or repeated
        self._counters: str | None = None

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

    @property
    def conflict(self) -> str | None:
        """Text for the user; None while one unit answers. A conflict remains until the end of the run."""
        serials = self.serials
        if len(serials) > 2 and serials[-3] == serials[-1]:
            return (
                f"serial numbers {serials[-2]} and {serials[-1]} answer in turn as number {self._number}: two units "
                f"with this number on one bus; disconnect one or give it another number"
            )
        if len(serials) > 1:
            return f"serial number {serials[-1]} answers as number {self._number}; before, {serials[-2]} did"
        return self._counters
