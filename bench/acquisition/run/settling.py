"""Settled is not reached: in band, slow enough, confirmed by the unit's own sensor, and for long enough."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from bench.acquisition.profile.segments import SettleRule


@dataclass
class Settling:
    """Watches chamber air and unit temperatures until they meet a `SettleRule` for its whole dwell time.

    `reason` says, with the number, why it is not settled yet; None when it is.
    """

    rule: SettleRule
    target_degc: float
    reason: str | None = field(default="no reading yet", init=False)
    _inside: deque[tuple[float, Sequence[float]]] = field(default_factory=deque, init=False)

    def feed(self, t_s: float, air_degc: float, units_degc: Sequence[float]) -> bool:
        """Take one reading (NaN where unknown, which never settles); True when settled.

        When a unit has left, the dwell time starts anew for the others.
        """
        if self._inside and len(units_degc) != len(self._inside[-1][1]):
            self._inside.clear()
        self.reason = self._outside(air_degc, units_degc)
        if self.reason is not None:
            self._inside.clear()
            return False
        self._inside.append((t_s, units_degc))
        while len(self._inside) > 1 and self._inside[1][0] <= t_s - self.rule.dwell_s:
            self._inside.popleft()
        self.reason = self._unsteady()
        return self.reason is None

    def _outside(self, air_degc: float, units_degc: Sequence[float]) -> str | None:
        rule, target = self.rule, self.target_degc
        if not abs(air_degc - target) <= rule.band_degc:
            return f"chamber air is {abs(air_degc - target):.2f} degC from {target:g}, {rule.band_degc:g} allowed"
        for unit_degc in units_degc:
            away = abs(unit_degc - target)
            if not away <= rule.unit_band_degc:
                return f"unit sensor is {away:.2f} degC from {target:g}, {rule.unit_band_degc:g} allowed"
        return None

    def _unsteady(self) -> str | None:
        rule = self.rule
        times = np.array([t_s for t_s, _ in self._inside])
        if times[-1] - times[0] < rule.dwell_s:
            return f"in band for {times[-1] - times[0]:.0f} s, dwell time is {rule.dwell_s:.0f} s"
        units = np.array([units for _, units in self._inside])
        minutes = (times - times.mean()) / 60.0
        slope = float(np.max(np.abs(minutes @ units), initial=0.0) / (minutes @ minutes))
        if not slope <= rule.slope_degc_per_min:
            return f"unit sensor moves by {slope:.3f} degC/min, {rule.slope_degc_per_min:g} allowed"
        return None
