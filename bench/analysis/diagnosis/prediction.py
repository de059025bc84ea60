"""Prediction of a run that has not been made: the unit's temperature, and the channels that follow it.

The chamber is learnt from the runs at hand: the unit's thermometer follows the set point through two lags in series,
T = offset + L(tau_1) L(tau_2) set point, for any chamber, fixture and unit; the air follows it through one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from bench.analysis.effects.operators import ramp_invariant_lag
from bench.base import FloatArray
from bench.record import Dataset

AIR = "chamber_temperature"
_LONGEST_S = 7200.0
_TYPICAL_S = (300.0, 120.0)  # of a bench chamber with a fixture, where no set point was recorded
_BINS = 24


@dataclass(frozen=True)
class Follower:
    """A thermometer that follows the set point through lags in series [s], with an offset [degC]."""

    lags_s: tuple[float, ...]
    offset_degc: float = 0.0

    def temperature(self, time_s: FloatArray, setpoint: FloatArray) -> FloatArray:
        """Its temperature (n,) [degC] for a set point in force (n,), settled at the start."""
        for lag_s in self.lags_s:
            setpoint = ramp_invariant_lag(time_s, setpoint, lag_s)
        return np.asarray(setpoint + self.offset_degc)


@dataclass(frozen=True)
class ChamberModel:
    """The unit's thermometer and that of the air."""

    unit: Follower = Follower(_TYPICAL_S)
    air: Follower = Follower(_TYPICAL_S[1:])


def chamber_model(records: Sequence[Dataset]) -> ChamberModel:
    """Model fitted to the runs that recorded their set point; a typical one where none did."""
    known = [r for r in records if np.isfinite(r.channels.get("chamber_setpoint", np.array([np.nan]))).sum() > 10]
    usual = ChamberModel()
    return ChamberModel(_fitted(known, "temperature", usual.unit), _fitted(known, AIR, usual.air))


def _fitted(records: Sequence[Dataset], channel: str, usual: Follower) -> Follower:
    """How the channel follows the set point in these records, the slowest lag first; as usual where none has it."""
    records = [record for record in records if channel in record.channels]
    if not records:
        return usual

    def at(x: FloatArray) -> Follower:
        return Follower(tuple(np.exp(x[:-1]).tolist()), float(x[-1]))

    def misfit(x: FloatArray) -> FloatArray:
        model = at(x)
        left = [r.channel(channel) - model.temperature(r.time, r.channels["chamber_setpoint"]) for r in records]
        together = np.concatenate(left)
        return together[np.isfinite(together)]

    count = len(usual.lags_s)
    bounds = ([*[0.0] * count, -50.0], [*[np.log(_LONGEST_S)] * count, 50.0])
    # Robust: the start from room temperature and a chamber that cannot follow are not part of the lag.
    start = np.array([*np.log(usual.lags_s), 0.0])
    solved = at(scipy.optimize.least_squares(misfit, start, bounds=bounds, loss="soft_l1", f_scale=0.3).x)
    return Follower(tuple(sorted(solved.lags_s, reverse=True)), solved.offset_degc)


def predicted_record(
    records: Sequence[Dataset], setpoint: FloatArray, interval_s: float, chamber: ChamberModel | None = None
) -> Dataset:
    """The record of a run along a set point of every second, without its bias, in means over `interval_s`.

    `chamber` is the model of these records, where it was fitted before. Further channels that all runs have are what
    they were on average at that temperature.
    """
    seconds = np.arange(len(setpoint), dtype=np.float64)
    model, step = chamber or chamber_model(records), round(interval_s)
    rows = len(setpoint) // max(1, step)
    finer = {"temperature": model.unit.temperature(seconds, setpoint), "chamber_setpoint": setpoint}
    if all(AIR in record.channels for record in records):
        finer[AIR] = model.air.temperature(seconds, setpoint)
    channels = {name: values[: rows * step].reshape(rows, step).mean(axis=1) for name, values in finer.items()}
    mean = channels["temperature"]
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
