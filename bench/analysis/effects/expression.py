"""A term of your own, written in one line of the model file.

Equation: B = the formula, for instance `k * dT_dt * quadrature`, or `a * (temperature - lag(temperature, tau_s))` with
`bounds: {tau_s: [60, 3600]}`. Names of channels, time, dT_dt and direction are data; lag(x, tau_s), uneven_lag(x,
rise_s, fall_s) (one time constant while x is above it, another while it is below), delay(x, late_s), play(x, width),
slew(x, per_min) that follows x no faster, dead_zone(x, width) (what of x is further from 0), latch(x, high, low) (1
from where x rises above `high` until it falls below `low`, else 0), total(x) [x h], highest(x) and lowest(x) so far,
above(x) (x where it is above 0, else 0), sawtooth(x) (from -0.5 to 0.5 between whole numbers), abs, exp, log, sqrt,
sin, cos, tanh, sign are functions; every other name is a parameter. One that multiplies a term is an amplitude and
solved exactly; one inside a function needs bounds. The time constant of a lag, and the width of a play, may change with
a channel, as in `lag(dT_dt, tau_s * exp(-faster * temperature))`.
Units: B [deg/h], channels as in the vocabulary, time [s], dT_dt [degC/min], direction +1 heating, -1 cooling, 0 else.
Source: the user's.
When left out: the residual follows the formula.
Look-alikes: the built-in effects that the formula resembles.
Separated by: an experiment that moves what the formula uses and nothing else.
"""

from __future__ import annotations

import ast
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from bench.analysis.effects.base import Effect, Parameter, Theta
from bench.analysis.effects.formula import Data, Formula, parse
from bench.base import FloatArray, InputError
from bench.record import Dataset


@dataclass(frozen=True)
class Expression(Effect):
    """Terms of a `formula`; `bounds` {name: [low, high]} of its nonlinear parameters."""

    name = "expression"

    formula: str = ""
    bounds: Mapping[str, Sequence[float]] = field(default_factory=dict, hash=False)
    parsed: Formula = field(init=False, repr=False, compare=False, metadata={"fitted": True})

    def __post_init__(self) -> None:
        if not isinstance(self.bounds, Mapping):
            raise InputError("expression: bounds is a mapping such as {tau_s: [10, 1000]}")
        for name, pair in self.bounds.items():
            _check(name, pair)
        object.__setattr__(self, "parsed", parse(self.formula, self.bounds))

    @property
    def needs(self) -> tuple[str, ...]:
        """Channels in the formula."""
        return self.parsed.needs

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Parameters with bounds, logarithmic where these are positive and a decade apart."""
        return tuple(bounded(name, *self.bounds[name]) for name in self.parsed.nonlinear)

    def columns(self, record: Dataset, theta: Theta) -> FloatArray:
        """Factor of each amplitude (n, k)."""
        return self.parsed.columns(Data(record), theta)

    @property
    def amplitudes(self) -> tuple[tuple[str, str], ...]:
        """The amplitudes, in deg/h per what they multiply."""
        units = (f"deg/h per ({ast.unparse(factor)})" for factor in self.parsed.factors)
        return tuple(zip(self.parsed.amplitudes, units, strict=True))


def _check(name: object, pair: object) -> None:
    numbers = isinstance(pair, Sequence) and len(pair) == 2 and all(type(end) in {int, float} for end in pair)
    if not isinstance(pair, Sequence) or not numbers or not pair[0] < pair[1] or not np.all(np.isfinite(pair)):
        raise InputError(f"expression: bounds of '{name}' are {pair!r}, needed are two numbers [low, high], low < high")


def bounded(name: str, low: float, high: float) -> Parameter:
    """A parameter of a formula between two bounds."""
    log = low > 0 and high >= 10.0 * low
    start = float(np.sqrt(low * high)) if log else 0.5 * (low + high)
    return Parameter(name, "", float(low), float(high), start, log, "of the formula")
