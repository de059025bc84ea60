"""A model fitted to runs: least squares in one piece, variable projection for time constants, honest covariance.

Rows count by the noise that the fit itself shows (`weights="noise"`, see `weighting`), or by the samples behind each,
as in the source papers (`"count"`). The covariance is that of the estimate under this noise, white + flicker + random
walk (`covariance="noise"`), or the block sandwich, which assumes nothing but short memory (`"sandwich"`). White-noise
bands would be ten times too narrow.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from bench.analysis.effects.base import options_of
from bench.analysis.effects.model import Model
from bench.analysis.fit.design import Bound, FitRows, fit_rows
from bench.analysis.fit.disturbances import left_out_words, undisturbed
from bench.analysis.fit.parameters import choose, nonlinear, refuse
from bench.analysis.fit.quantisation import coarse_temperature
from bench.analysis.fit.solve import (
    one_blas_thread,
    solve,
)
from bench.analysis.fit.uncertainty import CovarianceKind, counted_covariance, jacobian_of
from bench.analysis.fit.weighting import (
    NoiseWeights,
    WeightsKind,
    lacking,
    noise_weights,
    solved,
)
from bench.analysis.fit.weighting import (
    covariance as noise_covariance,
)
from bench.analysis.noise.estimate import Noise
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
    weights: NoiseWeights | None = field(default=None, repr=False)
    """The noise that weighed the rows; None where the samples behind each did."""
    weights_reason: str = ""
    """Why the rows were not weighed by their noise, where that was asked for."""
    counted: Fit | None = field(default=None, repr=False)
    """The same model with rows that count by their samples, without covariance, where the noise weighed the rows."""

    @property
    def theta(self) -> dict[str, float]:
        """Nonlinear parameters by effect.parameter, in their units."""
        return {f"{key}.{name}": value for key, own in self.bound.theta.items() for name, value in own.items()}

    @property
    def theta_std(self) -> dict[str, float]:
        """Standard deviation of each nonlinear parameter, NaN of one on an end of its range."""
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

    def out_of_range(self, dataset: Dataset, near: float = 0.0) -> BoolArray:
        """Rows (n,) where a channel that the model needs is outside the range it was fitted to.

        `near`: by more than this share of that range.
        """
        outside = np.zeros(len(dataset), dtype=bool)
        for channel, (low, high) in self.validity.items():
            values, allowed = dataset.channel(channel), near * (high - low)
            outside |= (values < low - allowed) | (values > high + allowed)
        return outside

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
            "weights": self.weights_json(),
            "rms_dph": self.rms_dph,
            "condition": self.condition,
            "rows": self.rows,
            "interval_s": self.interval_s,
            "runs": list(self.runs),
            "validity": {c: {"from": r[0], "to": r[1], "unit": CHANNELS[c].unit} for c, r in self.validity.items()},
            "warnings": list(self.warnings),
        }

    def weights_json(self) -> dict[str, str]:
        """How the rows count, `noise` or `count`, and why by count where the noise was asked for."""
        return {"by": "count" if self.weights is None else "noise", "reason": self.weights_reason}

    def _effects_json(self) -> list[dict[str, Any]]:
        pairs = zip(self.model.effects, self.bound.effects, strict=True)
        return [{"effect": e.name, "options": options_of(e), "state": p.state()} for e, p in pairs]


def fit_model(  # noqa: PLR0913 - options of one fit, by keyword
    model: Model,
    datasets: Dataset | Sequence[Dataset],
    rows: Sequence[BoolArray] | None = None,
    *,
    covariance: CovarianceKind = "noise",
    weights: WeightsKind | NoiseWeights = "noise",
    start: Mapping[str, float] | None = None,
    hold: bool = False,
) -> Fit:
    """Fit a model to runs of one unit; `rows` masks the rows to fit, effects still see the whole record. Stretches in
    which a run was disturbed are left out (see `disturbances`).

    `weights` of an earlier fit to at least these rows are taken as they are; the `sandwich` assumes no noise, and its
    estimate is count-weighted. `start` (the `theta` of an earlier fit) replaces the grid search, and with `hold` all
    search. Raises InputError: a channel is missing or constant, too few rows, an interval without data, dependent
    columns, condition above 1e12.
    """
    records = (datasets,) if isinstance(datasets, Dataset) else tuple(datasets)
    refuse_unfit(records)
    records = tuple(map(undisturbed, records))
    with one_blas_thread():
        laid_out = choose(fit_rows(model, records, rows))
        if isinstance(weights, NoiseWeights):
            result = _weighed(laid_out, weights, covariance, start)
        else:
            counted = _Solver(laid_out, nonlinear(laid_out, start, hold=hold))
            result = _fitted(counted, covariance, "count" if covariance == "sandwich" else weights)
        steps = coarse_temperature(result.bound, result.beta, result.rms_dph, records)
        stuck = (f"{key} = {result.theta[key]:g} is on its bound: not determined" for key in result.on_bound)
        return replace(result, warnings=(*left_out_words(records), *steps, *stuck))


class _Solver:
    """A model at given nonlinear parameters, solved with rows that count by their samples."""

    def __init__(self, rows: FitRows, theta: FloatArray) -> None:
        self.rows, self.theta = rows, theta
        self.bound, self.columns = rows.bind(theta)
        self.solution = solve(self.columns, rows.y, rows.weights)
        refuse(rows, self.bound, self.columns, self.solution)

    def jacobian(self, beta: FloatArray) -> FloatArray:
        """Columns of amplitudes and nonlinear parameters (rows, q)."""
        return jacobian_of(self.rows, self.bound, self.columns, beta)

    def fit(self, beta: FloatArray, covariance: FloatArray | None = None, noise: Noise | None = None) -> Fit:
        """The fit with these coefficients, and the covariance of them and of the parameters inside their ranges."""
        rows, size = self.rows, beta.size + self.theta.size
        known = np.flatnonzero(np.concatenate([np.ones(beta.size, dtype=bool), rows.inside(self.theta)]))
        every = np.full((size, size), np.nan)
        if covariance is not None:
            every[np.ix_(known, known)] = covariance
        residual = rows.y - self.columns @ beta
        return Fit(
            model=rows.model,
            bound=self.bound,
            beta=beta,
            covariance=every,
            noise=noise,
            rms_dph=float(np.sqrt(np.average(residual**2, weights=rows.weights))),
            condition=self.solution.condition,
            rows=rows.y.size,
            interval_s=rows.records[0].interval_s,
            runs=tuple(record.name for record in rows.records),
            validity=rows.validity(),
            residuals=rows.scatter(residual),
        )


def _fitted(counted: _Solver, covariance: CovarianceKind, weights: WeightsKind) -> Fit:
    """The fit with rows that count by their noise, where that can be estimated and is asked for."""
    plain = counted.fit(counted.solution.beta)
    if covariance == "none" and weights == "count":
        return plain
    jacobian = counted.jacobian(plain.beta)
    found = "not asked for" if covariance == "sandwich" else noise_weights(counted.rows, jacobian)
    noise = found if isinstance(found, NoiseWeights) else None
    reason = ""
    if weights == "noise":
        reason = found if isinstance(found, str) else lacking(counted.rows, plain.rms_dph)
    if weights == "noise" and noise is not None and not reason:
        try:
            return replace(_weighed(counted.rows, noise, covariance, plain.theta), counted=plain)
        except InputError as error:
            reason = str(error)
    cov = None
    if covariance != "none":
        cov = counted_covariance(counted.rows, jacobian, counted.solution.residual, noise)
    fit = counted.fit(plain.beta, cov, None if noise is None else noise.found.noise)
    return replace(fit, weights_reason=reason)


def _weighed(
    rows: FitRows, weights: NoiseWeights, covariance: CovarianceKind, start: Mapping[str, float] | None
) -> Fit:
    whitening = weights.whitening(rows)
    at = _Solver(rows, nonlinear(rows, start, whitening))
    beta = solved(rows, at.columns, whitening)
    cov = None if covariance == "none" else noise_covariance(rows, at.jacobian(beta), weights)
    return replace(at.fit(beta, cov, weights.found.noise), weights=weights)


def _is_rounding(matrix: FloatArray, units: Sequence[str]) -> BoolArray:
    """Rows (p,) that are rounding errors beside the others of their unit: no amplitude can move that coefficient."""
    size = np.linalg.norm(matrix, axis=1)
    of_unit = np.unique(np.array(units), return_inverse=True)[1]
    largest = np.zeros(int(of_unit.max(initial=0)) + 1)
    np.maximum.at(largest, of_unit, size)
    return np.asarray(size <= _ROUNDING * largest[of_unit])


def refuse_stuck(record: Dataset) -> None:
    """InputError where the rate is the same in every row."""
    rate = record.channels.get("rate", np.zeros(0))
    known = rate[np.isfinite(rate)]
    if known.size > 1 and np.ptp(known) == 0.0:
        text = f"{record.name}: rate is {known[0]:.6g} deg/h in every row: no gyro is so quiet"
        raise InputError(f"{text}; check the column, and whether the unit still measured")


def refuse_unfit(records: Iterable[Dataset]) -> None:
    """InputError where a record is not the bias of one axis over temperature: the unit corrected its rate itself, or
    one of several outputs was recorded in several attitudes, each of which turns another axis; or it never changes.
    """
    for record in records:
        refuse_stuck(record)
        if record.corrected:
            text = f"{record.name}: the unit corrected its rate itself during this run: it is a verification"
            raise InputError(f"{text} and cannot be fitted or checked against; use runs of the raw rate")
        stood = {segment.attitude for segment in record.segments if segment.attitude}
        if record.output != "rate" and len(stood) > 1:
            raise InputError(
                f"{record.name}: the unit stood in {len(stood)} attitudes, and each turn and the Earth act on other "
                "axes in each of them; `bench imu` fits all axes together"
            )
