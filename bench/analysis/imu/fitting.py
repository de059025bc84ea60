"""Fit of a triad over temperature: all parameters of an axis jointly, by generalised least squares.

The equation is that of `curves`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from bench.analysis.effects.base import Effect, Parameter
from bench.analysis.fit.solve import one_blas_thread
from bench.analysis.imu.curves import (
    AxisCurves,
    Effects,
    ImuCurves,
    Reference,
    Theta,
    TriadCurves,
    abscissa,
    extra_columns,
)
from bench.analysis.imu.marginal import marginal_covariance
from bench.analysis.imu.scatter import ATTITUDES, Gls, Scatter, components, estimate, gls
from bench.analysis.imu.triad import Term, Triad, TriadModel, terms
from bench.base import FloatArray, InputError
from bench.record import AXES

_GRID = 12


@dataclass(frozen=True, eq=False)
class AxisFit(AxisCurves):
    """One axis of a triad after its fit."""

    scatter: Scatter
    solution: Gls


@dataclass(frozen=True, eq=False)
class TriadFit(TriadCurves):
    """A triad after its fit."""

    axes: tuple[AxisFit, AxisFit, AxisFit]


@dataclass(frozen=True, eq=False)
class ImuFit(ImuCurves):
    """Both triads of a unit after their fit."""

    gyro: TriadFit
    accelerometer: TriadFit

    @property
    def triads(self) -> tuple[TriadFit, TriadFit]:
        """Gyros and accelerometers."""
        return self.gyro, self.accelerometer


def fit_triad(
    data: Triad,
    model: TriadModel | None = None,
    effects: Mapping[int, Effects] | Effects = (),
    reference: Reference | None = None,
    known: Mapping[str, float] | None = None,
) -> TriadFit:
    """Fit all three axes; `effects` of one axis by its number, or of all; `known` variances of attitudes [rad^2].

    InputError where the rows are fewer than the parameters, or by `identify.refuse_undetermined` before.
    """
    given = effects if isinstance(effects, Mapping) else dict.fromkeys(range(3), effects)
    with one_blas_thread():
        x, y, z = (fit_axis(data, i, model or TriadModel(), tuple(given.get(i, ())), known) for i in range(3))
    return TriadFit(data.kind, (x, y, z), reference or Reference())


def fit_imu(
    gyro: Triad,
    accelerometer: Triad,
    model: TriadModel | None = None,
    effects: Mapping[str, Mapping[int, Effects]] | None = None,
    reference: Reference | None = None,
) -> ImuFit:
    """Fit both triads; `effects` by kind of triad and number of the axis.

    How exact the attitudes were is estimated from all accelerometers together, which see every one of them, and then
    holds for the gyros: these see it at the few visits on the turning table only.
    """
    given = effects or {}
    model = model or TriadModel()
    with one_blas_thread():
        own = dict.fromkeys(range(3), ()) | dict(given.get("accelerometer", {}))
        first = [_prepared(accelerometer, i, model, tuple(own[i])).scatter.variances for i in range(3)]
    exact = {name: float(np.mean([found[name] for found in first])) for name in first[0] if name in ATTITUDES}
    second = fit_triad(accelerometer, model, given.get("accelerometer", {}), reference, exact)
    return ImuFit(fit_triad(gyro, model, given.get("gyro", {}), reference, exact), second)


@dataclass(frozen=True, eq=False)
class _Prepared:
    """One axis whose nonlinear parameters and variances are found, and whose amplitudes are not."""

    terms: tuple[Term, ...]
    effects: Effects
    theta: Theta
    columns: FloatArray
    target: FloatArray
    parts: Mapping[str, FloatArray]
    scatter: Scatter


def fit_axis(
    data: Triad,
    axis: int,
    model: TriadModel,
    effects: Effects = (),
    known: Mapping[str, float] | None = None,
    first: Scatter | None = None,
) -> AxisFit:
    """Fit one axis: nonlinear parameters and variances in turn, then the amplitudes; `known` variances stay.

    `first`: the scatter to search the nonlinear parameters with, once; left out, they are searched twice, and the
    covariance holds that the variances are uncertain.
    """
    own = _prepared(data, axis, model, effects, known, first)
    solution = gls(own.columns, own.target, own.scatter)
    slopes = _slopes(data, axis, own.terms, own.effects, own.theta, solution.beta)
    columns = np.hstack([own.columns, slopes])
    if first is None:
        beta = np.concatenate([solution.beta, np.zeros(slopes.shape[1])])
        covariance = marginal_covariance(columns, own.target, own.parts, known or {}, beta)
    else:
        covariance = gls(columns, own.target, own.scatter).covariance
    return AxisFit(own.terms, tuple(own.effects), own.theta, solution.beta, covariance, own.scatter, solution)


def _prepared(
    data: Triad,
    axis: int,
    model: TriadModel,
    effects: Effects,
    known: Mapping[str, float] | None = None,
    first: Scatter | None = None,
) -> _Prepared:
    own = tuple(terms(model, data.kind, axis, span(data, axis)))
    effects = tuple(effect.suited([data.record(axis)]) for effect in effects)
    theta: Theta = {effect.name: {p.name: p.start for p in effect.parameters} for effect in effects}
    target = data.output[:, axis] - data.driving[:, axis]
    parts = components(data, axis)
    columns = design(data, axis, own, effects, theta)
    if len(target) <= columns.shape[1] + len(parts):
        raise InputError(
            f"{data.kind} {AXES[axis]}: {len(target)} rows for {columns.shape[1]} parameters; "
            "measure more positions and temperatures, or lower the orders"
        )
    scatter = first or estimate(columns, target, parts, known)
    passes = 2 if first is None else 1
    for _ in range(passes if effects or first else 0):
        theta = search(data, axis, own, effects, theta, scatter)
        columns = design(data, axis, own, effects, theta)
        scatter = estimate(columns, target, parts, known)
    return _Prepared(own, effects, theta, columns, target, parts, scatter)


def span(data: Triad, axis: int) -> tuple[float, float]:
    """Range of an axis's temperature [degC]."""
    return float(data.temperature[:, axis].min()), float(data.temperature[:, axis].max())


