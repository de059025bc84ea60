"""Settled is not reached: in band, slow enough, confirmed by the unit's own sensor, and for long enough."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from bench.profile import SettleRule


@dataclass
class Settling:
    """Watches chamber air and unit temperatures until they meet a `SettleRule` for its whole dwell time."""

    rule: SettleRule
    target_degc: float
    _window: deque[tuple[float, float, tuple[float, ...]]] = field(default_factory=deque, init=False)

    def feed(self, t_s: float, air_degc: float, units_degc: Sequence[float]) -> bool:
        """Take one reading (NaN where unknown, which never settles); True when settled."""
        self._window.append((t_s, air_degc, tuple(units_degc)))
        while self._window and self._window[0][0] < t_s - self.rule.dwell_s:
            self._window.popleft()
        return self.reason() is None

    def reason(self) -> str | None:
        """Why it is not settled yet, with the number; None when it is."""
        rule, window = self.rule, self._window
        if not window or window[-1][0] - window[0][0] < rule.dwell_s - 1.5:
            return "dwell time not over"
        air = max(abs(row[1] - self.target_degc) for row in window)
        if not air <= rule.band_degc:
            return f"chamber air is {air:.2f} degC from {self.target_degc:g}, {rule.band_degc:g} allowed"
        times = np.array([row[0] for row in window]) / 60.0
        units = np.array([row[2] for row in window])
        away = float(np.max(np.abs(units - self.target_degc), initial=0.0))
        if not away <= rule.unit_band_degc:
            return f"unit sensor is {away:.2f} degC from {self.target_degc:g}, {rule.unit_band_degc:g} allowed"
        if units.size:
            slopes = np.polynomial.polynomial.polyfit(times - times[0], units, 1)[1]
            slope = float(np.max(np.abs(slopes)))
            if not slope <= rule.slope_degc_per_min:
                return f"unit sensor moves by {slope:.3f} degC/min, {rule.slope_degc_per_min:g} allowed"
        return None
