"""One candidate's best parameters and noise, continuously, and how well the data fix the parameters."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np
import scipy

from bench.analysis.diagnosis.candidates import (
    Candidate,
    Problem,
    Theta,
    from_unit,
    joint,
    outside,
    to_unit,
)
from bench.analysis.diagnosis.descent import descend
from bench.analysis.noise.likelihood import STEPS, NoiseLattice, Point, Surface, beside, gls, spanned
from bench.analysis.noise.probability import CHI2_95, JUMP_95
from bench.analysis.noise.whitening import Whitener
from bench.base import BoolArray, FloatArray

_STARTS = 4
_DIFFERENCE = 2e-3  # of a parameter's range, for slopes
_MOVED = 0.5  # of -2 ln L: a search that gains more has seen where to go
_LEAST = 0.1  # of -2 ln L, for which one goes on
_NEAR = 0.25  # of a step of the grid: range searched first where the parameter was searched before
_CORNER = 0.02  # of a parameter's range: size of the first simplex


@dataclass(frozen=True)
class Interval:
    """A parameter with its 95 % profile-likelihood interval, cut at the bounds of the search."""

    value: float
    low: float
    high: float
    unit: str


@dataclass(frozen=True)
class Start:
    """A grid point, the noise point where it does best, and its -2 ln L there."""

    theta: Theta
    point: Point
    height: float


class Whitened(NamedTuple):
    """The problem at one noise: basis of the base and its ln |X' C^-1 X|, the response and its rest beside the base.

    Of the isothermal records the bases, what these leave and its square sum. Of all records ln |C|, with ln |X' C^-1 X|
    of the isothermal ones, and the degrees of freedom beside base and isothermal trends.
    """

    basis: FloatArray
    volume: float
    white: FloatArray
    residual: FloatArray
    trends: tuple[FloatArray, ...]
    quiet: tuple[FloatArray, ...]
    still: float
    log_det: float
    freedom: int

    def height(self, rest: FloatArray, volume: float) -> tuple[float, float]:
        """-2 ln L and sigma^2 of a whitened rest (n,) beside columns of a volume ln |X' C^-1 X|."""
        sigma2 = max((float(rest @ rest) + self.still) / self.freedom, 1e-300)
        return self.freedom * float(np.log(sigma2)) + self.log_det + volume, sigma2


class Seen(NamedTuple):
    """Base and candidate at one noise: -2 ln L, sigma^2, the whitened rest (n,) and the part ln |X' C^-1 X| of it."""

    height: float
    sigma2: float
    rest: FloatArray
    volume: float


