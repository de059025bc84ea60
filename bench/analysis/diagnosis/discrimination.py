"""Expected discrimination: how probably a planned run decides between rivals, over what the runs so far leave open.

Parameters, amplitudes and noise are drawn from their posterior, not taken at their best values: from a weak first run
the best values choose worse runs than a fixed habit does. Each draw of each rival is the truth in turn. D is the gap in
2 ln L by which it beats the nearest rival of another family, all free parameters fitted again over all runs together
(T-optimality; A. C. Atkinson, V. V. Fedorov, Biometrika 62 (1975) 57). The gap that is realised scatters about D with
variance 4 D, so that D says how probable a decision is; its mean, weighted by evidence, is what a plan is judged by
(as G. E. P. Box, W. J. Hill, Technometrics 9 (1967) 57). Of two rivals neither is quite the cause, the noise is free,
and the best of many plans promises too much: D is taken for less (docs/hidden_effects.md has the count).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import NamedTuple

import numpy as np

from bench.analysis.diagnosis.candidates import Candidate, Problem, Theta, about, orthonormal, outside
from bench.analysis.diagnosis.limits import probability
from bench.analysis.diagnosis.plan import Plan
from bench.analysis.diagnosis.prediction import ChamberModel, chamber_model, predicted_record
from bench.analysis.diagnosis.refine import Refiner
from bench.analysis.diagnosis.rivals import Rival
from bench.analysis.diagnosis.suspects import Layout
from bench.analysis.effects.expression import Expression
from bench.analysis.fit import design
from bench.analysis.noise.likelihood import NoiseLattice, Point, coordinates, gls
from bench.analysis.noise.whitening import Whitener
from bench.base import FloatArray

DRAWS = 24
_HALF_DECADE = 8
_NOISES = 3
_POINTS = 6
_REALISED = 0.55  # of D is what runs of mechanisms that are like the rivals, and not equal to them, have shown
_MOST_ON_A_GRID = 2  # parameters of a formula: of more,
_TRIED = 80  # … so many are tried about those found,
_ABOUT = 0.15  # … within this share of the bounds that a model gives them, which are near already
_SAME = 0.99  # correlation of what two rivals predict: no run that matters tells them apart
_RULED_OUT = 100.0  # of -2 ln L: a truth that is told from all other parameters is told from these, too


@dataclass(frozen=True)
class Expected:
    """What a plan promises: mean probability of a decision, and the median over draws of the gap D.

    `gaps` (draws,) and their `weights` are behind both.
    """

    gaps: FloatArray
    weights: FloatArray

    @property
    def probability(self) -> float:
        """Of a right decision."""
        return float(np.average([probability(gap) for gap in self.gaps], weights=self.weights))

    @property
    def gap(self) -> float:
        """Median D."""
        order = np.argsort(self.gaps)
        share = np.cumsum(self.weights[order]) / np.sum(self.weights)
        return float(self.gaps[order][np.searchsorted(share, 0.5)])

    def after(self, before: Expected, runs: int) -> Expected:
        """The same after this many runs of the plan instead of one."""
        return replace(self, gaps=before.gaps + runs * np.maximum(self.gaps - before.gaps, 0.0))


class Discrimination:
    """Rivals as the runs so far leave them, and what any plan promises."""

    def __init__(self, layout: Layout, rivals: Sequence[Rival], noise: Point, seed: int = 0) -> None:
        """`noise` is the most likely one; its neighbours on the lattice take part by their likelihood."""
        self._layout, self._rivals, self._noise, self._seed = layout, rivals, noise, seed
        self._base = layout.rows.bind(layout.theta, trial=True)[0]
        self._candidates = [self._candidate(layout, rival) for rival in rivals]
        problem = layout.problem
        self._refiner = Refiner(problem, NoiseLattice(problem.records(), problem.interval_s))

    @cached_property
    def _chamber(self) -> ChamberModel:
        """Fitted once for all plans."""
        return chamber_model(self._layout.rows.records)

    @cached_property
    def _points(self) -> tuple[list[Point], FloatArray, list[float]]:
        """Noise points, their posterior weights, and the white variance at each."""
        rivals = list(zip(self._rivals, self._candidates, strict=True))
        best, candidate = max(rivals, key=lambda pair: pair[0].evidence)
        points = NoiseLattice.around(self._noise, _HALF_DECADE)
        heights = np.array([self._refiner.height(candidate, best.theta, point) for point in points])
        order = np.argsort(heights)[:_NOISES]
        weights = np.exp(0.5 * (heights[order[0]] - heights[order]))
        kept = [points[i] for i in order]
        variances = [self._refiner.sigma2(candidate, best.theta, point) for point in kept]
        return kept, weights / weights.sum(), variances

    @cached_property
    def _heights(self) -> list[FloatArray]:
        """-2 ln L of each rival over its grid, at the likeliest noise."""
        point = self._noise
        return [np.array([self._refiner.height(c, theta, point) for theta in c.grid()]) for c in self._candidates]

    @cached_property
    def _open(self) -> list[list[Theta]]:
        """Parameters of each rival's grid that the runs so far do not rule out, and the next ones on either side."""
        found = []
        for candidate, heights in zip(self._candidates, self._heights, strict=True):
            likely = np.flatnonzero(heights <= heights.min() + _RULED_OUT)
            beside = np.unique(likely[:, None] + np.array([-1, 0, 1]))
            found.append([candidate.grid()[i] for i in beside if 0 <= i < len(heights)])
        return found

    @cached_property
    def _drawn(self) -> list[list[Theta]]:
        """Parameters of each rival drawn from their posterior on the grid, the best values first."""
        rng = np.random.default_rng(self._seed)
        drawn = []
        for rival, candidate, heights in zip(self._rivals, self._candidates, self._heights, strict=True):
            grid = candidate.grid()
            share = np.exp(0.5 * (heights.min() - heights))
            chosen = rng.choice(len(grid), DRAWS - 1, p=share / share.sum())
            drawn.append([rival.theta, *(grid[i] for i in chosen)])
        return drawn

    def expected(self, plan: Plan | None, *, roughly: bool = False) -> Expected:
        """Over the runs so far and then the plan's; roughly: at the likeliest noise, rivals at few parameters."""
        noises = 1 if roughly else _NOISES
        stacked = self._layout if plan is None else self._with(plan)
        problem = replace(stacked.problem, statics=())
        candidates = [_kept(self._candidate(stacked, rival)) for rival in self._rivals]
        tried = [_some(thetas) if roughly else thetas for thetas in self._open]
        every, likely, variances = self._points
        points, weights = every[:noises], likely[:noises]
        lattice = NoiseLattice(problem.records(), problem.interval_s)
        evidence = np.array([rival.evidence for rival in self._rivals])
        prior = np.exp(0.5 * (evidence - evidence.max()))
        gaps, shares = [], []
        for point, weight, sigma2, (way,) in zip(points, weights, variances[:noises], lattice.at(points), strict=True):
            basis = orthonormal(way.apply(problem.base))
            spaces = [self._spaces(c, own, way, basis) for c, own in zip(candidates, tried, strict=True)]
            known = lattice_of(self._layout.problem).way(point)
            for i, rival in enumerate(self._rivals):
                if not rival.tied:
                    continue
                white = way.apply(self._means(problem, candidates[i], self._drawn[i], known, sigma2))
                others = [j for j, other in enumerate(self._rivals) if other.family != rival.family]
                rest = outside(basis, white)
                least = [_least(white, rest, candidates[j], spaces[j], tried[j]) for j in others]
                gaps.append(_REALISED * np.min(least, axis=0) / sigma2)
                shares.append(np.full(DRAWS, weight * prior[i]))
        return Expected(np.concatenate(gaps), np.concatenate(shares))

    def unlike(self, plan: Plan, most: int) -> list[Rival]:
        """The first rival, and those after it that predict something else than those before them, in the runs and the
        plan's together; at most so many.
        """
        stacked, y = self._with(plan), self._layout.problem.y
        problem = replace(stacked.problem, statics=())
        way, known = lattice_of(problem).way(self._noise), lattice_of(self._layout.problem).way(self._noise)
        basis = orthonormal(way.apply(problem.base))
        found, shapes = list[Rival](), list[FloatArray]()
        for rival in self._rivals:
            own = stacked.candidate(rival.effect, rival.name).columns(rival.theta)
            fit = gls(np.column_stack([problem.base, own])[: len(y)], y, known)
            shape = outside(basis, way.apply(own @ fit.beta[-own.shape[1] :]))
            shape = shape / max(float(np.linalg.norm(shape)), 1e-300)
            if len(found) < most and all(abs(float(shape @ other)) < _SAME for other in shapes):
                found.append(rival)
                shapes.append(shape)
        return found

    def _candidate(self, layout: Layout, rival: Rival) -> Candidate:
        """The rival beside the model; where a grid of its parameters would be coarse, values about those found."""
        candidate = layout.candidate(rival.effect, rival.name)
        if not isinstance(rival.effect, Expression) or len(candidate.parameters) < _MOST_ON_A_GRID:
            return candidate
        moved = _ABOUT * np.random.default_rng(self._seed).standard_normal((_TRIED, len(candidate.parameters)))
        return replace(candidate, tried=about(candidate.parameters, rival.theta, moved))

    @staticmethod
    def _spaces(candidate: Candidate, tried: Sequence[Theta], way: Whitener, basis: FloatArray) -> list[_Space]:
        """What a rival may follow, beside the model, at each of these parameters."""
        whitened = [way.apply(candidate.columns(theta)) for theta in tried]
        return [_Space.of(c if candidate.kind == "abscissa" else outside(basis, c)) for c in whitened]

    def _means(
        self, problem: Problem, candidate: Candidate, drawn: Sequence[Theta], way: Whitener, sigma2: float
    ) -> FloatArray:
        """Bias (n, draws) [deg/h] if this rival is the truth, its amplitudes drawn beside what the known rows say."""
        rng = np.random.default_rng([self._seed, 1])
        y = self._layout.problem.y
        means = np.empty((len(problem.y), len(drawn)))
        for theta in dict.fromkeys(drawn):
            own = candidate.columns(theta)
            columns = own if candidate.kind == "abscissa" else np.column_stack([problem.base, own])
            fit = gls(columns[: len(y)], y, way, sigma2)
            values, vectors = np.linalg.eigh(fit.covariance)
            half = vectors * np.sqrt(np.maximum(values, 0.0))
            which = [i for i, each in enumerate(drawn) if each == theta]
            scatter = half @ rng.standard_normal((len(values), len(which)))
            means[:, which] = columns @ (fit.beta[:, None] + scatter)
        return means

    def _with(self, plan: Plan) -> Layout:
        """The layout with the planned run as one more record, its bias as the present model predicts it."""
        rows = self._layout.rows
        planned = predicted_record(rows.records, plan.setpoint(), rows.records[0].interval_s, self._chamber)
        columns = self._base.columns(planned)
        known = lattice_of(self._layout.problem).way(self._noise)
        beta = gls(self._layout.problem.base, self._layout.problem.y, known).beta
        planned = planned.with_channel("rate", columns @ beta[: columns.shape[1]])
        masks = (*rows.masks, np.ones(len(planned), dtype=bool))
        return replace(self._layout, rows=design.FitRows(rows.model, (*rows.records, planned), masks))


