"""What a run could show: the smallest effect it would have found, and how far it separates one effect from another.

Both come from the whitened geometry alone, before any evidence: an effect m that the model with rival j cannot follow
raises 2 ln L by D = min |W (m - M_j)|^2 / sigma^2 on average; D = 20 exceeds a gap of 6 with 94 % probability.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.analysis.diagnosis.candidates import Candidate, Problem, Theta, orthonormal, outside
from bench.analysis.noise.likelihood import NoiseLattice, Point, gls
from bench.analysis.noise.probability import normal_share
from bench.analysis.thresholds import TIE

FOUND = 20.0
"""Expected gap in 2 ln L at which an effect is found (and told apart) with 94 % probability."""


@dataclass(frozen=True)
class Smallest:
    """The smallest effect that the run would have shown, infinite where no value in the range would.

    `rms_dph` [deg/h] is the RMS of the whole effect over the run. Of a term `amplitude` is that of its first column; of
    an abscissa the first parameter is the amplitude and `theta` holds the least that would show.
    """

    theta: Theta
    amplitude: float = np.inf
    rms_dph: float = np.inf


def smallest(
    problem: Problem, candidate: Candidate, theta: Theta, lattice: NoiseLattice, point: Point, sigma2: float
) -> Smallest:
    """Smallest amplitude of a candidate with parameters `theta` that this run finds, at a noise of the lattice."""
    way = lattice.way(point)
    base = orthonormal(way.apply(problem.base))
    if candidate.kind == "abscissa":
        # The first parameter of the grid, from its lower bound up, whose effect on the fitted base would show.
        beta = gls(problem.base, problem.y, way).beta
        for tried in candidate.grid():
            moved = (candidate.columns(tried) - problem.base) @ beta
            left = outside(base, way.apply(moved))
            if float(left @ left) / sigma2 >= FOUND:
                return Smallest(tried, 1.0, float(np.std(moved)))
        return Smallest(())
    column = candidate.columns(theta)[:, 0]
    white = way.apply(column)
    left = outside(base, white)
    seen = float(left @ left)
    if seen <= 1e-9 * float(white @ white):
        return Smallest(theta)
    amplitude = float(np.sqrt(FOUND * sigma2 / seen))
    return Smallest(theta, amplitude, amplitude * float(np.std(column)))


def probability(gap: float) -> float:
    """Probability that a realised gap exceeds a tie when D is expected: Phi((D - tie) / (2 sqrt(D)))."""
    return normal_share((gap - TIE) / (2.0 * np.sqrt(gap))) if gap > 0.0 else 0.0
