"""Bench time: wall time on real equipment, lock-step simulated time otherwise.

All code of the bench waits on a `Clock`; nothing else sleeps. Bench time starts at 0 s, or later when an interrupted
run is continued.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from typing import Protocol

Step = Callable[[float, float], None]
"""Advances a simulation from one bench time [s] to a later one [s]."""


class Clock(Protocol):
    """One time line for sequencing, guards and recording."""

    def now(self) -> float:
        """Bench time [s]."""

    def utc(self) -> datetime:
        """Calendar time of `now()`."""

    def sleep_until(self, t_s: float) -> None:
        """Return when bench time has reached `t_s` [s]."""


class WallClock:
    """Bench time that follows the computer's monotonic clock."""

    def __init__(self, start_s: float = 0.0) -> None:
        self.started_monotonic_ns = time.monotonic_ns() - round(start_s * 1e9)
        """Monotonic time [ns] at bench time 0."""
        self._started_utc = datetime.now(UTC) - timedelta(seconds=start_s)

    def now(self) -> float:
        """Bench time [s]."""
        return (time.monotonic_ns() - self.started_monotonic_ns) * 1e-9

    def utc(self) -> datetime:
        """Start of the clock plus bench time, free of jumps of the calendar clock."""
        return self._started_utc + timedelta(seconds=self.now())

    def sleep_until(self, t_s: float) -> None:
        """Sleep until bench time `t_s` [s]; returns at once when it has passed."""
        remaining_s = t_s - self.now()
        if remaining_s > 0:
            time.sleep(remaining_s)


class SimClock:
    """Bench time that advances only when a caller waits, in pieces of at most one second.

    Each attached step is called for each piece, in the order of attachment, so a simulation is deterministic
    and as fast as the machine allows.
    """

    PIECE_S = 1.0

    def __init__(self, epoch: datetime | None = None, start_s: float = 0.0) -> None:
        self._now_s = start_s
        self._epoch = epoch or datetime.now(UTC) - timedelta(seconds=start_s)
        self._steps: list[Step] = []

    def attach(self, step: Step) -> None:
        """Call `step(t0, t1)` for every piece of time that passes from now on."""
        self._steps.append(step)

    def now(self) -> float:
        """Bench time [s]."""
        return self._now_s

    def utc(self) -> datetime:
        """Epoch plus bench time."""
        return self._epoch + timedelta(seconds=self._now_s)

    def sleep_until(self, t_s: float) -> None:
        """Advance simulated time to `t_s` [s]; earlier times change nothing."""
        while self._now_s < t_s:
            end_s = min(self._now_s + self.PIECE_S, t_s)
            for step in self._steps:
                step(self._now_s, end_s)
            self._now_s = end_s
