"""Thermometer that follows the gyro's temperature late: the gyro leads, all terms see what the thermometer will show.

Equation: T_g = T + tau dT/dt, and every term of the model is a function of T_g; the error of leaving it out is about
+B'(T) tau dT/dt. The slope is central over a minute, or half of tau where that is longer.
Units: T thermometer, T_g gyro [degC], tau [s].
Source: inverse of the first-order response of a thermometer (IEC 60751, thermal response time); a film on the board
1-20 s, a probe in a well or taped to the case 20-600 s.
When left out: loops over temperature as wide as the bias curve is steep, of the sign opposite to those of thermal_lag.
Look-alikes: clock_delay (temperature late; the same to first order), temperature_rate (present where the curve is flat,
too), thermal_lag (opposite sign), thermometer_hysteresis (as wide at any rate).
Separated by: steps and reversals (a lag rounds corners, a delay shifts them); a second thermometer.
"""

from __future__ import annotations

from dataclasses import dataclass

from bench.analysis.effects.base import Effect, Parameter, Theta
from bench.analysis.effects.operators import lead
from bench.base import FloatArray
from bench.record import Dataset


@dataclass(frozen=True)
class ThermometerLag(Effect):
    """Moves the abscissa of all terms; no terms of its own."""

    name = "thermometer_lag"
    needs = ("temperature",)
    rarity = 0.5
    parameters = (Parameter("tau_s", "s", 3.0, 3000.0, 30.0, log=True, meaning="time constant of the thermometer"),)

    def abscissa(self, record: Dataset, theta: Theta) -> FloatArray:
        """Temperature of the gyro (n,) [degC]."""
        return lead(record.time, record.channel("temperature"), theta["tau_s"])
