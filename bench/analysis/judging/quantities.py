"""The quantities of a run, each with the interval that holds it with 95 % probability: what limits are applied to.

Standard uncertainties (docs/uncertainty.md): of one mean the white noise sqrt(N^2 / tau), of a difference of two the
root of two times that; RMS values carry the bootstrap interval of their blocks, noise coefficients that of their
likelihood; counts, temperatures and durations are what the record says.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from bench.analysis.diagnosis.compare import rates_of
from bench.analysis.diagnosis.scores import HeldOut, Score
from bench.analysis.effects import registry as effects
from bench.analysis.effects.model import Model
from bench.analysis.fit.fitting import fit_model
from bench.analysis.fit.quantisation import step_error_dph
from bench.analysis.judging.branches import branch_gap
from bench.analysis.judging.completeness import Completeness
from bench.analysis.judging.quantity import Quantity
from bench.analysis.noise.floor import Floor
from bench.analysis.thresholds import LEAST_COVERED_DEGC, LEAST_RATES, TURNING_DPS
from bench.base import DPH_PER_DPS, BoolArray, FloatArray, InputError
from bench.record import Dataset

if TYPE_CHECKING:
    from bench.analysis.judging.analysis import Analysis

_MEDIAN = 1.2533
"""Standard error of a median over that of the mean, sqrt(pi / 2); of two values in each branch, the least there are."""
_ROWS = 1200
"""Means that the noise is estimated from, at most (bench/noise/estimate.py)."""
_NOISE = (
    ("angle_random_walk_dprh", "white"),
    ("bias_instability_dph", "flicker"),
    ("rate_random_walk_dphrh", "walk"),
)
_SLOPES = ("quantisation_deg", "rate_ramp_dphh")
"""Coefficients of IEEE 952 that the floor does not contain."""


def quantities(analysis: Analysis) -> tuple[Quantity, ...]:
    """All quantities of a run; those that it does not show have a reason instead of a value."""
    noise = analysis.floor.noise
    white_dph = float(np.sqrt(noise.white_variance(analysis.interval_s))) if noise else analysis.floor.floor_dph
    listed = [*_of_noise(analysis), *of_data(analysis.done)]
    if analysis.dataset is not None:
        listed += [*_of_bias(analysis.dataset, white_dph), *_of_scale(analysis.dataset, white_dph)]
    if analysis.best is not None:
        listed += _of_model(analysis, analysis.best, white_dph)
    return tuple(listed)


def _of_bias(whole: Dataset, white_dph: float) -> Iterator[Quantity]:
    data = standing(whole)
    bias = data.bias[np.isfinite(data.bias)]
    if bias.size:
        yield Quantity.expanded("bias_span_dph", float(np.ptp(bias)), np.sqrt(2.0) * white_dph)
        yield Quantity.positive("bias_max_dph", float(np.abs(bias).max()), white_dph)
    yield _loop("thermal_hysteresis_dph", data, white_dph)
    temperature = np.sort(whole.channel("temperature")[np.isfinite(whole.bias)])
    if temperature.size:
        yield Quantity.exact("lowest_temperature_degc", float(temperature[0]))
        yield Quantity.exact("highest_temperature_degc", float(temperature[-1]))
        yield Quantity.exact("temperature_hole_degc", float(np.diff(temperature).max(initial=0.0)))


def _loop(name: str, data: Dataset, white_dph: float, values: FloatArray | None = None) -> Quantity:
    gap = branch_gap(data, values) if bool(np.any(np.isfinite(data.bias))) else None
    if gap is None:
        return Quantity(name, reason="no temperature was passed both heating and cooling")
    return Quantity.positive(name, abs(gap[0]), _MEDIAN * white_dph)


def _of_noise(analysis: Analysis) -> Iterator[Quantity]:
    floor = analysis.floor
    if floor.noise is None or floor.estimate is None:
        names = [*(name for name, _ in _NOISE), *_SLOPES]
        yield from (Quantity(name, reason=floor.reason) for name in names)
    else:
        for name, coefficient in _NOISE:
            low, high = floor.noise.intervals.get(coefficient, (np.nan, np.nan))
            yield Quantity(name, getattr(floor.noise, coefficient), low, high)
        estimate = replace(floor.estimate, noise=floor.noise)
        yield Quantity(_SLOPES[0], *estimate.quantisation())
        yield Quantity(_SLOPES[1], *estimate.ramp())
    yield level_of(floor)


def level_of(floor: Floor) -> Quantity:
    """The noise floor of a run."""
    if np.isfinite(floor.floor_dph):
        return Quantity("noise_floor_dph", floor.floor_dph, *floor.interval_dph)
    return Quantity("noise_floor_dph", reason=floor.reason)


def _of_model(analysis: Analysis, best: Score, white_dph: float) -> Iterator[Quantity]:
    held_out = best.held_out
    low, high = held_out.interval_dph
    if np.isfinite(held_out.rms_dph):
        yield Quantity("residual_rms_dph", held_out.rms_dph, low, high)
        yield Quantity.positive("residual_peak_dph", held_out.peak_dph, white_dph)
        yield over_floor(held_out, level_of(analysis.floor))
        yield Quantity.exact("extrapolated_percent", 100.0 * held_out.out_of_range)
    else:
        yield from (Quantity(name, reason=held_out.reason) for name in ("residual_rms_dph", "residual_peak_dph"))
    yield Quantity.exact("condition", best.fit.condition)
    data = analysis.dataset
    if data is not None:
        yield _loop("residual_hysteresis_dph", data, white_dph, analysis.residual())
        yield Quantity.exact("temperature_step_error_dph", step_error_dph(best.fit.bound, best.fit.beta, data))


def over_floor(error: HeldOut, floor: Quantity) -> Quantity:
    """An error over the noise floor; its interval has what the floor leaves open, too."""
    low, high = error.interval_dph
    least, most = (end if np.isfinite(end) else floor.value for end in (floor.low, floor.high))
    return Quantity("residual_over_floor", error.rms_dph / floor.value, low / most, high / least, floor.reason)


def of_data(done: Completeness) -> Iterator[Quantity]:
    """What of a run is there."""
    if done.lost is None:
        yield Quantity("samples_lost", reason="the frames of this record were not counted")
    else:
        yield Quantity.exact("samples_lost", float(done.lost))
    if done.unplanned is None or not done.samples:
        yield Quantity("samples_missing_ppm", reason="the sampling rate of this record is not known")
    else:
        yield Quantity.exact("samples_missing_ppm", done.missing_ppm)
    if done.samples:
        yield Quantity.exact("longest_gap_s", done.longest_gap_s)
        yield Quantity.exact("heating_min", done.heating_s / 60.0)
        yield Quantity.exact("cooling_min", done.cooling_s / 60.0)


def _of_scale(data: Dataset, white_dph: float) -> Iterator[Quantity]:
    """Scale factor where a rate table turned: IEEE 1431's straight line, beside a cubic bias over temperature."""
    applied = data.channels.get("applied_rate")
    names = (
        "scale_factor_error_ppm",
        "scale_factor_temperature_ppm_per_degc",
        "scale_factor_nonlinearity_ppm",
    )
    rates = rates_of(data)
    if applied is None or rates.size < LEAST_RATES:
        yield from (Quantity(name, reason="the unit was not turned at three rates or more") for name in names)
        return
    try:
        line, left = (
            _line(data, applied) if np.ptp(_present(data)) < LEAST_COVERED_DEGC else _line_over_temperature(data)
        )
    except InputError as error:
        yield from (Quantity(name, reason=str(error)) for name in names)
        return
    yield from line
    full_dph = DPH_PER_DPS * float(np.nanmax(np.abs(applied)))
    groups = [left[(np.round(applied) == rate) & np.isfinite(left)] for rate in rates.tolist()]
    off = max((abs(float(group.mean())), group.size) for group in groups if group.size)
    yield Quantity.positive(names[2], 1e6 * off[0] / full_dph, 1e6 * white_dph / np.sqrt(off[1]) / full_dph)


