"""Prediction of a run that has not been made: the unit's temperature, and the channels that follow it.

The chamber is learnt from the runs at hand: the unit's thermometer follows the set point through two lags in series,
T = offset + L(tau_1) L(tau_2) set point, for any chamber, fixture and unit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from bench.analysis.effects.operators import ramp_invariant_lag
from bench.base import FloatArray
from bench.record import Dataset

_LONGEST_S = 7200.0
_TYPICAL_S = (300.0, 120.0)  # of a bench chamber with a fixture, where no set point was recorded
_BINS = 24


@dataclass(frozen=True)
class ChamberModel:
    """Two lags [s] and an offset [degC] from set point to the unit's thermometer."""

    slow_s: float = _TYPICAL_S[0]
    fast_s: float = _TYPICAL_S[1]
    offset_degc: float = 0.0

    def temperature(self, time_s: FloatArray, setpoint: FloatArray) -> FloatArray:
        """Temperature of the unit (n,) [degC] for a set point in force (n,), settled at the start."""
        lagged = ramp_invariant_lag(time_s, ramp_invariant_lag(time_s, setpoint, self.slow_s), self.fast_s)
        return lagged + self.offset_degc


def chamber_model(records: Sequence[Dataset]) -> ChamberModel:
    """Model fitted to the runs that recorded their set point; a typical one where none did."""
    known = [r for r in records if np.isfinite(r.channels.get("chamber_setpoint", np.array([np.nan]))).sum() > 10]
    if not known:
        return ChamberModel()

    def misfit(x: FloatArray) -> FloatArray:
        model = ChamberModel(float(np.exp(x[0])), float(np.exp(x[1])), float(x[2]))
        left = [r.channel("temperature") - model.temperature(r.time, r.channels["chamber_setpoint"]) for r in known]
        together = np.concatenate(left)
        return together[np.isfinite(together)]

    start = np.array([*np.log(_TYPICAL_S), 0.0])
    bounds = ([0.0, 0.0, -50.0], [np.log(_LONGEST_S), np.log(_LONGEST_S), 50.0])
    # Robust: the start from room temperature and a chamber that cannot follow are not part of the lag.
    solved = scipy.optimize.least_squares(misfit, start, bounds=bounds, loss="soft_l1", f_scale=0.3)
    slow, fast = sorted(np.exp(solved.x[:2]).tolist(), reverse=True)
    return ChamberModel(slow, fast, float(solved.x[2]))


def predicted_record(
    records: Sequence[Dataset], setpoint: FloatArray, interval_s: float, chamber: ChamberModel | None = None
) -> Dataset:
    """The record of a run along a set point of every second, without its bias, in means over `interval_s`.

    `chamber` is the model of these records, where it was fitted before. Further channels that all runs have are what
    they were on average at that temperature.
    """
    seconds = np.arange(len(setpoint), dtype=np.float64)
    temperature = (chamber or chamber_model(records)).temperature(seconds, setpoint)
    rows = len(setpoint) // max(1, round(interval_s))
    step = round(interval_s)
    mean = temperature[: rows * step].reshape(rows, step).mean(axis=1)
    channels = {"temperature": mean, "chamber_setpoint": setpoint[: rows * step].reshape(rows, step).mean(axis=1)}
    shared = set.intersection(*(set(record.channels) for record in records)) - {"rate", *channels}
    for name in sorted(shared):
        channels[name] = np.zeros(rows) if name == "applied_rate" else _over_temperature(records, name, mean)
    return Dataset(
        name="planned",
        time=interval_s * (np.arange(rows, dtype=np.float64) + 0.5),
        channels=channels,
        segment=np.zeros(rows, dtype=np.int64),
        interval_s=interval_s,
        counts={"rate": np.full(rows, float(np.median(records[0].count("rate"))))},
    )


def _over_temperature(records: Sequence[Dataset], name: str, temperature: FloatArray) -> FloatArray:
    """A channel as the runs' mean over temperature."""
    seen = np.concatenate([record.channel("temperature") for record in records])
    value = np.concatenate([record.channels[name] for record in records])
    good = np.isfinite(seen) & np.isfinite(value)
    if not good.any():
        return np.full(len(temperature), np.nan)
    edges = np.unique(np.quantile(seen[good], np.linspace(0.0, 1.0, _BINS + 1)))
    which = np.clip(np.searchsorted(edges, seen[good], side="right") - 1, 0, max(len(edges) - 2, 0))
    count = np.bincount(which)
    used = count > 0
    at = np.bincount(which, seen[good])[used] / count[used]
    return np.asarray(np.interp(temperature, at, np.bincount(which, value[good])[used] / count[used]))
