"""Error of the scale factor that is the same at every rate and temperature.

Equation: B = 3600e-6 s0 W.
Units: B [deg/h], W rate of the table [deg/s], s0 [ppm].
Source: IEEE 1431 (scale-factor error); thousands of ppm without calibration. About -2,000,000 ppm: the sign of the rate
or of the table is reversed; a misalignment of the table's axis by an angle a gives 1e6 (cos a - 1).
When left out: the residual is proportional to the applied rate.
Look-alikes: scale_factor_temperature and scale_factor_nonlinearity (both have this term and further ones).
Separated by: plus and minus several rates at several temperatures.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from bench.analysis.effects.base import Effect, Scale, Theta
from bench.base import DPH_PER_DPS, FloatArray
from bench.record import Dataset


@dataclass(frozen=True)
class ScaleFactor(Effect):
    """One term: the applied rate."""

    name = "scale_factor"
    needs = ("applied_rate",)

    def prepare(self, records: Sequence[Dataset]) -> Self:
        """Checks that the table turned."""
        Scale.of(records, "applied_rate")
        return self

    @property
    def shared(self) -> str:
        """The constant of the scale factor."""
        return "scale factor"

    def columns(self, record: Dataset, theta: Theta) -> FloatArray:
        """Bias per ppm (n, 1) [deg/h]."""
        return np.asarray(1e-6 * DPH_PER_DPS * record.channel("applied_rate")[:, None])

    @property
    def amplitudes(self) -> tuple[tuple[str, str], ...]:
        """The error [ppm]."""
        return (("s0", "ppm"),)
