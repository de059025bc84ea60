"""Notices that the bench stood still: stopped by a signal, or the whole computer suspended."""

from __future__ import annotations

import time
from typing import Any, Protocol

STILL_S = 5.0
"""A bench whose ticks are further apart than this stood still."""


class Report(Protocol):
    """Takes an event."""

    def __call__(self, kind: str, text: str, **facts: Any) -> None:
        """Kind, text and numbers."""


class Standstill:
    """Told at every tick. Bench time does not pass while a computer is suspended; the calendar clock does.

    A calendar clock that somebody sets looks the same: the event says both.
    """

    def __init__(self, report: Report) -> None:
        self._report = report
        self._last: tuple[float, float] | None = None

    def tick(self, now_s: float, calendar_s: float | None = None) -> None:
        """It is bench time `now_s` [s], by the calendar `calendar_s` [s]."""
        calendar_s = time.time() if calendar_s is None else calendar_s
        before, self._last = self._last, (now_s, calendar_s)
        if before is None:
            return
        passed_s, calendar_passed_s = now_s - before[0], calendar_s - before[1]
        if passed_s > STILL_S:
            text = f"the bench stood still for {passed_s:.0f} s: stopped, or the computer was overloaded"
            self._report("standstill", text, seconds=round(passed_s, 3))
        elif calendar_passed_s - passed_s > STILL_S:
            ahead_s = calendar_passed_s - passed_s
            text = f"the calendar clock went ahead by {ahead_s:.0f} s: the computer was suspended, or somebody set it"
            self._report("standstill", text, seconds=round(ahead_s, 3))
