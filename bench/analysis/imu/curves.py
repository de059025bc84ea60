"""What the parameters of a unit are at a temperature, and outputs corrected by them; a fit gives them, or a record.

Equation: y_i = u_i + b_i(T) + s_i(T) u_i + sum_j m_ij(T) u_j + sum_j g_ij(T) f_j + k_i(T) f_i^2 + effects with memory,
u the rate of a gyro or the specific force f of an accelerometer (IEEE Std 1431 and 1293). Every parameter is a curve
over the temperature of its own axis; an effect that moves the abscissa (a lag) moves it for all of them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bench.analysis.effects.base import Effect
from bench.analysis.imu.triad import AT, POWERS, Term, Triad
from bench.base import FloatArray

COVERAGE = 2.0
"""k of the stated U: 95 % of a normal distribution."""
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
class AxisCurves:
    """The parameters of one axis over temperature."""

    terms: tuple[Term, ...]
    effects: tuple[Effect, ...]
    theta: Theta
    beta: FloatArray
    """Coefficients (p,): those of the terms, then the amplitudes of the effects."""
    covariance: FloatArray
    """(p + q, p + q) with the q nonlinear parameters last."""

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
class TriadCurves:
    """The parameters of a triad."""

    kind: str
    axes: tuple[AxisCurves, AxisCurves, AxisCurves]
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
        """What an axis adds to its matrix times the input (n, 3): bias, g-sensitivity, effects; no powers of it."""
        out = np.zeros((len(data.time), 3))
        for i, axis in enumerate(self.axes):
            warm = abscissa(data, i, axis.effects, axis.theta)
            for term in axis.terms:
                if term.kind in {"bias", "g-sensitivity"}:
                    out[:, i] += axis.curve(term, warm) * term.drive(data, i)
            extra = extra_columns(data, i, axis.effects, axis.theta)
            out[:, i] += extra @ axis.beta[len(axis.beta) - extra.shape[1] :]
        return out

    def corrected(self, data: Triad) -> FloatArray:
        """Outputs (n, 3) turned back into rate or specific force; of gyros with `data.force`, measured or corrected."""
        warm = np.stack([abscissa(data, i, axis.effects, axis.theta) for i, axis in enumerate(self.axes)], axis=1)
        matrix, left = self.matrix(warm), data.output - self.rest(data)
        factors = {kind: np.zeros_like(left) for kind in POWERS}
        for i, axis in enumerate(self.axes):
            for term in (term for term in axis.terms if term.kind in POWERS):
                factors[term.kind][:, i] = axis.curve(term, warm[:, i])
        found, at = np.linalg.solve(matrix, left[..., None])[..., 0], AT[self.kind]
        used = {POWERS[kind]: factor * at for kind, factor in factors.items() if factor.any()}
        for _ in range(3 if used else 0):  # powers of the input are small: each pass wins three digits or more
            more = sum(factor * (found / at) ** k for k, factor in used.items())
            found = np.linalg.solve(matrix, (left - more)[..., None])[..., 0]
        return np.asarray(found)


@dataclass(frozen=True, eq=False)
class ImuCurves:
    """The parameters of a unit."""

    gyro: TriadCurves
    accelerometer: TriadCurves

    @property
    def triads(self) -> tuple[TriadCurves, TriadCurves]:
        """Gyros and accelerometers."""
        return self.gyro, self.accelerometer

    def corrected(self, gyro: Triad, accelerometer: Triad) -> tuple[FloatArray, FloatArray]:
        """Rates [deg/h] and specific forces [m/s^2] (n, 3) of outputs; g-sensitivity acts on the corrected forces."""
        force = self.accelerometer.corrected(accelerometer)
        return self.gyro.corrected(replace(gyro, force=force)), force


def abscissa(data: Triad, axis: int, effects: Effects, theta: Theta) -> FloatArray:
    """Temperature (n,) that the terms of an axis see."""
    movers = [effect for effect in effects if effect.moves_abscissa]
    if not movers:
        return data.temperature[:, axis]
    record, own = data.record(axis), data.temperature[:, axis]
    moved = movers[0].abscissa(record, theta[movers[0].name])
    # The rows are means; the shift at their middle is what a lag adds to them.
    return np.asarray(own + np.interp(data.time, record.time, moved - record.channel("temperature")))


def extra_columns(data: Triad, axis: int, effects: Effects, theta: Theta) -> FloatArray:
    """Columns (n, k) of the effects that add terms."""
    record = data.record(axis)
    columns = [e.prepare([record]).columns(record, theta[e.name]) for e in effects if not e.moves_abscissa]
    if not columns:
        return np.empty((len(data.time), 0))
    table = np.hstack(columns)
    return np.stack([np.interp(data.time, record.time, column) for column in table.T], axis=1)
