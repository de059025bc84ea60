"""Fit of a triad over temperature: all parameters of an axis jointly, by generalised least squares.

Equation: y_i = u_i + b_i(T) + s_i(T) u_i + sum_j m_ij(T) u_j + sum_j g_ij(T) f_j + k_i(T) f_i^2 + effects with memory,
u the rate of a gyro or the specific force f of an accelerometer (IEEE Std 1431 and 1293). Every parameter is a curve
over the temperature of its own axis; an effect that moves the abscissa (a lag) moves it for all of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.optimize import minimize_scalar

from bench.analysis.effects.base import Effect, Parameter
from bench.analysis.fit.solve import one_blas_thread
from bench.analysis.imu.attitudes import STANDARD_GRAVITY
from bench.analysis.imu.scatter import ATTITUDES, Gls, Scatter, components, estimate, gls
from bench.analysis.imu.triad import Term, Triad, TriadModel, terms
from bench.base import FloatArray, InputError
from bench.record import AXES

COVERAGE = 2.0
"""k of the stated U: 95 % of a normal distribution."""
_GRID = 12
Effects = Sequence[Effect]
Theta = dict[str, dict[str, float]]
"""Parameters of each effect by its name."""


@dataclass(frozen=True)
class Reference:
    """Standard uncertainties of what drives the unit, which no residual shows [ppm]."""

    rate_ppm: float = 0.0
    """Scale of the rate table."""
    gravity_ppm: float = 0.0
    """Of the gravity taken for the place."""


@dataclass(frozen=True)
class Estimate:
    """A parameter at one temperature: value and U (k = 2) in `unit`."""

    name: str
    kind: str
    unit: str
    temperature: float
    value: float
    U: float


@dataclass(frozen=True, eq=False)
class AxisFit:
    """One axis of a triad after its fit."""

    terms: tuple[Term, ...]
    effects: tuple[Effect, ...]
    theta: Theta
    beta: FloatArray
    """Coefficients (p,): those of the terms, then the amplitudes of the effects."""
    covariance: FloatArray
    """(p + q, p + q) with the q nonlinear parameters last."""
    scatter: Scatter
    solution: Gls

    @cached_property
    def slices(self) -> dict[str, slice]:
        """Where the coefficients of each parameter stand."""
        ends = np.cumsum([0, *(term.curve.size for term in self.terms)]).tolist()
        return {term.name: slice(a, b) for term, a, b in zip(self.terms, ends, ends[1:], strict=False)}

    def curve(self, term: Term, temperature: FloatArray) -> FloatArray:
        """The parameter at temperatures (m,) as a plain factor, not in its unit."""
        term.curve.refuse(temperature)
        return np.asarray(term.curve.columns(temperature) @ self.beta[self.slices[term.name]])

    def estimates(self, temperature: float, reference: Reference, kind: str) -> Iterator[Estimate]:
        """Every parameter at one temperature [degC]."""
        for term in self.terms:
            own, basis = self.slices[term.name], term.curve.columns(np.array([temperature]))[0]
            variance = float(basis @ self.covariance[own, own] @ basis)
            if term.kind == "scale factor":
                variance += (1e-6 * (reference.rate_ppm if kind == "gyro" else reference.gravity_ppm)) ** 2
            value = float(self.curve(term, np.array([temperature]))[0])
            U = COVERAGE * term.factor * float(np.sqrt(variance))
            yield Estimate(term.name, term.kind, term.unit, temperature, term.factor * value, U)


@dataclass(frozen=True, eq=False)
class TriadFit:
    """A triad after its fit."""

    kind: str
    axes: tuple[AxisFit, AxisFit, AxisFit]
    reference: Reference

    def estimates(self, temperatures: Sequence[float]) -> tuple[Estimate, ...]:
        """Every parameter of every axis at these temperatures [degC]; InputError beyond what was measured."""
        return tuple(
            e for t in temperatures for axis in self.axes for e in axis.estimates(t, self.reference, self.kind)
        )

    def matrix(self, temperature: FloatArray) -> FloatArray:
        """What multiplies the input (n, 3, 3) at the axes' temperatures (n, 3) [degC]."""
        out = np.zeros((len(temperature), 3, 3))
        for i, axis in enumerate(self.axes):
            for term in axis.terms:
                if term.kind in {"scale factor", "misalignment"}:
                    out[:, i, i if term.towards is None else term.towards] += axis.curve(term, temperature[:, i])
        return out + np.eye(3)

    def rest(self, data: Triad) -> FloatArray:
        """What an axis adds to its matrix times the input (n, 3): bias, g-sensitivity, effects; no second order."""
        out = np.zeros((len(data.time), 3))
        for i, axis in enumerate(self.axes):
            warm = _abscissa(data, i, axis.effects, axis.theta)
            for term in axis.terms:
                if term.kind in {"bias", "g-sensitivity"}:
                    out[:, i] += axis.curve(term, warm) * term.drive(data, i)
            extra = _extra(data, i, axis.effects, axis.theta)
            out[:, i] += extra @ axis.beta[len(axis.beta) - extra.shape[1] :]
        return out

    def corrected(self, data: Triad) -> FloatArray:
        """Outputs (n, 3) turned back into rate or specific force; of gyros with `data.force`, measured or corrected."""
        warm = np.stack([_abscissa(data, i, axis.effects, axis.theta) for i, axis in enumerate(self.axes)], axis=1)
        matrix, left = self.matrix(warm), data.output - self.rest(data)
        second = np.zeros_like(left)
        for i, axis in enumerate(self.axes):
            for term in (term for term in axis.terms if term.kind == "second order"):
                second[:, i] = axis.curve(term, warm[:, i]) / STANDARD_GRAVITY
        found = np.linalg.solve(matrix, left[..., None])[..., 0]
        for _ in range(3 if second.any() else 0):  # the second order is small: each pass wins four digits
            found = np.linalg.solve(matrix, (left - second * found**2)[..., None])[..., 0]
        return np.asarray(found)


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


