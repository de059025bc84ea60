"""A run at constant temperature, which tells the noise of a unit, beside what the terms of a model change in it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bench.analysis.diagnosis.candidates import orthonormal, outside
from bench.analysis.effects.base import Effect
from bench.analysis.fit.disturbances import undisturbed
from bench.analysis.noise.likelihood import Record
from bench.analysis.noise.turning import at_rest, scale_columns
from bench.analysis.thresholds import LEAST_PRESENT, LEAST_STATIC_ROWS, SETTLED_DEGC_PER_MIN
from bench.base import FloatArray, InputError, IntArray, despike
from bench.record import Dataset

_SETTLES_S = 900.0  # of its first part: warm-up and gradients that the thermometer does not see
_MOVES = 0.2  # of the white noise of a mean: what a term changes less is not told from it


@dataclass(frozen=True, eq=False)
class Still:
    """Means of an isothermal run, and the `rows` (n,) in which the temperature stands still."""

    means: Dataset
    rows: IntArray

    @classmethod
    def of(cls, static: Dataset, interval_s: float) -> Still:
        """Raises InputError: rows longer than `interval_s`, or too few of them stand still."""
        means = static.average(interval_s)
        still = np.isfinite(means.bias) & (np.abs(np.nan_to_num(means.dT_dt)) < SETTLED_DEGC_PER_MIN)
        if still.sum() < LEAST_STATIC_ROWS:
            raise InputError(
                f"static run {static.name} has {still.sum()} means over {interval_s:g} s with the temperature "
                f"standing still, at least {LEAST_STATIC_ROWS} are needed: record some hours at one temperature"
            )
        rows = np.flatnonzero(still)
        means = at_rest(means, rows)
        standing = undisturbed(means.select(np.isin(np.arange(len(means)), rows)))
        return cls(means, rows[despike(standing.bias)])  # as the runs are

    @cached_property
    def record(self) -> Record:
        """The noise, beside a constant, the temperature, settling and the scale factor, where a table changed its rate.

        A trend in time, which the temperature does not explain, is left to the noise: nothing else tells a slow cause
        from a random walk.
        """
        time, count = self.means.time[self.rows], self.means.count("rate")[self.rows]
        settling = np.exp((time[0] - time) / _SETTLES_S)
        temperature = self.means.channel("temperature")[self.rows]
        moved = np.nan_to_num(temperature - np.nanmean(temperature))
        trend = np.column_stack([np.ones_like(settling), settling, moved, scale_columns(self.means, self.rows)])
        return Record(time, self.means.bias[self.rows], trend, np.maximum(np.median(count) / count, 1.0))

    def columns(self, effect: Effect) -> FloatArray:
        """What an effect without parameters adds (n_s, k) in the rows of `record`."""
        return effect.columns(self.means, {})[self.rows]

    def beside(self, terms: Iterable[FloatArray]) -> Record:
        """The record beside the terms of a model (n, of all means), each of a size of its own; small ones are noise."""
        record = self.record
        white = float(np.std(record.steps(self.means.interval_s))) / np.sqrt(2.0)
        basis = orthonormal(record.X)
        own = [_filled(record.time_s, term[self.rows]) for term in terms]
        moving = [term for term in own if np.std(outside(basis, term)) > _MOVES * white]
        return replace(record, X=np.column_stack([record.X, *moving])) if moving else record


def _filled(time_s: FloatArray, term: FloatArray) -> FloatArray:
    """A term (n,) with straight lines over gaps of its channel; zeros where most of it is gaps."""
    known = np.isfinite(term)
    return np.interp(time_s, time_s[known], term[known]) if np.mean(known) >= LEAST_PRESENT else np.zeros(len(term))
