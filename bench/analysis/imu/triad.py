"""What is measured of a triad, and the model of it: each parameter a curve over temperature."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
import scipy
from numpy.polynomial import chebyshev

from bench.analysis.imu.attitudes import STANDARD_GRAVITY, Stay
from bench.analysis.thresholds import LEAST_RANGE_DEGC
from bench.base import DPH_PER_DPS, FloatArray, InputError, IntArray
from bench.record import AXES, Dataset

Kind = Literal["gyro", "accelerometer"]
UNITS = {"gyro": "deg/h", "accelerometer": "m/s^2"}
POWERS = {"second order": 2, "third order": 3, "fourth order": 4, "fifth order": 5}
"""Of the input of an axis, by the kind of parameter that multiplies them."""
AT = {"gyro": 100.0 * DPH_PER_DPS, "accelerometer": STANDARD_GRAVITY}
"""Inputs for which the factors of powers are stated: 100 deg/s and 1 g, in the units of the triads."""
MOST_ROWS = 800
"""The covariance of the rows is a full matrix; longer rows are as good."""
_BEYOND_DEGC = 1.0


@dataclass(frozen=True, eq=False)
class Triad:
    """Means of three outputs over rows of equal length, and what they should have measured."""

    kind: Kind
    time: FloatArray
    """(n,) middle of each row [s], increasing."""
    output: FloatArray
    """(n, 3) [deg/h] or [m/s^2]."""
    temperature: FloatArray
    """(n, 3) [degC]: what each axis reads of its own die; one thermometer stands three times."""
    rate: FloatArray
    """(n, 3) along the unit's axes, Earth included [deg/h]."""
    force: FloatArray
    """(n, 3) specific force along the unit's axes [m/s^2]."""
    stay: Stay
    """Attitude, angle and rate of the table of each row."""
    visit: IntArray
    """(n,) the same number while an attitude was kept."""
    attitude: IntArray
    """(n,) the same number for the same attitude."""
    interval_s: float
    history: tuple[Dataset, ...] = field(default=(), repr=False)
    """Temperature of each axis over the whole record, for effects with memory; empty: of the rows alone."""

    def __post_init__(self) -> None:
        rows = len(self.time)
        for name in ("output", "temperature", "rate", "force"):
            values = getattr(self, name)
            if values.shape != (rows, 3):
                raise InputError(f"{self.kind}: {name} has shape {values.shape}, time needs ({rows}, 3)")
            if not np.isfinite(values).all():
                row = int(np.nonzero(~np.isfinite(values).all(axis=1))[0][0])
                raise InputError(f"{self.kind}: {name} has no value in row {row + 1}; leave rows with gaps out")
        if rows > MOST_ROWS:
            raise InputError(f"{self.kind}: {rows} rows, at most {MOST_ROWS} are fitted; average over longer rows")
        if np.any(np.diff(self.time) <= 0.0):
            raise InputError(f"{self.kind}: time runs backwards or stands still")

    @property
    def driving(self) -> FloatArray:
        """What the triad measures (n, 3): rate of gyros, specific force of accelerometers."""
        return self.rate if self.kind == "gyro" else self.force

    def rows(self, chosen: FloatArray | IntArray) -> Triad:
        """Only these rows; effects with memory still see the whole record."""
        history = self.history or tuple(self.record(axis) for axis in range(3))
        names = ("time", "output", "temperature", "rate", "force", "visit", "attitude")
        picked = {name: getattr(self, name)[chosen] for name in names}
        return replace(self, **picked, stay=self.stay.rows(chosen), history=history)

    def record(self, axis: int) -> Dataset:
        """The temperature of an axis as effects see it."""
        if self.history:
            return self.history[axis]
        segment = np.zeros(len(self.time), dtype=np.int64)
        temperature = {"temperature": self.temperature[:, axis]}
        return Dataset(self.kind, self.time, temperature, segment, interval_s=self.interval_s)


