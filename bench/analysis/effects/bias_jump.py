"""A sudden lasting change of the bias at an unknown time: released stress, charging, a lost count.

Equation: B = a H(t - t_j), H the unit step; the mean over a row that contains t_j takes its share of the step.
Units: B and a [deg/h], t and t_j time of the run [h].
Source: change-point regression; 0.05-0.5 deg/h for a 1 deg/h class, steps of 90-470 deg/h were seen in a MEMS unit.
When left out: the residual has two levels, before and after one moment, and slopes towards the moment.
Look-alikes: aging, warm_up, bias_kink and frost (at a temperature that repeats), random walk of the rate.
Separated by: repeating the profile: neither the time nor the temperature of a jump repeats.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from bench.analysis.effects.base import Effect, Parameter, Theta
from bench.base import FloatArray, InputError
from bench.record import Dataset


@dataclass(frozen=True)
class BiasJump(Effect):
    """One step; `run` names the run that it happened in where several are fitted together."""

    name = "bias_jump"
    family = "jump"
    amplitudes = (("a", "deg/h"),)

    run: str = ""
    span_h: tuple[float, float] = field(default=(0.0, 24.0), repr=False, metadata={"fitted": True})

    def __post_init__(self) -> None:
        if not isinstance(self.run, str):
            raise InputError(f"bias_jump: run is {self.run!r}, allowed is the name of a run")

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Time of the jump, anywhere in the record."""
        low, high = self.span_h
        return (Parameter("at_h", "h", low, high, 0.5 * (low + high), meaning="time of the jump", change_point=True),)

    def suited(self, records: Sequence[Dataset]) -> BiasJump:
        """The time within the record, two rows from its ends."""
        times = [r.time for r in records if len(r) > 5 and self.run in {"", r.name}]
        if not times:
            raise InputError(f"bias_jump: no run{f' {self.run!r}' * bool(self.run)} with more than 5 rows")
        return replace(self, span_h=(min(t[2] for t in times) / 3600.0, max(t[-3] for t in times) / 3600.0))

    def columns(self, record: Dataset, theta: Theta) -> FloatArray:
        """Share of each row after the jump (n, 1); zero in other runs."""
        after = (record.time - 3600.0 * theta["at_h"]) / record.interval_s + 0.5
        return np.clip(after, 0.0, 1.0)[:, None] * float(self.run in {"", record.name})