class Refiner:
    """-2 ln L (restricted, see `evidence`) of candidates of one problem at any parameters and lattice points; what a
    noise point needs is kept.
    """

    def __init__(self, problem: Problem, lattice: NoiseLattice) -> None:
        """Shares the whiteners of the lattice."""
        self.problem, self.lattice = problem, lattice
        self._kept: dict[Point, Whitened] = {}
        self._last: tuple[FloatArray, BoolArray, float] | None = None

    def height(self, candidate: Candidate, theta: Theta, point: Point) -> float:
        """-2 ln L of base and candidate."""
        return self._measured(candidate, theta, point)[0]

    def sigma2(self, candidate: Candidate, theta: Theta, point: Point) -> float:
        """White variance of one mean that goes with `height` [(deg/h)^2]."""
        return self._measured(candidate, theta, point)[1]

    @property
    def alone(self) -> Surface:
        """The same of the base without a candidate over the noise."""

        def measure(point: Point) -> tuple[float, float]:
            at = self.at(point)
            return at.height(at.residual, at.volume)

        return Surface(self.lattice, measure)

    def surface(self, candidate: Candidate, theta: Theta) -> Surface:
        """`height` and `sigma2` over the noise, the parameters fixed."""
        own = candidate.columns(theta)
        fixed = replace(candidate, columns=lambda _: own)
        return Surface(self.lattice, lambda point: self._measured(fixed, theta, point))

    def _measured(self, candidate: Candidate, theta: Theta, point: Point) -> tuple[float, float]:
        """`height` and `sigma2`."""
        seen = self._seen(candidate, [theta], point)[0]
        return seen.height, seen.sigma2

    def _seen(self, candidate: Candidate, thetas: Sequence[Theta], point: Point) -> list[Seen]:
        """Base and candidate at some parameters, which are whitened at once."""
        at, own = self.at(point), [candidate.columns(theta) for theta in thetas]
        white = np.split(self.lattice.way(point).apply(np.column_stack(own)), len(own), axis=1)
        found = []
        for mine, columns in zip(own, white, strict=True):
            if candidate.still is not None:
                found.append(self._alike(mine, candidate.still, at, point))
                continue
            rest, volume, kept = self._left(candidate, columns, at)
            volume += (at if candidate.kind == "term" else self._flat).volume - self._flat_volume(candidate, mine, kept)
            found.append(Seen(*at.height(rest, volume), rest, volume))
        return found

    def _alike(self, columns: FloatArray, still: FloatArray, at: Whitened, point: Point) -> Seen:
        """The same of a candidate that acts in the unit's isothermal run, too: one size for its columns of both."""

        def both(one: Whitened, ways: Sequence[Whitener]) -> FloatArray:
            return np.vstack([outside(one.basis, ways[0].apply(columns)), outside(one.trends[0], ways[1].apply(still))])

        response = np.concatenate([at.residual, at.quiet[0]])
        rest, volume = beside(both(at, self.lattice.at([point])[0]), response)
        volume += at.volume - beside(both(self._flat, self.lattice.white()), response)[1]
        others = at._replace(still=at.still - float(at.quiet[0] @ at.quiet[0]))
        return Seen(*others.height(rest, volume), rest, volume)

    def _flat_volume(self, candidate: Candidate, own: FloatArray, kept: BoolArray) -> float:
        """Volume ln |X' X| of own columns beside the base under white noise, kept for further points."""
        if self._last is None or self._last[0] is not own or not np.array_equal(self._last[1], kept):
            white = self.lattice.white()[0].apply(own)
            if candidate.kind == "term":
                white = outside(self._flat.basis, white)[:, kept]
            self._last = own, kept, beside(white, np.zeros(len(white)))[1]
        return self._last[2]

    @staticmethod
    def _left(candidate: Candidate, columns: FloatArray, at: Whitened) -> tuple[FloatArray, float, BoolArray]:
        """Rest (n,) beside base and own whitened columns, ln |X' C^-1 X| of the latter, and which of them count."""
        kept, response = np.ones(columns.shape[1], dtype=bool), at.white
        if candidate.kind == "term":
            before = np.linalg.norm(columns, axis=0)
            columns = outside(at.basis, columns)
            kept, response = np.linalg.norm(columns, axis=0) > 3e-5 * before, at.residual
        return *beside(columns[:, kept] if not kept.all() else columns, response), kept

    @cached_property
    def _flat(self) -> Whitened:
        """The problem under white noise."""
        return self._whitened(self.lattice.white())

    def at(self, point: Point) -> Whitened:
        """The problem at a noise point, computed once."""
        if point not in self._kept:
            self._kept[point] = self._whitened(self.lattice.at([point])[0])
        return self._kept[point]

    def _whitened(self, ways: Sequence[Whitener]) -> Whitened:
        base = ways[0].apply(np.column_stack([self.problem.base, self.problem.y]))
        basis, volume = spanned(base[:, :-1], np.linalg.norm(self.problem.base, axis=0))
        freedom, log_det = self.problem.rows - basis.shape[1], sum(each.log_det for each in ways)
        trends, quiet = [], []
        for record, other in zip(self.problem.statics, ways[1:], strict=True):
            both = other.apply(np.column_stack([record.X, record.y]))
            trend, more = spanned(both[:, :-1], np.linalg.norm(record.X, axis=0))
            trends.append(trend)
            quiet.append(outside(trend, both[:, -1]))
            log_det, freedom = log_det + more, freedom - trend.shape[1]
        still = sum(float(each @ each) for each in quiet)
        left = outside(basis, base[:, -1])
        return Whitened(basis, volume, base[:, -1], left, tuple(trends), tuple(quiet), still, log_det, freedom)

    def refine(
        self, candidate: Candidate, grid: Sequence[Start], base: Point, closely: bool = True
    ) -> tuple[Theta, Point, float]:
        """Best parameters, noise point and -2 ln L, from the lowest few minima of the grid.

        Not closely: from the lowest alone, at the noise of the base.
        """
        starts = _minima(grid)[:_STARTS]
        if not closely:
            starts = [Start(starts[0].theta, base, self.height(candidate, starts[0].theta, base))]
        if candidate.parameters:
            starts = [self._search(candidate, start, roughly=len(starts) > 1) for start in starts]
        best = min(starts, key=lambda start: start.height)
        for steps in (STEPS, STEPS[-1:]) if closely else ():
            before, best = best.point, self._denoise(candidate, best, base, steps)
            if not candidate.parameters or (steps is not STEPS and best.point == before):
                break
            best = self._search(candidate, best, within=_NEAR)
        return best.theta, best.point, best.height

    def _denoise(self, candidate: Candidate, start: Start, base: Point, steps: Sequence[int]) -> Start:
        """The noise profiled at fixed parameters, from the better of the start's and the base's."""
        surface = self.surface(candidate, start.theta)
        surface.visit([start.point, base])
        point = surface.descend(min((start.point, base), key=surface.height), steps=steps)
        return Start(start.theta, point, surface.height(point))

    def _search(self, candidate: Candidate, start: Start, roughly: bool = False, within: float = 1.0) -> Start:
        """Parameters improved at fixed noise: one downhill by grid steps, or a share of them, several by Gauss-Newton.

        Roughly: only so far that the best of several starts is known.
        """
        at = _unit(candidate, start.theta)
        if len(at) == 1:
            step, function = 1.0 / max(1, len(candidate.grid()) - 1), self._of_unit(candidate, start.point)
            accuracy = step / (20.0 if roughly else 200.0)
            unit, height = _downhill(lambda u: function(np.array([u])), float(at[0]), within * step, accuracy)
            return Start(_theta(candidate, unit), start.point, height) if height < start.height else start
        found = self._newton(candidate, start, roughly)
        if not candidate.change_point or start.height - found.height > _MOVED:
            return found
        moved = self._simplex(candidate, found)  # where no row is near a place, slopes do not see it
        return self._newton(candidate, moved, roughly) if moved.height < found.height - _LEAST else found

    def _newton(self, candidate: Candidate, start: Start, roughly: bool) -> Start:
        def seen(unit: FloatArray) -> Seen:
            return self._seen(candidate, [_theta(candidate, unit)], start.point)[0]

        slopes = partial(self._slopes, candidate, start.point)
        unit, height = descend(seen, slopes, _unit(candidate, start.theta), _LEAST / 2.0 if roughly else 1e-3)
        return Start(_theta(candidate, unit), start.point, height) if height < start.height else start

    def _slopes(
        self, candidate: Candidate, point: Point, unit: FloatArray, steps: FloatArray, here: Seen
    ) -> tuple[FloatArray, FloatArray]:
        """Gradient (p,) and Gauss-Newton matrix (p, p) of `height` over parameters (p,) between 0 and 1."""
        away = np.where(unit > 0.5, -steps, steps)
        near = self._seen(candidate, [_theta(candidate, each) for each in unit + np.diag(away)], point)
        rests = np.column_stack([each.rest - here.rest for each in near]) / away
        volumes = np.array([each.volume - here.volume for each in near]) / away
        return 2.0 * rests.T @ here.rest / here.sigma2 + volumes, 2.0 * rests.T @ rests / here.sigma2

    def _simplex(self, candidate: Candidate, start: Start) -> Start:
        at = _unit(candidate, start.theta)
        corners = np.vstack([at, at + np.diag(np.where(at < 0.5, _CORNER, -_CORNER))])
        found = scipy.optimize.minimize(
            self._of_unit(candidate, start.point),
            at,
            method="Nelder-Mead",
            bounds=[(0.0, 1.0)] * len(at),
            options={"maxfev": 60 * len(at), "xatol": 5e-3, "fatol": 0.2, "initial_simplex": corners},
        )
        return Start(_theta(candidate, found.x), start.point, float(found.fun))

    def _of_unit(self, candidate: Candidate, point: Point) -> Callable[[FloatArray], float]:
        return lambda unit: self.height(candidate, _theta(candidate, unit), point)

    def intervals(self, candidate: Candidate, theta: Theta, point: Point) -> dict[str, Interval]:
        """95 % intervals of the parameters at this noise, each with the others where they fit best (linearised)."""
        by_name = {}
        best = _unit(candidate, theta)
        function = self._of_unit(candidate, point)
        lowest, ways = function(best), np.eye(len(best))
        if len(best) > 1:
            here = self._seen(candidate, [theta], point)[0]
            ways = _valleys(self._slopes(candidate, point, best, np.full(len(best), _DIFFERENCE), here)[1])
        for number, parameter in enumerate(candidate.parameters):
            rise = partial(_rise, function, best, ways[number], number, lowest)
            level = JUMP_95 if parameter.jump else CHI2_95
            ends = np.array([_crossing(rise, float(best[number]), end, level) for end in (0.0, 1.0)])
            low, high = from_unit(parameter, ends).tolist()
            by_name[parameter.name] = Interval(theta[number], low, high, parameter.unit)
        return by_name

    def covariance(self, candidate: Candidate, theta: Theta, beta: FloatArray, point: Point) -> FloatArray:
        """Covariance of the linear coefficients, the parameters being fitted too (linearised).

        A parameter on an end of its range is not determined, and is stated so: the sizes are those at that value.
        """
        columns = joint(self.problem, candidate, theta)
        slopes = []
        best = _unit(candidate, theta)
        inside = [not p.on_bound(value) for p, value in zip(candidate.parameters, theta, strict=True)]
        for index in [] if candidate.change_point else np.flatnonzero(inside).tolist():
            ends = np.clip(best[index] + np.array([-_DIFFERENCE, _DIFFERENCE]), 0.0, 1.0)
            low, high = (joint(self.problem, candidate, _theta(candidate, _moved(best, index, e))) @ beta for e in ends)
            slopes.append((high - low) / (ends[1] - ends[0]))
        way = self.lattice.way(point)
        fit = gls(np.column_stack([columns, *slopes]), self.problem.y, way, self.sigma2(candidate, theta, point))
        return fit.covariance[: columns.shape[1], : columns.shape[1]]


