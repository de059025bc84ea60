"""Polynomial, regression and spline solved from the moments of a record instead of its rows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from math import comb
from typing import Any

import numpy as np
from scipy import linalg

from bench.channels import FloatArray
from bench.effects.base import Effect, Scale, Series
from bench.effects.polynomial import Polynomial
from bench.effects.regression import Regression
from bench.effects.spline import MIN_ROWS, Spline
from bench.errors import InputError
from bench.fit.design import Bound
from bench.fit.moments import CELLS, CHANNELS, ORDER, Moments, Ranges
from bench.fit.solve import MAX_CONDITION
from bench.model import Model


@dataclass(frozen=True, eq=False)
class Solved:
    """A model solved from moments: as the fields of `bench.fit.Fit` of the same names."""

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


def check(model: Model) -> None:
    """InputError unless the model can be solved from moments."""
    effect = model.effects[0]
    if len(model.effects) != 1 or model.rows != "all" or not _FITS.get(effect.name, lambda _: False)(effect):
        raise InputError(
            f"model '{model.name}' cannot be solved from moments: allowed are, each alone and on all rows, polynomial, "
            f"regression to order {ORDER['joint']}, and spline with a given number of intervals that divides {CELLS}"
        )


def solve_moments(model: Model, moments: Moments) -> Solved:
    """The fit of the model to the rows behind the moments; InputError as `fit` has it, or where `check` refuses."""
    check(model)
    effect = model.effects[0]
    ranges = {channel: (float(a), float(b)) for channel, (a, b) in zip(CHANNELS, moments.ranges, strict=True)}
    missing = [channel for channel in effect.needs if not np.isfinite(ranges[channel][0])]
    if missing:
        raise InputError(f"channel '{missing[0]}' has no value in the rows to fit")
    prepared = _prepared(effect, ranges)
    if isinstance(prepared, Spline):
        beta, rss, condition = _solve_spline(prepared, moments)
    else:
        beta, rss, condition = _solve_triangle(prepared, moments)
    if not condition <= MAX_CONDITION:
        raise InputError(
            f"model '{model.name}' is not determined by these rows (condition {condition:.1g}, limit "
            f"{MAX_CONDITION:.0e})"
        )
    part = 1 if isinstance(prepared, Regression) else 0
    bound = Bound(model.keys, (prepared,), {model.keys[0]: {}}, {model.keys[0]: slice(1, beta.size)})
    rms_dph = float(np.sqrt(max(rss, 0.0) / moments.weight[part]))
    validity = {channel: ranges[channel] for channel in effect.needs}
    return Solved(bound, beta, rms_dph, condition, int(moments.rows[part]), validity)


def _prepared(effect: Effect, ranges: Ranges) -> Spline | Polynomial | Regression:
    scales = {channel: Scale(*ranges[channel]) for channel in effect.needs}
    if isinstance(effect, Spline):
        return replace(effect, scale=scales["temperature"])
    if isinstance(effect, Polynomial):
        return replace(effect, series=Series("temperature", effect.order, scales["temperature"]))
    if isinstance(effect, Regression):
        return replace(effect, series=tuple(Series(c, effect.order, scales[c]) for c in effect.needs))
    raise RuntimeError(f"{effect.name} was not checked")


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
    r = linalg.qr(np.column_stack([columns / scale, triangle[:, -1]]), mode="r")[0]
    n = len(wanted)
    spectrum = linalg.svdvals(r[:n, :n])
    if not spectrum[-1] > spectrum[0] * np.finfo(float).eps:
        return np.full(n, np.nan), np.inf, np.inf
    beta = linalg.solve_triangular(r[:n, :n], r[:n, n]) / scale
    return beta, float(r[n, n] ** 2) if len(r) > n else 0.0, float(spectrum[0] / spectrum[-1])


def _solve_spline(spline: Spline, moments: Moments) -> tuple[FloatArray, float, float]:
    m = spline.intervals
    if not isinstance(m, int):
        raise RuntimeError("the number of intervals was not checked")
    visited = moments.cell_rows.reshape(m, -1).sum(axis=1)
    if visited.min() < MIN_ROWS:
        i = int(visited.argmin())
        raise InputError(f"spline: interval {i + 1} of {m} has {visited[i]:.0f} rows, at least {MIN_ROWS} are needed")
    pieces = _pieces(m, spline.ends)
    hankel = moments.powers[:, np.add.outer(np.arange(4), np.arange(4))]
    flat = pieces.reshape(4 * CELLS, -1)
    gram = flat.T @ (hankel @ pieces).reshape(4 * CELLS, -1)
    right = flat.T @ moments.products.ravel()
    scale = np.sqrt(np.diag(gram))
    scaled = gram / np.outer(scale, scale)
    spectrum = linalg.eigvalsh(scaled)
    if not spectrum[0] > spectrum[-1] * np.finfo(float).eps:
        return np.full(scale.size, np.nan), np.inf, np.inf
    beta = linalg.cho_solve(linalg.cho_factor(scaled), right / scale) / scale
    rss = moments.square - 2 * float(right @ beta) + float(beta @ gram @ beta)
    beta[0] += moments.offset
    return beta, rss, float(np.sqrt(spectrum[-1] / spectrum[0]))


@lru_cache(maxsize=64)
def _pieces(m: int, ends: str) -> FloatArray:
    """Coefficients (48, 4, 1 + k) of u^0..u^3 in every cell of the constant and of the basis of a spline."""
    unit = Spline(m, ends, Scale(0.0, float(m)))
    powers = unit.physical().matrix.reshape(m, 4, -1)  # of (v - knot)^j, intervals of width one
    each = CELLS // m
    half = 0.5 / each
    out = np.zeros((CELLS, 4, powers.shape[2]))
    for cell in range(CELLS):
        centre = (cell % each + 0.5) / each
        for j in range(4):
            for i in range(j + 1):  # (centre + half u)^j
                out[cell, i] += comb(j, i) * centre ** (j - i) * half**i * powers[cell // each, j]
    out.flags.writeable = False
    return out
