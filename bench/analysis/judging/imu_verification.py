"""The calibration of an inertial unit against other positions and rates than it was fitted to.

Nothing is fitted: not to the unit, nor to fixture or place. Only rows whose attitude or rate was not fitted are judged;
a row beyond the calibrated temperatures is left out and counted. Without limits the calibration is judged by what it
states of itself: the mean of an axis is one draw of its wandering bias and of its parameters, its scatter is many.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from typing import Any

import numpy as np
from scipy.stats import chi2

from bench.analysis.imu.curves import TriadCurves
from bench.analysis.imu.rows import ImuRows
from bench.analysis.imu.stored import curves_of
from bench.analysis.imu.triad import Triad
from bench.analysis.judging.limits import Limits, judge_limits
from bench.analysis.judging.quantity import COVERAGE, Quantity
from bench.analysis.noise.whitening import Ratios, covariance
from bench.analysis.thresholds import VERIFIED_RATIO
from bench.base import BoolArray, FloatArray, InputError
from bench.record import (
    AXES,
    ImuAxisError,
    ImuRecord,
    ImuSource,
    ImuTriad,
    ImuVerificationRecord,
    Judged,
    StoredQuantity,
    Verdict,
)

NEW_DEG = 5.0
"""An attitude that is closer to a fitted one is that one."""
NEW_DPS = 1.0
"""The same of a rate; or 5 % of it."""
_BEYOND_DEGC = 1.0
_LEAST_PAIRS = 6
UNITS = {"gyro": "dph", "accelerometer": "mps2"}
"""End of the names of quantities."""


def verify_imu(
    record: ImuRecord, rows: ImuRows, limits: Limits | None = None, sources: Sequence[ImuSource] = ()
) -> ImuVerificationRecord:
    """Judge a calibration by rows of another table, made from `sources`.

    InputError where none of them has a new attitude or rate.
    """
    within, new = _within(record, rows), _new(record, rows.gyro)
    chosen = np.flatnonzero(within & new)
    if not len(chosen):
        raise InputError(
            f"no row of {len(new)} verifies this calibration: {np.sum(within & ~new)} have attitudes and rates that "
            f"were fitted, {np.sum(~within)} temperatures beyond the calibrated ones; measure other positions or rates"
        )
    gyro, accelerometer = rows.gyro.rows(chosen), rows.accelerometer.rows(chosen)
    curves = curves_of(record)
    found = curves.corrected(gyro, accelerometer)
    axes = tuple(
        error
        for data, values, own, stored in zip(
            (gyro, accelerometer), found, (curves.gyro, curves.accelerometer), record.triads, strict=True
        )
        for error in _errors(data, values, own, stored)
    )
    quantities = tuple(_quantities(axes))
    verdict, judged = _judged(axes, quantities, limits)
    both = np.hstack([gyro.temperature, accelerometer.temperature])
    return ImuVerificationRecord(
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        sources=tuple(sources),
        verdict=verdict.value,
        rows=len(chosen),
        stays=len(np.unique(gyro.visit)),
        fitted_rows=int(np.sum(within & ~new)),
        rows_beyond=int(np.sum(~within)),
        range_degc=(float(both.min()), float(both.max())),
        axes=axes,
        quantities=tuple(StoredQuantity.model_validate(quantity.to_json()) for quantity in quantities),
        **judged,
    )


def _within(record: ImuRecord, rows: ImuRows) -> BoolArray:
    """Rows (n,) whose temperatures were calibrated, every axis of them."""
    inside = np.ones(len(rows.gyro.time), dtype=bool)
    for data, triad in zip((rows.gyro, rows.accelerometer), record.triads, strict=True):
        for i, axis in enumerate(triad.axes):
            low, high = axis.range_degc
            own = data.temperature[:, i]
            inside &= (own >= low - _BEYOND_DEGC) & (own <= high + _BEYOND_DEGC)
    return inside


def _new(record: ImuRecord, data: Triad) -> BoolArray:
    """Rows (n,) whose attitude and rate were not fitted together."""
    ups = np.array([position.up for position in record.positions])
    rates = np.array([position.rate_dps for position in record.positions])
    apart = np.degrees(np.arccos(np.clip(data.stay.attitude[:, :, 2] @ ups.T, -1.0, 1.0)))
    off = np.abs(data.stay.rate_dps[:, None] - rates[None, :])
    same = (apart < NEW_DEG) & (off < np.maximum(NEW_DPS, 0.05 * np.abs(rates)[None, :]))
    return np.asarray(~same.any(axis=1))


def _errors(data: Triad, found: FloatArray, own: TriadCurves, stored: ImuTriad) -> Iterator[ImuAxisError]:
    error, raw = found - data.driving, data.output - data.driving
    stays = len(np.unique(data.visit))
    for i, axis in enumerate(AXES):
        rms = _rms(error[:, i])
        low, high = (rms * float(np.sqrt(stays / chi2.ppf(p, stays))) for p in (0.975, 0.025))
        floor = _floor(data, error[:, i], i, stored)
        yield ImuAxisError(
            name=f"{data.kind} {axis}",
            unit=stored.unit,
            raw_rms=_rms(raw[:, i]),
            rms=rms,
            interval=(low, high),
            mean=float(np.mean(error[:, i])),
            scatter=float(np.std(error[:, i])),
            peak=float(np.max(np.abs(error[:, i]))),
            floor=floor,
            over_floor=rms / floor,
            stated=float(np.sqrt(floor**2 + _uncertain(data, i, own) + _wandering(data, i, stored))),
        )


def _floor(data: Triad, error: FloatArray, axis: int, stored: ImuTriad) -> float:
    variances = stored.axes[axis].variances
    exact = sum(value for name, value in variances.items() if name in {"visit", "attitude"})
    across = np.delete(data.driving, axis, axis=1)
    attitudes = exact * float(np.mean(np.sum(across**2, axis=1)))
    together = (np.diff(data.visit) == 0) & (np.abs(np.diff(data.stay.rate_dps)) < NEW_DPS)
    if np.sum(together) >= _LEAST_PAIRS:
        noise = 0.5 * float(np.mean(np.diff(error)[together] ** 2))
    else:  # no stay is two rows long
        noise = variances.get("white", 0.0)
    return float(np.sqrt(noise + attitudes))


def _uncertain(data: Triad, axis: int, own: TriadCurves) -> float:
    """Mean variance of these rows from the uncertainty of the parameters."""
    fit, reference = own.axes[axis], own.reference
    parts = [term.curve.columns(data.temperature[:, axis]) * term.drive(data, axis)[:, None] for term in fit.terms]
    columns = np.hstack(parts)
    ppm = reference.rate_ppm if own.kind == "gyro" else reference.gravity_ppm
    scale = (1e-6 * ppm * data.driving[:, axis]) ** 2
    return float(np.mean(np.sum(columns @ fit.covariance * columns, axis=1) + scale))


def _wandering(data: Triad, axis: int, stored: ImuTriad) -> float:
    """Mean variance of these rows from flicker and walk, as the calibration found them."""
    variances, none = stored.axes[axis].variances, np.zeros(len(data.time))
    flicker, walk = (
        float(np.mean(np.diag(covariance(data.time, data.interval_s, ratios, none))))
        for ratios in (Ratios(1.0, 0.0), Ratios(0.0, 1.0))
    )
    return variances.get("flicker", 0.0) * flicker + variances.get("walk", 0.0) * walk


def _quantities(axes: tuple[ImuAxisError, ...]) -> Iterator[Quantity]:
    """The worst axis of each triad."""
    for kind, unit in UNITS.items():
        own = [axis for axis in axes if axis.name.startswith(kind)]
        worst = max(own, key=lambda axis: axis.rms)
        yield Quantity(f"{kind}_error_rms_{unit}", worst.rms, *worst.interval, in_verification=True)
        peak = max(own, key=lambda axis: axis.peak)
        yield Quantity.positive(f"{kind}_error_peak_{unit}", peak.peak, peak.floor)
        ratio = max(own, key=lambda axis: axis.over_floor)
        low, high = (end / ratio.floor for end in ratio.interval)
        yield Quantity(f"{kind}_error_over_floor", ratio.over_floor, low, high, in_verification=True)


def _judged(
    axes: tuple[ImuAxisError, ...], quantities: tuple[Quantity, ...], limits: Limits | None
) -> tuple[Verdict, dict[str, Any]]:
    if limits is not None:
        own = tuple(limit for limit in limits.limits if limit.within({q.name for q in quantities}))
        if not own:
            names = ", ".join(quantity.name for quantity in quantities)
            raise InputError(
                f"limits {limits.name}: none is for a quantity of an inertial unit's verification: {names}"
            )
        judgement = judge_limits(limits.model_copy(update={"limits": own}), quantities)
        return judgement.verdict, {"limits": Judged.model_validate(judgement.to_json())}
    rule = (
        f"of each axis the mean within {COVERAGE:g} times the stated standard deviation, the scatter within "
        f"{VERIFIED_RATIO:g} times; MARGINAL where the 95 % interval of the scatter reaches below"
    )
    if any(abs(axis.mean) > COVERAGE * axis.stated for axis in axes):
        return Verdict.FAIL, {"rule": rule}
    over = [axis for axis in axes if axis.scatter > VERIFIED_RATIO * axis.stated]
    low = all(axis.scatter * axis.interval[0] / axis.rms <= VERIFIED_RATIO * axis.stated for axis in over)
    return (Verdict.FAIL if not low else Verdict.MARGINAL if over else Verdict.PASS), {"rule": rule}


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))