def _downhill(function: Callable[[float], float], at: float, step: float, accuracy: float) -> tuple[FloatArray, float]:
    """The minimum between 0 and 1 within a step of the start, or as many steps further as it lies on the edge."""
    height = np.inf
    while True:
        low, high = max(0.0, at - step), min(1.0, at + step)
        least = scipy.optimize.minimize_scalar(
            function, bounds=(low, high), method="bounded", options={"xatol": accuracy, "maxiter": 18}
        )
        if least.fun >= height:
            return np.array([at]), height
        at, height = float(least.x), float(least.fun)
        if (low == 0.0 or at - low > 0.02 * step) and (high == 1.0 or high - at > 0.02 * step):
            return np.array([at]), height


def _unit(candidate: Candidate, theta: Theta) -> FloatArray:
    """Positions 0..1 between the bounds; a value at its bound lies beyond it by a rounding."""
    return np.array([to_unit(p, v) for p, v in zip(candidate.parameters, theta, strict=True)]).clip(0.0, 1.0)


def _theta(candidate: Candidate, unit: FloatArray) -> Theta:
    inside = np.clip(unit, 0.0, 1.0)
    return tuple(float(from_unit(p, inside[[i]])[0]) for i, p in enumerate(candidate.parameters))


def _rise(
    function: Callable[[FloatArray], float],
    best: FloatArray,
    way: FloatArray,
    index: int,
    lowest: float,
    value: float,
) -> float:
    """-2 ln L above the lowest with one parameter moved, and the others on their way (p,) with it."""
    return function(np.clip(best + (value - best[index]) * way, 0.0, 1.0)) - lowest


