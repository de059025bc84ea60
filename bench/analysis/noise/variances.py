"""Most likely N^2, B^2, K^2 and Q^2 of sums of squares, and intervals that hold the truth as often as they say.

A square with expected value lambda = unit @ variances adds freedom ln(lambda) + total / lambda to -2 ln L. It is
minimised for many sets of squares at once.

An interval holds the values that a likelihood-ratio test does not reject. Flicker and walk are often not told from
zero; the ratio then does not follow chi-square, so its 95 % point is found by simulation at the value that is tested
(G. J. Feldman, R. D. Cousins, Phys. Rev. D 57 (1998) 3873).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from bench.analysis.noise.components import Squares
from bench.analysis.noise.probability import CHI2_95
from bench.base import FloatArray

_STEPS, _STEPS_OF_MANY = 60, 15
_GAINED = 1e-3  # of -2 ln L in any of the sets, below which the steps end
_LARGEST = 1.5  # step of a logarithm
_SIMULATED = 200
_PRECISE = 0.05  # of the range that an end is searched in
_LEAST, _USUAL, _MOST = 2.0, CHI2_95, 8.0  # 95 % points of the ratio lie between the outer two
_FAR = 4.0 ** np.arange(1.0, 12.0)
_FINE, _REFINED, _CLOSE = 12, 8, 0.1


@dataclass(frozen=True)
class Along:
    """A variance of interest: `weights` (4,) @ variances, such as N^2 itself or the floor's square; its values (r,)."""

    weights: FloatArray
    values: FloatArray


