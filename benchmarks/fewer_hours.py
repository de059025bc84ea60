"""Chamber hours that a lot's earlier units save: stated intervals, worst unit, units unlike the lot.

    python -m benchmarks.fewer_hours [UNITS] [LOT] [SEEDS]

Units of `benchmarks.lots` (their truth shares no equation with the model), with ageing and noise that walks, go through
`ramp_-40_85`. The lot's first units go the whole way. Each further unit ends at the first look (every ten minutes) at
which it has been through every temperature of the lot, is like it, and is expected to have less than the limit; every
tenth goes the whole way as an audit. The error is over the whole ramp and against the truth, with all that is slow.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
import scipy

from bench.acquisition import load_profile
from bench.analysis import Prior, load_model
from bench.analysis.fit.fitting import fit_model
from bench.base import FloatArray, library
from bench.record import Dataset
from benchmarks.lots import STEP_S, UNLIKE, Truth, _behind, _relays, member

MODEL = "spline_lag_loop"
LIMIT_DPH = 0.2
LOOK_S = 600.0
AUDIT = 10


@cache
def case() -> tuple[FloatArray, FloatArray]:
    """Time [s] and temperature of the unit's case [degC] throughout the whole ramp."""
    profile = load_profile(library() / "ramp_-40_85.yaml")
    time: FloatArray = np.arange(0.5 * STEP_S, profile.duration_s, STEP_S)
    return time, _behind(profile.setpoint(time), 180.0)


def record(truth: Truth, name: str, seed: int) -> tuple[Dataset, FloatArray]:
    """30 s means of the whole ramp, and the bias without white noise (n,) [deg/h]."""
    random = np.random.default_rng(seed)
    time, degc = case()
    x = (degc - 25.0) / 65.0
    bias = truth.constant_dph + truth.leak_dph * np.sin(truth.phase + 0.35 * x) * (1.0 + 0.3 * np.tanh(1.5 * x))
    bias += truth.swell_dph * np.exp((degc - 85.0) / truth.swell_k)
    bias += truth.knee_dph * np.exp(-(((degc - truth.knee_degc) / 8.0) ** 2))
    bias = truth.sign * bias + truth.loop_dph * _relays(degc)
    ageing = random.normal(0.0, 0.05) * np.log1p(time / 3600.0)
    slow = bias + ageing + np.cumsum(random.normal(0.0, 0.004, time.size))
    shown = _behind(degc, truth.lag_s) + random.normal(0.0, 0.01, time.size)
    channels = {"rate": slow + random.normal(0.0, 0.08, time.size), "temperature": shown}
    segment = np.zeros(time.size, dtype=np.int64)
    return Dataset(name, time, channels, segment, interval_s=STEP_S, unit=name), slow


@dataclass(frozen=True)
class Ended:
    """How a unit ended: share of the ramp, stated interval and error [deg/h RMS], and that of the whole ramp's fit."""

    share: float
    low_dph: float
    high_dph: float
    error_dph: float
    whole_dph: float
    like: bool


def conduct(prior: Prior, whole: Dataset, slow: FloatArray, limit_dph: float = LIMIT_DPH) -> Ended:
    """One unit through the ramp, looked at every ten minutes."""
    own = fit_model(load_model(MODEL), whole, covariance="none", weights="count")
    left = _rms(own.predict(whole).bias - slow)
    end, like = whole.time[-1], True
    looks = np.append(np.arange(LOOK_S, end, LOOK_S), end + 1.0)
    for at in looks:
        so_far = whole.select(whole.time < at)
        found = prior.expected(so_far)
        last = at == looks[-1]
        if not last and (not like or found.seen < 1.0 or found.high_dph > limit_dph):
            continue
        told = None if last else prior.like(so_far)
        like = like and (last or (told is not None and told.like))
        if like or last:
            error = _rms(prior.curve(whole, found.amplitudes) - slow) if like else left
            return Ended(min(at / end, 1.0), found.low_dph, found.high_dph, error, left, like)
    raise RuntimeError("the last look ends every run")


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def share(hits: int, n: int) -> str:
    """A share with its 95 % interval (Clopper-Pearson)."""
    low, high = scipy.stats.binomtest(hits, n).proportion_ci(0.95)
    return f"{100 * hits / n:.1f} % of {n} (95 %: {100 * low:.1f} to {100 * high:.1f} %)"


def campaign(units: int, lot: int, seed: int) -> tuple[list[Ended], list[Ended]]:
    """Units of the lot, and units of each kind that is unlike it."""
    random = np.random.default_rng(seed)
    begin = 100_000 * seed
    known = [record(member(random), f"L{i:03d}", begin + i)[0] for i in range(lot)]
    prior = Prior.of(load_model(MODEL), known)
    good = [conduct(prior, *record(member(random), f"U{i:03d}", begin + 1000 + i)) for i in range(units)]
    changes: list[Callable[[Truth, np.random.Generator], Truth]] = list(UNLIKE.values())
    each = max(1, units // len(changes))
    bad = [
        conduct(prior, *record(change(member(random), random), f"X{i}", begin + 50_000 + 1000 * k + i))
        for k, change in enumerate(changes)
        for i in range(each)
    ]
    return good, bad


def main(units: int = 200, lot: int = 40, seeds: int = 1) -> None:
    everyone: list[Ended] = []
    others: list[Ended] = []
    for seed in range(1, seeds + 1):
        good, bad = campaign(units, lot, seed)
        everyone, others = everyone + good, others + bad
        hours = np.array([1.0 if i % AUDIT == AUDIT - 1 else one.share for i, one in enumerate(good)])
        worst, whole = max(one.error_dph for one in good), max(one.whole_dph for one in good)
        print(f"lot {seed}: {lot} units before, {units} units: {100 * (1 - hours.mean()):.1f} % of the hours saved "
              f"({100 * (1 - (hours.sum() + lot) / (units + lot)):.1f} % with the first {lot}); "
              f"worst {worst:.3f}, by the whole ramp {whole:.3f} deg/h ({worst / whole:.2f} times); "
              f"median {np.median([one.error_dph for one in good]):.3f}, "
              f"{np.median([one.whole_dph for one in good]):.3f}")  # fmt: skip
    ended = [one for one in everyone if one.like]
    held = sum(one.low_dph <= one.error_dph <= one.high_dph for one in ended)
    print(f"stated interval holds: {share(held, len(ended))}")
    print(f"within the limit: {share(sum(one.error_dph <= LIMIT_DPH for one in everyone), len(everyone))}")
    print(f"whole ramps within the limit: {share(sum(one.whole_dph <= LIMIT_DPH for one in everyone), len(everyone))}")
    print(f"units of the lot taken for unlike: {share(len(everyone) - len(ended), len(everyone))}")
    each = len(others) // seeds // len(UNLIKE)
    for k, kind in enumerate(UNLIKE):
        own = [one for i, one in enumerate(others) if (i // each) % len(UNLIKE) == k]
        print(f"  {kind}: whole ramp for {share(sum(one.share == 1.0 for one in own), len(own))}")
    print(f"unlike units that got the whole ramp: {share(sum(one.share == 1.0 for one in others), len(others))}")


if __name__ == "__main__":
    main(*(int(word) for word in sys.argv[1:]))
