"""The calibration of an inertial unit as parameters of PX4 and of ArduPilot: biases over temperature, and the
accelerometers' scale factors. What they cannot hold stands at the top of each file.

Sources: PX4-Autopilot, src/modules/temperature_compensation/TemperatureCompensation.cpp (offset = X0 + X1 d + X2 d^2 +
X3 d^3, d = T - TREF, T clipped to TMIN, TMAX) and src/lib/sensor_calibration (data - thermal offset - offset, of
accelerometers times scale), rad/s and m/s^2. ArduPilot, libraries/AP_InertialSensor/AP_InertialSensor_tempcal.cpp
(v -= P(T) - P(CALTEMP), P(T) = (c1 + (c2 + c3 d) d) d / 1e6, d = T - 35 degC) and AP_InertialSensor_Backend.cpp
(then - offset, then times scale).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import Polynomial

from bench.analysis import POWERS, Curve
from bench.base import FloatArray
from bench.record import ImuAxis, ImuRecord, ImuTriad

ORDER = 3
"""Of their polynomials."""
ARDUPILOT_DEGC = 35.0
_RADIANS = np.pi / 180.0 / 3600.0


@dataclass(frozen=True, eq=False)
class _Biases:
    """Bias of each axis of a triad as a cubic in T - `reference` [rad/s or m/s^2], and the worst that it differs by."""

    reference: float
    low: float
    high: float
    cubics: FloatArray
    """(3, 4), lowest power first."""
    worst: float
    """In the unit of the record."""


def px4(record: ImuRecord) -> tuple[str, tuple[str, ...]]:
    """A parameter file of QGroundControl (tabs; type 9 is a float, 6 an integer), and what it lacks, line by line."""
    middle = round(0.5 * sum(record.range_degc), 1)
    gyro, accelerometer = (_biases(triad, middle) for triad in record.triads)
    lost = tuple(_lost(record, gyro, accelerometer, middle))

    def lines() -> Iterator[tuple[str, float, int]]:
        for letter, found in (("G", gyro), ("A", accelerometer)):
            yield f"TC_{letter}_ENABLE", 1, 6
            own = f"TC_{letter}0"
            ends = {"TREF": found.reference, "TMIN": found.low, "TMAX": found.high}
            yield from ((f"{own}_{name}", value, 9) for name, value in ends.items())
            for power in range(ORDER + 1):
                yield from ((f"{own}_X{power}_{i}", float(found.cubics[i, power]), 9) for i in range(3))
        yield from ((f"CAL_GYRO0_{axis}OFF", 0.0, 9) for axis in "XYZ")
        yield from ((f"CAL_ACC0_{axis}OFF", 0.0, 9) for axis in "XYZ")
        yield from ((f"CAL_ACC0_{axis}SCALE", s, 9) for axis, s in zip("XYZ", _scales(record, middle), strict=True))

    head = _head(record, "PX4", lost, "Set CAL_GYRO0_ID, CAL_ACC0_ID, TC_G0_ID and TC_A0_ID to the ids of the sensors, "
                 "and CAL_GYRO0_ROT, CAL_ACC0_ROT for their axes.")  # fmt: skip
    return head + "".join(f"1\t1\t{name}\t{value:.9g}\t{kind}\n" for name, value, kind in lines()), lost


def ardupilot(record: ImuRecord) -> tuple[str, tuple[str, ...]]:
    """A parameter file (NAME,VALUE) of the first inertial unit, and what it lacks, line by line."""
    at = float(np.clip(ARDUPILOT_DEGC, *record.range_degc))
    gyro, accelerometer = (_biases(triad, ARDUPILOT_DEGC) for triad in record.triads)
    lost = tuple(_lost(record, gyro, accelerometer, at))

    def lines() -> Iterator[tuple[str, float]]:
        yield "INS_TCAL1_ENABLE", 1
        yield "INS_TCAL1_TMIN", max(gyro.low, accelerometer.low)
        yield "INS_TCAL1_TMAX", min(gyro.high, accelerometer.high)
        for letters, name, found in (("GYR", "GYROFFS", gyro), ("ACC", "ACCOFFS", accelerometer)):
            for power in range(1, ORDER + 1):
                yield from ((f"INS_TCAL1_{letters}{power}_{axis}", 1e6 * float(found.cubics[i, power]))
                            for i, axis in enumerate("XYZ"))  # fmt: skip
            yield f"INS_{letters}1_CALTEMP", at
            offsets = [float(Polynomial(row)(at - ARDUPILOT_DEGC)) for row in found.cubics]
            yield from ((f"INS_{name}_{axis}", value) for axis, value in zip("XYZ", offsets, strict=True))
        yield from ((f"INS_ACCSCAL_{axis}", s) for axis, s in zip("XYZ", _scales(record, at), strict=True))
        yield "INS_GYR_CAL", 0

    head = _head(record, "ArduPilot", lost, "INS_GYR_CAL 0 keeps the offsets of the gyros: else each start replaces "
                 "them. The axes are those of the unit: AHRS_ORIENTATION has to fit.")  # fmt: skip
    return head + "".join(f"{name},{value:.9g}\n" for name, value in lines()), lost


def _head(record: ImuRecord, what: str, lost: tuple[str, ...], todo: str) -> str:
    lines = [
        f"{what}: inertial unit {record.unit or 'without a serial number'}, calibrated {record.created}", todo,
        "Not in this file:", *(f"  {text}" for text in lost),
    ]  # fmt: skip
    return "".join(f"# {line}\n" for line in lines)


def _biases(triad: ImuTriad, reference: float) -> _Biases:
    low, high = max(a.range_degc[0] for a in triad.axes), min(a.range_degc[1] for a in triad.axes)
    grid, size = np.linspace(low, high, 201), _RADIANS if triad.kind == "gyro" else 1.0
    cubics, worst = [], 0.0
    for axis in triad.axes:
        values = _curve(axis, "bias")(grid)
        cubic = Polynomial.fit(grid - reference, values, ORDER).convert()
        worst = max(worst, float(np.max(np.abs(cubic(grid - reference) - values))))
        cubics.append(size * np.asarray(cubic.coef, dtype=np.float64))
    return _Biases(reference, low, high, np.array(cubics), worst)


def _scales(record: ImuRecord, at: float) -> list[float]:
    """What an accelerometer's output is multiplied by, at one temperature."""
    return [1.0 / (1.0 + float(_curve(axis, "scale factor")(np.array([at]))[0])) for axis in record.accelerometer.axes]