@dataclass(frozen=True, eq=False)
class ImuFit:
    """Both triads of a unit after their fit."""

    gyro: TriadFit
    accelerometer: TriadFit

    @property
    def triads(self) -> tuple[TriadFit, TriadFit]:
        """Gyros and accelerometers."""
        return self.gyro, self.accelerometer

    def corrected(self, gyro: Triad, accelerometer: Triad) -> tuple[FloatArray, FloatArray]:
        """Rates [deg/h] and specific forces [m/s^2] (n, 3) of outputs; g-sensitivity acts on the corrected forces."""
        force = self.accelerometer.corrected(accelerometer)
        return self.gyro.corrected(replace(gyro, force=force)), force


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
    first = fit_triad(accelerometer, model, given.get("accelerometer", {}), reference)
    exact = {
        name: float(np.mean([axis.scatter.variances[name] for axis in first.axes]))
        for name in first.axes[0].scatter.variances if name in ATTITUDES
    }  # fmt: skip
    second = fit_triad(accelerometer, model, given.get("accelerometer", {}), reference, exact)
    return ImuFit(fit_triad(gyro, model, given.get("gyro", {}), reference, exact), second)


def fit_axis(
    data: Triad,
    axis: int,
    model: TriadModel,
    effects: Effects = (),
    known: Mapping[str, float] | None = None,
    first: Scatter | None = None,
) -> AxisFit:
    """Fit one axis: nonlinear parameters and variances in turn, then the amplitudes; `known` variances stay.

    `first`: the scatter to search the nonlinear parameters with, once; left out, they are searched twice.
    """
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
    solution = gls(columns, target, scatter)
    slopes = _slopes(data, axis, own, effects, theta, solution.beta)
    full = gls(np.hstack([columns, slopes]), target, scatter).covariance if slopes.size else solution.covariance
    return AxisFit(own, tuple(effects), theta, solution.beta, full, scatter, solution)


def span(data: Triad, axis: int) -> tuple[float, float]:
    """Range of an axis's temperature [degC]."""
    return float(data.temperature[:, axis].min()), float(data.temperature[:, axis].max())


def design(data: Triad, axis: int, own: Sequence[Term], effects: Effects, theta: Theta) -> FloatArray:
    """Columns (n, p) of the terms and of the effects with memory."""
    warm = _abscissa(data, axis, effects, theta)
    parts = [term.curve.columns(warm) * term.drive(data, axis)[:, None] for term in own]
    return np.hstack([*parts, _extra(data, axis, effects, theta)])


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


def _abscissa(data: Triad, axis: int, effects: Effects, theta: Theta) -> FloatArray:
    """Temperature (n,) that the terms of an axis see."""
    movers = [effect for effect in effects if effect.moves_abscissa]
    if not movers:
        return data.temperature[:, axis]
    record, own = data.record(axis), data.temperature[:, axis]
    moved = movers[0].abscissa(record, theta[movers[0].name])
    # The rows are means; the shift at their middle is what a lag adds to them.
    return np.asarray(own + np.interp(data.time, record.time, moved - record.channel("temperature")))


def _extra(data: Triad, axis: int, effects: Effects, theta: Theta) -> FloatArray:
    """Columns (n, k) of the effects that add terms."""
    record = data.record(axis)
    columns = [e.prepare([record]).columns(record, theta[e.name]) for e in effects if not e.moves_abscissa]
    if not columns:
        return np.empty((len(data.time), 0))
    table = np.hstack(columns)
    return np.stack([np.interp(data.time, record.time, column) for column in table.T], axis=1)
