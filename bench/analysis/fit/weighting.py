"""How the rows of a fit count: by the samples behind each, or by the noise that the fit itself shows.

The noise (white + flicker + random walk) is the most likely one beside the model's columns; what it leaves of the
correlation of rows is taken away before least squares (generalised least squares; A. C. Aitken, Proc. R. Soc. Edinb. 55
(1935) 42). The level alone is not: at which value the slow noise stood in the first row is not known, so the constant
is the one with which the residual is zero on average over the rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from bench.analysis.fit.design import FitRows
from bench.analysis.fit.solve import solve
from bench.analysis.noise.estimate import NoiseFit, profile_noise
from bench.analysis.noise.floor import noise_floor
from bench.analysis.noise.likelihood import Record
from bench.analysis.noise.whitening import Whitener
from bench.analysis.noise.whitening import covariance as dense
from bench.analysis.thresholds import MOST_CONDITION
from bench.base import BoolArray, FloatArray, InputError

WeightsKind = Literal["noise", "count"]
_MOST_LEFT = 2.5
"""Noise floors that a fit may leave: models that lack nothing left up to 2.55, such as lack an effect 2.3 to 9.6
(`python -m benchmarks.weighting`)."""
OF_SUMS = (
    "the sums of a pass over the samples do not keep their order in time, so that slow noise cannot be taken away; "
    "every sample counts alike"
)
"""Why a fit that is made from sums alone is not weighted by the noise."""
MOST_ROWS = 4000
"""Rows up to which the noise is estimated beside a model: its whiteners take half a megabyte for a thousand rows."""


@dataclass(frozen=True, eq=False)
class NoiseWeights:
    """Noise of the rows of a fit, which fits to a part of the same rows share."""

    found: NoiseFit
    masks: tuple[BoolArray, ...]
    """Rows (n,) of each record that the noise was estimated from."""
    whiteners: tuple[Whitener | None, ...]
    """One a record; None where it has no row."""

    def whitening(self, rows: FitRows) -> Whitening:
        """For these rows, all or a part of those that the noise was estimated from.

        Where rows are left out, each gets a free value, which is as good as leaving it out and needs no new whitener.
        """
        parts = []
        for way, whole, mask in zip(self.whiteners, self.masks, rows.masks, strict=True):
            if way is None:
                continue
            kept = mask[whole]
            free = np.zeros((kept.size, 0))
            if not kept.all():
                free = np.linalg.qr(way.apply(np.eye(kept.size)[:, ~kept]))[0]
            parts.append(_Part(way, kept, free))
        return Whitening(tuple(parts))


@dataclass(frozen=True, eq=False)
class _Part:
    """The rows of one record: its whitener, those that are kept (n,), and a basis (n, k) of the others' free values."""

    way: Whitener
    kept: BoolArray
    free: FloatArray

    def apply(self, matrix: FloatArray) -> FloatArray:
        spread = np.zeros((self.kept.size, *matrix.shape[1:]))
        spread[self.kept] = matrix
        white = self.way.apply(spread)
        return np.asarray(white - self.free @ (self.free.T @ white))


@dataclass(frozen=True, eq=False)
class Whitening:
    """Turns rows into as many or more of independent errors of one size."""

    parts: tuple[_Part, ...]

    def __call__(self, matrix: FloatArray) -> FloatArray:
        """Whitened columns (rows, p) or one vector (rows,) of all records, one below the other."""
        ends = np.cumsum([int(part.kept.sum()) for part in self.parts])[:-1]
        return np.concatenate([p.apply(own) for p, own in zip(self.parts, np.split(matrix, ends), strict=True)])


