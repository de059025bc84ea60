"""Scale factor that changes with the rate itself.

Equation: B = 3600e-6 (c1 W + c2 W^2 + c3 W^3); `order` 2 leaves c3 out, `constant` false c1, the scale factor's offset.
Units: B [deg/h], W rate of the table [deg/s], c1 [ppm], c2 [ppm per deg/s], c3 [ppm per (deg/s)^2].
Source: IEEE 1431 (scale-factor nonlinearity and asymmetry).
When left out: the residual is a curve over the applied rate: even for asymmetry (c2), odd for saturation (c3).
Look-alikes: scale_factor_temperature (changes with temperature instead); c1 is what both share.
Separated by: several rates of both signs at one temperature.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from bench.analysis.effects.base import Effect, Scale, Theta, check_choice, check_whole
from bench.base import DPH_PER_DPS, FloatArray
from bench.record import Dataset

_UNITS = ("", "ppm", "ppm per deg/s", "ppm per (deg/s)^2")


@dataclass(frozen=True)
class ScaleFactorNonlinearity(Effect):
    """Powers of the applied rate; `order` 2 or 3, `constant` true or false."""

    name = "scale_factor_nonlinearity"
    needs = ("applied_rate",)

    order: int = 3
    constant: bool = True

    def __post_init__(self) -> None:
        check_whole(self.name, "order", self.order, 2, 3)
        check_choice(self.name, "constant", self.constant, (True, False))

    def prepare(self, records: Sequence[Dataset]) -> ScaleFactorNonlinearity:
        """Checks that the table turned."""
        Scale.of(records, "applied_rate")
        return self

    @property
    def shared(self) -> str:
        """The constant of the scale factor."""
        return "scale factor" if self.constant else ""

    def without_shared(self) -> Effect:
        """Without the constant."""
        return replace(self, constant=False)

    def columns(self, record: Dataset, theta: Theta) -> FloatArray:
        """Bias per coefficient (n, k) [deg/h]."""
        powers = (record.mean_of(partial(_power, power), "applied_rate") for power in self._powers)
        return np.column_stack([1e-6 * DPH_PER_DPS * each for each in powers])

    @property
    def amplitudes(self) -> tuple[tuple[str, str], ...]:
        """c1, c2, c3."""
        return tuple((f"c{power}", _UNITS[power]) for power in self._powers)

    @property
    def _powers(self) -> range:
        return range(1 if self.constant else 2, self.order + 1)


def _power(power: int, channels: Mapping[str, FloatArray]) -> FloatArray:
    return np.asarray(channels["applied_rate"] ** power)