def _line(data: Dataset, applied: FloatArray) -> tuple[list[Quantity], FloatArray]:
    """At one temperature: slope of the bias over the rate, and what it leaves (n,) [deg/h]."""
    rows = np.isfinite(data.bias) & np.isfinite(applied)
    (slope, constant), covariance = np.polyfit(applied[rows], data.bias[rows], 1, cov=True)
    ppm = 1e6 / DPH_PER_DPS
    error = Quantity.expanded("scale_factor_error_ppm", ppm * float(slope), ppm * float(np.sqrt(covariance[0, 0])))
    reason = f"the temperature moves by less than {LEAST_COVERED_DEGC:g} degC"
    left: FloatArray = data.bias - constant - slope * applied
    return [error, Quantity("scale_factor_temperature_ppm_per_degc", reason=reason)], left


def _line_over_temperature(data: Dataset) -> tuple[list[Quantity], FloatArray]:
    """The same with a slope that changes with temperature, beside a cubic bias."""
    cubic = effects.make("polynomial", {"order": 3})
    fit = fit_model(Model("scale", (cubic, effects.make("scale_factor_temperature"))), data)
    known = {c.key: (c.value, c.std) for c in fit.coefficients}
    pairs = (("scale_factor_error_ppm", "s0"), ("scale_factor_temperature_ppm_per_degc", "s1"))
    line = [Quantity.expanded(name, *known[f"scale_factor_temperature.{key}"]) for name, key in pairs]
    return line, data.bias - fit.predict(data).bias


def _present(data: Dataset) -> FloatArray:
    temperature = data.channel("temperature")
    present: FloatArray = temperature[np.isfinite(temperature)]
    return present


def standing(data: Dataset) -> Dataset:
    """The rows in which no rate table turns: elsewhere the scale factor is part of the bias."""
    return data if "applied_rate" not in data.channels else data.select(~turning(data))


def zero_rate(data: Dataset) -> FloatArray:
    """Zero-rate output (n,) [deg/h]: NaN in gaps and where a rate table turns."""
    output: FloatArray = np.where(turning(data), np.nan, data.bias)
    return output


def turning(data: Dataset) -> BoolArray:
    """Rows (n,) in which a rate table turns."""
    applied = data.channels.get("applied_rate", np.zeros(len(data)))
    return np.asarray(np.abs(applied) > TURNING_DPS)
