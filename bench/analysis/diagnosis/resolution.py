"""Steps of thermometer and output, found before anything is named: what they cause looks like effects.

A converter without dither errs by up to half a step, the same way each time the same value comes back: no noise, but a
fine structure over temperature. Where the error of the steps matters, columns that follow the output's rounding join
the model's, and no effect is named whose contribution is smaller than what the steps may cause.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bench.analysis.thresholds import STEPS_MATTER
from bench.base import FloatArray
from bench.record import Dataset

_ORDERS = (1, 2)
_ROUND = float(np.sqrt(12.0))
_AT_MOST = 1.5  # times its RMS: where the temperature stands still, an error keeps its sign for hours


@dataclass(frozen=True)
class Resolution:
    """Steps of the output [deg/h] and of the thermometer [degC], 0 where none is seen, and their RMS errors [deg/h]."""

    rate_step_dph: float = 0.0
    rate_error_dph: float = 0.0
    temperature_step_degc: float = 0.0
    temperature_error_dph: float = 0.0

    @property
    def error_dph(self) -> float:
        """RMS error of both."""
        return float(np.hypot(self.rate_error_dph, self.temperature_error_dph))

    def matters(self, floor_dph: float) -> bool:
        """Whether the steps cause more than a share of the noise, or of a noise that is not known (NaN)."""
        return self.error_dph > 0.0 and not self.error_dph <= STEPS_MATTER * floor_dph

    def hides(self, contribution: FloatArray) -> bool:
        """Whether what an effect adds beside the model (n,) [deg/h] is within what the steps may cause."""
        return float(np.sqrt(np.mean(contribution**2))) < _AT_MOST * self.error_dph

    def rounding(self, fitted: FloatArray) -> FloatArray:
        """Columns (n, k) that rounding the output adds, from its fitted values (n,) [deg/h]; none without a step.

        The error of rounding is a saw-tooth of the value: its first harmonics, what noise leaves of them.
        """
        if not self.rate_step_dph:
            return np.empty((len(fitted), 0))
        phase = 2.0 * np.pi * fitted / self.rate_step_dph
        return np.column_stack([wave(order * phase) for order in _ORDERS for wave in (np.sin, np.cos)])

    def words(self) -> str:
        """The finding, empty where there is none."""
        parts = []
        if self.temperature_step_degc:
            parts.append(
                f"the thermometer has steps of {self.temperature_step_degc:.3g} degC, which cause up to "
                f"{self.temperature_error_dph:.2g} deg/h"
            )
        if self.rate_step_dph:
            text = f"the output has steps of {self.rate_step_dph:.3g} deg/h, which cause up to "
            parts.append(f"{text}{self.rate_error_dph:.2g} deg/h")
        return " and ".join(parts)


def resolution(runs: Sequence[Dataset], slope: FloatArray, white_dph: float) -> Resolution:
    """Resolution of runs whose fitted curve has this slope (n,) [deg/h/degC] and whose rows have this white noise.

    Noise of half a step, row by row, dithers the output: what then remains of its error is nothing.
    """
    rate = max((run.rate_step for run in runs), default=0.0)
    temperature = max((run.temperature_step for run in runs if "temperature" in run.channels), default=0.0)
    own = max(white_dph**2 - rate**2 / 12.0, 0.0)  # without the error of rounding, which is part of what is measured
    undithered = float(np.exp(-2.0 * np.pi**2 * own / rate**2)) if rate else 0.0
    steep = float(np.sqrt(np.nanmean(slope**2))) if np.isfinite(slope).any() else 0.0
    return Resolution(rate, rate / _ROUND * undithered, temperature, steep * temperature / _ROUND)
