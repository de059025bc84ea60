"""Bias as a polynomial of the unit's own temperature.

Equation: B(T) = a0 + a1 T + a2 T^2 + a3 T^3 (eq. 1 of the first source paper); `order` sets the last power.
Units: B [deg/h], T [degC], ak [deg/h/degC^k].
Source: first source paper, eq. 1; the usual form of factory calibration (IEEE 1431, temperature sensitivity of bias).
When left out: the residual follows the temperature, equally while heating and cooling.
Look-alikes: spline (the same curve with local freedom), resonance_frequency (a function of temperature as well).
Separated by: a staircase with soaks: the curve stays when the temperature stands still.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from bench.analysis.effects.base import Parameter, Physical, Series, Theta, check_whole, powers_unit
from bench.base import FloatArray
from bench.record import Dataset


@dataclass(frozen=True)
class Polynomial:
    """Polynomial in temperature; `order` 1 to 12."""

    name: ClassVar[str] = "polynomial"
    family: ClassVar[str] = "static"
    needs: ClassVar[tuple[str, ...]] = ("temperature",)
    parameters: ClassVar[tuple[Parameter, ...]] = ()

    order: int = 3
    series: Series | None = field(default=None, repr=False, metadata={"fitted": True})

    def __post_init__(self) -> None:
        check_whole(self.name, "order", self.order, 1, 12)

    def prepare(self, records: Sequence[Dataset]) -> Polynomial:
        """Scale the temperature; InputError where it is constant."""
        return replace(self, series=Series.of(records, "temperature", self.order))

    def columns(self, record: Dataset, theta: Theta) -> FloatArray:
        """Chebyshev polynomials T_1..T_order of the scaled temperature (n, order)."""
        return self._series.columns(record)

    def physical(self) -> Physical:
        """Coefficients a0..a_order of powers of T [deg/h/degC^k]."""
        powers = range(self.order + 1)
        matrix = np.hstack([np.eye(self.order + 1, 1), self._series.powers()])
        units = tuple(powers_unit("temperature", p) for p in powers)
        return Physical(tuple(f"a{p}" for p in powers), units, matrix)

    def state(self) -> dict[str, Any]:
        """Scale of the temperature."""
        return {"temperature": [self._series.scale.low, self._series.scale.high]}

    @property
    def _series(self) -> Series:
        if self.series is None:
            raise RuntimeError("prepare() comes before columns()")
        return self.series
