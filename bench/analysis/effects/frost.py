"""Frost or condensate that melts on the way up.

Equation: B = a exp(-((T - T_f) / w)^2) while the temperature rises and has been below T_f - w since it was last above
T_f + 3 w; 0 otherwise.
Units: B and a [deg/h], T, T_f and w [degC].
Source: empirical: kinks of a MEMS unit near +7 degC on heating only; 0-0.3 deg/h in sealed units.
When left out: the residual has a bump near 0 degC on warming branches only.
Look-alikes: bias_kink (both branches), bias_jump (once), a thermometer that stands still while ice melts.
Separated by: repeating the passage dry (purged with nitrogen): it is gone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.analysis.effects.base import Effect, Parameter, Theta
from bench.analysis.effects.operators import slope
from bench.base import BoolArray, FloatArray
from bench.record import STILL_DEGC_PER_MIN, Dataset


@dataclass(frozen=True)
class Frost(Effect):
    """One bump on heating."""

    name = "frost"
    needs = ("temperature",)
    parameters = (
        Parameter("at_degc", "degC", -10.0, 15.0, 1.0, meaning="middle of the bump"),
        Parameter("width_degc", "degC", 1.0, 10.0, 3.0, log=True, meaning="half-width of the bump"),
    )
    amplitudes = (("a", "deg/h"),)

    def columns(self, record: Dataset, theta: Theta) -> FloatArray:
        """The bump on heating (n, 1)."""
        temperature, at, width = record.channel("temperature"), theta["at_degc"], theta["width_degc"]
        heating = 60.0 * slope(record.time, temperature, 60.0) > STILL_DEGC_PER_MIN
        bump = np.exp(-(((temperature - at) / width) ** 2))
        wet = heating & _since(temperature < at - width, temperature > at + 3.0 * width)
        return np.where(np.isfinite(temperature), bump * wet, np.nan)[:, None]


def _since(begins: BoolArray, ends: BoolArray) -> BoolArray:
    """True (n,) from a row where it begins until one where it ends."""
    rows = np.arange(begins.size)
    last_begin = np.maximum.accumulate(np.where(begins, rows, -1))
    last_end = np.maximum.accumulate(np.where(ends, rows, -1))
    return last_begin > last_end
