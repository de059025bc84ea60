"""Bias as a polynomial of the unit's own temperature.

Equation: B(T) = a0 + a1 T + a2 T^2 + a3 T^3 (eq. 1 of the first source paper); `order` sets the last power.
Units: B [deg/h], T [degC], ak [deg/h/degC^k].
Source: first source paper, eq. 1; the usual form of factory calibration (IEEE 1431, temperature sensitivity of bias).
When left out: the residual follows the temperature, equally while heating and cooling.
Look-alikes: spline (the same curve with local freedom), resonance_frequency (a function of temperature as well).
Separated by: a staircase with soaks: the curve stays when the temperature stands still.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from bench.analysis.effects.base import (
    Physical,
    Scale,
    Series,
    StaticEffect,
    Theta,
    check_whole,
    powers_unit,
    prepared,
)
from bench.base import FloatArray
from bench.record import Dataset


@dataclass(frozen=True)
class Polynomial(StaticEffect):
    """Polynomial in temperature; `order` 1 to 12."""

    name = "polynomial"
    needs = ("temperature",)

    order: int = 3
    series: Series | None = field(default=None, repr=False, metadata={"fitted": True})

    def __post_init__(self) -> None:
        check_whole(self.name, "order", self.order, 1, 12)

    def scaled(self, scales: Mapping[str, Scale]) -> Polynomial:
        """Scale the temperature."""
        return replace(self, series=Series("temperature", self.order, scales["temperature"]))

    def columns(self, record: Dataset, theta: Theta) -> FloatArray:
        """Chebyshev polynomials T_1..T_order of the scaled temperature (n, order)."""
        return prepared(self.series).columns(record)

    def physical(self) -> Physical:
        """Coefficients a0..a_order of powers of T [deg/h/degC^k]."""
        powers = range(self.order + 1)
        matrix = np.hstack([np.eye(self.order + 1, 1), prepared(self.series).powers()])
        units = tuple(powers_unit("temperature", p) for p in powers)
        return Physical(tuple(f"a{p}" for p in powers), units, matrix)

    def state(self) -> dict[str, Any]:
        """Scale of the temperature."""
        scale = prepared(self.series).scale
        return {"temperature": [scale.low, scale.high]}
