"""Recordings that are wrong in one way, for `benchmarks.traps`: thermometers, clocks and converters of their own.

A trap changes the samples of a simulated unit at 10 Hz (what a sensor does), its means (what acts in a part of the
range only), or its mechanisms. Nothing here is shared with the effects of the analysis.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import scipy

from bench.analysis.effects.model import Model
from bench.base.channels import FloatArray
from bench.mystery import virtual
from bench.mystery.hidden import CHANNELS, NOISE, Entry, static_curve
from bench.record.dataset import Dataset
from benchmarks import cases
from drivers.sim.resonator import UnitSettings

Unit = tuple[Entry, ...]
Sensor = Callable[[FloatArray, FloatArray, float], FloatArray]
"""What a sensor shows (n,) of values at 10 Hz: time [s], values, size."""
QUIET = {"angle_random_walk": 0.001, "bias_instability": 0.01, "rate_random_walk": 0.01}
_ROUNDS = 4  # of matching the size to the strength
_RUN, _CHECK, _STATIC = 0, 1, 4


class Runs(NamedTuple):
    """The run, a check run and an isothermal one, recorded in the same way."""

    run: Dataset
    check: Dataset
    static: Dataset


@dataclass(frozen=True)
class Trap:
    """One way to be wrong. `right` names are true, () where nothing should be named.

    `temperature` and `rate` are sensors; `entries` further mechanisms of the truth; `gate` says where those act (1 or 0
    by temperature [degC]). `size` is the size of the sensor or the factor of the mechanisms at the start; it is matched
    to the strength if `scaled`.
    """

    kind: str
    right: tuple[str, ...]
    temperature: Sensor | None = None
    rate: Sensor | None = None
    entries: Unit = ()
    gate: Callable[[FloatArray], FloatArray] | None = None
    gated: Callable[[Dataset, float], FloatArray] | None = None
    size: float = 1.0
    scaled: bool = True
    noise: Mapping[str, float] = field(default_factory=lambda: NOISE)
    logged: Callable[[Dataset, float], Dataset] | None = None
    """What a logger makes of the means."""


def recorded(trap: Trap, seed: int, strength: float, model: Model) -> Runs:
    """The runs of one unit."""
    size = _matched(trap, seed, strength, model) if trap.scaled else trap.size
    profiles = (cases.TWO_RATES, _RUN), (cases.LOOPS, _CHECK), (cases.STATIC, _STATIC)
    return Runs(*(_one(trap, seed, profile, number, size, trap.noise) for profile, number in profiles))


def _matched(trap: Trap, seed: int, strength: float, model: Model) -> float:
    """Size at which the spline leaves the strength times the noise."""
    clean = _one(trap, seed, cases.TWO_RATES, _RUN, 0.0, cases.SILENT)
    noisy = _one(replace(trap, rate=None, temperature=None, logged=None), seed, cases.TWO_RATES, _RUN, 0.0, trap.noise)
    noise = cases.rms(cases.absorbed(noisy, noisy.bias, model))
    base, size = cases.rms(cases.absorbed(clean, clean.bias, model)), trap.size
    for _ in range(_ROUNDS):
        run = _one(trap, seed, cases.TWO_RATES, _RUN, size, cases.SILENT)
        left = np.sqrt(max(cases.rms(cases.absorbed(run, run.bias, model)) ** 2 - base**2, 1e-12))
        size *= float(np.clip(strength * noise / left, 0.1, 10.0))
    return size


def _one(trap: Trap, seed: int, profile: str, number: int, size: float, noise: Mapping[str, float]) -> Dataset:
    curve = static_curve(np.random.default_rng([seed, 7]))
    path = cases.trace(profile)
    key = 1000 * seed + number
    samples = _samples(json.dumps([curve]), json.dumps(dict(noise)), profile, key)
    channels = dict(samples.channels)
    for name, sensor in (("temperature", trap.temperature), ("rate", trap.rate)):
        if sensor is not None and size:
            channels[name] = _sensed(sensor, samples.time, channels[name], size)
    run = cases.dataset(replace(samples, channels=channels), path, profile)
    true = cases.dataset(samples, path, profile) if trap.temperature else run
    if trap.entries and size:
        run = _with(run, trap, size, (profile, key, curve), true)
    if trap.gated is not None and size:
        run = replace(run, channels={**run.channels, "rate": run.channels["rate"] + trap.gated(true, size)})
    return trap.logged(run, size) if trap.logged else run


def _with(run: Dataset, trap: Trap, size: float, unit: tuple[str, int, Entry], true: Dataset) -> Dataset:
    """The means with what the mechanisms add, times the size, where the gate is open."""
    profile, key, curve = unit
    path, quiet = cases.trace(profile), json.dumps(dict(cases.SILENT))
    without = cases.dataset(_samples(json.dumps([curve]), quiet, profile, key), path, profile)
    with_it = cases.dataset(_samples(json.dumps([curve, *trap.entries]), quiet, profile, key), path, profile)
    added = size * (with_it.channels["rate"] - without.channels["rate"])
    if trap.gate is not None:
        added = added * trap.gate(true.channels["temperature"])
    return replace(run, channels={**run.channels, "rate": run.channels["rate"] + added})


@lru_cache(maxsize=12)
def _samples(truth: str, noise: str, profile: str, seed: int) -> virtual.Samples:
    settings = UnitSettings.parse({"truth": json.loads(truth), "noise": json.loads(noise), "channels": CHANNELS})
    return virtual.unit(settings, cases.trace(profile), seed)


def _sensed(sensor: Sensor, time: FloatArray, values: FloatArray, size: float) -> FloatArray:
    """What the sensor shows, on the rows that have a value."""
    present = np.isfinite(values)
    shown = sensor(time, np.interp(time, time[present], values[present]), size)
    return np.where(present, shown, np.nan)


def low_pass(time: FloatArray, values: FloatArray, tau_s: float) -> FloatArray:
    """A resistance and a capacity, in Euler steps of 0.1 s."""
    share = min((time[1] - time[0]) / tau_s, 1.0)
    state = scipy.signal.lfilter_zi([share], [1.0, share - 1.0]) * values[0]
    return np.asarray(scipy.signal.lfilter([share], [1.0, share - 1.0], values, zi=state)[0])


def two_poles(time: FloatArray, values: FloatArray, tau_s: float) -> FloatArray:
    """Element and sheath."""
    return low_pass(time, low_pass(time, values, 0.6 * tau_s), 0.4 * tau_s)


def later(time: FloatArray, values: FloatArray, delay_s: float) -> FloatArray:
    """Stamped too late by whole and partial samples."""
    return np.asarray(np.interp(time - delay_s, time, values))


def earlier(time: FloatArray, values: FloatArray, delay_s: float) -> FloatArray:
    """The rate is late by this, seen from the temperature."""
    return later(time, values, -delay_s)


def fast_clock(time: FloatArray, values: FloatArray, ppt: float) -> FloatArray:
    """A logger whose clock drifts; both are set when the run begins."""
    return np.asarray(np.interp(time * (1.0 - 1e-3 * ppt), time, values))


def relays(half_degc: float) -> Sensor:
    """Thermometer with 3,000 slipping contacts: their mean state times the size is subtracted."""

    def shown(time: FloatArray, values: FloatArray, opening_degc: float) -> FloatArray:
        rng = np.random.default_rng(17)
        centre, half = rng.uniform(-70.0, 120.0, 3000), rng.gamma(4.0, half_degc / 4.0, 3000)
        step = 50
        state, out = np.where(centre < values[0], 1.0, -1.0), np.empty(len(values[::step]))
        for i, now in enumerate(values[::step].tolist()):
            state[now > centre + half] = 1.0
            state[now < centre - half] = -1.0
            out[i] = state.mean()
        slip = np.interp(time, time[::step], out)
        # A mean state rises with temperature, too: that is part of any scale and stays.
        return np.asarray(values + opening_degc * 8.0 * slip)

    return shown


def stepped(time: FloatArray, values: FloatArray, step: float) -> FloatArray:
    """A converter without dither."""
    return np.asarray(step * np.round(values / step))


def output_steps(per_s: float) -> Sensor:
    """The mean over `per_s`, rounded and held: a filter before the converter."""

    def shown(time: FloatArray, values: FloatArray, step: float) -> FloatArray:
        size = round(per_s / float(time[1] - time[0]))
        blocks = np.arange(len(values)) // size
        means = np.bincount(blocks, values) / np.bincount(blocks)
        return np.asarray((step * np.round(means / step))[blocks])

    return shown


def rows_rounded(run: Dataset, step: float) -> Dataset:
    """An imported log of means with few digits."""
    rate = step * np.round(run.channels["rate"] / step) if step else run.channels["rate"]
    ones = {name: np.isfinite(column).astype(np.float64) for name, column in run.channels.items()}
    channels = {**run.channels, "rate": rate}
    return replace(run, channels=channels, counts=ones, variances={}, finer=None, finer_rate_step=None)


def constant(time: FloatArray, values: FloatArray, offset_degc: float) -> FloatArray:
    """A thermometer that reads high."""
    return values + offset_degc


def bent(time: FloatArray, values: FloatArray, size_degc: float) -> FloatArray:
    """A characteristic of the wrong order."""
    return np.asarray(values * 1.01 + size_degc * np.tanh((values - 30.0) / 45.0))


def ageing(time: FloatArray, values: FloatArray, size_degc: float) -> FloatArray:
    """A reference that drifts like the root of time."""
    return np.asarray(values + size_degc * np.sqrt(time / time[-1]))


def leads(run: Dataset, share: float) -> Dataset:
    """Leads that feel the air: the thermometer shows a share of it."""
    seen, air = run.channels["temperature"], run.channels["chamber_temperature"]
    return replace(run, channels={**run.channels, "temperature": seen + share * (air - seen)})


def noisy(time: FloatArray, values: FloatArray, sigma_degc: float) -> FloatArray:
    """A thermometer with much white noise."""
    return np.asarray(values + np.random.default_rng(5).normal(0.0, sigma_degc, len(values)))


def _above(at_degc: float, width_degc: float) -> Callable[[FloatArray], FloatArray]:
    return lambda temperature: np.asarray(np.clip((temperature - at_degc) / width_degc + 0.5, 0.0, 1.0))


def _below(at_degc: float, width_degc: float) -> Callable[[FloatArray], FloatArray]:
    return lambda temperature: np.asarray(1.0 - _above(at_degc, width_degc)(temperature))


def _integrated(run: Dataset, drive: FloatArray, tau_s: float) -> FloatArray:
    """A heat capacity that a channel heats, in explicit steps of a second."""
    fine = np.arange(run.time[0], run.time[-1], 1.0)
    return np.asarray(np.interp(run.time, fine, low_pass(fine, np.interp(fine, run.time, drive), tau_s)))


def compressor_through_mass(run: Dataset, size: float) -> FloatArray:
    """Vibration that heats the mount."""
    return size * _integrated(run, run.channels["compressor"], 420.0)


def quadrature_by_gradient(run: Dataset, size: float) -> FloatArray:
    """Leakage through a phase that a temperature gradient turns."""
    temperature = run.channels["temperature"]
    gradient = temperature - _integrated(run, temperature, 500.0)
    return np.asarray(size * gradient * (run.channels["quadrature"] - np.mean(run.channels["quadrature"])))


def turned(run: Dataset, size: float) -> FloatArray:
    """The fixture slips to another direction: the Earth's rate along the axis changes within a minute."""
    return np.asarray(size * np.clip((run.time - 0.55 * run.time[-1]) / 60.0, 0.0, 1.0))


