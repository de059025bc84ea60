"""Who answers under a unit's number: what the heartbeat says, and whether it is one unit or two."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Identity:
    """What the unit says about itself in its heartbeat."""

    serial: int
    firmware: int
    coefficient_set: int
    state: int


class Impostors:
    """Notices a second unit with the same number on the bus, by its heartbeats or by its sample counter.

    Two serial numbers in turn are proof. Two counters, or every sample twice, are as good as that when they make up
    more than a fifth of the frames over some seconds; single stray or repeated frames are not.
    """

    SHARE = 0.2
    FRAMES = 500

    def __init__(self, number: int) -> None:
        self.serials: list[int] = []
        """Serial numbers that answered, each time that it changed. A new one counts when it is heard twice in a short
        while: heartbeats need not carry a CRC."""
        self._heard: deque[int] = deque(maxlen=4)
        self._number = number
        self._recent: deque[tuple[int, int]] = deque()  # frames, and those among them that fit nothing or came twice
        self._counters: str | None = None

    def heard(self, serials: Sequence[int]) -> bool:
        """The serial numbers of the heartbeats of a block; whether they are all that of the unit."""
        for serial in serials:
            self._heard.append(serial)
            if not self.serials or (self.serials[-1] != serial and self._heard.count(serial) > 1):
                self.serials = [*self.serials[-7:], serial]
        return {*serials} == {self.serials[-1]}

    def counted(self, frames: int, misfits: int) -> None:
        """So many rate frames in a block, and how many of them carried a second counter or a sample again."""
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
        """What is wrong, for a human; None while one unit answers. Stays once it was seen."""
        serials = self.serials
        if len(serials) > 2 and serials[-3] == serials[-1]:
            return (
                f"serial numbers {serials[-2]} and {serials[-1]} answer in turn as number {self._number}: two units "
                f"with this number on one bus; disconnect one or give it another number"
            )
        if len(serials) > 1:
            return f"serial number {serials[-1]} answers as number {self._number}, where {serials[-2]} did before"
        return self._counters
