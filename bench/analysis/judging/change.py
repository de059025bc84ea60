"""Error of a unit's output before and after its calibration: one definition for both, at rest and turning apart."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.analysis.judging.quantities import turning
from bench.base import BoolArray, FloatArray, InputError, finite
from bench.record import Dataset


@dataclass(frozen=True)
class Figures:
    """Output less applied rate [deg/h]: means over `interval_s`, weighted by their samples, about zero."""

    rms_dph: float
    mean_dph: float
    scatter_dph: float
    """RMS about the mean."""
    peak_dph: float
    span_dph: float
    interval_s: float

    @classmethod
    def of(cls, data: Dataset, error: FloatArray | None = None) -> Figures:
        """Of the error (n,) [deg/h] of a record, by default its bias; InputError where it has no value."""
        values, count = data.bias if error is None else error, data.count("rate")
        rows = np.isfinite(values) & (count > 0)
        if not rows.any():
            raise InputError(f"{data.name}: holds no rate")
        left, weights = values[rows], count[rows]
        mean = float(np.average(left, weights=weights))
        square = float(np.average(left**2, weights=weights))
        scatter = float(np.sqrt(np.average((left - mean) ** 2, weights=weights)))
        return cls(
            float(np.sqrt(square)), mean, scatter, float(np.abs(left).max()), float(np.ptp(left)), data.interval_s
        )

    def to_json(self) -> dict[str, float]:
        """By name."""
        return dict(vars(self))


@dataclass(frozen=True)
class State:
    """A unit in one state of its calibration: figures at rest and, where a table turned it, turning."""

    rest: Figures | None
    turning: Figures | None

    @classmethod
    def of(
        cls, data: Dataset, error: FloatArray | None = None, within_degc: tuple[float, float] = (-np.inf, np.inf)
    ) -> State:
        """Of the rows of a record whose temperature [degC] lies within a range; InputError where none has a value."""
        values = data.bias if error is None else error
        temperature = data.channel("temperature")
        inside = (temperature >= within_degc[0]) & (temperature <= within_degc[1])
        if within_degc == (-np.inf, np.inf):
            inside = np.ones(len(data), dtype=bool)
        turned = turning(data)
        found = cls(_figures(data, values, inside & ~turned), _figures(data, values, inside & turned))
        if found.rest is None and found.turning is None:
            raise InputError(f"{data.name}: holds no rate between {within_degc[0]:g} and {within_degc[1]:g} degC")
        return found


@dataclass(frozen=True)
class Change:
    """What a calibration did to the output: both states over the temperatures that both records have."""

    before: State | None
    after: State
    within_degc: tuple[float, float]

    @classmethod
    def between(cls, before: Dataset | None, after: Dataset, left: FloatArray | None = None) -> Change:
        """From the record of the raw output to that of the corrected one, whose error is `left` (n,) [deg/h]."""
        low, high = range_degc(after)
        if before is not None:
            other = range_degc(before)
            shared = max(low, other[0]), min(high, other[1])
            with contextlib.suppress(InputError):  # nothing to compare: they share no temperature, or none with a rate
                return cls(State.of(before, None, shared), State.of(after, left, shared), shared)
        return cls(None, State.of(after, left), (low, high))

    @property
    def factor(self) -> float:
        """By how much the RMS at rest fell; NaN where it is not known for both."""
        return _ratio(self.before.rest if self.before else None, self.after.rest)

    @property
    def turning_factor(self) -> float:
        """By how much the RMS under rotation fell; NaN where it is not known for both."""
        return _ratio(self.before.turning if self.before else None, self.after.turning)

    @property
    def words(self) -> str:
        """Both factors; empty where none is known."""
        states = {"at rest": self.factor, "while turning": self.turning_factor}
        return ", ".join(
            f"{factor:.1f} times less {where} than before" for where, factor in states.items() if factor > 0
        )

    def to_json(self) -> dict[str, Any]:
        """For verification.json and certificate.json: `before`, `after` and `factor` are those at rest."""
        old = self.before or State(None, None)
        pairs = {"before": old.rest, "after": self.after.rest, "turning_before": old.turning}
        shown = {**pairs, "turning_after": self.after.turning}
        return {
            **{name: None if figures is None else figures.to_json() for name, figures in shown.items()},
            "factor": finite(self.factor),
            "turning_factor": finite(self.turning_factor),
            "within_degc": [finite(end) for end in self.within_degc],
        }


def range_degc(data: Dataset) -> tuple[float, float]:
    """Temperatures [degC] of the rows that hold a rate; infinite where it was not measured."""
    temperature = data.channel("temperature")[np.isfinite(data.bias)]
    present = temperature[np.isfinite(temperature)]
    return (float(present.min()), float(present.max())) if present.size else (-np.inf, np.inf)


def _figures(data: Dataset, error: FloatArray, rows: BoolArray) -> Figures | None:
    chosen = rows & np.isfinite(error) & (data.count("rate") > 0)
    return Figures.of(data.select(chosen), error[chosen]) if chosen.any() else None


def _ratio(before: Figures | None, after: Figures | None) -> float:
    return np.nan if before is None or after is None else before.rms_dph / after.rms_dph