@dataclass(frozen=True)
class Curve:
    """A parameter over temperature: polynomial of an `order`, or cubic spline of `intervals`."""

    order: int = 0
    intervals: int = 0
    low: float = -1.0
    high: float = 1.0

    def over(self, low: float, high: float) -> Curve:
        """The same over this range [degC]; where there is none, only its constant is left to be determined."""
        return replace(self, low=low, high=high)

    @property
    def size(self) -> int:
        """Number of coefficients."""
        return self.intervals + 3 if self.intervals else self.order + 1

    def columns(self, temperature: FloatArray) -> FloatArray:
        """Basis (n, size): Chebyshev polynomials or B-splines; tangents beyond the range."""
        width = self.high - self.low if self.high - self.low > LEAST_RANGE_DEGC else np.inf
        x = (2.0 * temperature - self.low - self.high) / width
        inside = np.clip(x, -1.0, 1.0)
        if not self.intervals:
            table = chebyshev.chebvander(inside, self.order)
            slopes = np.stack([chebyshev.chebval(inside, chebyshev.chebder(row)) for row in np.eye(self.size)], axis=1)
            return np.asarray(table + slopes * (x - inside)[:, None])
        knots = np.concatenate([[-1.0] * 3, np.linspace(-1.0, 1.0, self.intervals + 1), [1.0] * 3])
        spline = scipy.interpolate.BSpline(knots, np.eye(self.size), 3)
        return np.asarray(spline(inside) + spline.derivative()(inside) * (x - inside)[:, None])

    def refuse(self, temperature: FloatArray) -> None:
        """InputError for temperatures beyond what was measured."""
        low, high = float(np.min(temperature)), float(np.max(temperature))
        if low < self.low - _BEYOND_DEGC or high > self.high + _BEYOND_DEGC:
            raise InputError(
                f"{low:.1f} to {high:.1f} degC is beyond what was calibrated, {self.low:.1f} to {self.high:.1f} degC"
            )


@dataclass(frozen=True)
class TriadModel:
    """Curves of each kind of parameter; None leaves a kind out."""

    bias: Curve = Curve(3)
    scale: Curve = Curve(2)
    misalignment: Curve = Curve(1)
    g_sensitivity: Curve | None = Curve(1)
    """Of gyros, (3 x 3)."""
    second_order: Curve | None = Curve(1)
    """Of accelerometers."""
    surface: int | None = None
    """Total degree of a polynomial in temperature and the axis's own input, in the place of bias, scale and second
    order; degree 5 has 21 coefficients."""


@dataclass(frozen=True)
class Term:
    """One parameter of an axis: `columns` multiply what drives it."""

    name: str
    kind: str
    unit: str
    factor: float
    """Its value in `unit` for a coefficient of one."""
    curve: Curve
    towards: int | None = None
    """Axis of the input, where a parameter has one."""

    def drive(self, data: Triad, axis: int) -> FloatArray:
        """What the parameter multiplies (n,)."""
        if self.kind == "bias":
            return np.ones(len(data.time))
        if self.kind in POWERS:
            return np.asarray(data.driving[:, axis] ** POWERS[self.kind] / AT[data.kind] ** (POWERS[self.kind] - 1))
        if self.kind == "g-sensitivity":
            return data.force[:, self.towards or 0] / STANDARD_GRAVITY
        return data.driving[:, axis if self.towards is None else self.towards]


def terms(model: TriadModel, kind: Kind, axis: int, span: tuple[float, float]) -> Iterator[Term]:
    """The parameters of one axis in their order, curves over `span` [degC]."""
    own = f"{kind} {AXES[axis]}"
    degree = model.surface
    bias, scale = (model.bias, model.scale) if degree is None else (Curve(degree), Curve(degree - 1))
    yield Term(f"{own}: bias", "bias", UNITS[kind], 1.0, bias.over(*span))
    yield Term(f"{own}: scale factor", "scale factor", "ppm", 1e6, scale.over(*span))
    for other in (k for k in range(3) if k != axis):
        name = f"{own}: misalignment towards {AXES[other]}"
        yield Term(name, "misalignment", "mrad", 1e3, model.misalignment.over(*span), other)
    if kind == "gyro" and model.g_sensitivity is not None:
        for k in range(3):
            name = f"{own}: g-sensitivity along {AXES[k]}"
            yield Term(name, "g-sensitivity", "deg/h/g", 1.0, model.g_sensitivity.over(*span), k)
    powers = {name: Curve(degree - k) for name, k in POWERS.items() if degree is not None and k <= degree}
    if degree is None and kind == "accelerometer" and model.second_order is not None:
        powers = {"second order": model.second_order}
    for name, curve in powers.items():
        unit = f"ug/g^{POWERS[name]}" if kind == "accelerometer" else "ppm"
        yield Term(f"{own}: {name}", name, unit, 1e6, curve.over(*span))
