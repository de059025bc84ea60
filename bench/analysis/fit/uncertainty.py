"""Covariance of a least-squares estimate when the residual is not white."""

from __future__ import annotations

from functools import partial
from typing import Literal

import numpy as np

from bench.analysis.fit.design import Bound, FitRows
from bench.analysis.fit.solve import Solution, sandwich, solve
from bench.analysis.noise.estimate import Noise, profile_noise
from bench.analysis.noise.likelihood import Record
from bench.analysis.noise.whitening import covariance as noise_covariance
from bench.base import FloatArray, IntArray

CovarianceKind = Literal["noise", "sandwich", "none"]
_LEAST_BLOCK_S = 300.0
_MOST_DENSE_ROWS = 4000


def estimate_covariance(
    rows: FitRows, bound: Bound, columns: FloatArray, solution: Solution, kind: CovarianceKind
) -> tuple[FloatArray, Noise | None]:
    """Covariance (1 + k + m, ..) of amplitudes and nonlinear parameters jointly, and the noise behind it.

    `noise`: P C P' with P the estimate's own pseudo-inverse and C = white + flicker + random walk, most likely beside
    these columns (what the model fails to explain counts as noise and widens it). `sandwich`: sums of scores over
    blocks of at least 300 s. NaN where no row is left to judge by, or for `none`.
    """
    size = columns.shape[1] + len(rows.parameters)
    if kind == "none" or rows.y.size <= size + 1:
        return np.full((size, size), np.nan), None
    jacobian = np.hstack([columns, _slopes(rows, bound, solution)])
    full = solve(jacobian, rows.y, rows.weights)
    if not np.isfinite(full.condition):  # a parameter without influence: its own deviation is unknown
        return np.full((size, size), np.nan), None
    inverse = full.pseudo_inverse(rows.weights)
    # Bins are means of rows from anywhere in the run: they have no spectrum.
    if kind == "sandwich" or rows.y.size > _MOST_DENSE_ROWS or rows.model.rows == "bins":
        return sandwich(inverse, solution.residual, _time_blocks(rows, size)), None
    return _under_noise(rows, jacobian, inverse)


def _slopes(rows: FitRows, bound: Bound, solution: Solution) -> FloatArray:
    """Derivative of the model with respect to each nonlinear parameter (rows, m)."""
    values = np.array([value for own in bound.theta.values() for value in own.values()])
    out = np.zeros((rows.y.size, values.size))
    for i, slope in enumerate(rows.slopes(values, partial(_model, rows, bound, solution))):
        out[:, i] = slope
    return out


def _model(rows: FitRows, bound: Bound, solution: Solution, values: FloatArray) -> FloatArray:
    given = iter(values.tolist())
    theta = {key: {name: next(given) for name in own} for key, own in bound.theta.items()}
    moved = Bound(bound.keys, bound.effects, theta, bound.slices)
    parts = [moved.columns(r)[m] for r, m in zip(rows.records, rows.masks, strict=True)]
    return np.concatenate(parts) @ solution.beta


def _time_blocks(rows: FitRows, size: int) -> IntArray:
    """Contiguous blocks as long as the rows allow: at least 300 s, and more blocks than coefficients."""
    duration = sum(float(np.ptp(time)) for time in rows.time)
    length = max(_LEAST_BLOCK_S, duration / max(2 * size, 40))
    labels, used = [], 0
    for time in rows.time:
        own = used + ((time - time.min(initial=np.inf)) // length).astype(np.int64)
        used = int(own.max(initial=used)) + 1
        labels.append(own)
    return np.concatenate(labels)


def _under_noise(rows: FitRows, jacobian: FloatArray, inverse: FloatArray) -> tuple[FloatArray, Noise]:
    interval_s = rows.records[0].interval_s
    ends = np.cumsum([time.size for time in rows.time])[:-1]
    parts = [np.split(array, ends) for array in (rows.y, jacobian, 1.0 / rows.weights)]
    records = [
        Record(time, y, own, white) for time, y, own, white in zip(rows.time, *parts, strict=True) if time.size > 1
    ]
    first = max(range(len(records)), key=lambda i: records[i].y.size)
    others = [record for i, record in enumerate(records) if i != first]
    noise = profile_noise(records[first].X, records[first].y, records[first].time_s, others, interval_s)
    covariance = np.zeros((inverse.shape[0],) * 2)
    for own, time, white in zip(np.split(inverse, ends, axis=1), rows.time, parts[2], strict=True):
        if time.size:
            dense = noise_covariance(time, interval_s, noise.ratios, white)
            covariance += noise.sigma2 * (own @ dense @ own.T)
    return covariance, noise.noise
