"""The error of a calibration by a run that went another way than the lot's: simulated for each unit of the lot.

Each unit of the lot is taken in turn for a new one: y = X k + m(T, dT/dt) + e along the other way, calibrated by the
lot's other units. The error is over the unit's whole run, as it was measured, which is taken to begin where the other
way ends: its slow changes and all that the model leaves are those that happened. k are drawn from the amplitudes that
the unit may have had when its whole run began, by generalised least squares to that run; m is what the model leaves by
temperature and direction; e is drawn from the lot's noise (`prior`): white, and flicker and walk back from the end of
the way. The logarithms of these errors have mean and spread.

What m has of the direction follows the rate: at twice the rate that the lot was driven at it is taken for twice as
large. That is the price of a rate at which the lag was never seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bench.analysis.noise.whitening import Ratios
from bench.analysis.noise.whitening import covariance as dense
from bench.base import FloatArray, IntArray

Noise = tuple[float, Ratios]
"""White variance of a mean [(deg/h)^2], and flicker and walk beside it."""
DRAWS = 8
"""Of the noise, for each unit."""
_CELLS = 24
_TURNING = 0.1
"""Share of the usual rate below which the unit neither heats nor cools."""
_LEAST_SQUARE = 1e-6
_LATER_S = 14_400.0
"""From the end of a run to its unit's use: flicker fades until then, a walk does not."""


@dataclass(frozen=True, eq=False)
class Way:
    """A run in the prior's coordinates: mid times (n,) [s], temperature (n,) [degC], columns (n, p) and bias (n,)."""

    time: FloatArray
    degc: FloatArray
    columns: FloatArray
    bias: FloatArray

    def rates(self) -> FloatArray:
        """Rates (n,) [degC/s]."""
        return np.asarray(np.gradient(self.degc, self.time)) if self.time.size > 1 else np.zeros(self.time.size)


@dataclass(frozen=True, eq=False)
class Unit:
    """A unit of the lot: its whole run, its amplitudes (p,), and mean (p,) and covariance (p, p) of all others."""

    whole: Way
    known: FloatArray
    mean: FloatArray
    spread: FloatArray
    start: FloatArray
    """Amplitudes (p,) when its whole run began …"""
    scatter: FloatArray
    """… and the Cholesky factor (p, p) of their covariance."""

    @classmethod
    def of(
        cls, whole: Way, known: FloatArray, others: tuple[FloatArray, FloatArray], noise: Noise, block_s: float
    ) -> Unit:
        """`others`: mean and covariance of the amplitudes of all other units."""
        among = noise[0] * dense(whole.time, block_s, noise[1])
        solved = np.linalg.solve(among, np.column_stack([whole.columns, whole.bias]))
        covariance = np.linalg.inv(whole.columns.T @ solved[:, :-1])
        start: FloatArray = covariance @ (whole.columns.T @ solved[:, -1])
        scatter: FloatArray = np.asarray(np.linalg.cholesky(0.5 * (covariance + covariance.T)), dtype=np.float64)
        return cls(whole, known, *others, start, scatter)

    def at_its_start(self, random: np.random.Generator) -> FloatArray:
        """Amplitudes (p, DRAWS) that it may have had when its whole run began."""
        return np.asarray(self.start[:, None] + self.scatter @ random.normal(size=(self.start.size, DRAWS)))


def simulated(way: Way, units: Sequence[Unit], noise: Noise, block_s: float, level: FloatArray) -> FloatArray:
    """Errors over the lot's whole run after this way, of each unit and draw (units, DRAWS) [deg/h RMS].

    `level` are the amplitudes (p,) of a constant of 1 deg/h.
    """
    white, ratios = noise
    random = np.random.default_rng(1)
    among, later = among_rows(way.time, noise, block_s)
    solved, onto = np.split(np.linalg.solve(among, np.column_stack([way.columns, later])), [-1], axis=1)
    precision = way.columns.T @ solved
    back = (way.time[-1] - way.time)[::-1]
    slow = np.linalg.cholesky(white * dense(back, block_s, ratios, np.full(back.size, _LEAST_SQUARE)))[::-1]
    usual = float(np.median([np.median(np.abs(_driven(unit.whole.rates()))) for unit in units]))
    faster = _direction(way.rates(), usual) * np.maximum(np.abs(way.rates()) / usual, 1.0)
    errors = np.empty((len(units), DRAWS))
    for row, unit in enumerate(units):
        even, odd = _left(unit, usual)
        at = _cells(way.degc, unit.whole.degc)
        y = way.columns @ unit.at_its_start(random) + (even[at] + odd[at] * faster)[:, None]
        y += slow @ random.normal(size=y.shape) + random.normal(0.0, np.sqrt(white), y.shape)
        gain = np.linalg.solve(np.eye(len(level)) + unit.spread @ precision, unit.spread)
        found = unit.mean[:, None] + gain @ (solved.T @ (y - (way.columns @ unit.mean)[:, None]))
        found += level[:, None] * (onto.T @ (y - way.columns @ found))
        errors[row] = np.mean((unit.whole.bias[:, None] - unit.whole.columns @ found) ** 2, axis=0) - white
    return np.sqrt(np.maximum(errors, _LEAST_SQUARE))


def among_rows(time_s: FloatArray, noise: Noise, block_s: float) -> tuple[FloatArray, FloatArray]:
    """Covariance (n, n) of the noise of rows, and theirs (n,) with its slow part when the unit is used [(deg/h)^2]."""
    both = noise[0] * dense(np.append(time_s, time_s[-1] + _LATER_S), block_s, noise[1])
    return both[:-1, :-1], both[:-1, -1]


def _driven(rates: FloatArray) -> FloatArray:
    """Those of rates [degC/s] at which the chamber was driven, not at rest."""
    fast = np.abs(rates) > 0.5 * float(np.quantile(np.abs(rates), 0.9))
    return rates[fast]


def _direction(rates: FloatArray, usual: float) -> FloatArray:
    return np.where(np.abs(rates) > _TURNING * usual, np.sign(rates), 0.0)


def _cells(degc: FloatArray, range_degc: FloatArray) -> IntArray:
    borders = np.linspace(range_degc.min(), range_degc.max(), _CELLS + 1)[1:-1]
    return np.searchsorted(borders, degc)


def _left(unit: Unit, usual: float) -> tuple[FloatArray, FloatArray]:
    """What the model leaves of a unit by cell of temperature: mean of both directions, half their difference."""
    whole = unit.whole
    residual, at = whole.bias - whole.columns @ unit.known, _cells(whole.degc, whole.degc)
    direction = _direction(whole.rates(), usual)
    every = np.bincount(at, residual, _CELLS) / np.maximum(np.bincount(at, minlength=_CELLS), 1)
    means = []
    for sign in (1.0, -1.0):
        own = direction == sign
        count = np.bincount(at[own], minlength=_CELLS)
        total = np.bincount(at[own], residual[own], minlength=_CELLS)
        means.append(np.divide(total, count, out=every.copy(), where=count > 0))
    heating, cooling = means
    return 0.5 * (heating + cooling), 0.5 * (heating - cooling)
