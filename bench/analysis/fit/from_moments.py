"""Polynomial, regression and spline solved from the moments of a record instead of its rows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from bench.analysis.effects.base import Scale, StaticEffect
from bench.analysis.effects.model import Model
from bench.analysis.effects.polynomial import Polynomial
from bench.analysis.effects.regression import Regression
from bench.analysis.effects.spline import Spline, refuse_unvisited
from bench.analysis.fit.cells import Cells
from bench.analysis.fit.design import Bound
from bench.analysis.fit.moments import CELLS, CHANNELS, ORDER, Moments
from bench.analysis.fit.smooth import solve_spline
from bench.analysis.thresholds import MOST_CONDITION
from bench.base import FloatArray, InputError


@dataclass(frozen=True, eq=False)
class SolvedMoments:
    """A model solved from moments: as the fields of `bench.analysis.fit.Fit` of the same names."""

    bound: Bound
    beta: FloatArray
    rms_dph: float
    condition: float
    rows: int
    validity: dict[str, tuple[float, float]]


_FITS: dict[str, Callable[[Any], bool]] = {
    "polynomial": lambda effect: effect.order <= ORDER["static"],
    "regression": lambda effect: effect.order <= ORDER["joint"],
    "spline": lambda effect: isinstance(effect.intervals, int) and CELLS % effect.intervals == 0,
}


def check(model: Model) -> StaticEffect:
    """The effect of a model that can be solved from moments; InputError for any other."""
    effect = model.effects[0]
    alone = len(model.effects) == 1 and model.rows == "all"
    if not isinstance(effect, StaticEffect) or not alone or not _FITS.get(effect.name, lambda _: False)(effect):
        raise InputError(
            f"model '{model.name}' cannot be solved from moments: allowed are, each alone and on all rows, polynomial, "
            f"regression to order {ORDER['joint']}, and spline with a given number of intervals that divides {CELLS}"
        )
    return effect


def solve_moments(model: Model, moments: Moments) -> SolvedMoments:
    """The fit of the model to the rows behind the moments; InputError as `fit` has it, or where `check` refuses."""
    effect = check(model)
    ranges = {channel: (float(a), float(b)) for channel, (a, b) in zip(CHANNELS, moments.ranges, strict=True)}
    missing = [channel for channel in effect.needs if not np.isfinite(ranges[channel][0])]
    if missing:
        raise InputError(f"channel '{missing[0]}' has no value in the rows to fit")
    prepared = effect.scaled({channel: Scale(*ranges[channel]) for channel in effect.needs})
    if isinstance(prepared, Spline):
        beta, rss, condition = _solve_spline(prepared, moments)
    elif isinstance(prepared, Polynomial | Regression):
        beta, rss, condition = _solve_triangle(prepared, moments)
    else:
        raise RuntimeError(f"{effect.name} was not checked")
    if not condition <= MOST_CONDITION:
        raise InputError(
            f"model '{model.name}' is not determined by these rows (condition {condition:.1g}, limit "
            f"{MOST_CONDITION:.0e})"
        )
    part = 1 if isinstance(prepared, Regression) else 0
    bound = Bound(model.keys, (prepared,), {model.keys[0]: {}}, {model.keys[0]: slice(1, beta.size)})
    rms_dph = float(np.sqrt(max(rss, 0.0) / moments.weight[part]))
    validity = {channel: ranges[channel] for channel in effect.needs}
    return SolvedMoments(bound, beta, rms_dph, condition, int(moments.rows[part]), validity)


def _solve_triangle(effect: Polynomial | Regression, moments: Moments) -> tuple[FloatArray, float, float]:
    """Amplitudes, weighted square sum of the residual, condition of the scaled columns."""
    if isinstance(effect, Regression):
        triangle, rows = moments.joint, moments.rows[1]
        wanted = [0, *(1 + i * ORDER["joint"] + k for i in range(len(CHANNELS)) for k in range(effect.order))]
    else:
        triangle, rows, wanted = moments.static, moments.rows[0], list(range(effect.order + 1))
    columns = triangle[:, wanted]
    scale = np.linalg.norm(columns, axis=0)
    if rows < len(wanted) or np.any(scale == 0.0):
        raise InputError(f"{rows:.0f} rows for {len(wanted)} coefficients: record more, or fit less")
    r = scipy.linalg.qr(np.column_stack([columns / scale, triangle[:, -1]]), mode="r")[0]
    n = len(wanted)
    spectrum = scipy.linalg.svdvals(r[:n, :n])
    if not spectrum[-1] > spectrum[0] * np.finfo(float).eps:
        return np.full(n, np.nan), np.inf, np.inf
    beta = scipy.linalg.solve_triangular(r[:n, :n], r[:n, n]) / scale
    return beta, float(r[n, n] ** 2) if len(r) > n else 0.0, float(spectrum[0] / spectrum[-1])


def _solve_spline(spline: Spline, moments: Moments) -> tuple[FloatArray, float, float]:
    m = spline.intervals
    if not isinstance(m, int):
        raise RuntimeError("the number of intervals was not checked")
    visited = moments.cell_rows.reshape(m, -1).sum(axis=1)
    low, high = moments.ranges[0].tolist()
    refuse_unvisited(visited, (low, high))
    cells = Cells(low, high, CELLS, moments.offset)
    squares = np.zeros((CELLS, 1))
    squares[0] = moments.square
    sums = np.hstack([moments.powers, moments.products, squares]).ravel()
    try:
        solved = solve_spline(cells, sums, m, spline.ends)
    except InputError:  # said by the caller, which knows the model
        return np.full(0, np.nan), np.inf, np.inf
    return solved.beta, solved.rss, solved.condition
