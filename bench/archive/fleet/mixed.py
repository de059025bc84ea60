"""A linear model with a random level for each group, by restricted likelihood: y = X beta + u[group] + e."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from bench.base import BoolArray, FloatArray, IntArray

Tested = tuple[float, float, float]
"""Value, standard error, p."""
_RANK = 1e-10
_LOW, _HIGH = 1e-2, 1e6
"""Search of the ratio of variances between and within groups, in parts of one over the mean size of a group."""
_SHOWN = 0.1
_STEP = 0.3
"""Of the logarithm of the ratio, for slopes of the likelihood."""


@dataclass(frozen=True, eq=False)
class _Solution:
    """At one ratio of the variances; `squares` of the residual, `fixed`: the rest of -2 ln L."""

    inverse: FloatArray
    projector: FloatArray
    beta: FloatArray
    squares: float
    fixed: float
    rank: int


@dataclass(frozen=True, eq=False)
class Columns:
    """A matrix (n, p) of few entries a row, as many in each: their columns (n, k) and values (n, k)."""

    place: IntArray
    value: FloatArray
    count: int

    def at(self, rows: BoolArray) -> Columns:
        """Some rows."""
        return Columns(self.place[rows], self.value[rows], self.count)

    def sums(self, group: IntArray, groups: int) -> FloatArray:
        """Sum of the rows of each group (groups, p)."""
        at = group[:, None] * self.count + self.place
        found = np.bincount(at.ravel(), self.value.ravel(), groups * self.count)
        return np.asarray(found, dtype=np.float64).reshape(groups, self.count)

    def product(self, y: FloatArray) -> FloatArray:
        """X'y (p,)."""
        found = np.bincount(self.place.ravel(), (self.value * y[:, None]).ravel(), self.count)
        return np.asarray(found, dtype=np.float64)

    def gram(self) -> FloatArray:
        """X'X (p, p)."""
        found = np.zeros(self.count**2)
        entries = range(self.place.shape[1])
        for one, other in itertools.product(entries, entries):
            at = self.place[:, one] * self.count + self.place[:, other]
            found += np.bincount(at, self.value[:, one] * self.value[:, other], found.size)
        return found.reshape(self.count, self.count)


