"""What the units of a lot say of a further one during its run: the error that its calibration will have.

Equation: y = X g + e, g ~ N(m, S). X are the columns of the lot's model and, beside them, its slopes in each
nonlinear parameter (each unit has its own lag), in coordinates in which |g| is the RMS over the lot's whole run. m and
S are mean and covariance of the lot's units, shrunk (O. Ledoit, M. Wolf, J. Multivar. Anal. 88 (2004) 365) and widened
by 1 + 1/n. e is the noise that the lot's units show (median): white, flicker and walk. Rows so far give the posterior
of g; the root of the trace of its covariance is the error to be expected over the whole run [deg/h RMS]. A unit is used
after its run, so the level contains the flicker and walk that are expected then: a walk stays where it ended.

A model leaves something in every unit that it does not know of. So each unit of the lot is taken in turn for a new one:
cut off after the same time, calibrated by the others, compared with all that was measured of it but its white noise.
Error over expected error is lognormal to a good approximation; its mean and spread make the stated interval.
Where a run goes another way than the lot's, the errors are those of simulated runs of the lot's units (`another_way`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import scipy

from bench.analysis.effects.model import Model
from bench.analysis.fit.design import Bound
from bench.analysis.fit.fitting import Fit, fit_model
from bench.analysis.fit.solve import one_blas_thread
from bench.analysis.judging.another_way import Noise, Unit, Way, among_rows, simulated
from bench.analysis.judging.likeness import LEAST_UNITS, Cells, Likeness, likeness
from bench.analysis.judging.lot import by_unit
from bench.analysis.noise.estimate import profile_noise
from bench.analysis.noise.whitening import Ratios
from bench.base import FloatArray, InputError
from bench.record import Dataset

BLOCK_S = 120.0
"""Rows are averaged to this: noise that is faster does not matter."""
LEVEL = 0.95
_REPEATS = 3
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
class Prior:
    """A lot as the prior of a further unit."""

    fit: Fit
    basis: FloatArray
    """Columns to coordinates (q, p)."""
    known: FloatArray
    """Coordinates of the lot's units (n, p)."""
    noise: Noise
    cells: Cells
    records: Sequence[Dataset]
    """Whole runs of the lot's units."""
    units: Sequence[Unit]
    """The same runs as means over two minutes, and what the others say of each."""
    duration_s: float
    """Of the lot's whole runs."""
    cut_off: dict[int, FloatArray] = field(default_factory=dict)
    """Logarithms of error over expected error of the lot's units, by the blocks after which each was cut off."""

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
            noise = _noise(rows, basis)
            alone = [
                Unit.of(_in(basis, one), known[unit], _moments(np.delete(known, unit, axis=0)), noise, BLOCK_S)
                for unit, one in enumerate(rows)
            ]
            return cls(fit, basis, known, noise, cells, first, alone, duration_s)

    def expected(self, record: Dataset) -> Expected:
        """What the rows of a unit so far make of the error of its calibration."""
        with one_blas_thread():
            rows = self._way(record)
            amplitudes, left = self._posterior(rows, len(rows.bias), *_moments(self.known))
            error = self._of_same(rows, _size(left)) if self._same_way(record) else self._of_another(rows)
        return Expected(*error, amplitudes, left * (error[0] / _size(left)) ** 2, self._seen(record))

    def foreseen(self, planned: Dataset) -> tuple[float, float, float, float]:
        """Error, its 95 % interval [deg/h RMS] and the share of cells seen, of a run that has no bias yet."""
        with one_blas_thread():
            blank = replace(planned, channels={**planned.channels, "rate": np.zeros(len(planned))})
            return (*self._of_another(self._way(blank)), self._seen(planned))

    def _of_same(self, rows: Way, expected_dph: float) -> tuple[float, float, float]:
        """Median and 95 % interval of the error where a run went the lot's way: the lot's units are cut off, too."""
        span_s = rows.time[-1] - rows.time[0]
        blocks = round(span_s / BLOCK_S)
        if blocks not in self.cut_off:
            self.cut_off[blocks] = np.array([self._off(unit, span_s + 0.5 * BLOCK_S) for unit in self.units])
        off = self.cut_off[blocks]
        return self._around(float(np.log(expected_dph) + off.mean()), float(off.std(ddof=1)))

    def _off(self, unit: Unit, span_s: float) -> float:
        """Logarithm of error over expected error of a unit that was cut off."""
        count = max(2, int(np.searchsorted(unit.whole.time - unit.whole.time[0], span_s)))
        amplitudes, left = self._posterior(unit.whole, count, unit.mean, unit.spread)
        return float(np.log(self._left(unit.whole, amplitudes) / _size(left)))

    def _of_another(self, way: Way) -> tuple[float, float, float]:
        """Median and 95 % interval of the error of a whole run after a run that went another way."""
        off = np.log(simulated(way, self.units, self.noise, BLOCK_S, self._level()))
        return self._around(float(off.mean()), float(off.std(ddof=1)))

    def _way(self, record: Dataset) -> Way:
        return _in(self.basis, _rows(self.fit, record))

    def _level(self) -> FloatArray:
        """Amplitudes of a constant of 1 deg/h."""
        return np.asarray(np.linalg.lstsq(self.basis, np.eye(len(self.basis))[0], rcond=None)[0])

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
        try:
            return self._alike([record], float(span_s))[0]
        except InputError:
            return None

    def recognised(self, planned: Dataset) -> float:
        """Share of the lot's units that would look like their lot after a planned run, by model and drawn noise."""
        (white, ratios), random = self.noise, np.random.default_rng(1)
        step = np.sqrt(white * ratios.walk * planned.interval_s / 3600.0)
        rates = self.known.repeat(_REPEATS, axis=0) @ self.columns(planned).T
        rates += np.cumsum(random.normal(0.0, step, rates.shape), axis=1)
        runs = [replace(planned, channels={**planned.channels, "rate": rate}) for rate in rates]
        return float(np.mean([one.like for one in self._alike(runs, np.inf)]))

    def _alike(self, records: Sequence[Dataset], span_s: float) -> Sequence[Likeness]:
        beside = (one.select(one.time - one.time[0] <= span_s) for one in self.records)
        table = np.array([self.cells.means([one]) for one in beside])
        return likeness(table, self.cells, [self.cells.means([one]) for one in records])

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
        return self._left(self._way(record), amplitudes)

    def _around(self, middle: float, spread: float) -> tuple[float, float, float]:
        """Median and 95 % interval [deg/h] by mean and spread of the logarithm, of a further unit of the lot."""
        n = len(self.known)
        reach = float(scipy.stats.t.ppf(0.5 + LEVEL / 2, n - 1)) * spread * np.sqrt(1.0 + 1.0 / n)
        low, error, high = np.exp(middle + np.array([-reach, 0.0, reach])).tolist()
        return error, low, high

    def _posterior(self, rows: Way, count: int, mean: FloatArray, spread: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Amplitudes by the first `count` rows, and their covariance."""
        columns, bias = rows.columns[:count], rows.bias[:count]
        among, later = among_rows(rows.time[:count], self.noise, BLOCK_S)
        gain = columns @ spread
        solved = np.linalg.solve(gain @ columns.T + among, np.column_stack([gain, bias - columns @ mean]))
        amplitudes = mean + gain.T @ solved[:, -1] + self._level() * float(later @ solved[:, -1])
        return amplitudes, spread - gain.T @ solved[:, :-1]

    def _left(self, rows: Way, amplitudes: FloatArray) -> float:
        square = float(np.mean((rows.bias - rows.columns @ amplitudes) ** 2)) - self.noise[0]
        return float(np.sqrt(max(square, _LEAST_SQUARE)))


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


def _in(basis: FloatArray, rows: Way) -> Way:
    """The same with columns in the prior's coordinates."""
    return replace(rows, columns=rows.columns @ basis)


def _rows(fit: Fit, record: Dataset) -> Way:
    """Means over two minutes of the rows that have temperature and bias; effects see the whole record."""
    whole = np.isfinite(record.channel("temperature"))
    record = record.select(whole) if not whole.all() else record
    columns = np.column_stack([record.time, record.channel("temperature"), _columns(fit, record), record.bias])
    columns = columns[np.isfinite(columns[:, -1])]
    if not len(columns):
        raise InputError(f"{record.name}: no row has a temperature and a rate")
    block = ((columns[:, 0] - columns[0, 0]) // BLOCK_S).astype(np.int64)
    starts = np.flatnonzero(np.diff(block, prepend=-1))
    means = np.add.reduceat(columns, starts) / np.diff(np.append(starts, len(columns)))[:, None]
    return Way(means[:, 0], means[:, 1], means[:, 2:-1], means[:, -1])


def _noise(rows: Sequence[Way], basis: FloatArray) -> Noise:
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
