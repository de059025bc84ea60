"""What a run could show: the smallest effect it would have found, and how far it separates one effect from another.

Both come from the whitened geometry alone, before any evidence: an effect m that the model with rival j cannot follow
raises 2 ln L by D = min |W (m - M_j)|^2 / sigma^2 on average; D = 20 exceeds a gap of 6 with 94 % probability.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import norm

from bench.analysis.diagnosis.candidates import Candidate, Problem, Theta, orthonormal
from bench.analysis.diagnosis.refine import Refiner, Start
from bench.analysis.noise.likelihood import NoiseLattice, Point, gls
from bench.base import FloatArray

FOUND = 20.0
"""Expected gap in 2 ln L at which an effect is found (and told apart) with 94 % probability."""


@dataclass(frozen=True)
class Smallest:
    """The smallest effect that the run would have shown.

    `rms_dph` [deg/h] is the RMS of the whole effect over the run, `share` the part of its variance that the base does
    not absorb. For a term `amplitude` is that of its first column; for an abscissa the first parameter is the amplitude
    and `theta` holds the least that would show. Infinite where no value in the range would.
    """

    name: str
    theta: Theta
    amplitude: float
    rms_dph: float
    share: float


def smallest(
    problem: Problem, candidate: Candidate, theta: Theta, lattice: NoiseLattice, point: Point, sigma2: float
) -> Smallest:
    """Smallest amplitude of a candidate with parameters `theta` that this run finds, at a noise of the lattice."""
    way = lattice.at([point])[0][0]
    q = orthonormal(way.apply(problem.base))
    if candidate.kind == "abscissa":
        return _smallest_abscissa(problem, candidate, lattice, point, sigma2)
    column = candidate.columns(theta)[:, 0]
    white = way.apply(column)
    outside = white - q @ (q.T @ white)
    seen = float(outside @ outside)
    basis = orthonormal(problem.base)
    centred = column - column.mean()
    left = column - basis @ (basis.T @ column)
    share = float(left @ left) / max(float(centred @ centred), 1e-300)
    if seen <= 1e-9 * float(white @ white):
        return Smallest(candidate.name, theta, np.inf, np.inf, share)
    amplitude = float(np.sqrt(FOUND * sigma2 / seen))
    return Smallest(candidate.name, theta, amplitude, amplitude * float(np.std(column)), share)


def _smallest_abscissa(
    problem: Problem, candidate: Candidate, lattice: NoiseLattice, point: Point, sigma2: float
) -> Smallest:
    """The first parameter of the grid, from its lower bound up, whose effect on the fitted base would show."""
    way = lattice.at([point])[0][0]
    beta = gls(problem.base, problem.y, way).beta
    q = orthonormal(way.apply(problem.base))
    basis = orthonormal(problem.base)
    for theta in candidate.grid():
        moved = (candidate.columns(theta) - problem.base) @ beta
        white = way.apply(moved)
        outside = white - q @ (q.T @ white)
        if float(outside @ outside) / sigma2 >= FOUND:
            left = moved - basis @ (basis.T @ moved)
            share = float(left @ left) / max(float(np.var(moved)) * len(moved), 1e-300)
            return Smallest(candidate.name, theta, 1.0, float(np.std(moved)), share)
    return Smallest(candidate.name, (), np.inf, np.inf, 0.0)


def expected_gap(
    problem: Problem, mean: FloatArray, rival: Candidate, lattice: NoiseLattice, point: Point, sigma2: float
) -> float:
    """D: expected gain in 2 ln L of the truth over the rival on this record, `mean` (n,) being the true bias [deg/h].

    The rival's linear coefficients and parameters are fitted to the mean without noise. Stack several runs by stacking
    their rows: whitening across the join only costs a little of the second run's start.
    """
    refiner = Refiner(replace(problem, y=mean, statics=()), lattice.part(0, 1))
    grid = [Start(theta, point, refiner.rss(rival, theta, point)) for theta in rival.grid()]
    return refiner.lowest_rss(rival, grid) / sigma2


def probability(gap: float, least: float = 6.0) -> float:
    """Probability that a realised gap exceeds `least` when D is expected: Phi((D - least) / (2 sqrt(D)))."""
    return float(norm.cdf((gap - least) / (2.0 * np.sqrt(gap)))) if gap > 0.0 else 0.0
