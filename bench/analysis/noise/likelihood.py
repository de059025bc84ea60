"""Likelihood of coloured noise beside a linear model, over a lattice of noise ratios that keeps its whiteners.

A record is data whose mean is a linear model: y = X beta + nu, nu ~ N(0, sigma^2 C(rho)), C as in `whitening`. The
ratios rho are searched on a lattice down to eighths of a decade (finer than their uncertainty), which lets every
candidate of a diagnosis share the whiteners. An isothermal record is one more record of the same noise.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from copy import copy
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from typing import NamedTuple

import numpy as np
import scipy

from bench.analysis.noise.whitening import Ratios, Recursion, Whitener
from bench.base import FloatArray

_PER_DECADE = 16
_LOWEST, _HIGHEST = -3 * _PER_DECADE, 3 * _PER_DECADE
_ZERO = _LOWEST - _PER_DECADE  # lattice index that stands for a ratio of exactly zero
_PLAIN = 1e-7  # part of a column's square beside those before it from which on the normal equations are solved
_MOST_KEPT = 1000  # whiteners to an axis, half a megabyte each for a thousand rows; one diagnosis needs some 500
Point = tuple[int, int]
STEPS = (8, 4, 2)
"""Steps of a descent over the lattice, in sixteenths of a decade."""


@dataclass(frozen=True)
class Record:
    """Means y (n,) [deg/h] at mid times (n,) [s] and the columns X (n, p) that may explain them.

    `white` (n,) scales the white variance of means over fewer samples than the others (1 = full).
    """

    time_s: FloatArray
    y: FloatArray
    X: FloatArray
    white: FloatArray | None = None

    def steps(self, interval_s: float) -> FloatArray:
        """Differences (m,) of neighbouring means over `interval_s`: nearly all of them is white noise."""
        return np.asarray(np.diff(self.y)[np.diff(self.time_s) < 1.5 * interval_s])

    def fast_variance(self, interval_s: float) -> float:
        """Variance of nearly white noise of one mean, from these differences."""
        return 0.5 * float(np.mean(self.steps(interval_s) ** 2))


class Gls(NamedTuple):
    """Generalised least squares: coefficients (p,), covariance (p, p), square sum of the whitened residual (n,)."""

    beta: FloatArray
    covariance: FloatArray
    rss: float
    residual: FloatArray


def gls(X: FloatArray, y: FloatArray, whitener: Whitener, sigma2: float | None = None) -> Gls:
    """Generalised least squares of y (n,) on X (n, p); without `sigma2` the residual says how large the noise is.

    Columns may be of any scale; directions that the data do not determine get the shortest solution and no variance.
    """
    white_x, white_y = whitener.apply(X), whitener.apply(y)
    scale = np.linalg.norm(white_x, axis=0)
    scale[scale == 0.0] = 1.0
    u, s, vt = np.linalg.svd(white_x / scale, full_matrices=False)
    rank = int(np.sum(s > s[0] * 1e-12)) if len(s) else 0
    u, s, vt = u[:, :rank], s[:rank], vt[:rank]
    beta = (vt.T / s) @ (u.T @ white_y) / scale
    residual = white_y - u @ (u.T @ white_y)
    rss = float(residual @ residual)
    variance = rss / max(1, len(y) - rank) if sigma2 is None else sigma2
    half = (vt.T / s) / scale[:, None]
    return Gls(beta, variance * (half @ half.T), rss, residual)


class _Axis:
    """Rows of a record as far as its whiteners depend on them, and those made so far."""

    def __init__(self, time_s: FloatArray, interval_s: float, white: FloatArray | None) -> None:
        self._recursion = Recursion(time_s, interval_s, white)
        self._kept: dict[Point, Whitener] = {}

    def at(self, points: Sequence[Point], lattice: NoiseLattice) -> list[Whitener]:
        """The whiteners at these points, missing ones made; where there are too many, others are forgotten."""
        wanted = list(dict.fromkeys(point for point in points if point not in self._kept))
        if wanted and len(self._kept) + len(wanted) > _MOST_KEPT:
            for other in set(self._kept).difference(points):
                del self._kept[other]
        if wanted:
            made = self._recursion.whiteners([lattice.ratios(point) for point in wanted])
            self._kept.update(zip(wanted, made, strict=True))
        return [self._kept[point] for point in points]


@lru_cache(maxsize=4)
def _axis(times: bytes, white: bytes, interval_s: float) -> _Axis:
    """Rows at these times: records of one profile share their whiteners."""
    return _Axis(np.frombuffer(times), interval_s, np.frombuffer(white) if white else None)


class NoiseLattice:
    """Whiteners of a set of records at the points of a logarithmic lattice of ratios, made once and kept."""

    def __init__(self, records: Sequence[Record], interval_s: float) -> None:
        white = [b"" if record.white is None else record.white.tobytes() for record in records]
        pairs = zip(records, white, strict=True)
        self._axes = tuple(_axis(record.time_s.tobytes(), own, interval_s) for record, own in pairs)
        self.interval_s = interval_s

    def ratios(self, point: Point) -> Ratios:
        """The ratios at a lattice point; white variance goes with 1/interval, so do the ratios' natural units."""
        flicker, walk = (0.0 if i <= _ZERO else 10.0 ** (i / _PER_DECADE) for i in point)
        unit = self.interval_s / 30.0
        return Ratios(flicker * unit, walk * unit)

    def white(self) -> tuple[Whitener, ...]:
        """Whiteners of every record where there is neither flicker nor walk."""
        return self.at([(_ZERO, _ZERO)])[0]

    def at(self, points: Iterable[Point]) -> list[tuple[Whitener, ...]]:
        """Whiteners of every record at each of the points."""
        points = list(points)
        return list(zip(*(axis.at(points, self) for axis in self._axes), strict=True))

    def way(self, point: Point) -> Whitener:
        """The whitener of the first record, the fitted rows, at a point."""
        return self.at([point])[0][0]

    def part(self, first: int, count: int) -> NoiseLattice:
        """The same lattice seen by some of its records alone."""
        seen = copy(self)
        seen._axes = self._axes[first : first + count]
        return seen

    @staticmethod
    def coarse(step: int = _PER_DECADE) -> list[Point]:
        """Points over the whole lattice, zero included, `step` sixteenths of a decade apart."""
        axis = [_ZERO, *range(_LOWEST, _HIGHEST + 1, step)]
        return list(product(axis, axis))

    @staticmethod
    def around(point: Point, step: int) -> list[Point]:
        """The up to nine points one step about a point, itself included."""
        flicker, walk = (sorted({moved(i, d) for d in (-step, 0, step)}) for i in point)
        return list(product(flicker, walk))


