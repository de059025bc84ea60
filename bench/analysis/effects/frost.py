"""Frost or condensate that melts on the way up.

Equation: shape `bump` B = a exp(-((T - T_f) / w)^2) while the temperature rises and has been below T_f - w since it was
last above T_f + 3 w; shape `melt` B = a x exp(1 - x) with x = (T - T_f) / w > 0, while it rises and has been below T_f
since it was last above T_f + 6 w; 0 otherwise.
Units: B and a [deg/h], T, T_f and w [degC].
Source: empirical: kinks of a MEMS unit near +7 degC on heating only; 0-0.3 deg/h in sealed units. The second shape is
of ice of which each degree above freezing melts a share, and dries the same share of what is melted.
When left out: the residual has a bump near 0 degC on warming branches only.
Look-alikes: bias_kink (both branches), bias_jump (once), a thermometer that stands still while ice melts.
Separated by: repeating the passage dry (purged with nitrogen): it is gone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bench.analysis.effects.base import Effect, Parameter, Theta, check_choice
from bench.analysis.effects.operators import slope
from bench.base import BoolArray, FloatArray
from bench.record import STILL_DEGC_PER_MIN, Dataset

SHAPES = ("bump", "melt")


@dataclass(frozen=True)
class Frost(Effect):
    """One bump on heating; `shape` bump, the same on either side, or melt, which begins suddenly."""

    name = "frost"
    needs = ("temperature",)
    parameters = (
        Parameter("at_degc", "degC", -10.0, 15.0, 1.0, meaning="middle of the bump, or where it begins to melt"),
        Parameter("width_degc", "degC", 1.0, 10.0, 3.0, log=True, meaning="half-width, or from there to the peak"),
    )
    amplitudes = (("a", "deg/h"),)

    shape: str = SHAPES[0]

    def __post_init__(self) -> None:
        check_choice(self.name, "shape", self.shape, SHAPES)

    def shapes(self) -> tuple[Effect, ...]:
        """Both."""
        return tuple(replace(self, shape=shape) for shape in SHAPES)

    def columns(self, record: Dataset, theta: Theta) -> FloatArray:
        """The bump on heating (n, 1)."""
        temperature = record.channel("temperature")
        heating = 60.0 * slope(record.time, temperature, 60.0) > STILL_DEGC_PER_MIN
        above = (temperature - theta["at_degc"]) / theta["width_degc"]
        if self.shape == "melt":
            bump, wet = np.maximum(above, 0.0) * np.exp(1.0 - above), _since(above < 0.0, above > 6.0)
        else:
            bump, wet = np.exp(-(above**2)), _since(above < -1.0, above > 3.0)
        return np.where(np.isfinite(temperature), bump * (heating & wet), np.nan)[:, None]


def _since(begins: BoolArray, ends: BoolArray) -> BoolArray:
    """True (n,) from a row where it begins until one where it ends."""
    rows = np.arange(begins.size)
    last_begin = np.maximum.accumulate(np.where(begins, rows, -1))
    last_end = np.maximum.accumulate(np.where(ends, rows, -1))
    return last_begin > last_end
