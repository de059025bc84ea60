"""Turns the rate table as the legs say, records its encoder, and sees that it does what it was told.

The table is polled at every tick of the bench, which is also its sign of life from us. It turns only while a leg that
wants it runs: when none does (a hold, the way home, the end), the next poll brings it to a stand. It is switched on
when a leg first turns it; a run that turns nothing leaves it off.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from bench.acquisition.profile.legs import Leg
from bench.acquisition.station.records import Journal
from bench.base import EquipmentError
from drivers.clock import Clock
from drivers.errors import LinkError
from drivers.rate_table import RateTable, SafeStep

LATE_S = 30.0
"""Time that the table may need beyond what its acceleration says [s]."""
LOST_S = 3.0
"""A table that is off its rate for longer has failed [s]."""
RELATIVE = 0.002
"""Part of the rate that its mean over a tick may be off, beside the station's tolerance."""


class Turning(Protocol):
    """What the sequencer asks of a leg that turns."""

    def tick(self, now_s: float, settled: bool) -> bool:
        """Whether the leg's turning is done at bench time `now_s` [s]."""

    def stop(self) -> None:
        """The leg is over, however it ended."""


class Turntable:
    """The rate table of a station during a run; `table` is prepared."""

    def __init__(self, table: RateTable, clock: Clock, tolerance_dps: float, journal: Journal) -> None:
        """`journal` takes every reading of the encoder, and what the table was told."""
        self.table = table
        self._journal = journal
        self.lacks: tuple[str, ...] = ()
        """What of the supervision the table does not have."""
        self.rate_dps: float | None = None
        """Mean over the last tick; None before the first reading."""
        self._clock, self._tolerance_dps = clock, tolerance_dps
        self._leg: Leg | None = None
        self._told_s = 0.0
        self._arrived_s: float | None = None
        self._off_since: float | None = None
        self._silent = False

    def begin(self, leg: Leg) -> Turning:
        """Bring the table to the rate of a leg that starts now."""
        self._leg = leg
        if leg.turn_dps and not self.table.enabled:
            self.lacks = self.table.prepare()  # again: it may have been without power since
            self.table.enable()
            self._journal.event("rate_table", "switched on")
        self._go(leg.turn_dps)
        return _OneLeg(self, leg)

    def end(self) -> None:
        """The leg is over; unless another one begins before the next poll, the table comes to a stand."""
        self._leg = None

    def poll(self) -> None:
        """Take in and record what the encoder says; EquipmentError when the table does not turn as it was told."""
        try:
            readings = self.table.poll()
        except LinkError as error:
            if self.table.enabled:
                raise
            self._tell_silence(str(error))  # an axis that is off does not end a run
            return
        self._tell_silence("")
        if self._leg is None:
            self._go(0.0)
        if not len(readings):
            return
        self._journal.table(readings)
        self.rate_dps = float(np.mean(readings["rate_dps"]))
        self._supervise(self._clock.now())

    def _tell_silence(self, trouble: str) -> None:
        if bool(trouble) != self._silent:
            self._silent = bool(trouble)
            self._journal.event(
                "link", f"rate table does not answer: {trouble}" if trouble else "rate table answers again"
            )

    def arrived_s(self) -> float | None:
        """Bench time since which the table has had its rate [s]; None: not yet."""
        return self._arrived_s

    def safe(self) -> list[SafeStep]:
        """Quick stop and off, verified; a table that was not switched on is left as it was found."""
        return self.table.safe()

    def _go(self, rate_dps: float) -> None:
        if rate_dps == self.table.commanded_dps:
            return
        self.table.set_rate(rate_dps)
        self._told_s, self._arrived_s, self._off_since = self._clock.now(), None, None
        self._journal.event("rate_table", f"commanded {rate_dps:g} deg/s", rate_dps=rate_dps)

    def _supervise(self, now_s: float) -> None:
        if self.rate_dps is None or not self.table.enabled:
            return
        wanted = self.table.commanded_dps
        right = abs(self.rate_dps - wanted) <= self._tolerance_dps + RELATIVE * abs(wanted)
        text = f"rate table turns {self.rate_dps:.3f} deg/s, commanded {wanted:g}"
        if right:
            self._off_since = None
            if self._arrived_s is None:
                self._arrived_s = now_s
        elif self._arrived_s is None:
            limit_s = 2 * self.table.limits.rate_dps / self.table.limits.accel_dps2 + LATE_S
            if now_s - self._told_s > limit_s:
                raise EquipmentError(f"{text} for {limit_s:.0f} s; look at its drive and load")
        else:
            self._off_since = now_s if self._off_since is None else self._off_since
            if now_s - self._off_since > LOST_S:
                raise EquipmentError(f"{text}, and has left its rate for {LOST_S:.0f} s; look at its drive and load")


class _OneLeg:
    """One leg on the table."""

    def __init__(self, turntable: Turntable, leg: Leg) -> None:
        self._turntable, self._leg = turntable, leg

    def tick(self, now_s: float, settled: bool) -> bool:
        """A rate is done when the table has had it for the dwell time; any other leg once the table has got there."""
        if not self._turntable.table.enabled:
            return True
        arrived_s = self._turntable.arrived_s()
        dwell_s = self._leg.duration_s if self._leg.kind == "rate" else 0.0
        return arrived_s is not None and now_s - arrived_s >= dwell_s

    def stop(self) -> None:
        """The leg is over, however it ended."""
        self._turntable.end()