@dataclass(frozen=True, eq=False)
class Mixed:
    """The fit to values y (n,) with columns (n, p) and the group of each row (n,)."""

    columns: Columns
    y: FloatArray
    lot: IntArray
    ratio: float
    """Variance between groups over that within."""

    @classmethod
    def of(cls, columns: Columns, y: FloatArray, lot: IntArray) -> Mixed:
        """The fit of the most likely ratio."""
        start = cls(columns, y, lot, 0.0)
        size = y.size / start._sizes.size
        low, high = np.log(_LOW / size), np.log(_HIGH / size)
        best = scipy.optimize.minimize_scalar(
            start._height, bounds=(low, high), method="bounded", options={"xatol": 0.01}
        )
        return cls(columns, y, lot, float(np.exp(best.x)))

    @cached_property
    def _sizes(self) -> FloatArray:
        return np.bincount(self.lot).astype(np.float64)

    @cached_property
    def _sums(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
        """X'X (p, p), X'y (p,), sums by group of X (groups, p) and y (groups,), and the columns' scale (p,)."""
        gram = self.columns.gram()
        scale = np.sqrt(np.where(np.diag(gram) > 0.0, np.diag(gram), 1.0))
        sums = self.columns.sums(self.lot, self._sizes.size)
        totals: FloatArray = np.bincount(self.lot, self.y).astype(np.float64)
        return gram, self.columns.product(self.y), sums, totals, scale

    def _solve(self, ratio: float) -> _Solution:
        gram, product, sums, totals, scale = self._sums
        shrink = ratio / (1.0 + self._sizes * ratio)
        normal = (gram - (sums.T * shrink) @ sums) / np.outer(scale, scale)
        right = (product - sums.T @ (shrink * totals)) / scale
        values, vectors = np.linalg.eigh(normal)
        kept = values > _RANK * values[-1]
        half = vectors[:, kept] / np.sqrt(values[kept])
        inverse = half @ half.T
        beta = inverse @ right
        squares = float(self.y @ self.y - shrink @ totals**2 - beta @ right)
        fixed = float(np.log(values[kept]).sum() + np.log1p(self._sizes * ratio).sum())
        own = vectors[:, kept]
        projector = (own @ own.T) * np.outer(1.0 / scale, scale)
        return _Solution(inverse / np.outer(scale, scale), projector, beta / scale, squares, fixed, int(kept.sum()))

    def _height(self, log_ratio: float) -> float:
        """-2 ln L, restricted, at a ratio; the variance within groups is profiled out."""
        one = self._solve(float(np.exp(log_ratio)))
        rows = self.y.size - one.rank
        return rows * float(np.log(max(one.squares, 1e-300) / rows)) + one.fixed

    @cached_property
    def _here(self) -> _Solution:
        return self._solve(self.ratio)

    @cached_property
    def _beside(self) -> tuple[_Solution, _Solution]:
        return self._solve(self.ratio * np.exp(-_STEP)), self._solve(self.ratio * np.exp(_STEP))

    @property
    def beta(self) -> FloatArray:
        """Coefficients (p,) of the columns, the shortest where they depend on each other."""
        return self._here.beta

    @cached_property
    def variance(self) -> float:
        """Within groups."""
        return self._here.squares / max(self.y.size - self._here.rank, 1)

    @cached_property
    def level(self) -> FloatArray:
        """Predicted level of each group (groups,), drawn towards zero by what is not known of it."""
        _, _, sums, totals, _ = self._sums
        level: FloatArray = self.ratio / (1.0 + self._sizes * self.ratio) * (totals - sums @ self.beta)
        return level

    def determined(self, along: FloatArray) -> bool:
        """Whether the data tell `along` @ beta."""
        size = float(np.linalg.norm(along))
        return size > 0.0 and float(np.linalg.norm(along - along @ self._here.projector)) <= 1e-6 * size

    @property
    def inverse(self) -> FloatArray:
        """Covariance (p, p) of beta over the variance within groups."""
        return self._here.inverse

    def tested(self, along: FloatArray) -> Tested | None:
        """Value, standard error and p of `along` (p,) @ beta; None where the data do not determine it."""
        if not self.determined(along):
            return None
        return self._judged(float(along @ self.beta), along, 0.0, 0.0)

    def predicted(self, whole: Mixed, group: int) -> Tested | None:
        """How far a group of `whole` is from what this fit, which has not seen it, predicts; None where it cannot."""
        own = whole.lot == group
        along = whole.columns.at(own).product(np.full(int(own.sum()), 1.0 / int(own.sum())))
        if not self.determined(along):
            return None
        return self._judged(float(whole.y[own].mean() - along @ self.beta), along, 1.0, 1.0 / int(own.sum()))

    def without(self, group: int) -> Mixed | None:
        """The fit to all other groups; None where there are fewer than two."""
        kept = self.lot != group
        if np.unique(self.lot[kept]).size < 2:
            return None
        return Mixed.of(self.columns.at(kept), self.y[kept], self.lot[kept])

    def apart(self) -> dict[int, Tested]:
        """How far the mean of each group is from the columns, its standard error and p; of groups that have rows."""
        _, _, sums, totals, _ = self._sums
        size = np.maximum(self._sizes, 1.0)
        mean = sums / size[:, None]
        taken = np.einsum("ij,jk,ik->i", mean, self._here.inverse, mean, optimize=True)
        left = np.where(self._sizes > 0.0, self.ratio + 1.0 / size - taken, 0.0)
        value = totals / size - mean @ self.beta
        error = np.sqrt(self.variance * np.maximum(left, 0.0))
        known = np.flatnonzero(left > 1e-6 * (self.ratio + 1.0 / size))
        p = 2.0 * scipy.special.ndtr(-np.abs(value[known]) / error[known])
        rows = zip(known.tolist(), value[known].tolist(), error[known].tolist(), p.tolist(), strict=True)
        return {group: (one, own, chance) for group, one, own, chance in rows}

    def _judged(self, value: float, along: FloatArray, ratios: float, extra: float) -> Tested | None:
        """Value, error and p: the variance is that of along @ beta, `ratios` of that between groups, and `extra`."""
        shares = [float(along @ one.inverse @ along) for one in (*self._beside, self._here)]
        steps = [ratios * self.ratio * float(np.exp(step)) for step in (-_STEP, _STEP, 0.0)]
        lower, upper, here = (self.variance * (one + two + extra) for one, two in zip(shares, steps, strict=True))
        if not here > 0.0:
            return None
        freedom = self._freedom_of(here, (upper - lower) / (2.0 * _STEP))
        error = float(np.sqrt(here))
        return value, error, float(2.0 * scipy.special.stdtr(freedom, -abs(value) / error))

    def _freedom_of(self, variance: float, slope: float) -> float:
        """Satterthwaite's, of a variance with its slope over the logarithm of the ratio.

        The uncertainty of the variances is read from the curvature of the likelihood.
        """
        rows = max(self.y.size - self._here.rank, 1)
        if self.ratio * self.y.size < _SHOWN * self._sizes.size:  # the groups show no variance between them
            return float(rows)
        lower, upper = self._beside
        heights = [one.squares / self.variance + one.fixed for one in (lower, self._here, upper)]
        curvature = (heights[0] - 2.0 * heights[1] + heights[2]) / _STEP**2
        cross = -(upper.squares - lower.squares) / (2.0 * _STEP) / self.variance
        hessian = np.array([[float(rows), cross], [cross, max(curvature, 1e-3 + cross**2 / rows)]])
        gradient = np.array([variance, slope])
        spread = float(gradient @ np.linalg.solve(0.5 * hessian, gradient))
        return float(np.clip(2.0 * variance**2 / max(spread, 1e-300), 1.0, rows))
