"""A model fitted to runs: least squares in one piece, variable projection for time constants, honest covariance.

The estimate is ordinary (count-weighted) least squares, as in the source papers. Its covariance is that of this
estimate under noise that is not white: white + flicker + random walk, estimated beside the columns
(`covariance="noise"`), or the block sandwich, which assumes nothing but short memory (`"sandwich"`). White-noise bands
would be ten times too narrow.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from bench.analysis.effects.base import Parameter, options_of
from bench.analysis.effects.model import Model
from bench.analysis.fit.design import Bound, FitRows, fit_rows
from bench.analysis.fit.quantisation import coarse_temperature
from bench.analysis.fit.solve import (
    Solution,
    dependent_column,
    left_out_rms,
    one_blas_thread,
    projected,
    search,
    solve,
)
from bench.analysis.fit.uncertainty import CovarianceKind, estimate_covariance
from bench.analysis.noise.estimate import Noise
from bench.analysis.thresholds import MOST_CONDITION
from bench.base import CHANNELS, BoolArray, FloatArray, InputError, finite
from bench.record import Dataset

_ROUNDING = 1e-10  # of the largest row: a smaller one is what cancellation left of zero


@dataclass(frozen=True)
class Coefficient:
    """A physical coefficient: `key` is effect.label; `std` is one standard deviation under coloured noise."""

    key: str
    unit: str
    value: float
    std: float


@dataclass(frozen=True, eq=False)
class Prediction:
    """Modelled bias (n,) [deg/h] (NaN in gaps), its standard deviation (n,), and rows outside the fitted ranges."""

    bias: FloatArray
    std: FloatArray
    out_of_range: BoolArray


@dataclass(frozen=True, eq=False)
class Fit:
    """What a fit found. `beta` (1 + k,) are the constant and the scaled amplitudes, `covariance` (1 + k + m, ..) covers
    them and the m nonlinear parameters; `coefficients` are the physical ones.
    """

    model: Model
    bound: Bound
    beta: FloatArray
    covariance: FloatArray
    noise: Noise | None
    rms_dph: float
    condition: float
    rows: int
    interval_s: float
    runs: tuple[str, ...]
    validity: Mapping[str, tuple[float, float]]
    warnings: tuple[str, ...] = ()
    residuals: tuple[FloatArray, ...] = field(default=(), repr=False)
    """Measured minus modelled [deg/h] of each dataset (n,), NaN where a row was not fitted."""

    @property
    def theta(self) -> dict[str, float]:
        """Nonlinear parameters by effect.parameter, in their units."""
        return {f"{key}.{name}": value for key, own in self.bound.theta.items() for name, value in own.items()}

    @property
    def theta_std(self) -> dict[str, float]:
        """Standard deviation of each nonlinear parameter."""
        std = np.sqrt(np.diag(self.covariance))[self.beta.size :]
        return dict(zip(self.theta, std.tolist(), strict=True))

    @property
    def on_bound(self) -> tuple[str, ...]:
        """Nonlinear parameters that ended on an end of their range: the rows do not determine them."""
        pairs = zip(self.model.keys, self.model.effects, strict=True)
        searched = [(f"{key}.{p.name}", p) for key, effect in pairs for p in effect.parameters]
        return tuple(key for key, parameter in searched if parameter.on_bound(self.theta[key]))

    @cached_property
    def coefficients(self) -> tuple[Coefficient, ...]:
        """Physical coefficients with units; the one constant is in the first effect that has a place for it."""
        keys, units, matrix = self.bound.physical()
        matrix = np.where(_is_rounding(matrix, units)[:, None], 0.0, matrix)  # zero by constraint, as a spline's ends
        linear = self.covariance[: self.beta.size, : self.beta.size]
        # (M C M') entry by entry; cancellation can leave a variance a rounding error below zero.
        std = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", matrix, linear, matrix), 0.0))
        rows = zip(keys, units, (matrix @ self.beta).tolist(), std.tolist(), strict=True)
        return tuple(Coefficient(*row) for row in rows)

    def predict(self, dataset: Dataset) -> Prediction:
        """Modelled bias of any run. Outside the fitted ranges terms follow their tangents, and the rows are flagged."""
        columns = self.bound.columns(dataset)
        linear = self.covariance[: self.beta.size, : self.beta.size]
        variance = np.einsum("ij,jk,ik->i", columns, linear, columns)
        return Prediction(columns @ self.beta, np.sqrt(np.maximum(variance, 0.0)), self.out_of_range(dataset))

    def out_of_range(self, dataset: Dataset) -> BoolArray:
        """Rows (n,) where a channel that the model needs is outside the range it was fitted to."""
        outside = np.zeros(len(dataset), dtype=bool)
        for channel, (low, high) in self.validity.items():
            values = dataset.channel(channel)
            outside |= (values < low) | (values > high)
        return outside

    def contributions(self, dataset: Dataset) -> dict[str, FloatArray]:
        """What each effect adds (n,) [deg/h], and the `constant`; they sum to the prediction."""
        columns = self.bound.columns(dataset)
        parts = {key: columns[:, own] @ self.beta[own] for key, own in self.bound.slices.items()}
        return {"constant": np.full(len(dataset), self.beta[0]), **parts}

    def to_json(self) -> dict[str, Any]:
        """JSON object for calibration.json; numbers that do not exist are null."""
        return {
            "model": {"name": self.model.name, "rows": self.model.rows, "effects": self._effects_json()},
            "coefficients": [
                {"key": c.key, "unit": c.unit, "value": finite(c.value), "std": finite(c.std)}
                for c in self.coefficients
            ],
            "parameters": [
                {"key": key, "value": value, "std": finite(std), "at_bound": key in self.on_bound}
                for (key, value), std in zip(self.theta.items(), self.theta_std.values(), strict=True)
            ],
            "scaled": self.beta.tolist(),
            "rms_dph": self.rms_dph,
            "condition": self.condition,
            "rows": self.rows,
            "interval_s": self.interval_s,
            "runs": list(self.runs),
            "validity": {c: {"from": r[0], "to": r[1], "unit": CHANNELS[c].unit} for c, r in self.validity.items()},
            "warnings": list(self.warnings),
        }

    def _effects_json(self) -> list[dict[str, Any]]:
        pairs = zip(self.model.effects, self.bound.effects, strict=True)
        return [{"effect": e.name, "options": options_of(e), "state": p.state()} for e, p in pairs]


def fit_model(
    model: Model,
    datasets: Dataset | Sequence[Dataset],
    rows: Sequence[BoolArray] | None = None,
    *,
    covariance: CovarianceKind = "noise",
    quantisation_limit_dph: float = np.inf,
    start: Mapping[str, float] | None = None,
) -> Fit:
    """Fit a model to runs of one unit; `rows` masks the rows to fit, effects still see the whole record.

    `quantisation_limit_dph` refuses a temperature sensor whose steps cause a larger error [deg/h]; `start` (the `theta`
    of an earlier fit) replaces the grid search. Raises InputError: a channel is missing or constant, too few rows, an
    interval without data, dependent columns, condition above 1e12.
    """
    records = (datasets,) if isinstance(datasets, Dataset) else tuple(datasets)
    refuse_corrected(records)
    with one_blas_thread():
        laid_out = fit_rows(model, records, rows)
        laid_out = _choose(laid_out)
        theta = _theta(laid_out, start)
        bound, columns = laid_out.bind(theta)
        solution = solve(columns, laid_out.y, laid_out.weights)
        _refuse(laid_out, bound, columns, solution)
        cov, noise = estimate_covariance(laid_out, bound, columns, solution, covariance)
        result = _result(laid_out, bound, solution, cov, noise)
        steps = coarse_temperature(bound, solution.beta, result.rms_dph, records, quantisation_limit_dph)
        stuck = (f"{key} = {result.theta[key]:g} is on its bound: not determined" for key in result.on_bound)
        return replace(result, warnings=(*steps, *stuck))


def _is_rounding(matrix: FloatArray, units: Sequence[str]) -> BoolArray:
    """Rows (p,) that are rounding errors beside the others of their unit: no amplitude can move that coefficient."""
    size = np.linalg.norm(matrix, axis=1)
    of_unit = np.unique(np.array(units), return_inverse=True)[1]
    largest = np.zeros(int(of_unit.max(initial=0)) + 1)
    np.maximum.at(largest, of_unit, size)
    return np.asarray(size <= _ROUNDING * largest[of_unit])


def refuse_corrected(records: Iterable[Dataset]) -> None:
    """InputError where a unit corrected its rate itself: the rest is not the unit's bias."""
    for record in records:
        if record.corrected:
            text = f"{record.name}: the unit corrected its rate itself during this run: it is a verification"
            raise InputError(f"{text} and cannot be fitted or checked against; use runs of the raw rate")


