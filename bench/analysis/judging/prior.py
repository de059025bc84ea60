"""What the units of a lot say of a further one during its run: the error that its calibration will have.

Equation: y = X g + e, g ~ N(m, S). X are the columns of the lot's model and, beside them, its slopes in each
nonlinear parameter (each unit has its own lag), in coordinates in which |g| is the RMS over the lot's whole run. m and
S are mean and covariance of the lot's units, shrunk (O. Ledoit, M. Wolf, J. Multivar. Anal. 88 (2004) 365) and widened
by 1 + 1/n. e is the noise that the lot's units show (median): white, flicker and walk. Rows so far give the posterior
of g; the root of the trace of its covariance is the error to be expected over the whole run [deg/h RMS]. The level is
the one with which the rows so far have no residual on average, as in a fit.

A model leaves something in every unit that it does not know of. So each unit of the lot is taken in turn for a new one:
cut off, calibrated by the others, compared with all that was measured of it but its white noise. Error over expected
error is lognormal to a good approximation; its mean and spread, over the expected error, make the stated interval.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from bench.analysis.effects.model import Model
from bench.analysis.fit.design import Bound
from bench.analysis.fit.fitting import Fit, fit_model
from bench.analysis.fit.solve import one_blas_thread
from bench.analysis.judging.likeness import LEAST_UNITS, Cells, Likeness, likeness
from bench.analysis.judging.lot import by_unit
from bench.analysis.noise.estimate import profile_noise
from bench.analysis.noise.whitening import Ratios
from bench.analysis.noise.whitening import covariance as dense
from bench.base import FloatArray, InputError
from bench.record import Dataset

BLOCK_S = 120.0
"""Rows are averaged to this: noise that is faster does not matter."""
SHARES = tuple(np.arange(0.1, 1.001, 0.1).tolist())
"""Of its run after which each unit of the lot is cut off."""
_EVERY = 5
_LATEST = 0.75
"""Share after which what is left of a run is too little to judge by."""
LEVEL = 0.95
_STEP = 1.1  # factor of a nonlinear parameter, up and down, for its slope
_LEAST_DIRECTION = 1e-5
_LEAST_SQUARE = 1e-6
_FARTHEST = 12.0  # powers of the step: a factor of ten
_SAME_DEGC = 5.0  # a thermometer that lags by five minutes at 1 degC/min


@dataclass(frozen=True, eq=False)
class Expected:
    """The error of a calibration by the rows so far, over the lot's whole run [deg/h RMS]: median and 95 % interval."""

    error_dph: float
    low_dph: float
    high_dph: float
    amplitudes: FloatArray
    """In the prior's coordinates (p,) …"""
    covariance: FloatArray
    """… and their covariance, as large as the units of the lot show."""
    seen: float
    """Share of the cells of temperature in which the unit was."""


@dataclass(frozen=True, eq=False)
class _Rows:
    """Means over two minutes of one run."""

    time: FloatArray
    columns: FloatArray
    bias: FloatArray