def design(data: Triad, axis: int, own: Sequence[Term], effects: Effects, theta: Theta) -> FloatArray:
    """Columns (n, p) of the terms and of the effects with memory."""
    warm = abscissa(data, axis, effects, theta)
    parts = [term.curve.columns(warm) * term.drive(data, axis)[:, None] for term in own]
    return np.hstack([*parts, extra_columns(data, axis, effects, theta)])


def search(data: Triad, axis: int, own: Sequence[Term], effects: Effects, theta: Theta, scatter: Scatter) -> Theta:
    """The nonlinear parameters with the least whitened residual: a grid, then Brent's method, one at a time."""
    target, found = data.output[:, axis] - data.driving[:, axis], {key: dict(value) for key, value in theta.items()}
    for effect in effects:
        for parameter in effect.parameters:

            def misfit(z: float, effect: Effect = effect, parameter: Parameter = parameter) -> float:
                trial = {**found, effect.name: {**found[effect.name], parameter.name: float(_value(parameter, z))}}
                return -gls(design(data, axis, own, effects, trial), target, scatter).log_likelihood

            found[effect.name][parameter.name] = float(_value(parameter, _least(misfit)))
    return found


def _least(function: Callable[[float], float]) -> float:
    grid = np.linspace(0.0, 1.0, _GRID)
    values = [function(float(z)) for z in grid]
    best = int(np.argmin(values))
    bracket = float(grid[max(best - 1, 0)]), float(grid[min(best + 1, _GRID - 1)])
    refined = minimize_scalar(function, bounds=bracket, method="bounded", options={"xatol": 1e-3})
    return float(refined.x) if float(refined.fun) < values[best] else float(grid[best])


def _value(parameter: Parameter, z: float) -> float:
    if parameter.log:
        return float(np.exp(np.log(parameter.low) + z * np.log(parameter.high / parameter.low)))
    return parameter.low + z * (parameter.high - parameter.low)


def _slopes(
    data: Triad, axis: int, own: Sequence[Term], effects: Effects, theta: Theta, beta: FloatArray
) -> FloatArray:
    """Derivative of the model by each nonlinear parameter (n, q), central."""
    out = []
    for effect in effects:
        for parameter in effect.parameters:
            at = theta[effect.name][parameter.name]
            step = 0.02 * at if parameter.log else 0.01 * (parameter.high - parameter.low)
            up, down = (
                design(data, axis, own, effects, {**theta, effect.name: {**theta[effect.name], parameter.name: value}})
                for value in (at + step, at - step)
            )
            out.append((up - down) @ beta / (2.0 * step))
    return np.stack(out, axis=1) if out else np.empty((len(data.time), 0))
