"""The same cases with FROLS (SysIdentPy) and STLSQ (pysindy), with the bench's library of regressors.

They get more than their users usually have: the candidates' columns on a grid of their nonlinear parameters, made
orthogonal to the static spline, and the residual of that spline. Only their selection differs.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np

from bench.analysis.diagnosis.candidates import orthonormal
from bench.analysis.diagnosis.offer import catalogued, offer
from bench.analysis.diagnosis.suspects import Layout
from bench.analysis.effects.model import Model
from bench.analysis.fit.design import fit_rows
from bench.base.channels import FloatArray
from bench.record.dataset import Dataset

GRID = 6
STLSQ_THRESHOLDS = (0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.7, 1.0)
"""About pysindy's default, 0.1; columns and residual have unit RMS."""


@dataclass(frozen=True)
class Choice:
    """Effects in the order of a peer's preference and its score of the first; `default`: named by default."""

    ranking: tuple[str, ...]
    score: float
    default: bool


@dataclass(frozen=True, eq=False)
class Shelf:
    """Regressors (n, k) of unit RMS outside the spline, their effects, and the spline's residual (n,)."""

    names: tuple[str, ...]
    columns: FloatArray
    residual: FloatArray


def shelf(run: Dataset, model: Model) -> Shelf:
    """The bench's candidates for this run as plain columns."""
    layout, offered = offer(Layout(fit_rows(model, (run,)), np.zeros(0)), catalogued(model, (run,)))
    base = layout.problem.base
    basis = orthonormal(base)
    beta = np.linalg.lstsq(base, layout.problem.y, rcond=None)[0]
    names, columns = [], []
    for candidate in offered.candidates(layout):
        grid = candidate.grid()
        for theta in grid[:: max(1, len(grid) // GRID)]:
            own = candidate.columns(theta)
            if candidate.kind == "abscissa":
                own = ((own - base) @ beta)[:, None]
            left = own - basis @ (basis.T @ own)
            size = np.sqrt(np.mean(left**2, axis=0))
            for column in (left / np.where(size > 0.0, size, 1.0))[:, size > 1e-6 * np.sqrt(np.mean(own**2, axis=0))].T:
                names.append(candidate.effect or candidate.name)
                columns.append(column)
    residual = layout.problem.y - basis @ (basis.T @ layout.problem.y)
    return Shelf(tuple(names), np.column_stack(columns), residual / np.sqrt(np.mean(residual**2)))


def frols(given: Shelf, terms: int = 8) -> Choice:
    """SysIdentPy's forward regression by error reduction ratio; the number of terms by its BIC."""
    from sysidentpy.basis_function import Polynomial
    from sysidentpy.model_structure_selection import FROLS
    from sysidentpy.parameter_estimation import LeastSquares

    selector = FROLS(
        n_info_values=terms, info_criteria="bic", ylag=1, xlag=1, basis_function=Polynomial(1), estimator=LeastSquares()
    )
    selector.max_lag = 0  # the columns hold all memory there is
    columns = np.column_stack([np.ones(len(given.residual)), given.columns])
    y = given.residual[:, None]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        taken = int(np.argmin(selector.information_criterion(columns, y))) + 1
    ratios, order, _ = selector.error_reduction_ratio(columns, y, taken)
    chosen = [int(i) - 1 for i in order]  # column 0 is the constant
    ranking = tuple(dict.fromkeys(given.names[i] for i in chosen if i >= 0))
    return Choice(ranking, float(ratios[0]), bool(ranking))


def stlsq(given: Shelf) -> Choice:
    """pysindy's sequentially thresholded least squares, its threshold chosen by BIC from a path."""
    from pysindy import STLSQ

    rows, best, lowest = len(given.residual), np.zeros(given.columns.shape[1]), 0.0
    for threshold in STLSQ_THRESHOLDS:
        optimizer = STLSQ(threshold=threshold)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            optimizer.fit(given.columns, given.residual[:, None])
        found = np.asarray(optimizer.coef_, dtype=np.float64).ravel()
        left = given.residual - given.columns @ found
        bic = rows * float(np.log(np.mean(left**2))) + np.count_nonzero(found) * float(np.log(rows))
        if bic < lowest:
            best, lowest = found, bic
    size = np.abs(best)
    order = [int(i) for i in np.argsort(-size) if size[i] > 0.0]
    return Choice(tuple(dict.fromkeys(given.names[i] for i in order)), float(size.max(initial=0.0)), bool(order))
