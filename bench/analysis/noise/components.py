"""What isothermal stretches say of white noise, flicker, random walk, quantisation and correlated noise, in squares.

The angle random walk acts fastest, so most of it is seen inside the rows: how samples scatter within one row, and rows
within a group of neighbours. The means of these groups, the stretch's own trend removed, are turned into combinations
(cosines, nearly) that none of the noises correlates. Each square then has an expected value that is linear in N^2,
B^2, K^2, Q^2 and the variance of correlated noise of a known correlation time (IEEE 952's Markov noise: the output of
a filter, or a part that wanders about its rest), and the likelihood of all of them is a sum over a few dozen numbers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from bench.analysis.noise.whitening import Ratios, covariance, flicker_by_lag
from bench.base import BoolArray, FloatArray, InputError, IntArray

COMPONENTS = ("white", "flicker", "walk", "quantisation", "correlated")
Times = tuple[float, ...]
"""Correlation times [s]."""
_MOST_ROWS = 200  # group means of one stretch
_SINGLE = 12  # slowest combinations that stand for themselves; the others are joined with their neighbours
_SAME = 0.15  # logarithm up to which shares of the noises count as the same
_JOINED = 1.15  # ratio of the frequencies that are joined


@dataclass(frozen=True)
class Squares:
    """Sums of squares (m,) [(deg/h)^2] of `freedom` (m,) terms; a term's variance is `unit` (m, 4 + k) times variances.

    These are N^2 to Q^2, and those of correlated noise of k correlation times.
    """

    total: FloatArray
    freedom: FloatArray
    unit: FloatArray

    def and_(self, *others: Squares) -> Squares:
        """These and others."""
        parts = (self, *others)
        return Squares(
            np.concatenate([part.total for part in parts]),
            np.concatenate([part.freedom for part in parts]),
            np.concatenate([part.unit for part in parts]),
        )

    def with_time(self, order: int | None) -> Squares:
        """These with N to Q and correlated noise of the time of this order, or without any."""
        kept = [0, 1, 2, 3, *([] if order is None else [4 + order])]
        return Squares(self.total, self.freedom, self.unit[:, kept])

    def joined(self) -> Squares:
        """Those of several stretches whose variances are made of the same shares, summed."""
        share = np.log(self.unit[:, 1:3] / self.unit[:, :1])
        _, group = np.unique(np.rint(share / _SAME), axis=0, return_inverse=True)
        together = np.eye(int(group.max()) + 1)[group].T
        freedom = together @ self.freedom
        unit = together @ (self.freedom[:, None] * self.unit) / freedom[:, None]
        return Squares(together @ self.total, freedom, unit)


@dataclass(frozen=True)
class Stretch:
    """One isothermal stretch on an even grid.

    `rate` (n,) [deg/h], NaN in gaps; samples behind each row and their variance, where known.
    """

    rate: FloatArray
    counts: FloatArray | None = None
    variances: FloatArray | None = None

    def without(self, gone: BoolArray) -> Stretch:
        """The same with gaps in some rows (n,)."""
        parts = (None if own is None else np.where(gone, np.nan, own) for own in (self.counts, self.variances))
        return Stretch(np.where(gone, np.nan, self.rate), *parts)


def squares_of(
    stretches: Sequence[Stretch], interval_s: float, trend: int, times_s: Times = ()
) -> tuple[Squares | None, Squares]:
    """Squares of the samples within rows of `interval_s` (None where they are not known), and all slower ones.

    A polynomial in time of order `trend` is removed from each stretch (thermal tails). `times_s` are the correlation
    times of the last columns of `unit`. Raises InputError when no stretch is long enough.
    """
    slow = [found for stretch in stretches for found in _slower(stretch.rate, interval_s, trend, times_s)]
    if not slow:
        raise InputError(f"no isothermal stretch has the {trend + 4} means over {interval_s:g} s that the noise needs")
    fast = [found for stretch in stretches for found in _within_rows(stretch, interval_s, times_s)]
    return (fast[0].and_(*fast[1:]) if fast else None), slow[0].and_(*slow[1:]).joined()


def _within_rows(stretch: Stretch, interval_s: float, times_s: Times) -> list[Squares]:
    if stretch.counts is None or stretch.variances is None:
        return []
    known = np.isfinite(stretch.variances) & np.isfinite(stretch.rate) & (stretch.counts > 1)
    if not known.any():
        return []
    counts = stretch.counts[known]
    total = float(np.sum(stretch.variances[known] * (counts - 1)))
    samples = max(2, round(float(np.median(counts))))
    unit = _scatter_unit(samples, interval_s / samples, times_s)
    return [Squares(np.array([total]), np.array([float(np.sum(counts - 1))]), unit[None, :])] if total > 0 else []


def _slower(rate: FloatArray, interval_s: float, trend: int, times_s: Times) -> list[Squares]:
    group = max(1, -(-len(rate) // _MOST_ROWS))
    grouped = rate[: len(rate) // group * group].reshape(-1, group)
    present = np.isfinite(grouped)
    count = present.sum(axis=1)
    full = count * 2 >= group
    if full.sum() < trend + 4:
        return []
    count, present, grouped = count[full], present[full], grouped[full]
    mean = np.where(present, grouped, 0.0).sum(axis=1) / count
    found = [_combined(mean, np.flatnonzero(full), group / count, group * interval_s, trend, times_s)]
    inner = float(np.sum(np.where(present, grouped - mean[:, None], 0.0) ** 2))
    if group > 1 and inner > 0.0:
        unit = _scatter_unit(group, interval_s, times_s)
        found.append(Squares(np.array([inner]), np.array([float(np.sum(count - 1))]), unit[None, :]))
    return found


def _combined(
    mean: FloatArray, index: IntArray, white: FloatArray, interval_s: float, trend: int, times_s: Times
) -> Squares:
    """Squares of combinations of means over `interval_s` at these places of their grid (n,)."""
    places = tuple((index - index[0]).tolist())
    basis, unit = _basis(places, tuple(white.tolist()), interval_s, trend, times_s)
    value = (basis.T @ (mean - mean.mean())) ** 2
    edges, at = list(range(min(_SINGLE, len(value)))), float(_SINGLE)
    while at < len(value):
        edges.append(int(at))
        at = max(at + 1.0, at * _JOINED)
    freedom = np.diff(np.append(edges, len(value))).astype(np.float64)
    return Squares(np.add.reduceat(value, edges), freedom, np.add.reduceat(unit, edges) / freedom[:, None])


@lru_cache(maxsize=16)
def _basis(
    places: tuple[int, ...], white: tuple[float, ...], interval_s: float, trend: int, times_s: Times
) -> tuple[FloatArray, FloatArray]:
    """Combinations (n, n - trend - 1) without the trend, the slowest first, and their variance in units (…, 4)."""
    time_s: FloatArray = (np.array(places, dtype=np.float64) + 0.5) * interval_s
    at = (time_s - time_s.mean()) / np.ptp(time_s)
    rest = np.linalg.qr(np.vander(at, trend + 1), mode="complete")[0][:, trend + 1 :]
    parts = _parts(time_s, interval_s, np.array(white), times_s)
    basis = rest @ np.linalg.eigh(rest.T @ parts[2] @ rest)[1][:, ::-1]
    return basis, np.column_stack([np.sum(basis * (part @ basis), axis=0) for part in parts])


@lru_cache(maxsize=16)
def _scatter_unit(rows: int, interval_s: float, times_s: Times) -> FloatArray:
    """Variance (4 + k,) of neighbouring rows about their own mean, of N, B, K, Q and correlated noise of one."""
    return floor_unit(rows, interval_s, times_s) * (rows / (rows - 1))


def _parts(time_s: FloatArray, interval_s: float, white: FloatArray, times_s: Times) -> tuple[FloatArray, ...]:
    """Covariance (n, n) of means for N, B, K, Q and correlated noise of one [(deg/h)^2]."""
    none, hours = np.zeros(len(time_s)), interval_s / 3600.0
    apart_s = np.abs(time_s[:, None] - time_s[None, :])
    neighbours = np.abs(apart_s - interval_s) < 1e-6 * interval_s
    # The angle is off by q at both ends of a row, and neighbours share one of them.
    steps = (2.0 * np.eye(len(time_s)) - neighbours) / hours**2
    return (
        np.diag(white) / hours,
        covariance(time_s, interval_s, Ratios(1.0, 0.0), none),
        covariance(time_s, interval_s, Ratios(0.0, 1.0), none),
        steps,
        *(_correlated(apart_s, interval_s, tau_s) for tau_s in times_s),
    )


def _correlated(apart_s: FloatArray, interval_s: float, tau_s: float) -> FloatArray:
    """Covariance of means that are `apart_s` (n, n) [s], of noise whose correlation falls as exp(-t / tau), of one."""
    span = interval_s / tau_s
    between = (np.expm1(-span) / span) ** 2 * np.exp(-(np.maximum(apart_s - interval_s, 0.0)) / tau_s)
    return np.where(apart_s < 0.5 * interval_s, _mean_of_correlated(span), between)


def white_unit(interval_s: float, times_s: Times) -> FloatArray:
    """Variance (4 + k,) of one mean of white and of correlated noise of one; that of slower noise does not end."""
    return np.array([3600.0 / interval_s, 0.0, 0.0, 0.0, *(_mean_of_correlated(interval_s / t) for t in times_s)])


def _mean_of_correlated(span: float) -> float:
    """Variance of a mean over `span` correlation times of noise of one whose correlation falls exponentially."""
    return float(2.0 * (span + np.expm1(-span)) / span**2) if span > 1e-4 else 1.0 - span / 3.0


def floor_unit(rows: int, interval_s: float, times_s: Times = ()) -> FloatArray:
    """Mean square (4 + k,) of `rows` means about their own mean, of N, B, K, Q and correlated noise of one.

    The floor's square is linear in their squares. By sums over lags, since the noises' increments are stationary.
    """
    hours, span = interval_s / 3600.0, np.arange(rows, dtype=np.float64)
    flicker = flicker_by_lag(rows, interval_s)
    pairs = np.where(span == 0.0, rows, 2.0 * (rows - span))
    of_flicker = flicker[0] - float(pairs @ flicker) / rows**2
    # Walk: variance grows with time, and neighbours share it up to the earlier one.
    middle = (span + 0.5) * hours
    of_walk = float(middle.mean() - (2.0 * (rows - 1 - span) + 1.0) @ middle / rows**2) - hours / 6.0 * (1 - 1 / rows)
    of_quantisation = (2.0 - 2.0 / rows**2) / hours**2
    of_correlated = [_mean_of_correlated(interval_s / t) - _mean_of_correlated(rows * interval_s / t) for t in times_s]
    return np.array([(1.0 - 1.0 / rows) / hours, of_flicker, of_walk, of_quantisation, *of_correlated])
