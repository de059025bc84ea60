"""Scale factor that changes with temperature.

Equation: B = 3600e-6 W (s0 + s1 (T - 25 degC) + s2 (T - 25 degC)^2); `order` 1 leaves s2 out, `constant` false s0.
Units: B [deg/h], W rate of the table [deg/s], T [degC], s0 [ppm], s1 [ppm/degC], s2 [ppm/degC^2].
Source: IEEE 1431 (temperature sensitivity of the scale factor); 20-200 ppm/degC without, 1-10 with compensation.
When left out: the residual has the sign of the rate, and its size changes with temperature.
Look-alikes: scale_factor_nonlinearity (changes with the rate instead), misalignment of the table's axis (s0 alone).
Separated by: plus and minus the same rate at each temperature: the odd part is scale factor, the even part bias.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from bench.analysis.effects.base import REFERENCE_DEGC, Effect, Scale, Theta, check_choice, check_whole
from bench.base import DPH_PER_DPS, FloatArray
from bench.record import Dataset

_UNITS = ("ppm", "ppm/degC", "ppm/degC^2")


@dataclass(frozen=True)
class ScaleFactorTemperature(Effect):
    """Applied rate times a polynomial in temperature; `order` 1 or 2, `constant` true or false."""

    name = "scale_factor_temperature"
    needs = ("applied_rate", "temperature")

    order: int = 2
    constant: bool = True

    def __post_init__(self) -> None:
        check_whole(self.name, "order", self.order, 1, 2)
        check_choice(self.name, "constant", self.constant, (True, False))

    def prepare(self, records: Sequence[Dataset]) -> ScaleFactorTemperature:
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
        """Bias per ppm (n, k) [deg/h]."""
        products = (record.mean_of(partial(_product, power), "applied_rate", "temperature") for power in self._powers)
        return np.column_stack([1e-6 * DPH_PER_DPS * each for each in products])

    @property
    def amplitudes(self) -> tuple[tuple[str, str], ...]:
        """s0, s1, s2."""
        return tuple((f"s{power}", _UNITS[power]) for power in self._powers)

    def state(self) -> dict[str, Any]:
        """Reference temperature [degC]."""
        return {"reference_degc": REFERENCE_DEGC}

    @property
    def _powers(self) -> range:
        return range(0 if self.constant else 1, self.order + 1)


def _product(power: int, channels: Mapping[str, FloatArray]) -> FloatArray:
    return np.asarray(channels["applied_rate"] * (channels["temperature"] - REFERENCE_DEGC) ** power)
