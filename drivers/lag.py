"""Lag of a capture behind its bus: the age of each frame when it is received, and when it is reported."""

from __future__ import annotations

import time

LIMIT_NS = 200_000_000
"""A lag above this [ns] is reported: on a busy bus it is several times the capacity of SocketCAN's default buffer."""
PLAUSIBLE_NS = 1_000_000_000
"""Ages up to this [ns] are always plausible; larger ones only when the backlog has had time to grow to them."""
SLACK_NS = 10_000_000
_TOGETHER_NS = 5_000
_READINGS = 8


def both_clocks() -> tuple[int, int]:
    """Monotonic and calendar time [ns] of one moment: read again where the process was interrupted in between."""
    for _ in range(_READINGS):
        before_ns, calendar_ns, now_ns = time.monotonic_ns(), time.time_ns(), time.monotonic_ns()
        if now_ns - before_ns < _TOGETHER_NS:
            break
    return now_ns, calendar_ns


class Lag:
    """Ages of frames [ns] from the calendar stamps of their interface.

    From one frame to the next the age can grow only by the time that has passed. So a step of the calendar clock, or an
    interface with another clock, is not mistaken for a backlog, and a real backlog of many seconds is recognised. An
    interface that stamps a frame only on delivery never shows a lag.
    """

    def __init__(self) -> None:
        self.spells = 0
        self.most_ns = 0
        self._age_ns = 0
        self._at_ns: int | None = None
        self._since_s: float | None = None

    def age_ns(self, now_ns: int, stamped_ns: int) -> int:
        """Age of a frame received at `now_ns` (monotonic), `stamped_ns` by its stamp; 0 when that is implausible."""
        oldest = 0 if self._at_ns is None else self._age_ns + now_ns - self._at_ns + SLACK_NS
        age = stamped_ns if 0 < stamped_ns < max(oldest, PLAUSIBLE_NS) else 0
        self._age_ns, self._at_ns = age, now_ns
        return age

    def caught_up(self, now_ns: int) -> None:
        """Reset the age: no frame waits."""
        self._age_ns, self._at_ns = 0, now_ns

    def news(self, behind_ns: int, now_s: float) -> str:
        """Text of an event after a batch whose oldest frame had waited `behind_ns`; empty when there is none.

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
