"""Least squares that has already been summed: a quadratic form instead of rows, one alone or one for each group."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from bench.analysis.thresholds import MOST_CONDITION
from bench.base import FloatArray, InputError

_EPS = np.finfo(float).eps
_RIDGE = 1e-13


@dataclass(frozen=True, eq=False)
class Normal:
    """Square sum of y - A b as a function of b: `square` - 2 `right` b + b `gram` b, over `rows` rows.

    Shapes (..., p, p), (..., p), (...), (...): leading axes are groups. b of the model is `back` @ b + `start`: the
    columns were made nearly orthonormal, and y was taken relative to a first guess, before anything was summed.
    """

    gram: FloatArray
    right: FloatArray
    square: FloatArray
    rows: FloatArray
    back: FloatArray
    start: FloatArray

    def sum(self) -> Normal:
        """The form of all groups."""
        whole = np.ones(self.right.shape[0])
        parts = (self.gram, self.right, self.square, self.rows)
        gram, right, square, rows = (np.asarray(np.tensordot(whole, part, 1)) for part in parts)
        return Normal(gram, right, square, rows, self.back, self.start)

    def error(self, inner: FloatArray) -> FloatArray:
        """Square sum of the residuals (...) of coefficients in the inner basis (p,) or (..., p)."""
        curved = (self.gram @ inner[..., None])[..., 0]
        squares: FloatArray = np.maximum(self.square + np.sum(inner * (curved - 2.0 * self.right), axis=-1), 0.0)
        return squares

    def model(self, inner: FloatArray) -> FloatArray:
        """Coefficients of the model's own columns."""
        return self.back @ inner + self.start


@dataclass(frozen=True, eq=False)
class Solved:
    """Coefficients (p,) of the model's columns and of the inner basis, and the fit's square sum, rows, condition."""

    beta: FloatArray
    inner: FloatArray
    rss: float
    rows: float
    condition: float

    @property
    def rms_dph(self) -> float:
        """RMS of the residuals [deg/h]."""
        return float(np.sqrt(self.rss / self.rows))


def solve(form: Normal) -> Solved:
    """Least squares of a form without groups; InputError where the rows do not determine it."""
    scale = np.sqrt(np.diag(form.gram))
    if form.rows < scale.size or np.any(scale == 0.0):
        raise InputError(f"{form.rows:.0f} rows for {scale.size} coefficients: record more, or fit less")
    scaled = form.gram / np.outer(scale, scale)
    values = scipy.linalg.eigvalsh(scaled)
    condition = condition_of(form, scale)
    if not values[0] > values[-1] * _EPS * len(values) or not condition <= MOST_CONDITION:
        raise InputError(f"not determined by these rows (condition {condition:.1g}, limit {MOST_CONDITION:.0e})")
    factor = scipy.linalg.cho_factor(scaled)
    inner = scipy.linalg.cho_solve(factor, form.right / scale)
    # One step of refinement: what the first solve left over is solved again.
    inner = (inner + scipy.linalg.cho_solve(factor, form.right / scale - scaled @ inner)) / scale
    return Solved(form.model(inner), inner, float(form.error(inner)), float(form.rows), condition)


def penalised_rms(form: Normal, penalty: FloatArray) -> float:
    """RMS [deg/h] of the rows beside the fit that a penalty (p, p) holds where no rows are, inf where none is left.

    Squares count over the rows less the effective number of coefficients: few rows are not taken for a good fit.
    """
    scale = np.sqrt(np.diag(form.gram + penalty))
    scaled = (form.gram + penalty) / np.outer(scale, scale) + _RIDGE * np.eye(scale.size)
    inner = np.linalg.solve(scaled, form.right / scale) / scale
    left = float(form.rows - np.trace(np.linalg.solve(scaled, form.gram / np.outer(scale, scale))))
    return float(np.sqrt(form.error(inner) / left)) if left >= 1.0 else np.inf


def condition_of(form: Normal, scale: FloatArray) -> float:
    """Condition of the model's own columns, each scaled to norm one, as `bench.analysis.fit.solve` has it."""
    try:
        triangle = scipy.linalg.cholesky(form.gram / np.outer(scale, scale)) * scale
    except scipy.linalg.LinAlgError:
        return np.inf
    # A = Q (triangle @ back^-1): the condition is that of the triangle, without the rows.
    own = scipy.linalg.solve(form.back.T, triangle.T).T
    spectrum = scipy.linalg.svdvals(own / np.linalg.norm(own, axis=0))
    return float(spectrum[0] / spectrum[-1]) if spectrum[-1] > spectrum[0] * _EPS else np.inf


def sandwich(groups: Normal, inner: FloatArray) -> FloatArray:
    """Covariance (p, p) of the model's coefficients from the scores of the groups, as `solve.sandwich`."""
    scores = groups.right - groups.gram @ inner
    whole = groups.sum()
    count, (n, p) = len(scores), (float(whole.rows), inner.size)
    factor = count / max(count - 1, 1) * n / max(n - p, 1.0)
    half = groups.back @ scipy.linalg.solve(whole.gram, scores.T, assume_a="sym")
    covariance: FloatArray = factor * (half @ half.T)
    return covariance


def left_out(groups: Normal, penalty: FloatArray | None = None, fitted: Normal | None = None) -> FloatArray:
    """Square sums (g,) of every group predicted by the fit to all others; NaN where the others do not determine it.

    `penalty` (p, p) is added to every Gram matrix; `fitted` are the same groups with only the rows that are fitted.
    All folds are solved in one batch.
    """
    own = groups if fitted is None else fitted
    whole = own.sum()
    gram, right = whole.gram - own.gram, whole.right - own.right
    if penalty is not None:
        gram = gram + penalty
    scale = np.sqrt(np.maximum(np.diagonal(gram, axis1=-2, axis2=-1), 0.0))
    lost = np.any(scale <= 1e-12 * np.sqrt(np.diag(whole.gram)), axis=-1)
    scale = np.where(scale > 0.0, scale, 1.0)
    scaled = gram / (scale[:, :, None] * scale[:, None, :])
    if penalty is None:
        lost |= np.linalg.eigvalsh(scaled)[:, 0] < 1e-13
    else:  # what neither rows nor penalty determine stays near zero
        scaled += _RIDGE * np.eye(scale.shape[1])
    scaled[lost] = np.eye(scale.shape[1])
    inner = np.linalg.solve(scaled, (right / scale)[..., None])[..., 0] / scale
    return np.where(lost, np.nan, groups.error(inner))


def held_out_rms(groups: Normal, penalty: FloatArray | None = None) -> float:
    """RMS [deg/h] of all rows, each group predicted by the fit to the others; inf where one is indispensable."""
    squares = left_out(groups, penalty)
    return float(np.sqrt(squares.sum() / groups.rows.sum())) if np.all(np.isfinite(squares)) else np.inf
