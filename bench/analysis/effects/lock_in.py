"""Lock-in of a ring laser: both beams couple by backscatter, and small rates are not seen.

Equation: B = 3600 (sign(W) sqrt(max(W^2 - WL^2, 0)) - W) a; a is 1 for a laser without dither, less with one.
Units: B [deg/h], W rate of the table [deg/s], WL lock-in threshold [deg/s].
Source: F. Aronowitz in Laser Applications 1 (1971) 113; W. W. Chow et al., Rev. Mod. Phys. 57 (1985) 61. Usual
threshold 0.01 to 0.3 deg/s without dither.
When left out: the error is an odd curve over the rate, largest at the threshold, and falls as WL^2 / 2 W above it.
Look-alikes: scale_factor_nonlinearity (grows with the rate instead of falling).
Separated by: several small rates of both signs around the threshold.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from bench.analysis.effects.base import Effect, Parameter, Scale, Theta
from bench.base import DPH_PER_DPS, FloatArray
from bench.record import Dataset


@dataclass(frozen=True)
class LockIn(Effect):
    """One term with a threshold."""

    name = "lock_in"
    family = "rotation"
    needs = ("applied_rate",)
    parameters = (Parameter("threshold_dps", "deg/s", 0.003, 3.0, 0.1, log=True, meaning="rate that is not seen"),)
    amplitudes = (("a", "1"),)

    def prepare(self, records: Sequence[Dataset]) -> LockIn:
        """Checks that the table turned."""
        Scale.of(records, "applied_rate")
        return self

    def columns(self, record: Dataset, theta: Theta) -> FloatArray:
        """What is lost of the rate (n, 1) [deg/h]."""
        lost = record.mean_of(partial(_lost, theta["threshold_dps"]), "applied_rate")
        return DPH_PER_DPS * lost[:, None]


def _lost(threshold_dps: float, channels: dict[str, FloatArray]) -> FloatArray:
    rate = channels["applied_rate"]
    return np.asarray(np.sign(rate) * np.sqrt(np.maximum(rate**2 - threshold_dps**2, 0.0)) - rate)