@dataclass(frozen=True, eq=False)
class Prior:
    """A lot as the prior of a further unit."""

    fit: Fit
    basis: FloatArray
    """Columns to coordinates (q, p)."""
    known: FloatArray
    """Coordinates of the lot's units (n, p)."""
    noise: tuple[float, Ratios]
    """White variance of a mean [(deg/h)^2], and flicker and walk beside it."""
    cells: Cells
    records: Sequence[Dataset]
    """Whole runs of the lot's units."""
    scale: FloatArray
    """Expected error (k,), and mean and spread of the logarithm of error over expected error there (3, k)."""
    beyond: FloatArray
    """The same of what comes after the cut alone: of a calibration by another run than the lot's."""
    duration_s: float
    """Of the lot's whole runs."""

    @classmethod
    def of(cls, model: Model, records: Sequence[Dataset]) -> Prior:
        """From whole runs of one profile, one of each unit. InputError: fewer than ten units, or nothing in common."""
        units = by_unit(records)
        if len(units) < LEAST_UNITS:
            raise InputError(f"a lot of {len(units)} units is no prior; at least {LEAST_UNITS} are needed")
        if more := sorted(set(model.needs) - {"temperature"}):
            raise InputError(f"model '{model.name}' needs {', '.join(more)}; a lot's prior takes models of temperature")
        first = [own[0] for own in units.values()]
        with one_blas_thread():
            fit = fit_model(model, first, covariance="none", weights="count")
            rows = [_rows(fit, record) for record in first]
            stacked = np.concatenate([one.columns / np.sqrt(len(one.bias)) for one in rows]) / np.sqrt(len(rows))
            _, sizes, directions = np.linalg.svd(stacked, full_matrices=False)
            kept = sizes > _LEAST_DIRECTION * sizes[0]
            basis = directions[kept].T / sizes[kept]
            known = np.array([np.linalg.lstsq(one.columns @ basis, one.bias, rcond=None)[0] for one in rows])
            low = max(float(np.nanmin(record.channel("temperature"))) for record in first)
            high = min(float(np.nanmax(record.channel("temperature"))) for record in first)
            if not low < high:
                raise InputError("the units of this lot have no temperature in common")
            cells = Cells.over(low, high)
            duration_s = float(np.median([record.time[-1] - record.time[0] for record in first]))
            none = np.zeros((3, 1))
            prior = cls(fit, basis, known, _noise(rows, basis), cells, first, none, none, duration_s)
            scale, beyond = prior._checked(rows)
            return replace(prior, scale=scale, beyond=beyond)

    def expected(self, record: Dataset) -> Expected:
        """What the rows of a unit so far make of the error of its calibration."""
        with one_blas_thread():
            rows = _rows(self.fit, record)
            amplitudes, left = self._posterior(rows, len(rows.bias), *_moments(self.known))
        error = self._interval(_size(left), self.scale) if self._same_way(record) else self._of_another(rows, left)
        return Expected(*error, amplitudes, left * (error[0] / _size(left)) ** 2, self._seen(record))

    def foreseen(self, planned: Dataset) -> tuple[float, float, float, float]:
        """Error, its 95 % interval [deg/h RMS] and the share of cells seen, of a run that has no bias yet."""
        with one_blas_thread():
            blank = replace(planned, channels={**planned.channels, "rate": np.zeros(len(planned))})
            rows = _rows(self.fit, blank)
            _, left = self._posterior(rows, len(rows.bias), *_moments(self.known))
        return (*self._of_another(rows, left), self._seen(planned))

    def _of_another(self, rows: _Rows, left: FloatArray) -> tuple[float, float, float]:
        """Median and 95 % interval of the error of a whole run after a run that went another way."""
        after = rows.time[-1] + np.arange(BLOCK_S, self.duration_s, BLOCK_S)
        return self._interval(np.hypot(_size(left), self._moves(rows.time, after)), self.beyond)

    def _moves(self, seen: FloatArray, after: FloatArray) -> float:
        """How far slow noise goes from the mean of the times `seen` at the times `after` [deg/h RMS]."""
        white, ratios = self.noise
        seen, after = seen[::_EVERY], after[::_EVERY]  # it is slow
        time = np.concatenate([seen, after])
        slow, n = white * dense(time, BLOCK_S, ratios, np.zeros(time.size)), seen.size
        square = np.trace(slow[n:, n:]) / after.size - 2.0 * slow[n:, :n].mean() + slow[:n, :n].mean()
        return float(np.sqrt(max(square, 0.0)))

    def _seen(self, record: Dataset) -> float:
        temperature = record.channel("temperature")
        visited = np.histogram(temperature[np.isfinite(temperature)], self.cells.borders)[0] > 0
        return float(visited.mean())

    def like(self, record: Dataset) -> Likeness | None:
        """Whether the unit is like its lot as far as it was seen; None where too little was seen to tell.

        The lot's units are cut off after the same time where they went the same way: a lag makes the bias in a cell
        depend on the rates so far.
        """
        span_s = record.time[-1] - record.time[0] if self._same_way(record) else np.inf
        beside = (one.select(one.time - one.time[0] <= span_s) for one in self.records)
        table = np.array([self.cells.means([one]) for one in beside])
        try:
            return likeness(table, self.cells, [self.cells.means([record])])[0]
        except InputError:
            return None

    def _same_way(self, record: Dataset) -> bool:
        """Whether a unit went through the temperatures of the lot at the same times."""
        beside = self.records[0]
        there = np.interp(record.time - record.time[0], beside.time - beside.time[0], beside.channel("temperature"))
        return float(np.nanmean(np.abs(record.channel("temperature") - there))) < _SAME_DEGC

    def curve(self, record: Dataset, amplitudes: FloatArray) -> FloatArray:
        """Bias (n,) of any record by these amplitudes [deg/h]."""
        return self.columns(record) @ amplitudes

    def columns(self, record: Dataset) -> FloatArray:
        """What the amplitudes multiply (n, p)."""
        return _columns(self.fit, record) @ self.basis

    def parameters(self, amplitudes: FloatArray) -> list[float]:
        """The nonlinear parameters to which the slopes of these amplitudes lead."""
        values = [value for own in self.fit.bound.theta.values() for value in own.values()]
        slopes = (self.basis @ amplitudes)[len(self.basis) - len(values) :]
        powers = np.clip(slopes, -_FARTHEST, _FARTHEST).tolist()
        return [value * _STEP ** (2.0 * power) for value, power in zip(values, powers, strict=True)]

    def error(self, record: Dataset, amplitudes: FloatArray) -> float:
        """What these amplitudes leave of a run [deg/h RMS], without white noise."""
        rows = _rows(self.fit, record)
        return self._left(rows, amplitudes)

    def _interval(self, expected_dph: float, scale: FloatArray) -> tuple[float, float, float]:
        """Median and 95 % interval of the error where the posterior expects this one [deg/h]."""
        at, means, spreads = np.log(scale[0]), scale[1], scale[2]
        x, n = np.log(expected_dph), len(self.known)
        middle, spread = (float(np.interp(x, at, values)) for values in (means, spreads))
        reach = float(scipy.stats.t.ppf(0.5 + LEVEL / 2, n - 1)) * spread * np.sqrt(1.0 + 1.0 / n)
        low, error, high = np.exp(x + middle + np.array([-reach, 0.0, reach])).tolist()
        return error, low, high

    def _checked(self, rows: Sequence[_Rows]) -> tuple[FloatArray, FloatArray]:
        """`scale` and `beyond`: each unit of the lot, cut off and calibrated by the others."""
        found = np.empty((4, len(SHARES), len(rows)))
        for unit, one in enumerate(rows):
            others = _moments(np.delete(self.known, unit, axis=0))
            for i, share in enumerate(SHARES):
                count = max(2, round(share * len(one.bias)))
                amplitudes, left = self._posterior(one, count, *others)
                error, rest = _size(left), _Rows(one.time[count:], one.columns[count:], one.bias[count:])
                found[:2, i, unit] = error, np.log(self._left(one, amplitudes) / error)
                if share <= _LATEST:
                    found[2, i, unit] = np.hypot(error, self._moves(one.time[:count], rest.time))
                    found[3, i, unit] = np.log(self._left(rest, amplitudes) / found[2, i, unit])
        early = np.array(SHARES) <= _LATEST
        return _table(found[0], found[1]), _table(found[2, early], found[3, early])

    def _posterior(
        self, rows: _Rows, count: int, mean: FloatArray, spread: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Amplitudes by the first `count` rows, and their covariance."""
        columns, bias = rows.columns[:count] @ self.basis, rows.bias[:count]
        white, ratios = self.noise
        gain = columns @ spread
        whole = gain @ columns.T + white * dense(rows.time[:count], BLOCK_S, ratios)
        solved = np.linalg.solve(whole, np.column_stack([gain, bias - columns @ mean]))
        amplitudes = mean + gain.T @ solved[:, -1]
        left = spread - gain.T @ solved[:, :-1]
        level = np.linalg.lstsq(self.basis, np.eye(len(self.basis))[0], rcond=None)[0]
        amplitudes = amplitudes + level * float(np.mean(bias - columns @ amplitudes))
        return amplitudes, left

    def _left(self, rows: _Rows, amplitudes: FloatArray) -> float:
        square = float(np.mean((rows.bias - rows.columns @ self.basis @ amplitudes) ** 2)) - self.noise[0]
        return float(np.sqrt(max(square, _LEAST_SQUARE)))


def _table(expected: FloatArray, off: FloatArray) -> FloatArray:
    """Mean expected error, mean and spread of the logarithms (k, n) beside it, in its order (3, k)."""
    table = np.array([expected.mean(axis=1), off.mean(axis=1), off.std(axis=1, ddof=1)])
    return table[:, np.argsort(table[0])]


def _size(covariance: FloatArray) -> float:
    """Error to be expected over the lot's whole run [deg/h RMS]."""
    return float(np.sqrt(max(np.trace(covariance), _LEAST_SQUARE)))


def _columns(fit: Fit, record: Dataset) -> FloatArray:
    """Columns of the lot's model and its slopes in the nonlinear parameters (n, q)."""
    parts = [fit.bound.columns(record)]
    for effect, own in fit.bound.theta.items():
        for name, value in own.items():
            ends = (_moved(fit.bound, effect, name, factor * value) for factor in (_STEP, 1.0 / _STEP))
            high, low = (end.columns(record) @ fit.beta for end in ends)
            parts.append((high - low)[:, None])
    return np.hstack(parts)


def _moved(bound: Bound, effect: str, name: str, value: float) -> Bound:
    return replace(bound, theta={**bound.theta, effect: {**bound.theta[effect], name: value}})


def _rows(fit: Fit, record: Dataset) -> _Rows:
    """Means over two minutes of the rows that have temperature and bias; effects see the whole record."""
    whole = np.isfinite(record.channel("temperature"))
    record = record.select(whole) if not whole.all() else record
    columns = np.column_stack([record.time, _columns(fit, record), record.bias])
    columns = columns[np.isfinite(columns[:, -1])]
    if not len(columns):
        raise InputError(f"{record.name}: no row has a temperature and a rate")
    block = ((columns[:, 0] - columns[0, 0]) // BLOCK_S).astype(np.int64)
    starts = np.flatnonzero(np.diff(block, prepend=-1))
    means = np.add.reduceat(columns, starts) / np.diff(np.append(starts, len(columns)))[:, None]
    return _Rows(means[:, 0], means[:, 1:-1], means[:, -1])


def _noise(rows: Sequence[_Rows], basis: FloatArray) -> tuple[float, Ratios]:
    found = [profile_noise(one.columns @ basis, one.bias, one.time, (), BLOCK_S) for one in rows]
    white = float(np.median([one.sigma2 for one in found]))
    flicker = float(np.median([one.sigma2 * one.ratios.flicker for one in found]))
    walk = float(np.median([one.sigma2 * one.ratios.walk for one in found]))
    return white, Ratios(flicker / white, walk / white)


def _moments(known: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean and covariance of units (n, p), shrunk towards equal variances, and wider for a further unit."""
    n, mean = len(known), known.mean(axis=0)
    apart = known - mean
    own = apart.T @ apart / (n - 1)
    size = float(np.trace(own)) / len(own)
    target = size * np.eye(len(own))
    distance = float(np.sum((own - target) ** 2))
    scatter = sum(float(np.sum((np.outer(one, one) - own) ** 2)) for one in apart) / n**2
    share = min(scatter / distance, 1.0) if distance else 1.0
    return mean, ((1.0 - share) * own + share * target) * (1.0 + 1.0 / n)