def _curve(axis: ImuAxis, kind: str) -> Callable[[FloatArray], FloatArray]:
    """The parameter of a kind over temperatures (n,), as a plain factor."""
    own = next(p for p in axis.parameters if p.kind == kind)
    curve = Curve(len(own.coefficients) - 1, own.intervals, *axis.range_degc)
    return lambda temperature: np.asarray(curve.columns(temperature) @ own.coefficients)


def _lost(record: ImuRecord, gyro: _Biases, accelerometer: _Biases, at: float) -> Iterator[str]:
    """What the parameters cannot hold, with its greatest size over the calibrated range."""
    for triad, kinds in zip(
        record.triads,
        (("scale factor", "misalignment", "g-sensitivity", *POWERS), ("misalignment", *POWERS)),
        strict=True,
    ):
        for kind in kinds:
            found = [v for v in record.parameters if v.name.startswith(triad.kind) and v.kind == kind]
            if found:
                worst = max(found, key=lambda v: abs(v.value))
                yield f"{triad.kind} {kind}: up to {abs(worst.value):.3g} {worst.unit}"
    apart = max(
        float(np.max(np.abs(1e6 * (curve(np.array(record.range_degc)) - curve(np.array([at]))))))
        for axis in record.accelerometer.axes for curve in (_curve(axis, "scale factor"),)
    )  # fmt: skip
    yield f"accelerometer scale factor over temperature: it is that of {at:g} degC, up to {apart:.3g} ppm from the ends"
    for triad, own in zip(record.triads, (gyro, accelerometer), strict=True):
        if own.worst > 1e-9 * max(1e-30, float(np.max(np.abs(own.cubics)))) and own.worst > 1e-6:
            yield f"{triad.kind} bias beyond order 3: up to {own.worst:.2g} {triad.unit}"
        names = dict.fromkeys(axis.thermometer for axis in triad.axes)
        if len(names) > 1:
            yield f"{triad.kind}: a thermometer for each axis ({', '.join(names)}); there is one for the triad"
    yield "the uncertainties"
