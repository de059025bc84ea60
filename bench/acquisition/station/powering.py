"""Switches the units' power as the legs say, and sees that the units go silent and come back.

While the power is off, and until every unit is heard again, nobody expects frames: guards on what units say do not
watch, no unit leaves the run, and what is missing is planned. However a leg ends, it leaves the power on.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

from bench.acquisition.profile.legs import Leg
from bench.acquisition.station.records import Journal
from bench.acquisition.station.unit import LiveUnit
from bench.base import EquipmentError
from drivers.clock import Clock

SILENT_S = 2.0
"""A unit without power that still sends after this time has its power from somewhere else [s]."""
BACK_S = 30.0
"""A unit has to be heard within this time after its power came on [s]."""
SAID_S = 3.0
"""After this time it has said twice in its heartbeat who it is [s]."""


class Cycling(Protocol):
    """What the sequencer asks of a leg that switches the power."""

    def tick(self, now_s: float) -> bool:
        """Whether the power is back and every unit is heard, at bench time `now_s` [s]."""

    def stop(self) -> None:
        """The leg is over, however it ended."""


class Supply(Protocol):
    """What the units have their power from."""

    def switch(self, on: bool) -> None:
        """Switch it and read it back; DriverError when it is not as it was told."""


class UnitPower:
    """The supply of the units during a run."""

    def __init__(self, supply: Supply, clock: Clock, journal: Journal) -> None:
        """`journal` takes an event for each switch."""
        self.supply = supply
        self.units: Sequence[LiveUnit] = ()
        """Those that are on it."""
        self.restored: Callable[[], None] = lambda: None
        """Called when all units are heard again."""
        self.cycling = False
        """Whether the power is off, or not all units are heard again."""
        self._clock, self._journal = clock, journal

    def begin(self, leg: Leg) -> Cycling:
        """Switch the power off for a leg that starts now."""
        self.cycling = True
        self.supply.switch(False)
        self._journal.event("power", "the units' power was switched off", on=False, off_s=leg.duration_s)
        return _OneCycle(self, self._clock.now(), leg.duration_s)

    def switch_on(self) -> float:
        """Switch the power on; bench time before it [s].

        The event comes first: units may send before the supply has confirmed, and what they sent before the event would
        be taken for the end of the gap.
        """
        for unit in self.units:
            unit.expect_power_on()
        now_s = self._clock.now()
        self._journal.event("power", "the units' power is switched on", on=True)
        self.supply.switch(True)
        return now_s


class _OneCycle:
    """One leg: off for its time, on, and heard."""

    def __init__(self, power: UnitPower, off_s: float, duration_s: float) -> None:
        self._power, self._off_s, self._duration_s = power, off_s, duration_s
        self._on_s: float | None = None

    def tick(self, now_s: float) -> bool:
        """EquipmentError for a unit that goes on sending without power, or does not come back."""
        power = self._power
        if not power.cycling:
            return True
        if self._on_s is None:
            for unit in power.units:
                if (unit.newest_frame_s or 0.0) > self._off_s + SILENT_S:
                    raise EquipmentError(
                        f"unit {unit.serial} still sends {SILENT_S:g} s after the supply was switched off; "
                        "connect it to that output, or name the right one in `instruments` of the station file"
                    )
            if now_s - self._off_s >= self._duration_s:
                self._on_s = power.switch_on()
            return False
        silent = [unit.serial for unit in power.units if (unit.newest_frame_s or 0.0) <= self._on_s]
        if not silent and now_s - self._on_s >= SAID_S:
            power.cycling = False
            power.restored()
            return True
        if silent and now_s - self._on_s > BACK_S:
            text = f"unit {', '.join(silent)} is not heard {BACK_S:g} s after its power came on"
            raise EquipmentError(f"{text}; look at its supply and its current limit")
        return False

    def stop(self) -> None:
        """The power stays on after a leg; a unit that is not back yet is missed by the guards from now on."""
        if self._on_s is None and self._power.cycling:
            self._on_s = self._power.switch_on()
        self._power.cycling = False
