"""Scale factor that changes with the rate itself.

Equation: B = 3600e-6 (c1 W + c2 W^2 + c3 W^3); `order` 2 leaves c3 out, `constant` false c1, the scale factor's offset.
Units: B [deg/h], W rate of the table [deg/s], c1 [ppm], c2 [ppm per deg/s], c3 [ppm per (deg/s)^2].
Source: IEEE 1431 (scale-factor nonlinearity and asymmetry).
When left out: the residual is a curve over the applied rate: even for asymmetry (c2), odd for saturation (c3).
Look-alikes: scale_factor_temperature (changes with temperature instead), scale_factor (c1 alone).
Separated by: several rates of both signs at one temperature.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from bench.analysis.effects.scale_factor_terms import ScaleFactorTerms
from bench.base import FloatArray


@dataclass(frozen=True)
class ScaleFactorNonlinearity(ScaleFactorTerms):
    """Powers of the applied rate; `order` 2 or 3, `constant` true or false."""

    name = "scale_factor_nonlinearity"
    needs = ("applied_rate",)
    letter, units, first = "c", ("", "ppm", "ppm per deg/s", "ppm per (deg/s)^2"), 1

    order: int = 3

    @staticmethod
    def term(power: int, channels: Mapping[str, FloatArray]) -> FloatArray:
        """A power of the rate."""
        return np.asarray(channels["applied_rate"] ** power)
