"""Runs of a simulated gyro with hidden effects, made in memory in about a second: physics only, no wire.

The truth integrates states of its own (`drivers.sim.truth`); nothing here knows a regressor of the analysis.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np

from bench.base.channels import FloatArray
from bench.record.dataset import Dataset, Segment
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


@dataclass(frozen=True)
class HiddenUnit:
    """A unit with a smooth static curve, further mechanisms of the truth, `scale` times their size, and noise.

    A thermal mechanism is scaled through the curve that it shifts.
    """

    mechanisms: tuple[Mapping[str, Any], ...] = ()
    scale: float = 1.0
    noise: Mapping[str, float] = field(default_factory=lambda: NOISE)

    def at_strength(self, strength: float, profile: str = "two_rates") -> HiddenUnit:
        """Scaled so that what no curve over temperature takes of the mechanisms is so many times the noise (RMS)."""
        if not self.mechanisms:
            return self
        full, plain = (_record([STATIC, *m], _SILENT, profile, 0, None) for m in (self.mechanisms, ()))
        noise = np.mean([_beyond(full, _record([], self.noise, profile, s, None)["rate"]) for s in range(3)])
        hidden = _beyond(full, full["rate"] - plain["rate"])
        return replace(self, scale=strength * float(noise) / hidden)

    def run(self, profile: str = "two_rates", seed: int = 1, turns: FloatArray | None = None) -> Dataset:
        """30 s means of one run; `turns` (n,) [deg/s] turns the unit, noise and channels wander by the seed."""
        full = _record([STATIC, *self.mechanisms], _SILENT, profile, seed, turns)
        plain = _record([STATIC], _SILENT, profile, seed, turns)["rate"]
        applied = 3600.0 * full["applied_rate"]
        kept = applied if self._thermal else plain
        noise = _record([], self.noise, profile, seed, turns)["rate"] - applied
        full["rate"] = kept + self.scale * (full["rate"] - kept) + noise
        segments = _segments(profile)
        middle = INTERVAL_S * (np.arange(len(noise), dtype=np.float64) + 0.5)
        which = np.searchsorted([s.from_s for s in segments], middle, side="right") - 1
        return Dataset(f"{profile} {seed}", middle, full, which.astype(np.int64), segments, float(INTERVAL_S))

    @property
    def _thermal(self) -> bool:
        settings = UnitSettings.parse({"truth": list(self.mechanisms)})
        return any(m.kind == "thermal" for m in settings.truth)


def hidden_run(
    mechanisms: Sequence[Mapping[str, Any]] = (), profile: str = "two_rates", seed: int = 1, strength: float = 1.0
) -> Dataset:
    """A run of a unit with these mechanisms at a strength relative to the noise."""
    return HiddenUnit(tuple(mechanisms)).at_strength(strength, profile).run(profile, seed)


def _beyond(record: Mapping[str, FloatArray], rate: FloatArray) -> float:
    """RMS of what a curve over temperature does not take [deg/h]."""
    t = record["temperature"]
    curve = np.polynomial.chebyshev.chebvander(np.interp(t, [t.min(), t.max()], [-1.0, 1.0]), 12)
    left = rate - curve @ np.linalg.lstsq(curve, rate, rcond=None)[0]
    return float(np.sqrt(np.mean(left**2)))


def _record(
    truth: Sequence[Mapping[str, Any]], noise: Mapping[str, float], profile: str, seed: int, turns: FloatArray | None
) -> dict[str, FloatArray]:
    """Channels of means over 30 s; of a unit that stands still each is made once, for all tests of a process."""
    unit = json.dumps([list(truth), dict(noise)])
    return _simulated(unit, profile, seed, turns) if turns is not None else dict(_still(unit, profile, seed))


@lru_cache(maxsize=400)
def _still(unit: str, profile: str, seed: int) -> dict[str, FloatArray]:
    return _simulated(unit, profile, seed, None)


def _simulated(unit: str, profile: str, seed: int, turns: FloatArray | None) -> dict[str, FloatArray]:
    truth, noise = json.loads(unit)
    settings = UnitSettings.parse({"truth": truth, "noise": noise})
    gyro, path = Resonator(settings, seed, rate_hz=10.0), _chamber(profile)
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
        signals = gyro.advance(environment)
        rows.append([float(np.mean(getattr(signals, name))) for name in _CHANNELS])
    means = np.array(rows)
    # Ten samples of the rate follow each of the others: their means are of moments that lie 0.45 s apart.
    means[:, 1:] += 0.45 / INTERVAL_S * np.gradient(means[:, 1:], axis=0)
    channels = dict(zip(("rate", *_CHANNELS[1:]), means.T.copy(), strict=True))
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
