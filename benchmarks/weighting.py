"""What the weights of the rows are worth: error on a profile that no fit saw, by noise and by counts, and coverage.

    python -m benchmarks.weighting --seeds 30 --out weighting.jsonl

Every truth is integrated at one second over the chamber's own temperature and shares no equation with the bench; the
noise is made from numpy alone (`noise_coverage`). A model that has the effect, and one that lacks it, are fitted to a
two-rate ramp, with rows that count by their noise and by their samples. The error is that of the predicted curve on a
profile of minor loops, about its mean and without noise, over the RMS of the noise. Covered is one row a run, drawn at
random, by one and two stated standard deviations. Where the bench keeps to counts (`weighting.lacking`), both are the
same. Results are appended to the file as they come; what stands there already is not run again. Prints one JSON object.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import lfilter
from scipy.stats import binomtest

from bench.analysis.effects import registry as effects
from bench.analysis.effects.model import Model
from bench.analysis.fit.design import Bound
from bench.analysis.fit.fitting import Fit, fit_model
from bench.base import FloatArray
from bench.record.dataset import Dataset
from benchmarks import campaigns, cases
from benchmarks.noise_coverage import NOISES, made

MODEL = Model("spline", (effects.make("spline", {"intervals": 8}),))
STRENGTH = 3.0
"""RMS of what the truth adds beside the spline over that of the noise, on the fitted run."""
_MEANS = round(cases.INTERVAL_S)


def _lagged(values: FloatArray, tau_s: float) -> FloatArray:
    """First-order lag at one second, settled at the start."""
    share = 1.0 / (tau_s + 1.0)
    return np.asarray(lfilter([share], [1.0, share - 1.0], values, zi=[values[0] * (1.0 - share)])[0])


def _bouc_wen(temperature: FloatArray) -> FloatArray:
    state, out = 0.0, np.zeros(temperature.size)
    for i, step in enumerate(np.diff(temperature).tolist(), start=1):
        state += (step - abs(step) * state) / 12.0
        out[i] = state
    return out


def _curve(temperature: FloatArray) -> FloatArray:
    x = temperature / 85.0
    return np.asarray(2.5 * x - 0.9 * x**2 + 0.7 * x**3 - 0.3 * x**4)


def _rate(temperature: FloatArray) -> FloatArray:
    return 60.0 * np.gradient(temperature)


def _relaxed(temperature: FloatArray) -> FloatArray:
    return np.mean([_lagged(temperature, tau_s) for tau_s in (900.0, 3600.0, 14400.0)], axis=0) - temperature


Truth = Callable[[FloatArray, float], FloatArray]
TRUTHS: Mapping[str, tuple[str | None, Truth]] = {
    "nothing": (None, lambda t, size: np.zeros(t.size)),
    "temperature_rate": ("temperature_rate", lambda t, size: size * _lagged(_rate(t), 15.0)),
    "thermal_lag": ("thermal_lag", lambda t, size: _curve(_lagged(t, 90.0 * size)) - _curve(t)),
    "bouc_wen": ("hysteresis", lambda t, size: size * _bouc_wen(t)),
    "relaxation": ("creep", lambda t, size: size * _relaxed(t)),
    "warm_up": ("warm_up", lambda t, size: size * np.exp(-np.arange(t.size) / 1200.0)),
}
"""The effect of the bench that stands for it, and what it adds (seconds,) in the temperature (seconds,)."""


@dataclass(frozen=True)
class Trial:
    """One run of one unit."""

    truth: str
    noise: str
    lacking: bool
    seed: int


def trials(seeds: int, noises: Sequence[str] = ("shipped", "walking")) -> Iterator[Trial]:
    """Seed by seed, so that an interrupted campaign is a smaller campaign."""
    for seed in range(1, seeds + 1):
        for truth, (effect, _) in TRUTHS.items():
            for noise in noises:
                yield from (Trial(truth, noise, lacking, seed) for lacking in (False, True) if effect or not lacking)


def _record(profile: str, rate: FloatArray) -> Dataset:
    trace = cases.trace(profile)
    temperature = trace.case[1 : rate.size + 1]
    time = np.arange(rate.size) + 0.5
    channels = {"rate": rate, "temperature": temperature}
    return Dataset(profile, time, channels, np.zeros(rate.size, dtype=np.int64)).average(cases.INTERVAL_S)


def _truth(trial: Trial, profile: str, size: float) -> tuple[FloatArray, FloatArray]:
    """Curve, and what the truth adds to it, second by second."""
    temperature = cases.trace(profile).case[1:]
    temperature = temperature[: temperature.size // _MEANS * _MEANS]
    return _curve(temperature), TRUTHS[trial.truth][1](temperature, size)


def run_trial(trial: Trial) -> dict[str, Any]:
    """Errors by noise and by counts over the RMS of the noise, and whether a drawn row is covered."""
    rng = np.random.default_rng([trial.seed, *map(ord, trial.truth + trial.noise)])
    curve, more = _truth(trial, cases.TWO_RATES, 1.0)
    noise = made(NOISES[trial.noise], rng, curve.size)[0]
    noise -= noise.mean()
    size = cases.rms(_record(cases.TWO_RATES, noise).bias)
    shape = cases.rms(cases.absorbed(_record(cases.TWO_RATES, curve + more), curve_means(more), MODEL))
    factor = STRENGTH * size / shape if shape > 0.0 else 0.0
    first = _record(cases.TWO_RATES, sum(_truth(trial, cases.TWO_RATES, factor), noise))
    other = _record(cases.LOOPS, sum(_truth(trial, cases.LOOPS, factor), np.zeros(())))
    effect = TRUTHS[trial.truth][0]
    model = MODEL if trial.lacking or effect is None else MODEL.adding(effects.make(effect))
    found = fit_model(model, first)
    numbers: dict[str, Any] = {}
    for name, fit in (("noise", found), ("count", found.counted or found)):
        numbers[f"in_sample_{name}"] = round(fit.rms_dph / size, 4)
        numbers[f"unseen_{name}"] = round(cases.rms(_error(fit, other)) / size, 4)
    error, deviation = _error(found, other), _deviation(found, other)
    row = int(rng.integers(error.size))
    return numbers | {"deviations": round(float(abs(error[row]) / deviation[row]), 4)}


def curve_means(values: FloatArray) -> FloatArray:
    """Means (n,) over the usual interval of values of every second."""
    return np.asarray(values.reshape(-1, _MEANS).mean(axis=1))


def _error(fit: Fit, other: Dataset) -> FloatArray:
    """Error of the predicted shape (n,) [deg/h]."""
    left = other.bias - fit.predict(other).bias
    return np.asarray(left - left.mean())


def _deviation(fit: Fit, other: Dataset) -> FloatArray:
    """Its stated standard deviation (n,), nonlinear parameters included."""
    jacobian = [fit.bound.columns(other)]
    for key, own in fit.bound.theta.items():
        for name, value in own.items():
            ends = [{**fit.bound.theta, key: {**own, name: value * (1.0 + d)}} for d in (-1e-4, 1e-4)]
            low, high = (Bound(fit.bound.keys, fit.bound.effects, end, fit.bound.slices).columns(other) for end in ends)
            jacobian.append(((high - low) @ fit.beta / (2e-4 * value))[:, None])
    columns = np.hstack(jacobian)
    columns -= columns.mean(axis=0)
    return np.asarray(np.sqrt(np.einsum("ij,jk,ik->i", columns, fit.covariance, columns)))


def summary(results: Sequence[tuple[Trial, dict[str, Any]]]) -> list[dict[str, Any]]:
    """Of each noise and truth: RMS errors, in how many runs the noise does better, coverage with its 95 % interval."""
    rows = []
    for noise, lacking, truth in dict.fromkeys((t.noise, t.lacking, t.truth) for t, _ in results):
        mine = [found for t, found in results if (t.noise, t.lacking, t.truth) == (noise, lacking, truth)]
        rows.append({"noise": noise, "truth": truth, "model": "lacks it" if lacking else "has it", **_row(mine)})
    for noise in dict.fromkeys(t.noise for t, _ in results):
        mine = [found for t, found in results if t.noise == noise and not t.lacking]
        rows.append({"noise": noise, "truth": "all", "model": "has it", **_row(mine)})
    return rows


def _row(mine: Sequence[Mapping[str, float]]) -> dict[str, Any]:
    names = ("in_sample_count", "in_sample_noise", "unseen_count", "unseen_noise")
    row: dict[str, Any] = {name: round(cases.rms(np.array([found[name] for found in mine])), 3) for name in names}
    row |= {"n": len(mine), "better_by_noise": sum(found["unseen_noise"] < found["unseen_count"] for found in mine)}
    for limit in (1, 2):
        held = sum(found["deviations"] <= limit for found in mine)
        ends = binomtest(held, len(mine)).proportion_ci(0.95, method="exact")
        row[f"within_{limit}_sigma"] = [round(held / len(mine), 3), round(ends.low, 3), round(ends.high, 3)]
    return row


def main(arguments: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=30)
    parser.add_argument("--out", type=Path, default=Path("weighting.jsonl"))
    options = parser.parse_args(arguments)
    print(json.dumps(summary(campaigns.found(trials(options.seeds), run_trial, options.out, Trial)), indent=1))


if __name__ == "__main__":
    main()
