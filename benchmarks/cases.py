"""Runs with one hidden mechanism of the truth whose effect on the residual has a given strength.

Only physics: the truth integrates, and no regressor of the analysis is used. Strength = RMS of the part that the
static spline over temperature cannot absorb / RMS of the residual noise after the same spline.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from bench.acquisition.profile import profile as profiles
from bench.analysis.effects.model import Model
from bench.analysis.fit.fitting import fit_model
from bench.base.channels import FloatArray
from bench.mystery import virtual
from bench.mystery.hidden import CHANNELS, HIDDEN, NOISE, Entry, draw, scaled, static_curve, times
from bench.record.dataset import Dataset, Segment
from drivers.sim.resonator import UnitSettings
from drivers.sim.truth import MECHANISMS

INTERVAL_S = 30.0
SILENT = dict.fromkeys(NOISE, 0.0)
ONE_RATE, TWO_RATES, LOOPS = "one_rate", "ramp_-40_85", "check_minor_loops"
STATIC = "static"
_STATIC_YAML = (
    "name: static\nstart: {temperature_degc: 25, soak_min: 60}\nsegments:\n  - {kind: soak, duration_min: 180}\n"
)
_TURN_S = 600
_TURNS_DPS = (0.0, 100.0, 0.0, -100.0, 0.0, 30.0, 0.0, -30.0)


@lru_cache(maxsize=8)
def trace(profile: str) -> virtual.Trace:
    """The chamber through a shipped profile, a YAML text or the isothermal run."""
    if profile == STATIC:
        text = _STATIC_YAML
    elif "\n" in profile:
        text = profile
    else:
        text = (Path(__file__).parents[1] / "profiles" / f"{profile}.yaml").read_text()
    return virtual.chamber(profiles.profile_from_text(text), seed=1)


def recorded(
    truth: Sequence[Entry], noise: Mapping[str, float], profile: str, seed: int, turns: bool = False
) -> Dataset:
    """A run of this unit in 30 s means."""
    return _recorded(json.dumps([list(truth), dict(noise)]), profile, seed, turns)


@lru_cache(maxsize=400)
def _recorded(unit: str, profile: str, seed: int, turns: bool) -> Dataset:
    truth, noise = json.loads(unit)
    settings = UnitSettings.parse({"truth": truth, "noise": noise, "channels": CHANNELS})
    path = trace(profile)
    return dataset(virtual.unit(settings, path, seed, table(path.seconds) if turns else None), path, profile)


def table(seconds: int) -> FloatArray:
    """A rate table that stops and turns at two rates in both directions, ten minutes each [deg/s]."""
    return np.asarray(np.array(_TURNS_DPS)[np.arange(seconds + 1) // _TURN_S % len(_TURNS_DPS)])


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
    segments = tuple(map(Segment.of, path.segments))
    time = np.arange(path.seconds, dtype=np.float64) + 0.5
    title = name.splitlines()[0].removeprefix("name: ")
    base = Dataset(title, time, channels, path.segment, segments, 1.0, counts)
    return base.average(INTERVAL_S)


def absorbed(record: Dataset, values: FloatArray, model: Model) -> FloatArray:
    """Residual of the static model for a series (n,) of this record."""
    plain = replace(
        record, channels={**{k: v for k, v in record.channels.items() if k != "applied_rate"}, "rate": values}
    )
    return fit_model(model, plain, covariance="none", weights="count").residuals[0]


def rms(values: FloatArray) -> float:
    """Root of the mean square, without gaps."""
    return float(np.sqrt(np.nanmean(values**2)))


@dataclass(frozen=True, eq=False)
class Case:
    """A unit with hidden mechanisms and their factors: its runs by profile, with and without the mechanisms.

    What adds to the output does so in proportion, so that units of several strengths share their recordings; what moves
    the resonator's temperature is recorded again.
    """

    hidden: tuple[str, ...]
    strength: float
    seed: int
    turns: bool
    curve: Entry
    parts: tuple[tuple[Entry, float], ...]

    def run(self, profile: str, number: int = 0) -> Dataset:
        """A run of the unit; another `number` is another day, on which mechanisms of one run do not occur."""
        parts = [(e, factor) for e, factor in self.parts if number == 0 or not HIDDEN[e["mechanism"]].one_run]
        if any(HIDDEN[entry["mechanism"]].thermal for entry, _ in parts):
            return self._recorded([times(entry, factor) for entry, factor in parts], NOISE, profile, number)
        run, clean = self.quiet(profile, number), self._recorded([], SILENT, profile, number)
        rate = run.channels["rate"]
        for entry, factor in parts:
            rate = rate + factor * (self._recorded([entry], SILENT, profile, number).bias - clean.bias)
        return replace(run, channels={**run.channels, "rate": rate})

    def quiet(self, profile: str, number: int) -> Dataset:
        """The unit without its hidden mechanisms."""
        return self._recorded([], NOISE, profile, number)

    def noise(self, profile: str, number: int) -> FloatArray:
        """Noise of such a run (n,) [deg/h] about its mean, independent of the hidden mechanisms."""
        alone = self.quiet(profile, number).bias - self._recorded([], SILENT, profile, number).bias
        return np.asarray(alone - np.nanmean(alone))

    def _recorded(self, hidden: Sequence[Entry], noise: Mapping[str, float], profile: str, number: int) -> Dataset:
        return recorded([self.curve, *hidden], noise, profile, 1000 * self.seed + number, self.turns)


def case(hidden: Sequence[str], strength: float, seed: int, profile: str, model: Model) -> Case:
    """A unit whose hidden mechanisms have this strength each on a run of this profile."""
    rng = np.random.default_rng([seed, *(sum(map(ord, name)) for name in hidden)])
    curve = static_curve(np.random.default_rng([seed, 7]))
    turns = any(HIDDEN[name].turns for name in hidden)
    bare = Case(tuple(hidden), strength, seed, turns, curve, ())
    if not strength:
        return bare
    hours = trace(profile).seconds / 3600.0
    clean = recorded([curve], SILENT, profile, 1000 * seed, turns)
    target = strength * rms(absorbed(clean, bare.quiet(profile, 0).bias - clean.bias, model))

    def share(entry: Entry) -> float:
        full = recorded([curve, entry], SILENT, profile, 1000 * seed, turns)
        return rms(absorbed(full, full.bias - clean.bias, model))

    drawn = [draw(name, rng, hours) for name in hidden]
    return replace(bare, parts=tuple((entry, scale(entry, target, share)) for entry in drawn))


def scale(entry: Entry, target: float, share: Callable[[Entry], float]) -> float:
    """Factor for an entry to reach the target [deg/h]: exact if proportional, within 1 % if it is thermal."""
    if HIDDEN[entry["mechanism"]].thermal:
        name = HIDDEN[entry["mechanism"]].amplitudes[0]
        start = MECHANISMS[entry["mechanism"]].model_fields[name].default
        return float(scaled(entry, target, share)[name] / entry.get(name, start))
    return target / max(share(entry), 1e-12)