def moved(index: int, step: int) -> int:
    """The index after a step along an axis of the lattice, whose lower neighbour is zero."""
    if index <= _ZERO:
        return _LOWEST if step > 0 else _ZERO
    moved = index + step
    return _ZERO if moved < _LOWEST else min(moved, _HIGHEST)


class Surface:
    """-2 ln L over the lattice, each point computed once; `measure` tells it and the sigma^2 of a point."""

    def __init__(self, lattice: NoiseLattice, measure: Callable[[Point], tuple[float, float]]) -> None:
        self.lattice, self.measure = lattice, measure
        self.known: dict[Point, tuple[float, float]] = {}

    @classmethod
    def of(cls, records: Sequence[Record], lattice: NoiseLattice, restricted: bool) -> Surface:
        """Of records, each beside its own columns."""
        return cls(lattice, lambda point: minus2logl(records, lattice.at([point])[0], restricted))

    def visit(self, points: Iterable[Point]) -> None:
        """Compute the points that are not known yet."""
        new = [point for point in dict.fromkeys(points) if point not in self.known]
        self.lattice.at(new)  # several at once are made faster
        for point in new:
            self.known[point] = self.measure(point)

    def descend(self, start: Point, steps: Sequence[int] = STEPS) -> Point:
        """The lowest point reached from a start with ever finer steps; only the finest are tried aslant, too."""
        best = start
        for step in steps:
            while True:
                around = NoiseLattice.around(best, step)
                if step != steps[-1]:
                    around = [point for point in around if point[0] == best[0] or point[1] == best[1]]
                self.visit(around)
                lowest = min(around, key=self.height)
                if self.height(lowest) >= self.height(best):
                    break
                best = lowest
        return best

    def height(self, point: Point) -> float:
        """-2 ln L at a visited point."""
        return self.known[point][0]

    def search(self) -> Point:
        """The lowest point of the whole lattice."""
        coarse = NoiseLattice.coarse()
        self.visit(coarse)
        return self.descend(min(coarse, key=self.height))

    def region(self, best: Point, within: float, step: int = 4) -> list[Point]:
        """All points connected with the best whose -2 ln L is at most `within` above it."""
        limit = self.known[best][0] + within
        seen, edge = {best}, [best]
        while edge:
            around = {p for point in edge for p in self.lattice.around(point, step)} - seen
            self.visit(around)
            seen |= around
            edge = [p for p in around if self.known[p][0] <= limit]
        return [p for p in seen if self.known[p][0] <= limit]


