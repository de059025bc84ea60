"""Bias from temperature gradients across the unit, which a changing temperature makes.

Equation: B = k1 r, and with `temperature_slope` + k2 r (T - 25 degC); r is dT/dt, central over a minute, or with
`filter_s` seen through a first-order filter of that time constant: r = (T - T_lag) / filter_s.
Units: B [deg/h], r [degC/min], T [degC], k1 [deg/h per degC/min], k2 [deg/h per degC/min per degC], filter_s [s].
Source: IEEE 1431 (sensitivity of bias to temperature ramp and gradient); usual size 0.2-2 deg/h per degC/min for a
vibratory gyro of the 1 deg/h class.
When left out: heating and cooling differ by a constant, or slowly varying, amount that doubles with the ramp rate and
vanishes in a soak.
Look-alikes: thermal_lag (vanishes where the bias curve is flat), hysteresis (stays in a soak, same at any rate), creep.
Separated by: standing still and reversing (minor loops, steps); ramps at two rates.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bench.analysis.effects.base import REFERENCE_DEGC, Effect, Theta, check_choice, check_number
from bench.analysis.effects.operators import ramp_invariant_lag, slope
from bench.base import FloatArray
from bench.record import Dataset


@dataclass(frozen=True)
class TemperatureRate(Effect):
    """One or two terms in dT/dt; `filter_s` 0 to 36000, `temperature_slope` true or false."""

    name = "temperature_rate"
    family = "rate"
    needs = ("temperature",)

    filter_s: float = 0.0
    temperature_slope: bool = False

    def __post_init__(self) -> None:
        check_number(self.name, "filter_s", self.filter_s, 0.0, 36000.0)
        check_choice(self.name, "temperature_slope", self.temperature_slope, (True, False))

    @property
    def rarity(self) -> float:
        """A lag over a curve of the bias looks like a size that grows: that is to show before it is counted."""
        return 1.0 if self.temperature_slope else 0.0

    def shapes(self) -> tuple[Effect, ...]:
        """The same at any temperature, and growing with it."""
        return (self,) if self.temperature_slope else (self, replace(self, temperature_slope=True))

    def columns(self, record: Dataset, theta: Theta) -> FloatArray:
        """The rate r (n, 1), or r and r (T - 25 degC) (n, 2)."""
        temperature = record.channel("temperature")
        if self.filter_s:
            behind = temperature - ramp_invariant_lag(record.time, temperature, self.filter_s)
            rate = 60.0 * behind / self.filter_s
        else:
            rate = 60.0 * slope(record.time, temperature, 60.0)
        return np.column_stack([rate, rate * (temperature - REFERENCE_DEGC)][: 1 + self.temperature_slope])

    @property
    def amplitudes(self) -> tuple[tuple[str, str], ...]:
        """k1 and k2."""
        return (("k1", "deg/h per degC/min"), ("k2", "deg/h per degC/min per degC"))[: 1 + self.temperature_slope]

    def state(self) -> dict[str, Any]:
        """Reference temperature [degC]."""
        return {"reference_degc": REFERENCE_DEGC} if self.temperature_slope else {}