def noise_weights(rows: FitRows, jacobian: FloatArray) -> NoiseWeights | str:
    """The noise of rows beside the columns of their model and its slopes (rows, q), or why it cannot be estimated."""
    if rows.model.rows == "bins":
        return "means of bins come from anywhere in the run: they have no order in time"
    if rows.y.size <= jacobian.shape[1] + 1:
        return f"{rows.y.size} rows for {jacobian.shape[1]} coefficients leave none to estimate the noise from"
    if rows.y.size > MOST_ROWS:
        return f"the noise is estimated from at most {MOST_ROWS} rows, there are {rows.y.size}"
    if not np.isfinite(solve(jacobian, rows.y, rows.weights).condition):
        return "a parameter without influence: its rows say nothing about the noise"
    interval_s = rows.records[0].interval_s
    parts = [_split(rows, array) for array in (rows.y, jacobian, 1.0 / rows.weights)]
    records = [Record(time, *own) for time, *own in zip(rows.time, *parts, strict=True) if time.size > 1]
    if not records:
        return "no run has two rows"
    first = max(range(len(records)), key=lambda i: records[i].y.size)
    others = [record for i, record in enumerate(records) if i != first]
    found = profile_noise(records[first].X, records[first].y, records[first].time_s, others, interval_s)
    whiteners = tuple(
        Whitener.of(found.ratios, time, interval_s, white) if time.size else None
        for time, white in zip(rows.time, parts[2], strict=True)
    )
    return NoiseWeights(found, rows.masks, whiteners)


def lacking(rows: FitRows, rms_dph: float) -> str:
    """Why the noise beside a model is not its noise: the fit leaves much more than what the stand-stills show.

    What a model lacks would pass for slow noise, and weights by it make the coefficients worse, not better.
    """
    step = max(record.temperature_step for record in rows.records)
    if step > 0.0:
        return f"the thermometer moves in steps of {step:.3g} degC: what they cause would pass for slow noise"
    floor_dph = noise_floor(rows.records, rows.records[0].interval_s, intervals=False).floor_dph
    if not rms_dph > _MOST_LEFT * floor_dph:
        return ""
    return (
        f"the fit leaves {rms_dph / floor_dph:.2g} times the noise of what stands still, more than {_MOST_LEFT:g}: "
        "what the model lacks would pass for slow noise"
    )


def solved(rows: FitRows, columns: FloatArray, whitening: Whitening) -> FloatArray:
    """Coefficients (p,) of columns (rows, p), the first of ones."""
    white_y = whitening(rows.y)
    found = solve(whitening(columns), white_y, np.ones(white_y.size))
    if not found.condition <= MOST_CONDITION:
        raise InputError(f"model '{rows.model.name}' is not determined by these rows beside their slow noise")
    beta = found.beta.copy()
    beta[0] += np.average(rows.y - columns @ beta, weights=rows.weights)
    return beta


def covariance(rows: FitRows, jacobian: FloatArray, weights: NoiseWeights) -> FloatArray:
    """Covariance (q, q) of the coefficients of `solved`, the nonlinear parameters' slopes among the columns.

    It is that of generalised least squares but for the variance of the constant: with m the means of the columns and c
    the variance of the mean of the noise, that grows by c - m' G m, which is not negative (Gauss-Markov).
    """
    white = weights.whitening(rows)(jacobian)
    full = solve(white, white[:, 0], np.ones(len(white)))
    if not np.isfinite(full.condition):
        return np.full((jacobian.shape[1],) * 2, np.nan)
    half = full.pseudo_inverse(np.ones(len(white)))
    own: FloatArray = weights.found.sigma2 * (half @ half.T)
    share = rows.weights / rows.weights.sum()
    means = jacobian.T @ share
    own[0, 0] += max(float(of_counted(rows, share[None, :], weights)[0, 0] - means @ own @ means), 0.0)
    return own


def of_counted(rows: FitRows, inverse: FloatArray, weights: NoiseWeights) -> FloatArray:
    """Covariance (q, q) of what a matrix (q, rows) makes of rows with this noise."""
    interval_s, total = rows.records[0].interval_s, np.zeros((len(inverse),) * 2)
    ends = np.cumsum([time.size for time in rows.time])[:-1]
    parts = zip(rows.time, np.split(inverse, ends, axis=1), _split(rows, 1.0 / rows.weights), strict=True)
    for time, own, white in parts:
        if time.size:
            total += own @ dense(time, interval_s, weights.found.ratios, white) @ own.T
    return weights.found.sigma2 * total


def _split(rows: FitRows, array: FloatArray) -> Sequence[FloatArray]:
    """Values of all rows by record."""
    return np.split(array, np.cumsum([time.size for time in rows.time])[:-1])