def _valleys(matrix: FloatArray) -> FloatArray:
    """How far all parameters go (p, p) where one moves by one, each row for one, by the Gauss-Newton matrix (p, p)."""
    ways = np.eye(len(matrix))
    for index in range(len(matrix)):
        others = np.arange(len(matrix)) != index
        ways[index, others] = -np.linalg.lstsq(matrix[np.ix_(others, others)], matrix[others, index], rcond=None)[0]
    return ways


def _moved(best: FloatArray, index: int, value: float) -> FloatArray:
    changed = best.copy()
    changed[index] = value
    return changed


def _crossing(rise: Callable[[float], float], best: float, end: float, level: float) -> float:
    """Where the rise passes a level between the best and the end of the range; doubling steps, then bisection."""
    step, inside = 0.002, best
    while True:
        outside = best + np.sign(end - best) * step
        if (end - outside) * (end - best) <= 0.0:
            outside = end
        if rise(outside) >= level:
            return float(scipy.optimize.brentq(lambda u: rise(u) - level, inside, outside, xtol=1e-4, maxiter=60))
        if outside == end:
            return end
        inside, step = outside, 2.0 * step


def _minima(grid: Sequence[Start]) -> list[Start]:
    """Grid points lower than all their neighbours, lowest first.

    A point without a height, where a run was too short for it, is as high as none.
    """
    grid = [start if np.isfinite(start.height) else replace(start, height=np.inf) for start in grid]
    if not grid or not grid[0].theta:
        return grid
    heights = np.array([start.height for start in grid])
    places = np.column_stack(
        [np.unique(values, return_inverse=True)[1] for values in zip(*(s.theta for s in grid), strict=True)]
    )
    near = (np.abs(places[:, None] - places) <= 1).all(axis=2)
    lowest = heights <= np.where(near, heights, np.inf).min(axis=1)
    return [grid[i] for i in np.argsort(heights, kind="stable") if lowest[i]]
