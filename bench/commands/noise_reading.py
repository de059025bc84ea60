"""bench noise: the noise coefficients of isothermal runs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from bench import analysis
from bench.base import InputError
from bench.commands.analysis import recovered
from bench.commands.results.analyse import NoiseCoefficient, NoiseFound
from bench.record import DEFAULT_INTERVAL_S, averaged, refuse_mixed


def noise(runs: Sequence[Path], output: str | None = None) -> NoiseFound:
    """`bench noise`: Allan deviation and the coefficients of IEEE 952 from where the temperature stands still."""
    datasets = [averaged(run, 1.0) for run in recovered(runs, output)]
    refuse_mixed(datasets)
    floor = analysis.noise_floor(datasets, DEFAULT_INTERVAL_S)
    if floor.noise is None or floor.estimate is None:
        raise InputError(f"no noise can be read: {floor.reason}", runs[0])
    known = floor.noise
    found = {
        "angle_random_walk": (known.white, *known.intervals["white"], "deg/√h"),
        "bias_instability": (known.flicker, *known.intervals["flicker"], "deg/h"),
        "rate_random_walk": (known.walk, *known.intervals["walk"], "deg/h/√h"),
        "quantisation": (*floor.estimate.quantisation(), "deg"),
        "rate_ramp": (*floor.estimate.ramp(), "deg/h/h"),
    }
    if known.correlated:
        found["correlated_noise"] = (known.correlated, *known.intervals["correlated"], "deg/h")
    return NoiseFound(tuple(map(str, runs)), floor, {key: NoiseCoefficient(*values) for key, values in found.items()})
