"""Least squares as every fit uses it: scaled QR with its condition, block sandwich, variable projection.

BLAS runs on one thread: on small matrices two threads cost up to six times the wall time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from typing import Any

import numpy as np
import scipy
from threadpoolctl import ThreadpoolController

from bench.analysis.effects.base import Parameter
from bench.base import FloatArray, InputError, IntArray

_TRIAL_CONDITION = 1e10


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """BLAS on one thread inside."""
    with _controller().limit(limits=1, user_api="blas"):
        yield


@lru_cache(maxsize=1)
def _controller() -> ThreadpoolController:
    return ThreadpoolController()


@dataclass(frozen=True, eq=False)
class Solution:
    """Weighted least squares of y (n,) on columns (n, p): `beta` (p,), `residual` (n,) unweighted, `rss` weighted.

    `q` (n, p) and `r` (p, p) factor the weighted columns after each was scaled to norm one by `scale` (p,).
    """

    beta: FloatArray
    residual: FloatArray
    rss: float
    condition: float
    q: FloatArray
    r: FloatArray
    scale: FloatArray

    def pseudo_inverse(self, weights: FloatArray) -> FloatArray:
        """Matrix (p, n) that turns y into beta."""
        inverse: FloatArray = scipy.linalg.solve_triangular(self.r, self.q.T) / self.scale[:, None]
        return inverse * np.sqrt(weights)


def solve(columns: FloatArray, y: FloatArray, weights: FloatArray) -> Solution:
    """Least squares by QR of normalised columns; a rank-deficient matrix has `condition` inf and no solution."""
    root = np.sqrt(weights)
    weighted = columns * root[:, None]
    scale = np.linalg.norm(weighted, axis=0)
    if len(y) < columns.shape[1] or np.any(scale == 0.0):
        return _unsolved(columns)
    q, r = scipy.linalg.qr(weighted / scale, mode="economic")
    spectrum = scipy.linalg.svdvals(r)
    if not spectrum[-1] > spectrum[0] * np.finfo(float).eps:
        return _unsolved(columns)
    beta = scipy.linalg.solve_triangular(r, q.T @ (root * y)) / scale
    residual = y - columns @ beta
    rss = float(np.sum(weights * residual**2))
    return Solution(beta, residual, rss, float(spectrum[0] / spectrum[-1]), q, r, scale)


def projected(columns: FloatArray, y: FloatArray, weights: FloatArray) -> FloatArray:
    """Weighted residual (n,) of y beside what the columns span, full rank or not (trial parameters may lose it)."""
    root = np.sqrt(weights)
    solution = solve(columns, y, weights)
    if solution.condition < _TRIAL_CONDITION:
        return root * solution.residual
    weighted = columns * root[:, None]
    scale = np.linalg.norm(weighted, axis=0)
    u, s, _ = scipy.linalg.svd(weighted / np.where(scale > 0.0, scale, 1.0), full_matrices=False)
    u = u[:, s > s[0] / _TRIAL_CONDITION]
    residual: FloatArray = root * y - u @ (u.T @ (root * y))
    return residual


def _unsolved(columns: FloatArray) -> Solution:
    nothing = np.full(columns.shape[1], np.nan)
    return Solution(nothing, np.full(len(columns), np.nan), np.inf, np.inf, columns[:, :0], columns[:0, :0], nothing)


def dependent_column(columns: FloatArray, weights: FloatArray) -> int:
    """Index of the column that the others explain best (to name the culprit of a rank deficiency)."""
    weighted = columns * np.sqrt(weights)[:, None]
    scale = np.linalg.norm(weighted, axis=0)
    if np.any(scale == 0.0):
        return int(np.argmin(scale))
    _, _, pivots = scipy.linalg.qr(weighted / scale, mode="economic", pivoting=True)
    return int(pivots[-1])


def sandwich(jacobian_inverse: FloatArray, residual: FloatArray, blocks: IntArray) -> FloatArray:
    """Covariance (p, p) of P y, P (p, n), from sums of the scores over contiguous blocks (n,): residuals may correlate.

    Source: K.-Y. Liang, S. L. Zeger, Biometrika 73 (1986) 13; factors G/(G-1) for G blocks and n/(n-p) for the fit.
    """
    scores = jacobian_inverse * residual
    _, label = np.unique(blocks, return_inverse=True)
    sums = np.zeros((scores.shape[0], int(label.max()) + 1))
    np.add.at(sums.T, label, scores.T)
    groups, (p, n) = sums.shape[1], scores.shape
    factor = groups / max(groups - 1, 1) * n / max(n - p, 1)
    covariance: FloatArray = factor * (sums @ sums.T)
    return covariance


def left_out_rms(solution: Solution, weights: FloatArray, blocks: IntArray) -> float:
    """RMS of the rows of each block predicted from all others, without refitting; inf where a block is indispensable.

    The residual of a left-out block is (I - Q_b Q_b')^-1 r_b (exact for fixed columns).
    """
    residual = left_out(solution, weights, blocks)
    if not np.all(np.isfinite(residual)):
        return np.inf
    return float(np.sqrt(np.sum(weights * residual**2) / np.sum(weights)))


def left_out(solution: Solution, weights: FloatArray, blocks: IntArray) -> FloatArray:
    """Residual (n,) of the rows of each block predicted from all others; NaN in blocks that are indispensable."""
    residual = np.full(len(blocks), np.nan)
    if not np.isfinite(solution.condition):
        return residual
    root = np.sqrt(weights)
    for block in np.unique(blocks):
        rows = blocks == block
        q, r = solution.q[rows], solution.residual[rows] * root[rows]
        if scipy.linalg.svdvals(np.eye(q.shape[1]) - q.T @ q)[-1] >= 1e-9:
            residual[rows] = np.linalg.solve(np.eye(len(r)) - q @ q.T, r) / root[rows]
    return residual


Objective = Callable[[FloatArray], FloatArray]
"""Parameters (m,) in their units to weighted residuals (n,) of the linear part solved for them."""

_GRID = (16, 8, 5, 4)
_PLACES = 65  # of a change point, over its range


def search(residual: Objective, parameters: Sequence[Parameter], start: FloatArray | None = None) -> FloatArray:
    """Parameters (m,) that minimise the square sum within their bounds: a grid first (or `start`), then refined.

    Trust-region least squares refines smooth parameters; a simplex follows, because widths and thresholds are not.
    Source: G. H. Golub, V. Pereyra, SIAM J. Numer. Anal. 10 (1973) 413.
    """
    units = _Units(parameters)

    def inner(u: FloatArray) -> FloatArray:
        return residual(units.values(np.clip(u, 0.0, 1.0)))

    def height(u: FloatArray) -> float:
        value = float(np.sum(inner(u) ** 2))
        return value if np.isfinite(value) else np.finfo(float).max

    seeds = [units.unit(start)] if start is not None else sorted(_grid(units, parameters), key=height)[:2]
    best = min((_refined(inner, height, seed) for seed in seeds), key=height)
    for number, parameter in enumerate(parameters if start is None else ()):
        if parameter.change_point:
            best = _elsewhere(inner, height, best, number)
    return units.values(best)


def _elsewhere(inner: Objective, height: Callable[[FloatArray], float], best: FloatArray, number: int) -> FloatArray:
    """The best where one place moves over its whole range: it has a minimum wherever the model's curve is stiff."""
    tried = [np.where(np.arange(best.size) == number, at, best) for at in np.linspace(0.0, 1.0, _PLACES)]
    heights = np.array([np.inf, *map(height, tried), np.inf])
    minima = np.flatnonzero((heights[1:-1] <= heights[:-2]) & (heights[1:-1] < heights[2:]))
    lowest = sorted(minima.tolist(), key=lambda row: heights[row + 1])[:2]
    return min((best, *(_refined(inner, height, tried[row]) for row in lowest)), key=height)


def _refined(inner: Objective, height: Callable[[FloatArray], float], seed: FloatArray) -> FloatArray:
    best = seed
    if np.all(np.isfinite(inner(seed))):
        inside, step = np.clip(seed, 1e-6, 1 - 1e-6), np.full(seed.size, 1e-4)
        try:
            solved = scipy.optimize.least_squares(
                inner, inside, bounds=(0.0, 1.0), x_scale=0.1, diff_step=step, max_nfev=60
            )
            best = min((seed, solved.x), key=height)
        except ValueError:  # a step to where the linear part is singular
            best = seed
    options: Any = {
        "xatol": 1e-6,
        "fatol": 1e-10 * height(best),
        "maxfev": 80 * seed.size,
        "initial_simplex": _simplex(best),
    }
    polished = scipy.optimize.minimize(
        height, best, method="Nelder-Mead", bounds=[(0.0, 1.0)] * seed.size, options=options
    )
    refined: FloatArray = min((best, polished.x), key=height)
    return refined


def _simplex(at: FloatArray) -> FloatArray:
    steps = np.where(at > 0.5, -0.02, 0.02)
    return np.vstack([at, at + np.diag(steps)])


def _grid(units: _Units, parameters: Sequence[Parameter]) -> list[FloatArray]:
    start = units.unit(np.array([parameter.start for parameter in parameters]))
    if len(parameters) > len(_GRID):  # one at a time from the start values
        axis = np.linspace(0.0, 1.0, 12)
        moved = [np.where(np.arange(start.size) == i, u, start) for i in range(start.size) for u in axis]
        return [start, *moved]
    axis = (np.arange(_GRID[len(parameters) - 1]) + 0.5) / _GRID[len(parameters) - 1]
    return [start, *(np.array(point) for point in product(axis, repeat=len(parameters)))]


class _Units:
    """Parameters in their units to and from [0, 1], logarithmic where they say so."""

    def __init__(self, parameters: Sequence[Parameter]) -> None:
        self._log = np.array([parameter.log for parameter in parameters])
        low, high = (np.array([getattr(p, end) for p in parameters]) for end in ("low", "high"))
        if np.any(low >= high) or np.any(self._log & (low <= 0)):
            raise InputError("a nonlinear parameter needs low < high, and low > 0 on a logarithmic scale")
        self._low, self._high = self._forward(low), self._forward(high)

    def _forward(self, values: FloatArray) -> FloatArray:
        return np.where(self._log, np.log(np.where(self._log, values, 1.0)), values)

    def unit(self, values: FloatArray) -> FloatArray:
        scaled: FloatArray = np.clip((self._forward(values) - self._low) / (self._high - self._low), 0.0, 1.0)
        return scaled

    def values(self, unit: FloatArray) -> FloatArray:
        plain = self._low + unit * (self._high - self._low)
        return np.where(self._log, np.exp(np.where(self._log, plain, 0.0)), plain)