def _choose(rows: FitRows) -> FitRows:
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


def _theta(rows: FitRows, start: Mapping[str, float] | None) -> FloatArray:
    parameters: Sequence[Parameter] = rows.parameters
    if not parameters:
        return np.zeros(0)
    given = None if start is None else np.array([start[key] for key in rows.parameter_keys])

    def residual(theta: FloatArray) -> FloatArray:
        try:
            _, columns = rows.bind(theta, trial=True)
        except InputError:  # a lag so long that the shifted temperature stands still
            return np.full(rows.y.size, np.inf)
        return projected(columns, rows.y, rows.weights)

    return search(residual, parameters, given)


def _refuse(rows: FitRows, bound: Bound, columns: FloatArray, solution: Solution) -> None:
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


def _result(rows: FitRows, bound: Bound, solution: Solution, cov: FloatArray, noise: Noise | None) -> Fit:
    return Fit(
        model=rows.model,
        bound=bound,
        beta=solution.beta,
        covariance=cov,
        noise=noise,
        rms_dph=float(np.sqrt(solution.rss / np.sum(rows.weights))),
        condition=solution.condition,
        rows=rows.y.size,
        interval_s=rows.records[0].interval_s,
        runs=tuple(record.name for record in rows.records),
        validity=rows.validity(),
        residuals=rows.scatter(solution.residual),
    )
