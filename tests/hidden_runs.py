"""Runs of a simulated gyro with hidden effects, made in memory in about a second: physics only, no wire.

The truth integrates states of its own (`drivers.sim.truth`); nothing here knows a regressor of the analysis.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np

from bench.channels import FloatArray
from bench.dataset import Dataset, Segment
from drivers.sim.plant import Plant
from drivers.sim.resonator import Environment, Resonator, UnitSettings

INTERVAL_S = 30
_SAMPLES = 10 * INTERVAL_S  # at 10 Hz: the mean over an interval has the noise of 500 Hz

PROFILES: dict[str, tuple[tuple[float, float, float], ...]] = {
    # (to degC, degC/min, soak min)
    "two_rates": ((-30, 1, 0), (-40, 0.5, 15), (85, 1, 15), (25, 1, 20), (-20, 2, 0), (85, 2, 10), (25, 2, 20)),
    "one_rate": ((-35, 1, 15), (85, 1, 15), (25, 1, 15)),
    "minor_loops": (
        *((65, 1.5, 0), (30, 1.5, 0), (80, 2.5, 10), (10, 1.5, 0), (30, 0.8, 0)),
        *((-25, 1.5, 15), (5, 0.8, 0), (-10, 1.5, 0), (25, 2.5, 15)),
    ),
    "steps": ((60, 3, 40), (25, 3, 40), (85, 3, 40), (0, 2, 40), (50, 3, 40), (-25, 2, 50), (25, 3, 40)),
    "short": ((60, 2, 10), (-5, 2, 10), (60, 3, 5), (20, 3, 0), (45, 2, 0), (25, 2, 10)),
    "static": ((25, 1, 180),),
}

STATIC = {"mechanism": "static_bias", "coefficients_dph": [4.0, 1.5, -2.0, -0.8, 0.9]}
NOISE = {"angle_random_walk": 0.01, "bias_instability": 0.03, "rate_random_walk": 0.03}
_SILENT = dict.fromkeys(NOISE, 0.0)
_CHANNELS = ("rate_dph", "temperature", "frequency", "drive", "quadrature", "supply")


def hidden_run(
    mechanisms: Sequence[Mapping[str, Any]] = (),
    profile: str = "two_rates",
    seed: int = 1,
    *,
    strength: float | None = None,
    noise: Mapping[str, float] | None = None,
    turns: FloatArray | None = None,
) -> Dataset:
    """A run of a unit with a smooth static curve, these further mechanisms of the truth, and noise; 30 s means.

    With `strength` the mechanisms are scaled so that the part of them that no curve over temperature takes has this
    multiple of the noise's RMS (a lag by scaling the curve that it shifts). `turns` (n,) [deg/s] turns the unit.
    """
    noise = NOISE if noise is None else noise
    full = _record([STATIC, *mechanisms], _SILENT, profile, seed, turns)
    random = _record([], noise, profile, seed, turns)
    applied = full["applied_rate"] * 3600.0
    random["rate"] = random["rate"] - applied
    rate = full["rate"]
    if strength is not None:
        plain = _record([STATIC], _SILENT, profile, seed, turns)["rate"]
        factor = strength * _beyond(full, random["rate"]) / _beyond(full, full["rate"] - plain)
        thermal = _is_thermal(mechanisms)
        rate = applied + factor * (rate - applied) if thermal else plain + factor * (rate - plain)
    full["rate"] = rate + random["rate"]
    segments = _segments(profile)
    middle = INTERVAL_S * (np.arange(len(rate), dtype=np.float64) + 0.5)
    which = np.searchsorted([s.from_s for s in segments], middle, side="right") - 1
    name = f"{profile} {seed}"
    return Dataset(name, middle, full, which.astype(np.int64), segments, float(INTERVAL_S))


def _is_thermal(mechanisms: Sequence[Mapping[str, Any]]) -> bool:
    settings = UnitSettings.parse({"truth": list(mechanisms)})
    return any(m.kind == "thermal" for m in settings.truth)


def _beyond(record: Mapping[str, FloatArray], rate: FloatArray) -> float:
    """RMS of what a curve over temperature does not take [deg/h]."""
    t = record["temperature"]
    curve = np.polynomial.chebyshev.chebvander(np.interp(t, [t.min(), t.max()], [-1.0, 1.0]), 12)
    left = rate - curve @ np.linalg.lstsq(curve, rate, rcond=None)[0]
    return float(np.sqrt(np.mean(left**2)))


def _record(
    truth: Sequence[Mapping[str, Any]], noise: Mapping[str, float], profile: str, seed: int, turns: FloatArray | None
) -> dict[str, FloatArray]:
    """Channels of means over 30 s."""
    settings = UnitSettings.parse({"truth": list(truth), "noise": dict(noise)})
    unit, path = Resonator(settings, seed, rate_hz=10.0), _chamber(profile)
    turned = np.zeros(len(path)) if turns is None else turns
    rows = []
    for i, (before, after) in enumerate(pairwise(path)):
        environment = Environment(
            INTERVAL_S * float(i),
            _SAMPLES,
            (float(before[0]), float(after[0])),
            (float(before[1]), float(after[1])),
            compressor=float(after[2]),
            heater=float(after[3]),
            applied_rate_dps=(float(turned[i]), float(turned[i])),
            rate_hz=10.0,
        )
        signals = unit.advance(environment)
        rows.append([float(np.mean(getattr(signals, name))) for name in _CHANNELS])
    channels = dict(zip(("rate", *_CHANNELS[1:]), np.array(rows).T.copy(), strict=True))
    others = {"chamber_temperature": path[1:, 1], "compressor": path[1:, 2], "applied_rate": turned[: len(rows)]}
    return channels | {name: np.array(values) for name, values in others.items()}


@lru_cache(maxsize=16)
def _chamber(profile: str) -> FloatArray:
    """Case and air temperature, compressor and heater (shares) at the ends of the intervals, (n + 1, 4)."""
    plant = Plant(seed=1)
    state = plant.state
    for _ in range(3600):  # the unit is on and settled when the run begins
        state = plant.step(1.0, 25.0)
    rows, setpoint = [[state.case, state.air, float(state.compressor), state.heater]], _setpoint(profile)
    for piece in setpoint[: len(setpoint) // INTERVAL_S * INTERVAL_S].reshape(-1, INTERVAL_S):
        states = [plant.step(1.0, float(value)) for value in piece]
        shares = np.mean([[s.compressor, s.heater] for s in states], axis=0)
        rows.append([states[-1].case, states[-1].air, *map(float, shares)])
    table = np.array(rows)
    table.setflags(write=False)
    return table


def _setpoint(profile: str) -> FloatArray:
    """Set point [degC] of each second."""
    path = [25.0]
    for to, rate, soak_min in PROFILES[profile]:
        seconds = round(abs(to - path[-1]) / rate * 60.0)
        path += [*np.linspace(path[-1], to, seconds + 1)[1:].tolist(), *([to] * round(60 * soak_min))]
    return np.array(path[1:])


def _segments(profile: str) -> tuple[Segment, ...]:
    segments: list[Segment] = []
    at, last = 0.0, 25.0
    for to, rate, soak_min in PROFILES[profile]:
        for kind, seconds in (("ramp", abs(to - last) / rate * 60.0), ("soak", 60.0 * soak_min)):
            if seconds:
                direction = ("heating" if to > last else "cooling") if kind == "ramp" else "constant"
                name = f"{kind} {len(segments) + 1}: {to:g} degC"
                segments.append(Segment(len(segments), name, kind, at, at + seconds, direction, float(to), float(rate)))
                at += seconds
        last = to
    return tuple(segments)
