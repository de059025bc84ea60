"""Scale factor that changes with temperature.

Equation: B = 3600e-6 W (s0 + s1 (T - 25 degC) + s2 (T - 25 degC)^2); `order` 1 leaves s2 out, `constant` false s0.
Units: B [deg/h], W rate of the table [deg/s], T [degC], s0 [ppm], s1 [ppm/degC], s2 [ppm/degC^2].
Source: IEEE 1431 (temperature sensitivity of the scale factor); 20-200 ppm/degC without, 1-10 with compensation.
When left out: the residual has the sign of the rate, and its size changes with temperature.
Look-alikes: scale_factor_nonlinearity (changes with the rate instead), scale_factor (s0 alone).
Separated by: plus and minus the same rate at each temperature: the odd part is scale factor, the even part bias.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.analysis.effects.base import REFERENCE_DEGC
from bench.analysis.effects.scale_factor_terms import ScaleFactorTerms
from bench.base import FloatArray


@dataclass(frozen=True)
class ScaleFactorTemperature(ScaleFactorTerms):
    """Applied rate times a polynomial in temperature; `order` 1 or 2, `constant` true or false."""

    name = "scale_factor_temperature"
    needs = ("applied_rate", "temperature")
    letter, units, first = "s", ("ppm", "ppm/degC", "ppm/degC^2"), 0

    def state(self) -> dict[str, Any]:
        """Reference temperature [degC]."""
        return {"reference_degc": REFERENCE_DEGC}

    @staticmethod
    def term(power: int, channels: Mapping[str, FloatArray]) -> FloatArray:
        """The rate times a power of the temperature."""
        return np.asarray(channels["applied_rate"] * (channels["temperature"] - REFERENCE_DEGC) ** power)