class _Space(NamedTuple):
    """Columns (n, k), and the matrix that makes coordinates in their span of products with them."""

    columns: FloatArray
    coordinates: FloatArray

    @classmethod
    def of(cls, columns: FloatArray) -> _Space:
        """The span of columns, dependent ones included."""
        found = coordinates(columns)
        if found is not None:
            return cls(columns, found)
        basis = orthonormal(columns)
        return cls(basis, np.eye(basis.shape[1]))

    def power(self, response: FloatArray) -> FloatArray:
        """Square sum (m,) of the part of responses (n, m) inside."""
        return np.asarray(np.sum((self.coordinates @ (self.columns.T @ response)) ** 2, axis=0))


def _kept(candidate: Candidate) -> Candidate:
    """The candidate with its columns kept: all noises and draws of one plan share them."""
    return replace(candidate, columns=cache(candidate.columns))


def _some(thetas: Sequence[Theta]) -> list[Theta]:
    """A few of these parameters, evenly spaced, to put plans in an order."""
    return [thetas[i] for i in np.unique(np.linspace(0, len(thetas) - 1, _POINTS).round().astype(int))]


def lattice_of(problem: Problem) -> NoiseLattice:
    """Whiteners of the run's rows alone."""
    return NoiseLattice(problem.records()[:1], problem.interval_s)


