"""Bias that follows the amplitude of the drive: coupling of the drive into the sense axis.

Equation: B = k1 p + k2 p^2, p = 100 (A / A_0 - 1), A_0 the middle of the fitted range; `order` 1 leaves k2 out.
Units: B [deg/h], A and A_0 [V], p [%], k1 [deg/h/%], k2 [deg/h/%^2].
Source: amplitude dependence of the damping and stiffness anisotropy (Lynch, vibratory gyro analysis by the method of
averaging, 1995); 0.1-1 deg/h per % for a 1 deg/h class, amplitude controls drift by 50-500 ppm/degC.
When left out: the residual follows the amplitude, also at constant temperature.
Look-alikes: resonance_frequency and quadrature_leakage where the channels wander together (correlation above 0.95).
Separated by: stepping the amplitude by 1 % at constant temperature.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from bench.analysis.effects.base import Effect, Scale, Theta, check_whole, prepared
from bench.base import FloatArray
from bench.record import Dataset


@dataclass(frozen=True)
class DriveAmplitude(Effect):
    """One or two terms in the relative amplitude; `order` 1 or 2."""

    name = "drive_amplitude"
    family = "drive"
    needs = ("drive",)

    order: int = 1
    scale: Scale | None = field(default=None, repr=False, metadata={"fitted": True})

    def __post_init__(self) -> None:
        check_whole(self.name, "order", self.order, 1, 2)

    def prepare(self, records: Sequence[Dataset]) -> DriveAmplitude:
        """Fix A_0; InputError where the amplitude does not move."""
        return replace(self, scale=Scale.of(records, "drive"))

    def columns(self, record: Dataset, theta: Theta) -> FloatArray:
        """Powers of p [%], (n, order)."""
        percent = 100.0 * (record.channel("drive") / prepared(self.scale).centre - 1.0)
        return np.column_stack([percent**power for power in range(1, self.order + 1)])

    @property
    def amplitudes(self) -> tuple[tuple[str, str], ...]:
        """k1 and k2."""
        return (("k1", "deg/h/%"), ("k2", "deg/h/%^2"))[: self.order]

    def state(self) -> dict[str, Any]:
        """A_0 [V]."""
        return {"nominal_v": prepared(self.scale).centre}
