"""Bias as cubics of temperature, resonance frequency, drive amplitude and quadrature, without cross terms.

Equation: B = b0 + sum_k (t_k T^k + f_k f^k + d_k A^k + q_k Q^k), k = 1..3 (eq. 2 of the first source paper, 13
coefficients); `order` sets the last power.
Units: B [deg/h], T [degC], f [Hz], A and Q [V]; each coefficient [deg/h] per unit of its channel to its power.
Source: first source paper, eq. 2; the same idea as the ring-gyro patent with bias over (f, A, Q).
When left out: the residual over temperature is a loop that the curve of another channel closes.
Look-alikes: thermal_lag (frequency follows the resonator, not the sensor), quadrature_leakage, drive_amplitude,
resonance_frequency: the single channels of this sum.
Separated by: moving one channel at constant temperature (quadrature set point, drive amplitude).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from bench.analysis.effects.base import Physical, Scale, Series, StaticEffect, Theta, check_whole, powers_unit
from bench.base import FloatArray
from bench.record import Dataset


@dataclass(frozen=True)
class Regression(StaticEffect):
    """Polynomials in four channels; `order` 1 to 5, 3 is the paper's."""

    name = "regression"
    needs = ("temperature", "frequency", "drive", "quadrature")

    order: int = 3
    series: tuple[Series, ...] = field(default=(), repr=False, metadata={"fitted": True})

    def __post_init__(self) -> None:
        check_whole(self.name, "order", self.order, 1, 5)

    def scaled(self, scales: Mapping[str, Scale]) -> Regression:
        """Scale the four channels."""
        return replace(self, series=tuple(Series(c, self.order, scales[c]) for c in self.needs))

    def columns(self, record: Dataset, theta: Theta) -> FloatArray:
        """Chebyshev polynomials of the four scaled channels (n, 4 * order)."""
        return np.hstack([series.columns(record) for series in self.series])

    def physical(self) -> Physical:
        """Coefficients b0, temperature^1 .. quadrature^order."""
        order, labels, units = self.order, ["b0"], ["deg/h"]
        matrix = np.zeros((1 + 4 * order, 1 + 4 * order))
        matrix[0, 0] = 1.0
        for i, series in enumerate(self.series):
            block = slice(1 + i * order, 1 + (i + 1) * order)
            powers = series.powers()
            matrix[0, block], matrix[block, block] = powers[0], powers[1:]
            labels += [f"{series.channel}^{p}" for p in range(1, order + 1)]
            units += [powers_unit(series.channel, p) for p in range(1, order + 1)]
        return Physical(tuple(labels), tuple(units), matrix)

    def state(self) -> dict[str, Any]:
        """Scale of each channel."""
        return {series.channel: [series.scale.low, series.scale.high] for series in self.series}
