"""The calibration of an inertial unit against other positions and rates than it was fitted to.

Nothing is fitted: not to the unit, nor to fixture or place. Only rows whose attitude or rate was not fitted are judged;
a row beyond the calibrated temperatures is left out and counted.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import chi2

from bench.analysis.imu.rows import ImuRows
from bench.analysis.imu.stored import curves_of
from bench.analysis.imu.triad import Triad
from bench.analysis.judging.limits import Limits, Quantity, Verdict, judge_limits
from bench.analysis.thresholds import VERIFIED_RATIO
from bench.base import BoolArray, FloatArray, InputError, finite
from bench.record import AXES, ImuRecord, ImuTriad

NEW_DEG = 5.0
"""An attitude that is closer to a fitted one is that one."""
NEW_DPS = 1.0
"""The same of a rate; or 5 % of it."""
_BEYOND_DEGC = 1.0
_LEAST_PAIRS = 6
UNITS = {"gyro": "dph", "accelerometer": "mps2"}
"""End of the names of quantities."""


@dataclass(frozen=True)
class AxisError:
    """One axis over the judged rows, in the unit of its output."""

    name: str
    unit: str
    raw_rms: float
    """Output less input, before the correction."""
    rms: float
    """After it."""
    interval: tuple[float, float]
    """95 %, as if each stay were one value: the rows of a stay share its attitude's error."""
    mean: float
    peak: float
    floor: float
    """What a perfect calibration would leave: noise of neighbouring rows of a stay, and attitudes that are as exact as
    the calibration found them. The wandering of a bias between two runs is not in it: the unit's user sees that."""

    @property
    def over_floor(self) -> float:
        """RMS over the floor."""
        return self.rms / self.floor

    def to_json(self) -> dict[str, Any]:
        """All of it."""
        numbers = {key: finite(getattr(self, key)) for key in ("raw_rms", "rms", "mean", "peak", "floor", "over_floor")}
        return {"name": self.name, "unit": self.unit, **numbers, "interval": [finite(end) for end in self.interval]}


@dataclass(frozen=True)
class ImuVerification:
    """What other positions and rates say of a calibration."""

    axes: tuple[AxisError, ...]
    rows: int
    """Judged."""
    stays: int
    fitted: int
    """Rows left out because attitude and rate were fitted."""
    beyond: int
    """Rows left out because a temperature was beyond the calibrated range."""
    range_degc: tuple[float, float]
    quantities: tuple[Quantity, ...]
    verdict: Verdict
    judged: dict[str, Any]

    def to_json(self) -> dict[str, Any]:
        """What the command answers."""
        return {
            "verdict": self.verdict.value,
            "rows": self.rows,
            "stays": self.stays,
            "fitted_rows": self.fitted,
            "rows_beyond": self.beyond,
            "range_degc": list(self.range_degc),
            "axes": [axis.to_json() for axis in self.axes],
            "quantities": [quantity.to_json() for quantity in self.quantities],
            **self.judged,
        }


def verify_imu(record: ImuRecord, rows: ImuRows, limits: Limits | None = None) -> ImuVerification:
    """Judge a calibration by rows of another table; InputError where none of them has a new attitude or rate."""
    within, new = _within(record, rows), _new(record, rows.gyro)
    chosen = np.flatnonzero(within & new)
    if not len(chosen):
        raise InputError(
            f"no row of {len(new)} verifies this calibration: {np.sum(within & ~new)} have attitudes and rates that "
            f"were fitted, {np.sum(~within)} temperatures beyond the calibrated ones; measure other positions or rates"
        )
    gyro, accelerometer = rows.gyro.rows(chosen), rows.accelerometer.rows(chosen)
    found = curves_of(record).corrected(gyro, accelerometer)
    axes = tuple(
        error
        for data, values, stored in zip((gyro, accelerometer), found, record.triads, strict=True)
        for error in _errors(data, values, stored)
    )
    quantities = tuple(_quantities(axes))
    verdict, judged = _judged(axes, quantities, limits)
    both = np.hstack([gyro.temperature, accelerometer.temperature])
    span = float(both.min()), float(both.max())
    counts = len(chosen), len(np.unique(gyro.visit)), int(np.sum(within & ~new)), int(np.sum(~within))
    return ImuVerification(axes, *counts, span, quantities, verdict, judged)


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


def _errors(data: Triad, found: FloatArray, stored: ImuTriad) -> Iterator[AxisError]:
    error, raw = found - data.driving, data.output - data.driving
    stays = len(np.unique(data.visit))
    for i, axis in enumerate(AXES):
        rms = _rms(error[:, i])
        low, high = (rms * float(np.sqrt(stays / chi2.ppf(p, stays))) for p in (0.975, 0.025))
        yield AxisError(
            f"{data.kind} {axis}", stored.unit, _rms(raw[:, i]), rms, (low, high), float(np.mean(error[:, i])),
            float(np.max(np.abs(error[:, i]))), _floor(data, error[:, i], i, stored),
        )  # fmt: skip


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


def _quantities(axes: tuple[AxisError, ...]) -> Iterator[Quantity]:
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
    axes: tuple[AxisError, ...], quantities: tuple[Quantity, ...], limits: Limits | None
) -> tuple[Verdict, dict[str, Any]]:
    if limits is not None:
        own = tuple(limit for limit in limits.limits if limit.quantity in {q.name for q in quantities})
        if not own:
            names = ", ".join(quantity.name for quantity in quantities)
            raise InputError(
                f"limits {limits.name}: none is for a quantity of an inertial unit's verification: {names}"
            )
        judgement = judge_limits(limits.model_copy(update={"limits": own}), quantities)
        return judgement.verdict, {"limits": judgement.to_json()}
    rule = (
        f"RMS of each axis at most {VERIFIED_RATIO:g} times its floor; MARGINAL where only 95 % intervals reach below"
    )
    if all(axis.rms <= VERIFIED_RATIO * axis.floor for axis in axes):
        return Verdict.PASS, {"rule": rule}
    low = all(axis.interval[0] <= VERIFIED_RATIO * axis.floor for axis in axes)
    return (Verdict.MARGINAL if low else Verdict.FAIL), {"rule": rule}


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))
