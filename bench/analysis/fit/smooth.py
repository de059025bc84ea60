"""Splines from sums in cells: any number of intervals that divides them, any ends, any smoothing, and how to choose it.

Source of the criteria: P. Craven, G. Wahba, Numer. Math. 31 (1979) 377 (GCV); S. N. Wood, J. R. Stat. Soc. B 73 (2011)
3 (REML). Both count every sample as new information and follow correlated noise; leaving blocks out does not.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
import scipy

from bench.analysis.effects.base import Scale
from bench.analysis.effects.spline import Spline
from bench.analysis.fit.cells import POWERS, Cells
from bench.analysis.fit.normal import Normal, Solved, held_out_rms, solve
from bench.base import FloatArray, InputError

Criterion = Literal["gcv", "reml", "blocks"]
_DECADES = (-10.0, 6.0)
"""Where the smoothing is searched, relative to the ratio of the traces of Gram and roughness."""


def spline_normal(cells: Cells, sums: FloatArray, intervals: int, ends: str) -> Normal:
    """Quadratic form of [constant, columns of the `spline` effect] of sums (..., 12 cells)."""
    joined = cells.joined(sums, intervals)
    pieces = _pieces(intervals, ends)
    hankel = joined[..., np.add.outer(np.arange(4), np.arange(4))]
    flat = pieces.reshape(4 * intervals, -1)
    inner = (hankel @ pieces).reshape(*sums.shape[:-1], *flat.shape)
    size = flat.shape[1]
    start = np.zeros(size)
    start[0] = cells.offset
    return Normal(
        gram=flat.T @ inner,
        right=joined[..., POWERS:-1].reshape(*sums.shape[:-1], -1) @ flat,
        square=joined[..., -1].sum(axis=-1),
        rows=joined[..., 0].sum(axis=-1),
        back=np.eye(size),
        start=start,
    )


def choose_intervals(
    cells: Cells, groups: FloatArray, candidates: tuple[int, ...], ends: str
) -> tuple[int, FloatArray]:
    """The number of intervals with the least RMS on groups (g, 12 cells) left out in turn, and the RMS of each."""
    errors = np.array([held_out_rms(spline_normal(cells, groups, m, ends)) for m in candidates])
    if not np.any(np.isfinite(errors)):
        raise InputError("spline: the rows determine none of its variants; record a longer or wider run")
    return candidates[int(np.argmin(errors))], errors


@dataclass(frozen=True, eq=False)
class Smoothed:
    """A penalised spline: `smoothing` weighs the integral of the squared second derivative [degC^3]."""

    solved: Solved
    smoothing: float
    freedom: float
    """Effective number of coefficients."""
    criterion: float


@dataclass(frozen=True, eq=False)
class Smoother:
    """Penalised splines of one basis for all smoothings: one eigenvalue problem, then a sum each.

    In the basis `vectors` (p, p) the Gram matrix is the identity and the roughness is diagonal, `roughness` (p,).
    """

    form: Normal
    penalty: FloatArray
    vectors: FloatArray
    roughness: FloatArray
    right: FloatArray
    scale: float

    @classmethod
    def of(cls, cells: Cells, sums: FloatArray, intervals: int, ends: str) -> Smoother:
        """Of sums (12 cells,); InputError where the rows do not determine the unpenalised spline."""
        form = spline_normal(cells, sums, intervals, ends)
        penalty = roughness(cells, intervals, ends)
        try:
            values, vectors = scipy.linalg.eigh(penalty, form.gram)
        except scipy.linalg.LinAlgError:
            raise InputError("spline: the rows do not reach every interval; use fewer intervals") from None
        # Constants (and lines, with free or natural ends) are not rough at all: rounding is not roughness.
        values = np.where(values > 1e-10 * values[-1], values, 0.0)
        scale = float(np.trace(form.gram) / np.trace(penalty))
        return cls(form, penalty, vectors, values, vectors.T @ form.right, scale)

    def at(self, smoothing: float, criterion: float = np.nan) -> Smoothed:
        """The spline of one smoothing."""
        shrink = 1.0 / (1.0 + smoothing * self.roughness)
        inner = self.vectors @ (shrink * self.right)
        rss = float(self.form.error(inner))
        solved = Solved(self.form.model(inner), inner, rss, float(self.form.rows), np.nan)
        return Smoothed(solved, smoothing, float(shrink.sum()), criterion)

    def gcv(self, smoothing: float) -> float:
        """Generalised cross-validation n RSS / (n - freedom)^2 [deg^2/h^2]."""
        smoothed = self.at(smoothing)
        n = float(self.form.rows)
        return n * smoothed.solved.rss / (n - smoothed.freedom) ** 2

    def reml(self, smoothing: float) -> float:
        """Restricted likelihood, -2 log of it less constants, with the variance profiled out."""
        own = smoothing * self.roughness
        rough = own > 0.0
        free = float(self.form.rows) - np.count_nonzero(~rough)
        # RSS + penalty of the minimum: y'y - right' (I + own)^-1 right
        least = float(self.form.square) - float(np.sum(self.right**2 / (1.0 + own)))
        determinants = np.sum(np.log1p(own)) - np.sum(np.log(own[rough]))
        return float(free * np.log(max(least, np.finfo(float).tiny) / free) + determinants)

    def choose(self, criterion: Criterion, groups: Normal | None = None) -> Smoothed:
        """The smoothing with the least criterion; `blocks` needs the form of the groups that are left out in turn."""
        low, high = (np.log(self.scale) + np.log(10.0) * d for d in _DECADES)
        if criterion == "blocks":
            if groups is None:
                raise InputError("smoothing by blocks needs the blocks")
            return self._by_blocks(groups, low, high)
        score: Callable[[float], float] = self.gcv if criterion == "gcv" else self.reml
        grid = np.linspace(low, high, 33)
        values = [score(float(np.exp(at))) for at in grid]
        best = int(np.argmin(values))
        bounds = grid[max(best - 1, 0)], grid[min(best + 1, 32)]
        least = scipy.optimize.minimize_scalar(lambda at: score(float(np.exp(at))), bounds=bounds, method="bounded")
        return self.at(float(np.exp(least.x)), float(least.fun))

    def _by_blocks(self, groups: Normal, low: float, high: float) -> Smoothed:
        def score(at: float) -> float:
            return held_out_rms(groups, np.exp(at) * self.penalty)

        grid = np.linspace(low, high, 9)
        for _ in range(2):  # coarse, then between the neighbours of the best
            values = [score(float(at)) for at in grid]
            best = int(np.argmin(values))
            at, value = float(grid[best]), values[best]
            grid = np.linspace(grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)], 7)[1:-1]
        return self.at(float(np.exp(at)), value)


def roughness(cells: Cells, intervals: int, ends: str) -> FloatArray:
    """Matrix (p, p) of the integral of the squared second derivative over temperature [1/degC^3]."""
    width = (cells.high - cells.low) / intervals
    second = np.zeros((2, 4))
    second[0, 2], second[1, 3] = 2.0, 6.0  # d2/du2 of u^2 and u^3: [1, u]
    inner = second.T @ np.diag([2.0, 2.0 / 3.0]) @ second  # integral over u in [-1, 1]
    pieces = _pieces(intervals, ends)
    flat = pieces.reshape(4 * intervals, -1)
    matrix: FloatArray = flat.T @ (inner @ pieces).reshape(flat.shape) * (2.0 / width) ** 3
    return 0.5 * (matrix + matrix.T)


def solve_spline(cells: Cells, sums: FloatArray, intervals: int, ends: str = "natural") -> Solved:
    """Least-squares spline of sums (12 cells,): coefficients of [constant, columns of the `spline` effect]."""
    return solve(spline_normal(cells, sums, intervals, ends))


@lru_cache(maxsize=64)
def _pieces(m: int, ends: str) -> FloatArray:
    """Coefficients (m, 4, 1 + k) of u^0..u^3 on every interval, of the constant and of the basis of a spline."""
    unit = Spline(m, ends, Scale(0.0, float(m)))
    powers = unit.physical().matrix.reshape(m, 4, -1)  # of (v - knot)^j, v - knot = (1 + u) / 2
    half = np.array([[1, 0.5, 0.25, 0.125], [0, 0.5, 0.5, 0.375], [0, 0, 0.25, 0.375], [0, 0, 0, 0.125]])
    out: FloatArray = half @ powers
    out.flags.writeable = False
    return out
