"""Error of the output as a surface over rate and temperature, the static model of the second source paper.

Equation: B = sum_ij c_ij x^i T^j, i + j <= `order`: 21 coefficients C0 ... C20 at order 5 with the constant, by total
degree, then falling power of x: c00, c10, c01, c20, c11, c02, ... x is the table's rate (`over: applied_rate`) or the
unit's raw output (`over: rate`, what a unit without a table can evaluate: the paper's Rate(NR, T) is NR - B; it needs a
fit over many rates; otherwise the output would explain itself).
Units: B [deg/h], x [deg/s] of the table or [deg/h] of the output, T [degC], c_ij [deg/h per unit of x^i T^j].
Source: second source paper, fifth-order surface over rate and temperature.
When left out: the residual has the sign of the rate, or its square, and changes with temperature.
Look-alikes: scale_factor_temperature and scale_factor_nonlinearity (its physical parts), polynomial (its edge at rest).
Separated by: several rates of both signs at several temperatures.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from bench.analysis.effects.base import Physical, Scale, Series, StaticEffect, Theta, check_choice, check_whole
from bench.base import CHANNELS, FloatArray, InputError
from bench.record import Dataset

LEAST_STEP = 0.01
"""Rates closer than this share of half their range count as one."""


def surface_powers(order: int) -> tuple[tuple[int, int], ...]:
    """(i, j) of the terms of total degree up to `order`: by total degree, then falling power of the first variable."""
    return tuple((total - j, j) for total in range(order + 1) for j in range(total + 1))


@dataclass(frozen=True)
class Surface(StaticEffect):
    """Polynomial in rate and temperature; `order` 1 to 7, `over` applied_rate or rate."""

    name = "surface"

    order: int = 5
    over: str = "applied_rate"
    series: tuple[Series, ...] = field(default=(), repr=False, metadata={"fitted": True})

    def __post_init__(self) -> None:
        check_whole(self.name, "order", self.order, 1, 7)
        check_choice(self.name, "over", self.over, ("applied_rate", "rate"))

    @property
    def needs(self) -> tuple[str, ...]:
        """Rate of the table (also to know the error of the output), the abscissa, temperature."""
        return tuple(dict.fromkeys((self.over, "applied_rate", "temperature")))

    def scaled(self, scales: Mapping[str, Scale]) -> Surface:
        """Scale both."""
        channels = (self.over, "temperature")
        return replace(self, series=tuple(Series(c, self.order, scales[c]) for c in channels))

    def demand(self, records: Sequence[Dataset]) -> None:
        """InputError where the table stood at too few rates for the order."""
        scale = self._pair[0].scale
        rate = np.concatenate([scale.unit(record.channel(self.over)) for record in records])
        rates = 1 + int(np.sum(np.diff(np.sort(rate[np.isfinite(rate)])) > LEAST_STEP))
        if rates <= self.order:
            raise InputError(
                f"surface: the run has {rates} rates, order {self.order} needs {self.order + 1}; record more rates or "
                "lower the order"
            )

    def columns(self, record: Dataset, theta: Theta) -> FloatArray:
        """Products T_i(x) T_j(T) (n, k), i + j from 1 to `order`, without the constant."""
        rate, temperature = (np.column_stack([np.ones(len(record)), s.columns(record)]) for s in self._pair)
        return np.column_stack([rate[:, i] * temperature[:, j] for i, j in self.terms[1:]])

    def physical(self) -> Physical:
        """Coefficients c_ij of x^i T^j, c00 the constant."""
        rate, temperature = (np.hstack([np.eye(self.order + 1, 1), s.powers()]) for s in self._pair)
        rows = self.terms
        matrix = np.array([[rate[i, k] * temperature[j, m] for k, m in rows] for i, j in rows])
        return Physical(tuple(f"c{i}{j}" for i, j in rows), tuple(self._unit(i, j) for i, j in rows), matrix)

    def state(self) -> dict[str, Any]:
        """Scales of rate and temperature."""
        return {series.channel: [series.scale.low, series.scale.high] for series in self._pair}

    @property
    def terms(self) -> tuple[tuple[int, int], ...]:
        """Degrees (i, j) of the constant and of each column."""
        return surface_powers(self.order)

    @property
    def _pair(self) -> tuple[Series, Series]:
        if len(self.series) != 2:
            raise RuntimeError("prepare() comes before columns()")
        return self.series[0], self.series[1]

    def _unit(self, i: int, j: int) -> str:
        powers = ((f"({CHANNELS[self.over].unit})", i), ("degC", j))
        return "deg/h" + "".join(f"/{unit}" + (f"^{p}" if p > 1 else "") for unit, p in powers if p)
