"""Covariance of a least-squares estimate when the residual is not white."""

from __future__ import annotations

from functools import partial
from typing import Literal

import numpy as np

from bench.analysis.fit.design import Bound, FitRows
from bench.analysis.fit.solve import sandwich, solve
from bench.analysis.fit.weighting import NoiseWeights, of_counted
from bench.base import FloatArray, IntArray

CovarianceKind = Literal["noise", "sandwich", "none"]
_LEAST_BLOCK_S = 300.0


def counted_covariance(
    rows: FitRows, jacobian: FloatArray, residual: FloatArray, noise: NoiseWeights | None
) -> FloatArray:
    """Covariance (q, q) of count-weighted amplitudes and nonlinear parameters jointly; `residual` (rows,) [deg/h].

    With a `noise`: P C P' with P the estimate's own pseudo-inverse and C = white + flicker + random walk, most likely
    beside these columns (what the model fails to explain counts as noise and widens it). Without: sums of scores over
    blocks of at least 300 s. NaN where no row is left to judge by.
    """
    size = jacobian.shape[1]
    full = solve(jacobian, rows.y, rows.weights)
    if rows.y.size <= size + 1 or not np.isfinite(full.condition):
        return np.full((size, size), np.nan)  # a parameter without influence: its own deviation is unknown
    inverse = full.pseudo_inverse(rows.weights)
    if noise is None:
        return sandwich(inverse, residual, _time_blocks(rows, size))
    return of_counted(rows, inverse, noise)


def jacobian_of(rows: FitRows, bound: Bound, columns: FloatArray, beta: FloatArray) -> FloatArray:
    """Columns (rows, q) of the amplitudes, then the derivative of the model by each parameter inside its range.

    One on an end of its range is not determined, and is stated so: what goes with it are the amplitudes at that value.
    """
    values = np.array([value for own in bound.theta.values() for value in own.values()])
    slopes = rows.slopes(values, partial(_model, rows, bound, beta))
    return np.column_stack([columns, *(slope for slope, own in zip(slopes, rows.inside(values), strict=True) if own)])


def _model(rows: FitRows, bound: Bound, beta: FloatArray, values: FloatArray) -> FloatArray:
    given = iter(values.tolist())
    theta = {key: {name: next(given) for name in own} for key, own in bound.theta.items()}
    moved = Bound(bound.keys, bound.effects, theta, bound.slices)
    parts = [moved.columns(r)[m] for r, m in zip(rows.records, rows.masks, strict=True)]
    return np.concatenate(parts) @ beta


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
