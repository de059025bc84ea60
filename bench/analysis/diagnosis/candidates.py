"""What the evidence engine compares: a record with its present model, and candidates for what that model lacks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import product
from typing import Literal

import numpy as np

from bench.analysis.effects.base import Parameter
from bench.analysis.noise.likelihood import Record, spanned
from bench.base import FloatArray

Theta = tuple[float, ...]
"""Nonlinear parameters of one candidate, in the order of its `parameters`."""

_POINTS = (24, 9, 5)  # grid points of each parameter for one, two and three of them
_POINTS_OF_CHANGE = 160  # a jump is sharp: what lies between two points would look smaller than it is


@dataclass(frozen=True)
class Candidate:
    """One effect that may be missing.

    `columns(theta)` are the columns (n, k) that it adds to the base, or for an "abscissa" the columns (n, p) that
    replace the base's, one by one. `change_point` costs one count more, `rarity` as many as it says. `effect` is the
    effect that the candidate is a shape of, by default its own name. `shift(theta)` (n, 1) is what a moved abscissa
    changes in the fitted curve, the curve held: the grid is then scanned with it, a tenth of the work.
    """

    name: str
    columns: Callable[[Theta], FloatArray]
    effect: str = ""
    kind: Literal["term", "abscissa"] = "term"
    parameters: tuple[Parameter, ...] = ()
    change_point: bool = False
    points: int | None = None
    tried: tuple[Theta, ...] | None = None
    """The grid where it is not one of evenly spaced points."""
    rarity: float = 0.0
    shift: Callable[[Theta], FloatArray] | None = field(default=None, repr=False)
    anew: Callable[[Theta], bool] | None = field(default=None, repr=False)
    """Whether the abscissa moves so far that the curve held says nothing: the curve has to be fitted anew."""
    still: FloatArray | None = field(default=None, repr=False)
    """Its column (n_s, 1) in the unit's isothermal run, where it acts there in the same size; for one column without
    parameters."""
    many: Callable[[Sequence[Theta]], FloatArray] | None = field(default=None, repr=False)
    """`columns` of many parameters at once (n, many, k), where that is faster."""

    def on(self, grid: Sequence[Theta]) -> FloatArray:
        """The columns, or their shift, at each point of a grid (n, points, k)."""
        return self.many(grid) if self.many else np.stack([(self.shift or self.columns)(one) for one in grid], axis=1)

    def grid(self) -> list[Theta]:
        """Parameters to try, the same number of steps to each; one empty tuple where there are none."""
        if self.tried is not None:
            return list(self.tried)
        if not self.parameters:
            return [()]
        usual = _POINTS_OF_CHANGE if self.change_point else _POINTS[min(len(self.parameters), len(_POINTS)) - 1]
        axes = [from_unit(parameter, np.linspace(0.0, 1.0, self.points or usual)) for parameter in self.parameters]
        return [tuple(map(float, theta)) for theta in product(*axes)]

    def on_bound(self, theta: Theta) -> bool:
        """Whether one of these parameters is on an end of its range: the data do not determine it."""
        return any(p.on_bound(value) for p, value in zip(self.parameters, theta, strict=True))

    def paid(self, base_columns: int, columns: int) -> float:
        """Parameters counted by the evidence for this many base columns and columns of its own."""
        linear = columns if self.kind == "term" else 0 if self.shift else columns - base_columns
        return linear + len(self.parameters) + int(self.change_point) + self.rarity


def from_unit(parameter: Parameter, at: FloatArray) -> FloatArray:
    """Values of a parameter for positions 0..1 between its bounds."""
    if parameter.log:
        return np.asarray(parameter.low * (parameter.high / parameter.low) ** at)
    return np.asarray(parameter.low + (parameter.high - parameter.low) * at)


def to_unit(parameter: Parameter, value: float) -> float:
    """Position 0..1 of a value between the bounds of its parameter."""
    if parameter.log:
        return float(np.log(value / parameter.low) / np.log(parameter.high / parameter.low))
    return (value - parameter.low) / (parameter.high - parameter.low)


def about(parameters: Sequence[Parameter], theta: Theta, moved: FloatArray) -> tuple[Theta, ...]:
    """These parameters, then those `moved` (n, parameters) from them by shares of their bounds, and kept within."""
    unit = np.array([to_unit(p, value) for p, value in zip(parameters, theta, strict=True)])
    tried = np.clip(unit + moved, 0.0, 1.0)
    values = [from_unit(p, own).tolist() for p, own in zip(parameters, tried.T, strict=True)]
    return (theta, *zip(*values, strict=True))


@dataclass(frozen=True)
class Problem:
    """A record of means, the columns of its present model and what else is known of the noise.

    Rows are complete: gaps are left out before, memory effects having seen the whole record. `white` (n,) scales the
    white variance of means over fewer samples. `statics` are isothermal records with columns of their own: that of the
    same gyro, then those of its sisters.
    Several runs are stacked with their times set days apart (a month, say): flicker is forgotten by then, and a walk
    leaves each run a constant of its own; where a gyro's turn-on scatters, each further run has a constant in `base`.
    """

    time_s: FloatArray
    y: FloatArray
    base: FloatArray
    interval_s: float
    statics: tuple[Record, ...] = ()
    white: FloatArray | None = field(default=None, repr=False)

    def records(self) -> tuple[Record, ...]:
        """The run with its base, then the isothermal records."""
        return (Record(self.time_s, self.y, self.base, self.white), *self.statics)

    @property
    def rows(self) -> int:
        """Rows of all records together."""
        return len(self.y) + sum(len(record.y) for record in self.statics)


def joint(problem: Problem, candidate: Candidate, theta: Theta) -> FloatArray:
    """Columns of base and candidate together (n, ...)."""
    own = candidate.columns(theta)
    return own if candidate.kind == "abscissa" else np.column_stack([problem.base, own])


def orthonormal(columns: FloatArray) -> FloatArray:
    """Basis (n, r) of the columns' span; columns that depend on the others give nothing."""
    return spanned(columns, np.ones(columns.shape[1]))[0]


def outside(basis: FloatArray, values: FloatArray) -> FloatArray:
    """The part of values (n,) or (n, m) that a basis (n, r) does not span."""
    inside = basis @ (basis.T @ values)
    return np.asarray(np.subtract(values, inside, out=inside))
