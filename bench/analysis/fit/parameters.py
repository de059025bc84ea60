"""A model laid out over its rows: its automatic options settled, its nonlinear parameters found, or refused."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from bench.analysis.effects.base import Parameter
from bench.analysis.fit.design import Bound, FitRows
from bench.analysis.fit.solve import Solution, dependent_column, left_out_rms, projected, search, solve
from bench.analysis.fit.weighting import Whitening
from bench.analysis.thresholds import MOST_CONDITION
from bench.base import FloatArray, InputError


def choose(rows: FitRows) -> FitRows:
    """Settle automatic options: the variant with the least RMS on left-out blocks."""
    for i, effect in enumerate(rows.model.effects):
        choices = effect.choices()
        if not choices:
            continue
        scored = [(score, variant) for variant in choices if np.isfinite(score := _left_out(rows.using(i, variant)))]
        if not scored:
            raise InputError(f"{effect.name}: these rows determine none of its variants; record a longer or wider run")
        rows = rows.using(i, min(scored, key=lambda pair: pair[0])[1])
    return rows


def _left_out(rows: FitRows) -> float:
    try:
        _, columns = rows.bind(rows.start())
    except InputError:
        return np.inf
    return left_out_rms(solve(columns, rows.y, rows.weights), rows.weights, rows.blocks())


def nonlinear(
    rows: FitRows, start: Mapping[str, float] | None, whitening: Whitening | None = None, *, hold: bool = False
) -> FloatArray:
    """Nonlinear parameters (m,) with the least square sum, of whitened rows where a `whitening` is given.

    `start` replaces the grid, and with `hold` all search.
    """
    parameters: Sequence[Parameter] = rows.parameters
    if not parameters:
        return np.zeros(0)
    given = None if start is None else np.array([start[key] for key in rows.parameter_keys])
    if hold and given is not None:
        return given
    white_y = None if whitening is None else whitening(rows.y)

    def residual(theta: FloatArray) -> FloatArray:
        try:
            _, columns = rows.bind(theta, trial=True)
        except InputError:  # a lag so long that the shifted temperature stands still
            return np.full(rows.y.size if white_y is None else white_y.size, np.inf)
        if whitening is None or white_y is None:
            return projected(columns, rows.y, rows.weights)
        return projected(whitening(columns), white_y, np.ones(white_y.size))

    return search(residual, parameters, given)


def refuse(rows: FitRows, bound: Bound, columns: FloatArray, solution: Solution) -> None:
    """InputError where the rows do not determine the columns."""
    n, p = columns.shape
    if n < p:
        raise InputError(f"{n} rows for {p} coefficients of model '{rows.model.name}': record more, or fit less")
    if not np.all(np.isfinite(columns)):
        raise InputError(f"model '{rows.model.name}' has columns that are not finite in rows without a gap")
    if solution.condition > MOST_CONDITION:
        culprit = dependent_column(columns, rows.weights)
        key = next((k for k, own in bound.slices.items() if own.start <= culprit < own.stop), "constant")
        raise InputError(
            f"model '{rows.model.name}' is not determined by these rows (condition {solution.condition:.1g}, limit "
            f"{MOST_CONDITION:.0e}): '{key}' repeats what the other terms contain; leave it out or vary its channel"
        )