def gradient(run: Dataset, size: float) -> FloatArray:
    """A bias in proportion to the slope of the true temperature, 0.15 deg/h at 1 degC/min."""
    return np.asarray(0.15 * np.gradient(run.channels["temperature"], run.time / 60.0))


_RATE: Unit = ({"mechanism": "temperature_rate", "tau_s": 15.0},)
_LOOP: Unit = ({"mechanism": "preisach", "half_width_degc": 6.0},)
_LAGS = ("thermal_lag", "clock_delay")
_LEADS = ("thermometer_lag", "clock_delay")
_PARTIAL = ("partial_range",)

TRAPS: dict[str, Trap] = {
    "thermometer lag": Trap("thermometer", ("thermometer_lag",), temperature=low_pass, size=40.0),
    "thermometer of two poles": Trap("thermometer", ("thermometer_lag",), temperature=two_poles, size=60.0),
    "thermometer loop, narrow": Trap("thermometer", ("thermometer_hysteresis",), temperature=relays(2.0), size=0.3),
    "thermometer loop, wide": Trap("thermometer", ("thermometer_hysteresis",), temperature=relays(6.0), size=0.3),
    "thermometer drift": Trap("thermometer", ("thermometer_offset",), temperature=ageing, size=0.5),
    "thermometer offset": Trap("thermometer", (), temperature=constant, size=4.0, scaled=False),
    "thermometer not linear": Trap("thermometer", (), temperature=bent, size=3.0, scaled=False),
    "thermometer feels the air": Trap(
        "thermometer", ("thermometer_offset", *_LAGS), logged=leads, size=0.02
    ),
    "thermometer with noise": Trap("thermometer", (), temperature=noisy, size=0.3, scaled=False),
    "temperature late": Trap("clock", _LEADS, temperature=later, size=30.0),
    "rate late": Trap("clock", _LAGS, temperature=earlier, size=30.0),
    "clock drifts": Trap("clock", _LEADS, temperature=fast_clock, size=2.0),
    "thermometer step 0.1 degC": Trap("quantisation", (), temperature=stepped, size=0.1, scaled=False),
    "thermometer step 0.5 degC": Trap("quantisation", (), temperature=stepped, size=0.5, scaled=False),
    "thermometer step 1 degC": Trap("quantisation", (), temperature=stepped, size=1.0, scaled=False),
    "quiet, thermometer step 0.5 degC": Trap(
        "quantisation", (), temperature=stepped, size=0.5, scaled=False, noise=QUIET
    ),
    "output step 0.5 deg/h, quiet": Trap(
        "quantisation", (), rate=output_steps(1.0), size=0.5, scaled=False, noise=QUIET
    ),
    "output step 0.2 deg/h, quiet": Trap(
        "quantisation", (), rate=output_steps(1.0), size=0.2, scaled=False, noise=QUIET
    ),
    "means rounded to 0.5 deg/h": Trap("quantisation", (), logged=rows_rounded, size=0.5, scaled=False),
    "quiet means rounded to 0.1 deg/h": Trap(
        "quantisation", (), logged=rows_rounded, size=0.1, scaled=False, noise=QUIET
    ),
    "gradient above 30 degC": Trap("range", _PARTIAL, entries=_RATE, gate=_above(30.0, 5.0)),
    "gradient below 10 degC": Trap("range", _PARTIAL, entries=_RATE, gate=_below(10.0, 5.0)),
    # The relays' mean rises with temperature, too: switched on at a place, it is a kink as well.
    "loop above 35 degC": Trap("range", (*_PARTIAL, "bias_kink"), entries=_LOOP, gate=_above(35.0, 5.0)),
    "compressor through a mass": Trap("memory", ("compressor",), gated=compressor_through_mass),
    "quadrature by gradient": Trap("memory", ("lagged_product",), gated=quadrature_by_gradient),
    "turned in the fixture": Trap("moment", ("bias_jump",), gated=turned),
    "thermometer lag and supply": Trap(
        "pair", ("thermometer_lag", "supply_voltage", "clock_delay"), temperature=low_pass, size=40.0,
        entries=({"mechanism": "supply_voltage", "k_dph_per_v": 0.05},),
    ),
    "rate late and loop": Trap(
        "pair", ("hysteresis", *_LAGS), temperature=earlier, size=30.0,
        entries=({"mechanism": "preisach", "amplitude_dph": 0.005, "half_width_degc": 6.0},),
    ),
    "gradient and thermometer step 0.5 degC": Trap(
        "pair", ("temperature_rate",), temperature=stepped, size=0.5, scaled=False,
        gated=gradient,
    ),
}  # fmt: skip
"""All traps by name."""
