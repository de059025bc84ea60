"""A sudden lasting change of the bias at an unknown time: released stress, charging, a lost count.

Equation: B = a H(t - t_j), H the unit step; the mean over a row that contains t_j takes its share of the step. With
`then: fades`, a shock that the unit recovers from: B = a H(t - t_j) exp(-(t - t_j) / tau); with `then: returns`, what
lasts for d: B = a (H(t - t_j) - H(t - t_j - d)).
Units: B and a [deg/h], t and t_j time of the run [h], tau and d [s].
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

from bench.analysis.effects.base import Effect, Parameter, Theta, check_choice
from bench.base import FloatArray, InputError
from bench.record import Dataset

_PARAMETERS = {
    "stays": (),
    "fades": (Parameter("tau_s", "s", 60.0, 7200.0, 600.0, log=True, meaning="time constant with which it fades"),),
    "returns": (Parameter("lasts_s", "s", 60.0, 36000.0, 1800.0, log=True, meaning="how long it lasts", jump=True),),
}


@dataclass(frozen=True)
class BiasJump(Effect):
    """One step, that `then` stays, fades or returns; `run` names the run that it happened in where several are fitted.

    `own` are the runs that it was fitted to, each with the times [h] between which it is searched.
    """

    name = "bias_jump"
    by_clock = True
    family = "jump"
    amplitudes = (("a", "deg/h"),)

    run: str = ""
    then: str = "stays"
    span_h: tuple[float, float] = field(default=(0.0, 24.0), repr=False, metadata={"fitted": True})
    own: tuple[tuple[str, float, float], ...] = field(default=(), repr=False, metadata={"fitted": True})

    def __post_init__(self) -> None:
        if not isinstance(self.run, str):
            raise InputError(f"bias_jump: run is {self.run!r}, allowed is the name of a run")
        check_choice(self.name, "then", self.then, (*_PARAMETERS,))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Time of the jump, anywhere in the record; how fast it fades, or how long it lasts."""
        low, high = self.span_h
        middle, meaning = 0.5 * (low + high), "time of the jump"
        at = Parameter("at_h", "h", low, high, middle, meaning=meaning, change_point=True, jump=True)
        return (at, *_PARAMETERS[self.then])

    @property
    def rarity(self) -> float:
        """One that does not stay follows any rest about a sharp change: it is to be plain."""
        return 0.0 if self.then == "stays" else 3.0

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
        """A jump in each of several runs, that stays, fades or returns."""
        alone = self.run or len(self.own) < 2
        each = [self] if alone else [replace(self, run=one[0], span_h=one[1:], own=(one,)) for one in self.own]
        return (
            *each,
            *(
                replace(one, then=then)
                for then in (("fades", "returns") if self.then == "stays" else ())
                for one in each
            ),
        )

    def columns(self, record: Dataset, theta: Theta) -> FloatArray:
        """What each row has of the jump (n, 1), about its mean once one that stays was fitted; zero in other runs."""
        fitted = {name for name, _, _ in self.own}
        if self.run not in {"", record.name} or (fitted and record.name not in fitted):
            return np.zeros((len(record), 1))
        since_s = record.time - 3600.0 * theta["at_h"]
        if self.then == "stays":
            after = _after(since_s, record.interval_s)
            return np.asarray(after - (float(np.mean(after)) if fitted and len(record) else 0.0))[:, None]
        if self.then == "returns":
            return (_after(since_s, record.interval_s) - _after(since_s - theta["lasts_s"], record.interval_s))[:, None]
        ends_s = np.maximum(since_s[:, None] + record.interval_s * np.array([-0.5, 0.5]), 0.0)
        begin, end = np.exp(-ends_s / theta["tau_s"]).T
        return np.asarray((begin - end) * theta["tau_s"] / record.interval_s)[:, None]


def _after(since_s: FloatArray, interval_s: float) -> FloatArray:
    """Share of rows (n,) that lies after a moment, so long before their middles."""
    return np.asarray(np.clip(since_s / interval_s + 0.5, 0.0, 1.0))
