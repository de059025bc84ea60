"""A sudden lasting change of the bias at an unknown time: released stress, charging, a lost count.

Equation: B = a H(t - t_j), H the unit step; the mean over a row that contains t_j takes its share of the step.
Units: B and a [deg/h], t and t_j time of the run [h].
Source: change-point regression; 0.05-0.5 deg/h for a 1 deg/h class, steps of 90-470 deg/h were seen in a MEMS unit.
When left out: the residual has two levels, before and after one moment, and slopes towards the moment.
Look-alikes: aging, warm_up, bias_kink and frost (at a temperature that repeats), random walk of the rate.
Separated by: repeating the profile: neither the time nor the temperature of a jump repeats.
In other runs: nothing. A jump belongs to the run that it happened in; there the column is counted from its mean, so
that the model's constant is the level of the whole run, with the jump as without it.
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
    """One step; `run` names the run that it happened in where several are fitted together.

    `own` are the runs that it was fitted to, each with the times [h] between which it is searched.
    """

    name = "bias_jump"
    by_clock = True
    family = "jump"
    amplitudes = (("a", "deg/h"),)

    run: str = ""
    span_h: tuple[float, float] = field(default=(0.0, 24.0), repr=False, metadata={"fitted": True})
    own: tuple[tuple[str, float, float], ...] = field(default=(), repr=False, metadata={"fitted": True})

    def __post_init__(self) -> None:
        if not isinstance(self.run, str):
            raise InputError(f"bias_jump: run is {self.run!r}, allowed is the name of a run")

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Time of the jump, anywhere in the record."""
        low, high = self.span_h
        middle, meaning = 0.5 * (low + high), "time of the jump"
        return (Parameter("at_h", "h", low, high, middle, meaning=meaning, change_point=True, jump=True),)

    def suited(self, records: Sequence[Dataset]) -> BiasJump:
        """The time within the record, two rows from its ends."""
        own = tuple(
            (r.name, float(r.time[2]) / 3600.0, float(r.time[-3]) / 3600.0)
            for r in records
            if len(r) > 5 and self.run in {"", r.name}
        )
        if not own:
            raise InputError(f"bias_jump: no run{f' {self.run!r}' * bool(self.run)} with more than 5 rows")
        return replace(self, span_h=(min(low for _, low, _ in own), max(high for _, _, high in own)), own=own)

    def shapes(self) -> tuple[Effect, ...]:
        """A jump in each of several runs."""
        if self.run or len(self.own) < 2:
            return (self,)
        return tuple(replace(self, run=each[0], span_h=each[1:], own=(each,)) for each in self.own)

    def columns(self, record: Dataset, theta: Theta) -> FloatArray:
        """Share of each row after the jump (n, 1), about its mean once it was fitted; zero in other runs."""
        fitted = {name for name, _, _ in self.own}
        if self.run not in {"", record.name} or (fitted and record.name not in fitted):
            return np.zeros((len(record), 1))
        after = np.clip((record.time - 3600.0 * theta["at_h"]) / record.interval_s + 0.5, 0.0, 1.0)
        level = float(np.mean(after)) if fitted and len(record) else 0.0
        return np.asarray(after - level)[:, None]
