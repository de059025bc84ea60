"""Bias as a cubic spline of the unit's own temperature, fitted by least squares.

Equation: on each of m equal intervals S_i(T) = a0 + a1 (T - T_i) + a2 (T - T_i)^2 + a3 (T - T_i)^3, with S, S' and S''
continuous at every knot (eq. 5-6 of the first source paper) and two conditions at the ends: `natural` S'' = 0,
`parabolic` S''' = 0 on the first and last interval (parabolic run-out), `periodic` S' and S'' equal at both ends,
`free` none. A model with `rows: bins` has the interpolating spline of the paper: S(x_i) = f(x_i), the mean bias of the
bin about knot x_i, of m + 1 bins of equal width. `intervals: auto` chooses m by leaving contiguous blocks out; ordinary
cross-validation overfits autocorrelated residuals.
Units: S [deg/h], T [degC], aj [deg/h/degC^j].
Source: first source paper, eq. 5-6; de Boor, A Practical Guide to Splines (1978), ch. XIV for the B-spline basis.
When left out: the residual over temperature has knees that a cubic cannot follow, equal for heating and cooling.
Look-alikes: polynomial of higher order; frost and bias_kink (local in temperature, but not in both directions).
Separated by: a slow ramp both ways: the same temperature twice.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from math import factorial
from typing import Any

import numpy as np
import scipy

from bench.analysis.effects.base import (
    Effect,
    Physical,
    Scale,
    StaticEffect,
    Theta,
    check_whole,
    powers_unit,
    prepared,
)
from bench.analysis.thresholds import LEAST_INTERVAL_ROWS
from bench.base import FloatArray, InputError
from bench.record import Dataset

ENDS = ("natural", "parabolic", "periodic", "free")
_COARSER = (12, 8)
CANDIDATES = (2, 3, 4, 6, 8, 12, 16, 24, 32, 48)


@dataclass(frozen=True)
class Spline(StaticEffect):
    """Cubic spline in temperature; `intervals` 1 to 200 or auto, `ends` natural, parabolic, periodic or free."""

    name = "spline"
    needs = ("temperature",)

    intervals: int | str = "auto"
    ends: str = "natural"
    scale: Scale | None = field(default=None, repr=False, metadata={"fitted": True})
    interpolating: bool = field(default=False, repr=False, metadata={"fitted": True})
    """Whether the rows are means at the knots, one each."""

    def replaces(self, other: Effect) -> bool:
        """A straight line is a part of both: beside a polynomial a spline is not determined."""
        return other.name == "polynomial"

    def __post_init__(self) -> None:
        if self.intervals != "auto":
            check_whole(self.name, "intervals", self.intervals, 1, 200)
        if self.ends not in ENDS:
            raise InputError(f"spline: ends is {self.ends!r}, allowed are {', '.join(ENDS)}")

    def choices(self) -> tuple[Effect, ...]:
        """Splines with 2 to 48 intervals where the number is left open."""
        if self.intervals != "auto":
            return ()
        return tuple(replace(self, intervals=m) for m in CANDIDATES)

    def shapes(self) -> tuple[Effect, ...]:
        """The same and coarser ones, which pay for fewer coefficients: one effect for a ranking."""
        return (self, *(replace(self, intervals=m) for m in _COARSER if self.intervals != "auto" and m < self._m))

    def scaled(self, scales: Mapping[str, Scale]) -> Spline:
        """Equal intervals over the range."""
        return replace(self, scale=scales["temperature"])

    def demand(self, records: Sequence[Dataset]) -> None:
        """InputError where an interval has too few rows, or none."""
        if self.interpolating:
            return
        temperature = np.concatenate([record.channel("temperature") for record in records])
        ends = self._scale.low, self._scale.high
        refuse_unvisited(np.histogram(temperature[np.isfinite(temperature)], np.linspace(*ends, self._m + 1))[0], ends)

    def columns(self, record: Dataset, theta: Theta) -> FloatArray:
        """Basis (n, k) of all splines that meet the end conditions, without the constant; tangents beyond the ends."""
        m, scale = self._m, self._scale
        v = (record.channel("temperature") - scale.low) * (m / (scale.high - scale.low))
        inside = np.clip(v, 0.0, float(m))
        begin, end = _tangents(m, self.ends)
        out: FloatArray = _spline(m, self.ends)(inside)
        beyond = v - inside
        for side, slope in ((beyond < 0, begin), (beyond > 0, end)):
            out[side] += beyond[side, None] * slope
        return out

    def physical(self) -> Physical:
        """Coefficients a0..a3 of every interval [deg/h/degC^j]."""
        m, width = self._m, (self._scale.high - self._scale.low) / self._m
        matrix = np.zeros((4 * m, 1 + _basis(m, self.ends).shape[1]))
        matrix[0::4, 0] = 1.0
        for j in range(4):
            # The third derivative jumps at the knots: read it inside the interval.
            at: FloatArray = np.arange(float(m)) + (0.5 if j == 3 else 0.0)
            matrix[j::4, 1:] = _spline(m, self.ends, j)(at) / (factorial(j) * width**j)
        labels = tuple(f"piece{i + 1}.a{j}" for i in range(m) for j in range(4))
        return Physical(labels, tuple(powers_unit("temperature", j) for j in range(4)) * m, matrix)

    def state(self) -> dict[str, Any]:
        """Knots [degC]."""
        return {"knots": np.linspace(self._scale.low, self._scale.high, self._m + 1).tolist(), "ends": self.ends}

    @property
    def _m(self) -> int:
        if not isinstance(self.intervals, int):
            raise RuntimeError("the number of intervals is chosen before prepare()")
        return self.intervals

    @property
    def _scale(self) -> Scale:
        return prepared(self.scale)


def refuse_unvisited(rows: FloatArray, ends: tuple[float, float], what: str = "rows") -> None:
    """InputError where one of the intervals between `ends` [degC] has too few of its rows (m,)."""
    i, knots = int(rows.argmin()), np.linspace(*ends, rows.size + 1)
    if rows[i] < LEAST_INTERVAL_ROWS:
        raise InputError(
            f"spline: interval {i + 1} of {rows.size} ({knots[i]:.1f} to {knots[i + 1]:.1f} degC) has {rows[i]:.0f} "
            f"{what}, at least {LEAST_INTERVAL_ROWS} are needed; use fewer intervals (`spline: {{intervals: 8}}` in a "
            "model file) or a profile that passes there more slowly"
        )


def _knots(m: int) -> FloatArray:
    """Clamped uniform knots on [0, m] (m + 7,): intervals of width one keep all derivatives of order one."""
    return np.concatenate([np.zeros(3), np.arange(m + 1.0), np.full(3, float(m))])


@lru_cache(maxsize=64)
def _basis(m: int, ends: str) -> FloatArray:
    """B-spline coefficients (m + 3, k), orthonormal, of the splines that meet the end conditions, less the constant."""
    spline = scipy.interpolate.BSpline(_knots(m), np.eye(m + 3), 3)
    both = np.array([0.0, float(m)])
    conditions = {
        "natural": spline.derivative(2)(both),
        "parabolic": spline.derivative(3)(np.array([0.5, m - 0.5])),
        "periodic": np.array([np.diff(spline.derivative(j)(both), axis=0)[0] for j in (1, 2)]),
        "free": np.zeros((0, m + 3)),
    }[ends]
    # All coefficients equal make the constant (it meets every condition); its complement is what remains.
    basis: FloatArray = scipy.linalg.null_space(np.vstack([conditions, np.ones(m + 3)]))
    basis.flags.writeable = False
    return basis


@lru_cache(maxsize=64)
def _spline(m: int, ends: str, order: int = 0) -> scipy.interpolate.BSpline:
    """The splines of the basis, or their derivatives per interval width: v (n,) to (n, k), NaN to NaN."""
    spline = scipy.interpolate.BSpline(_knots(m), _basis(m, ends), 3)
    return spline.derivative(order) if order else spline


@lru_cache(maxsize=64)
def _tangents(m: int, ends: str) -> tuple[FloatArray, FloatArray]:
    slope = _spline(m, ends, 1)(np.array([0.0, float(m)]))
    return slope[0], slope[1]
