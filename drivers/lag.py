"""How far a capture is behind its bus: the age of each frame when it is taken, and when that becomes news."""

from __future__ import annotations

LIMIT_NS = 200_000_000
"""Behind by more than this is told: SocketCAN's usual buffer is then full several times over on a busy bus."""
PLAUSIBLE_NS = 1_000_000_000
"""Stamps may always be this old [ns]; older ones only as a backlog that has grown so old."""
SLACK_NS = 10_000_000


class Lag:
    """Ages of frames [ns] from the calendar stamps of their interface.

    A frame can have become older since the one before only by the time that has passed. So a calendar clock that is
    set, or an interface that stamps with a clock of its own, does not pass for a backlog, and a real backlog of many
    seconds is believed. An interface that stamps only when it hands a frame over shows none.
    """

    def __init__(self) -> None:
        self.spells = 0
        self.most_ns = 0
        self._age_ns = 0
        self._at_ns: int | None = None
        self._since_s: float | None = None

    def age_ns(self, now_ns: int, stamped_ns: int) -> int:
        """Age of a frame taken at `now_ns` (monotonic) whose stamp says `stamped_ns`; 0 when that cannot be."""
        oldest = 0 if self._at_ns is None else self._age_ns + now_ns - self._at_ns + SLACK_NS
        age = stamped_ns if 0 < stamped_ns < max(oldest, PLAUSIBLE_NS) else 0
        self._age_ns, self._at_ns = age, now_ns
        return age

    def caught_up(self, now_ns: int) -> None:
        """Nothing waits any more."""
        self._age_ns, self._at_ns = 0, now_ns

    def news(self, behind_ns: int, now_s: float) -> str:
        """What to say after a batch whose oldest frame had waited `behind_ns`; mostly nothing.

        `most_ns` is the longest wait of this spell.
        """
        if self._since_s is None and behind_ns > LIMIT_NS:
            self._since_s, self.most_ns = now_s, behind_ns
            self.spells += 1
            return f"the capture is {behind_ns * 1e-9:.2f} s behind its bus"
        if self._since_s is None:
            return ""
        self.most_ns = max(self.most_ns, behind_ns)
        if behind_ns > LIMIT_NS // 2:
            return ""
        lasted_s, self._since_s = now_s - self._since_s, None
        return f"the capture has caught up after {lasted_s:.1f} s; it was at most {self.most_ns * 1e-9:.2f} s behind"