def _least(
    white: FloatArray, residual: FloatArray, rival: Candidate, spaces: Sequence[_Space], tried: Sequence[Theta]
) -> FloatArray:
    """Square sum (draws,) that a rival leaves of whitened means at its best parameters, `tried` or between them."""
    response = white if rival.kind == "abscissa" else residual
    power = np.einsum("ij,ij->j", response, response)
    gains = np.array([space.power(response) for space in spaces])
    most = gains.max(axis=0)
    if len(rival.parameters) == 1 and len(tried) > 2:
        most = np.maximum(most, between(np.array(tried)[:, 0], gains))
    return np.asarray(np.maximum(power - most, 0.0))


def between(at: FloatArray, gains: FloatArray) -> FloatArray:
    """Top (draws,) of the parabola through the highest of gains (n, draws) at places (n,) and its neighbours.

    A truth whose parameter lies between two points of the grid is nearly as well followed as one that lies on a point.
    """
    middle, draw = np.clip(np.argmax(gains, axis=0), 1, len(at) - 2), np.arange(gains.shape[1])
    x0, x1, x2 = (at[middle + k] for k in (-1, 0, 1))
    y0, y1, y2 = (gains[middle + k, draw] for k in (-1, 0, 1))
    first, second = (y1 - y0) / (x1 - x0), (y2 - y1) / (x2 - x1)
    bend = (second - first) / (x2 - x0)
    top = np.clip(0.5 * (x0 + x1) - first / (2.0 * np.where(bend < 0.0, bend, -np.inf)), x0, x2)
    return np.asarray(np.where(bend < 0.0, y0 + first * (top - x0) + bend * (top - x0) * (top - x1), y1))
