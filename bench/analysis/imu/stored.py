"""The calibration of an inertial unit as a record, and its curves out of that record again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np

from bench.analysis.imu.attitudes import gravity_at
from bench.analysis.imu.curves import AxisCurves, Estimate, ImuCurves, Reference, TriadCurves
from bench.analysis.imu.diagnosis import Diagnosis
from bench.analysis.imu.fitting import AxisFit, TriadFit
from bench.analysis.imu.plan import OUTPUTS, ImuPlan
from bench.analysis.imu.rows import ImuRows
from bench.analysis.imu.triad import UNITS, Curve, Kind, Term, Triad
from bench.base import FloatArray, InputError, __version__
from bench.record import AXES, ImuAxis, ImuFinding, ImuParameter, ImuPosition, ImuRecord, ImuSource, ImuTriad, ImuValue

_LEAST_PAIRS = 100
_STILL_DPS = 0.05
"""A sample at which the table turns no faster is one at rest: encoders of a table that stands are never quite still."""
_DIGITS = 7
"""Significant digits of rows that are kept to be looked at."""


@dataclass(frozen=True)
class ImuCalibration:
    """What `bench imu` found of one unit."""

    unit: str
    plan: ImuPlan
    rows: ImuRows
    found: Diagnosis
    range_degc: tuple[float, float]
    estimates: tuple[Estimate, ...]
    undetermined: tuple[str, ...]
    simulated: bool = False
    sample_hz: float | None = None
    """Of the unit, where the rows were made of means."""

    def record(self, columns: Mapping[str, FloatArray], sources: Sequence[ImuSource]) -> ImuRecord:
        """The record; `columns` are the samples that the rows were made of, for the noise between them."""
        plan, fit, gyro = self.plan, self.found.fit, self.rows.gyro
        step, noise = _noise(columns, plan)
        return ImuRecord(
            unit=self.unit,
            created=datetime.now(UTC).isoformat(timespec="seconds"),
            software={"bench": __version__},
            sources=tuple(sources),
            plan=plan.model_dump(mode="json"),
            latitude_deg=plan.latitude_deg,
            gravity=gravity_at(plan.latitude_deg) if plan.gravity is None else plan.gravity,
            interval_s=plan.row_s,
            left_out=self.rows.left_out,
            time_s=_kept(gyro.time),
            sample_hz=self.sample_hz or 1.0 / step,
            simulated=self.simulated,
            range_degc=self.range_degc,
            rate_ppm=plan.rate_ppm,
            gravity_ppm=plan.gravity_ppm,
            gyro=_triad("gyro", plan, gyro, fit.gyro, noise),
            accelerometer=_triad("accelerometer", plan, self.rows.accelerometer, fit.accelerometer, noise),
            parameters=tuple(
                ImuValue(name=e.name, kind=e.kind, unit=e.unit, temperature_degc=e.temperature, value=e.value, U=e.U)
                for e in self.estimates
            ),
            undetermined=self.undetermined,
            findings=tuple(
                ImuFinding(cause=f.cause, where=f.where, text=f.text, look_alikes=f.look_alikes)
                for f in self.found.findings
            ),
            positions=_positions(gyro),
        )


def curves_of(record: ImuRecord) -> ImuCurves:
    """The curves of a unit, as they were fitted."""
    reference = Reference(record.rate_ppm, record.gravity_ppm)
    gyro, accelerometer = (
        TriadCurves(triad.kind, (_axis(triad.axes[0]), _axis(triad.axes[1]), _axis(triad.axes[2])), reference)
        for triad in record.triads
    )
    return ImuCurves(gyro, accelerometer)


def _axis(stored: ImuAxis) -> AxisCurves:
    low, high = stored.range_degc
    terms = tuple(
        Term(p.name, p.kind, p.unit, p.factor, Curve(len(p.coefficients) - 1, p.intervals, low, high), p.towards)
        for p in stored.parameters
    )
    beta = np.array([value for p in stored.parameters for value in p.coefficients])
    return AxisCurves(terms, (), {}, beta, np.array(stored.covariance))


def _triad(kind: Kind, plan: ImuPlan, data: Triad, fit: TriadFit, noise: Mapping[str, float | None]) -> ImuTriad:
    thermometers = plan.thermometers(kind)

    def axis(i: int) -> ImuAxis:
        own, output = fit.axes[i], OUTPUTS[kind][i]
        curve = own.terms[0].curve
        left = own.scatter.root @ own.solution.residual
        return ImuAxis(
            axis=AXES[i],
            output=output,
            thermometer=thermometers[i],
            range_degc=(curve.low, curve.high),
            parameters=_parameters(own),
            covariance=tuple(tuple(row) for row in own.covariance.tolist()),
            variances=dict(own.scatter.variances),
            temperature_degc=_kept(data.temperature[:, i]),
            residual=_kept(left),
            noise_density=noise[output],
        )

    return ImuTriad(kind=kind, unit=UNITS[kind], axes=(axis(0), axis(1), axis(2)))


def _parameters(own: AxisFit) -> tuple[ImuParameter, ...]:
    if own.effects:
        raise InputError("a record of an inertial unit holds curves; effects with memory are not kept")
    return tuple(
        ImuParameter(
            name=term.name, kind=term.kind, unit=term.unit, factor=term.factor, towards=term.towards,
            coefficients=tuple(own.beta[own.slices[term.name]].tolist()), intervals=term.curve.intervals,
        )
        for term in own.terms
    )  # fmt: skip


def _noise(columns: Mapping[str, FloatArray], plan: ImuPlan) -> tuple[float, dict[str, float | None]]:
    """Time between samples [s], and white noise of each output at rest [unit / sqrt(Hz)].

    That of the Allan variance at the time between samples (IEEE Std 952): half the mean square of the differences of
    neighbours within a stay. Slower noise and the temperature do not reach it.
    """
    time = columns["time"]
    steps = np.diff(time)
    step = float(np.median(steps))
    still = np.abs(np.nan_to_num(columns.get("applied_rate", np.zeros(len(time))))) < _STILL_DPS
    inside = np.zeros(len(time), dtype=np.int64)
    for number, stay in enumerate(plan.stays, start=1):
        inside[(time >= stay.from_s) & (time < stay.to_s)] = number
    pairs = still[1:] & still[:-1] & (inside[1:] > 0) & (inside[1:] == inside[:-1]) & (steps < 1.5 * step)
    found: dict[str, float | None] = {}
    for name in (*OUTPUTS["gyro"], *OUTPUTS["accelerometer"]):
        apart = np.diff(columns[name])[pairs]
        apart = apart[np.isfinite(apart)]
        found[name] = float(np.sqrt(0.5 * np.mean(apart**2) * step)) if len(apart) >= _LEAST_PAIRS else None
    return step, found


def _positions(data: Triad) -> tuple[ImuPosition, ...]:
    rows = np.column_stack([data.stay.attitude[:, :, 2], data.stay.rate_dps])
    found = np.unique(rows.round(4), axis=0).tolist()
    return tuple(ImuPosition(up=(x, y, z), rate_dps=rate) for x, y, z, rate in found)


def _kept(values: FloatArray) -> tuple[float, ...]:
    return tuple(float(f"{value:.{_DIGITS}g}") for value in values.tolist())