def most_likely(
    squares: Squares, start: FloatArray, along: Along | None = None, total: FloatArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Variances (r, k) and their -2 ln L (r,) for `total` (r, m), by default the squares' own.

    `along` holds the variance of interest at its values. The steps are those of Fisher's scoring in the logarithms.
    """
    totals = squares.total[None, :] if total is None else total
    rows = max(len(totals), 1 if along is None else len(along.values))
    found = _held(np.repeat(start[None, :], rows, axis=0), along)
    pairs = (squares.unit[:, :, None] * squares.unit[:, None, :]).reshape(len(squares.total), -1)
    best, lowest = found, height(squares, found, totals)
    for _ in range(_STEPS if total is None else _STEPS_OF_MANY):
        spread = found @ squares.unit.T
        weight = squares.freedom / spread
        slope = found * ((weight - totals / spread**2) @ squares.unit)
        bend = ((weight / spread) @ pairs).reshape(rows, len(start), -1) * found[:, :, None] * found[:, None, :]
        bend[:, range(len(start)), range(len(start))] += np.abs(slope)  # of the logarithm; where it falls, caution
        scale = np.sqrt(np.einsum("rii->ri", bend))
        bend /= scale[:, :, None] * scale[:, None, :]
        right = slope / scale
        if along is None:
            step = np.linalg.solve(bend, right[..., None])[..., 0]
        else:  # along the surface on which the variance of interest has its value
            normal = along.weights * found / scale
            both = np.linalg.solve(bend, np.stack([right, normal], axis=-1))
            share = np.sum(normal * both[..., 0], axis=1) / np.sum(normal * both[..., 1], axis=1)
            step = both[..., 0] - share[:, None] * both[..., 1]
        found = _held(found * np.exp(np.clip(-step / scale, -_LARGEST, _LARGEST)), along)
        now = height(squares, found, totals)
        better = now < lowest
        gained = float(np.max(lowest - now))
        best, lowest = np.where(better[:, None], found, best), np.where(better, now, lowest)
        if abs(gained) < _GAINED:
            break
    return best, lowest


def height(squares: Squares, variances: FloatArray, total: FloatArray) -> FloatArray:
    """-2 ln L (r,) without constants."""
    spread = variances @ squares.unit.T
    return np.asarray(np.log(spread) @ squares.freedom + np.sum(total / spread, axis=1))


def _held(found: FloatArray, along: Along | None) -> FloatArray:
    """Variances (r, k) with those of interest scaled to where their sum has its values."""
    if along is None:
        return found
    scale = along.values / (found @ along.weights)
    return np.where(along.weights > 0.0, found * scale[:, None], found)


def interval(
    squares: Squares, best: FloatArray, weights: FloatArray, simulated: bool = True, spent: float = 0.0
) -> tuple[float, float]:
    """95 % interval of the standard deviation sqrt(`weights` @ variances) about the most likely variances `best` (4,).

    A variance that is exactly zero in `best` is no part of the noise. Not `simulated` takes the test's point from
    chi-square, which a variance far from zero allows; the ratio is then below it by `spent`, what something that is
    known no better (a correlation time) has taken of it.
    """
    test = _Test(squares, best, weights, simulated, spent)
    return float(np.sqrt(test.end(-1.0))), float(np.sqrt(test.end(1.0)))


def standard_errors(squares: Squares, variances: FloatArray) -> FloatArray:
    """Standard error (4,) of each variance alone, the others known."""
    spread = squares.unit @ variances
    information = 0.5 * squares.freedom @ (squares.unit / spread[:, None]) ** 2
    return np.asarray(1.0 / np.sqrt(information))


def may_vanish(squares: Squares, best: FloatArray, weights: FloatArray, spent: float = 0.0) -> bool:
    """Whether the data do not tell `weights` @ variances from zero at the 5 % level."""
    return _Test(squares, best, weights, True, spent).may_vanish()


class _Test:
    """The likelihood-ratio test of values of one variance of interest."""

    def __init__(self, squares: Squares, best: FloatArray, weights: FloatArray, simulated: bool, spent: float) -> None:
        active = best > 0.0
        squares = Squares(squares.total, squares.freedom, squares.unit[:, active])
        best, weights = best[active], weights[active]
        self.squares, self.best, self.weights, self.simulated, self.spent = squares, best, weights, simulated, spent
        self.lowest = float(height(squares, best[None, :], squares.total[None, :])[0])
        self.start = np.maximum(best, 0.1 * standard_errors(squares, best))
        rng = np.random.default_rng(0)
        # The same draws at every value that is tested: the point of the test then moves smoothly.
        self.draws = rng.chisquare(squares.freedom, size=(_SIMULATED, len(squares.freedom))) if simulated else None

    def end(self, side: float) -> float:
        """The value below or above the most likely one at which the test starts to reject."""
        if side < 0.0 and self.may_vanish():
            return 0.0
        if not self.simulated:
            return self._crossing(side, _USUAL - self.spent)
        end = self._rejecting(side)
        return end if side > 0.0 else min([end, *self._first_alone()])

    def _rejecting(self, side: float) -> float:
        """Where the ratio crosses the point of the test."""
        inside, outside = (float(np.sqrt(self._crossing(side, limit))) for limit in (_LEAST, _MOST))
        if self._rejected(inside) > 0.0 or self._rejected(outside) < 0.0:
            return (inside if self._rejected(inside) > 0.0 else outside) ** 2
        near = _PRECISE * abs(outside - inside)
        found: float = scipy.optimize.brentq(self._rejected, inside, outside, xtol=near, rtol=1e-9)
        return found**2

    def _rejected(self, deviation: float) -> float:
        """By how much the ratio at this value of the standard deviation is above the point of the test."""
        value = deviation**2
        held, at = most_likely(self.squares, self.start, Along(self.weights, np.array([value])))
        return float(at[0]) - self.lowest - self._point(held[0], value)

    def _first_alone(self) -> list[float]:
        """Values of a sum of variances that are accepted with white noise as all there is.

        The point of the test is another at that corner than just inside, where the others are not zero.
        """
        if not np.all(self.weights > 0.0):
            return []
        white = self.best[0] + np.linspace(-2.5, 2.5, 21) * standard_errors(self.squares, self.best)[0]
        values = self.weights[0] * white[white > 0.0]
        at = most_likely(self.squares, self.start, Along(self.weights, values))[1]
        corner = np.zeros(len(self.best))
        corner[0] = self.best[0]
        point = self._point(corner, float(self.weights @ corner))
        return [float(value) for value in values[at - self.lowest <= point]]

    def may_vanish(self) -> bool:
        """Whether the test accepts zero."""
        if np.all(self.weights > 0.0):
            return False
        held, at = self._none()
        return float(at[0]) - self.lowest + self.spent <= self._point(held[0], 0.0)

    def _none(self, total: FloatArray | None = None) -> tuple[FloatArray, FloatArray]:
        """The other variances alone: those (r, k) and -2 ln L (r,)."""
        others = self.weights == 0.0
        alone = Squares(self.squares.total, self.squares.freedom, self.squares.unit[:, others])
        found, at = most_likely(alone, self.start[others], None, total)
        held = np.zeros((len(found), len(others)))
        held[:, others] = found
        return held, at

    def _crossing(self, side: float, limit: float) -> float:
        """Where the ratio crosses a limit."""
        centre = float(self.weights @ self.best)
        near = max(centre, 0.1 * float(self.weights @ self.start)) if side > 0.0 else centre
        values = near * _FAR**side
        for _ in range(_REFINED):
            at = most_likely(self.squares, self.start, Along(self.weights, values))[1]
            beyond = np.flatnonzero(at - self.lowest > limit)
            first = int(beyond[0]) if beyond.size else len(values) - 1
            far, near = float(values[first]), float(values[first - 1]) if first else near
            if first and at[first] - at[first - 1] < _CLOSE:
                break
            values = np.geomspace(near, far, _FINE + 1)[1:]
        return far

    def _point(self, held: FloatArray, value: float) -> float:
        """The ratio that 95 % of simulations at these variances stay below."""
        if self.draws is None:
            return _USUAL
        total = self.draws * (self.squares.unit @ held)
        start = np.maximum(held, standard_errors(self.squares, held))
        free = most_likely(self.squares, start, None, total)[1]
        if value > 0.0:
            kept = most_likely(self.squares, start, Along(self.weights, np.full(len(total), value)), total)[1]
        else:
            kept = self._none(total)[1]
        return float(np.quantile(np.maximum(kept - free, 0.0), 0.95))