def spanned(white: FloatArray, scale: FloatArray) -> tuple[FloatArray, float]:
    """Basis (n, r) of whitened columns (n, p), and ln |X' C^-1 X| of the columns divided by `scale` (p,).

    What depends on other columns to 1e-10 is left out of both.
    """
    norm = np.linalg.norm(white, axis=0)
    kept = norm > 0.0
    if not kept.any():
        return white[:, :0], 0.0
    scaled = white[:, kept] / norm[kept]
    longer = float(np.log(norm[kept] / scale[kept]).sum())
    if scaled.shape[1] == 1:
        return scaled, 2.0 * longer
    if (once := coordinates(scaled)) is not None:  # twice through the normal equations: orthonormal to rounding
        first = scaled @ once.T
        if (twice := coordinates(first)) is not None:
            shorter = float(np.log(np.diagonal(once) * np.diagonal(twice)).sum())
            return first @ twice.T, 2.0 * (longer - shorter)
    u, s, _ = np.linalg.svd(scaled, full_matrices=False)
    rank = int(np.sum(s > s[0] * 1e-10))
    return u[:, :rank], 2.0 * (float(np.log(s[:rank]).sum()) + longer)


def coordinates(white: FloatArray) -> FloatArray | None:
    """Matrix M (p, p) by which M X' r are coordinates of r in an orthonormal basis of columns X (n, p).

    From the normal equations, a third of the work of the basis; None where the columns depend on each other too much.
    """
    gram = white.T @ white
    norm = np.sqrt(np.diagonal(gram))
    if not len(norm) or not np.all(norm > 0.0):
        return None
    try:
        lower = np.linalg.cholesky(gram / (norm * norm[:, None]))
    except np.linalg.LinAlgError:
        return None
    inverse: FloatArray = scipy.linalg.lapack.dtrtri(lower.T)[0].T / norm
    return inverse if float(np.diagonal(lower).min(initial=1.0)) ** 2 > _PLAIN else None


def beside(white: FloatArray, response: FloatArray) -> tuple[FloatArray, float]:
    """What of a response (n,) lies outside whitened columns X (n, p), and ln |X'X|."""
    if white.shape[1] == 1 and (own := white[:, 0]).any():
        power = float(own @ own)
        return response - own * (float(own @ response) / power), float(np.log(power))
    inverse = coordinates(white)
    if inverse is None:
        basis, volume = spanned(white, np.ones(white.shape[1]))
        rest = response - basis @ (basis.T @ response)
    else:
        rest, volume = response, -2.0 * float(np.log(np.diagonal(inverse)).sum())
        for _ in range(2):  # the second step takes away the rounding of the first
            rest = rest - white @ (inverse.T @ (inverse @ (white.T @ rest)))
    return rest, volume


def minus2logl(records: Sequence[Record], ways: Sequence[Whitener], restricted: bool) -> tuple[float, float]:
    """-2 ln L without constants, beta and sigma^2 profiled out, and that sigma^2 [(deg/h)^2]."""
    rss, freedom, log_det = 0.0, 0, 0.0
    for record, way in zip(records, ways, strict=True):
        white = way.apply(np.column_stack([record.X, record.y]))
        basis, volume = spanned(white[:, :-1], np.linalg.norm(record.X, axis=0))
        white_y = white[:, -1] - basis @ (basis.T @ white[:, -1])
        log_det += volume if restricted else 0.0
        rss += float(white_y @ white_y)
        freedom += len(record.y) - (basis.shape[1] if restricted else 0)
        log_det += way.log_det
    sigma2 = max(rss, 1e-300) / freedom
    return freedom * float(np.log(sigma2)) + log_det, sigma2
