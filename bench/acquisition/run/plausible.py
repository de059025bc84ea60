"""Do air, set point and units fit together? Three signals for the guards that every run has."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bench.acquisition.profile.guards import Signal
from bench.acquisition.profile.preflight import Limits
from bench.acquisition.recording.physics import LONGEST_S, UnitExcess
from drivers.chamber import ChamberReading

SHARE = 0.3
"""Part of its declared speed with which a chamber at least comes nearer to its set point."""
SLOWEST_DEGC_PER_MIN = 0.1
APART_DEGC = 10.0
SAME_DEGC = 3.0
"""A display is taken for one in degF when it and the unit are further apart than APART_DEGC, and nearer than SAME_DEGC
when the display is converted."""


class SetpointExcess:
    """How much further the air is from its set point than a chamber of the declared speed would be.

    What is explained grows by each move of the set point and shrinks at a share of the chamber's speed.
    """

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._last: tuple[float, float] | None = None  # time [s], set point [degC]
        self._explained = 0.0

    def take(self, reading: ChamberReading, ours_on: bool) -> float:
        """Excess [K], 0 or more; nothing is expected of a chamber that is off or not ours."""
        target = reading.setpoint if reading.working_setpoint is None else reading.working_setpoint
        apart = abs(reading.temperature - target)
        if not ours_on or not reading.on or self._last is None:
            self._explained = apart
        else:
            passed_s = min(reading.t_s - self._last[0], LONGEST_S)
            here = np.array([reading.temperature])
            speed = SHARE * float(self._limits.fastest(here, target > reading.temperature)[0])
            nearer = max(speed, SLOWEST_DEGC_PER_MIN) * passed_s / 60.0
            self._explained = max(self._explained + abs(target - self._last[1]) - nearer, 0.0)
        self._last = reading.t_s, target
        return max(apart - self._explained, 0.0)


def reads_degf(air_degc: float, units_degc: Sequence[float]) -> bool:
    """Whether the air's number is that of the units in degF; for a chamber that has stood at one temperature."""
    as_celsius = (air_degc - 32.0) / 1.8
    far = all(abs(degc - air_degc) > APART_DEGC for degc in units_degc)
    return far and all(abs(degc - as_celsius) < SAME_DEGC for degc in units_degc)


class Plausible:
    """The three of a run, from its readings and its units."""

    def __init__(self, limits: Limits, unit_lag_min: float) -> None:
        self._setpoint, self._units = SetpointExcess(limits), UnitExcess(unit_lag_min)
        self._excess: Signal | None = None
        self._moved = False

    def take(self, reading: ChamberReading, ours_on: bool) -> None:
        """Take in a reading; `ours_on`: the chamber was switched on by us."""
        target = reading.setpoint if reading.working_setpoint is None else reading.working_setpoint
        text = f"air {reading.temperature:.2f} degC, set point {target:g} degC"
        self._excess = Signal(self._setpoint.take(reading, ours_on), reading.t_s, text)
        self._moved = self._moved or ours_on

    def signals(self, reading: ChamberReading, units: Sequence[Signal]) -> dict[str, Signal]:
        """What is known now, by name; `units` are the temperatures of all units."""
        found = {} if self._excess is None else {"setpoint_excess": self._excess}
        if not units:
            return found
        air, degc = reading.temperature, [unit.value for unit in units]
        oldest_s = min(reading.t_s, *(unit.t_s for unit in units))
        text = f"air {air:.2f} degC, unit sensors {', '.join(f'{value:.2f}' for value in degc)} degC"
        in_degf = not self._moved and reads_degf(air, degc)
        advice = f"{text}; set the controller's display and registers to degC" if in_degf else text
        return {
            **found,
            "unit_excess": Signal(self._units.take(reading.t_s, air, degc), oldest_s, text),
            "display_degf": Signal(float(in_degf), oldest_s, advice),
        }
