"""Runs with one hidden mechanism of the truth, its amplitude set so that what it leaves has a given strength.

Physics only: the truth integrates, nothing here knows a regressor of the analysis. Strength = RMS of the part that the
static spline over temperature cannot absorb / RMS of the noise that is left beside the same spline.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from bench import profile as profiles
from bench import virtual
from bench.channels import FloatArray
from bench.dataset import Dataset, Segment
from bench.fit import fit
from bench.model import Model
from drivers.sim.resonator import UnitSettings

INTERVAL_S = 30.0
NOISE = {"angle_random_walk": 0.01, "bias_instability": 0.03, "rate_random_walk": 0.03}
SILENT = dict.fromkeys(NOISE, 0.0)
CHANNELS = {
    # Channels wander enough on their own to be told from the temperature, as the amplitudes of a real unit do.
    "frequency": {"wander_ppm": 20.0},
    "drive": {"wander_ppm": 1000.0},
    "quadrature": {"offset_dps": 0.5, "slope_dps_per_degc": 0.004, "wander_dps": 0.05},
}
ONE_RATE, TWO_RATES, LOOPS = "one_rate", "ramp_-40_85", "check_minor_loops"
STATIC = "static"
_STATIC_YAML = (
    "name: static\nstart: {temperature_degc: 25, soak_min: 60}\nsegments:\n  - {kind: soak, duration_min: 180}\n"
)
_TURN_S, _TURN_DPS = 600, 50.0


@dataclass(frozen=True)
class Mechanism:
    """One kind of hidden effect: what the bench should call it (None: outside its library), and a draw of it."""

    name: str
    effect: str | None
    family: str
    amplitudes: tuple[str, ...]
    """Parameters to which the contribution is proportional; for a thermal one its time constants."""
    turns: bool = False
    """Needs a rate table that turns."""


_F = Mechanism
HIDDEN: dict[str, Mechanism] = {
    m.name: m
    for m in (
        _F("thermal_lag", "thermal_lag", "lag", ("tau_s",)),
        _F("temperature_rate", "temperature_rate", "rate", ("k_dph_per_degc_per_min",)),
        _F("preisach", "hysteresis", "hysteresis", ("amplitude_dph",)),
        _F("bouc_wen", "hysteresis", "hysteresis", ("amplitude_dph",)),
        _F("creep", "creep", "creep", ("k_dph_per_degc",)),
        _F("warm_up", "warm_up", "", ("amplitude_dph",)),
        _F("aging", "aging", "", ("linear_dph_per_h",)),
        _F("quadrature_leakage", "quadrature_leakage", "", ("phase_mrad", "phase_slope_mrad_per_degc")),
        _F("drive_amplitude", "drive_amplitude", "", ("k_dph_per_percent",)),
        _F("resonance_frequency", "resonance_frequency", "", ("k_dph_per_hz",)),
        _F("supply_voltage", "supply_voltage", "", ("k_dph_per_v",)),
        _F("compressor", "compressor", "", ("k_dph_per_g2",)),
        _F("bias_jump", "bias_jump", "", ("step_dph",)),
        _F("bias_kink", "bias_kink", "", ("slope_dph_per_degc",)),
        _F("frost", "frost", "", ("amplitude_dph",)),
        _F("scale_factor_temperature", "scale_factor_temperature", "", ("ppm_per_degc", "ppb_per_degc2"), True),
        _F("scale_factor_nonlinearity", "scale_factor_nonlinearity", "", ("linear_ppm", "square_ppm"), True),
        _F("periodic", None, "", ("amplitude_dph",)),
        _F("rate_squared", None, "", ("k_dph_per_degc2_per_min2",)),
        _F("etalon", None, "", ("amplitude_dph",)),
        _F("unlogged_drift", None, "", ("sigma_dph",)),
        _F("two_pole_lag", None, "", ("first_tau_s", "second_tau_s")),
    )
}
_THERMAL = {"thermal_lag", "two_pole_lag", "thermal_network"}


def draw(name: str, rng: np.random.Generator, hours: float) -> dict[str, Any]:
    """Parameters of one unit, amplitudes of ordinary size; `hours` is the length of the run."""

    def log(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    def uniform(low: float, high: float) -> float:
        return float(rng.uniform(low, high))

    drawn: dict[str, dict[str, Any]] = {
        "thermal_lag": {"tau_s": 60.0},
        "two_pole_lag": {"first_tau_s": 60.0, "second_tau_s": 60.0 * uniform(2, 4)},
        "temperature_rate": {"k_dph_per_degc_per_min": 0.1, "tau_s": log(8, 40)},
        "preisach": {"half_width_degc": uniform(3, 12), "relay_seed": int(rng.integers(1000))},
        "bouc_wen": {"length_degc": uniform(6, 25)},
        "creep": {"shortest_h": log(0.3, 1), "longest_h": log(4, 10)},
        "warm_up": {"tau_s": log(400, 1800)},
        "aging": {},
        "quadrature_leakage": {"phase_mrad": 1.0, "phase_slope_mrad_per_degc": uniform(0, 0.01)},
        "drive_amplitude": {},
        "resonance_frequency": {},
        "supply_voltage": {},
        "compressor": {},
        "bias_jump": {"at_s": [3600.0 * hours * uniform(0.2, 0.8)], "step_dph": [0.2]},
        "bias_kink": {"at_degc": uniform(-10, 60)},
        "frost": {"freezing_degc": uniform(-5, 5), "width_degc": uniform(2, 6)},
        "scale_factor_temperature": {"ppm_per_degc": 60.0, "ppb_per_degc2": 0.0},
        "scale_factor_nonlinearity": {},
        "periodic": {"period_s": uniform(900, 2400), "phase_rad": uniform(0, 6.28)},
        "rate_squared": {},
        "etalon": {"period_degc": uniform(6, 12), "phase_rad": uniform(0, 6.28)},
        "unlogged_drift": {"tau_s": log(900, 3600)},
    }
    return {"mechanism": name, **drawn[name]}


def static_curve(rng: np.random.Generator) -> dict[str, Any]:
    """A smooth bias over temperature, 2 to 6 deg/h, steep enough that a lag shows."""
    size = rng.uniform(2.0, 6.0)
    shape = size * np.array([rng.uniform(-1, 1), rng.choice([-1, 1]) * rng.uniform(0.4, 1), *rng.uniform(-0.4, 0.4, 2)])
    return {"mechanism": "static_bias", "coefficients_dph": [2.0, *np.round(shape, 4).tolist()]}


@lru_cache(maxsize=8)
def trace(profile: str) -> virtual.Trace:
    """The chamber through a shipped profile, a YAML text or the isothermal run."""
    if profile == STATIC:
        text = _STATIC_YAML
    elif "\n" in profile:
        text = profile
    else:
        text = (Path(__file__).parents[1] / "profiles" / f"{profile}.yaml").read_text()
    return virtual.chamber(profiles.from_text(text), seed=1)


def recorded(truth: Sequence[Any], noise: dict[str, float], profile: str, seed: int, turns: bool = False) -> Dataset:
    """A run of this unit in 30 s means."""
    settings = UnitSettings.parse({"truth": list(truth), "noise": noise, "channels": CHANNELS})
    path = trace(profile)
    return dataset(virtual.unit(settings, path, seed, table(path.seconds) if turns else None), path, profile)


def table(seconds: int) -> FloatArray:
    """A rate table that stands and turns in both directions, ten minutes each [deg/s]."""
    pattern = np.array([0.0, _TURN_DPS, 0.0, -_TURN_DPS])
    return np.asarray(pattern[np.arange(seconds + 1) // _TURN_S % 4])


def dataset(samples: virtual.Samples, path: virtual.Trace, name: str) -> Dataset:
    """Means over 30 s of samples at 10 Hz."""
    second = np.floor(samples.time).astype(np.int64)
    channels, counts = {}, {}
    for channel, values in samples.channels.items():
        good = np.isfinite(values)
        count = np.bincount(second[good], minlength=path.seconds).astype(np.float64)
        total = np.bincount(second[good], values[good], minlength=path.seconds)
        channels[channel] = np.where(count > 0, total / np.maximum(count, 1.0), np.nan)
        counts[channel] = count
    segments = tuple(
        Segment(s["index"], s["name"], s["kind"], s["from_s"], s["to_s"], s["direction"], s["target_degc"],
                s["rate_degc_per_min"])
        for s in path.segments
    )  # fmt: skip
    base = Dataset(
        name.splitlines()[0].removeprefix("name: "), np.arange(path.seconds, dtype=np.float64) + 0.5, channels, path.segment, segments,
        1.0, counts,
    )  # fmt: skip
    return base.average(INTERVAL_S)


def absorbed(record: Dataset, values: FloatArray, model: Model) -> FloatArray:
    """What the static model leaves of a series (n,) of this record."""
    plain = replace(
        record, channels={**{k: v for k, v in record.channels.items() if k != "applied_rate"}, "rate": values}
    )
    return fit(model, plain, covariance="none").residuals[0]


def rms(values: FloatArray) -> float:
    """Root of the mean square, gaps left out."""
    return float(np.sqrt(np.nanmean(values**2)))


@dataclass(frozen=True, eq=False)
class Case:
    """A unit with hidden mechanisms: its runs by profile at one strength, and what it would be without them."""

    hidden: tuple[str, ...]
    strength: float
    seed: int
    turns: bool
    truth: tuple[Any, ...]

    def run(self, profile: str, number: int = 0) -> Dataset:
        """A run of the unit; another `number` is another day."""
        return recorded(self.truth, NOISE, profile, 1000 * self.seed + number, self.turns)


def case(hidden: Sequence[str], strength: float, seed: int, profile: str, model: Model) -> Case:
    """A unit whose hidden mechanisms have this strength each on a run of this profile."""
    rng = np.random.default_rng([seed, *(sum(map(ord, name)) for name in hidden)])
    curve = static_curve(np.random.default_rng([seed, 7]))
    turns = any(HIDDEN[name].turns for name in hidden)
    hours = trace(profile).seconds / 3600.0
    drawn = [draw(name, rng, hours) for name in hidden]
    if strength:
        clean = recorded([curve], SILENT, profile, 1000 * seed, turns)
        noisy = recorded([curve], NOISE, profile, 1000 * seed, turns)
        target = strength * rms(absorbed(clean, noisy.bias - clean.bias, model))
        drawn = [_scaled(entry, target, clean, (curve, profile, 1000 * seed, turns, model)) for entry in drawn]
    else:
        drawn = []
    return Case(tuple(hidden), strength, seed, turns, (curve, *drawn))


def _scaled(entry: dict[str, Any], target: float, clean: Dataset, how: tuple[Any, ...]) -> dict[str, Any]:
    """The mechanism with its amplitudes, or time constants, multiplied until its share has the target RMS [deg/h]."""
    curve, profile, seed, turns, model = how
    names, factor = HIDDEN[entry["mechanism"]].amplitudes, 1.0
    for _ in range(6 if entry["mechanism"] in _THERMAL else 1):
        tried = _times(entry, names, factor)
        full = recorded([curve, tried], SILENT, profile, seed, turns)
        share = rms(absorbed(full, full.bias - clean.bias, model))
        factor *= min(max(target / max(share, 1e-12), 1e-6), 30.0 if entry["mechanism"] in _THERMAL else 1e9)
        if abs(share / target - 1.0) < 0.01:
            break
    return _times(entry, names, factor)


def _times(entry: dict[str, Any], names: Sequence[str], factor: float) -> dict[str, Any]:
    defaults = {name: _default(entry["mechanism"], name) for name in names}
    values = {name: entry.get(name, defaults[name]) for name in names}
    return entry | {n: [factor * x for x in v] if isinstance(v, list) else factor * v for n, v in values.items()}


def _default(mechanism: str, name: str) -> Any:
    from drivers.sim.truth import MECHANISMS

    return MECHANISMS[mechanism].model_fields[name].default
