"""An effect of a changing temperature that acts in a part of the range only: above or below a place.

Equation: B = a s x, s a step of 5 degC width at T0, 1 above it (`side: above`) or below (`side: below`); x is dT/dt
over a minute (`of: rate`) or the play loop of half-width 4 degC (`of: loop`).
Units: B [deg/h], T0 [degC], a [deg/h per degC/min] of a rate, [deg/h] of a loop.
Source: glass transitions of epoxies (40-120 degC) above which a mount creeps and slips; solder and grease that stiffen
in the cold; a heater or a valve that works above a threshold.
When left out: heating and cooling differ in one part of the range and agree in the other.
Look-alikes: temperature_rate and hysteresis (act in the whole range), frost (on one branch), bias_kink (no loop).
Separated by: minor loops on both sides of the place, at two rates.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np

from bench.analysis.effects.base import Effect, Parameter, Scale, Theta, check_choice
from bench.analysis.effects.operators import play, slope
from bench.base import FloatArray
from bench.record import Dataset

SIDES, OF = ("above", "below"), ("rate", "loop")
_WIDTH_DEGC, _LOOP_DEGC = 2.0, 4.0


@dataclass(frozen=True)
class PartialRange(Effect):
    """One term; `side` above or below, `of` rate or loop."""

    name = "partial_range"
    needs = ("temperature",)
    rarity = 1.0

    side: str = "above"
    of: str = "rate"
    range_degc: tuple[float, float] = field(default=(-50.0, 120.0), repr=False, metadata={"fitted": True})

    def __post_init__(self) -> None:
        check_choice(self.name, "side", self.side, SIDES)
        check_choice(self.name, "of", self.of, OF)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Where it begins."""
        low, high = self.range_degc
        return (Parameter("at_degc", "degC", low, high, 0.5 * (low + high), meaning="where it begins"),)

    def shapes(self) -> tuple[Effect, ...]:
        """Rate and loop on either side, one effect for a ranking."""
        return tuple(replace(self, side=side, of=of) for of, side in product(OF, SIDES))

    def suited(self, records: Sequence[Dataset]) -> PartialRange:
        """The place within the temperatures of the records, a tenth from their ends."""
        scale = Scale.of(records, "temperature")
        return replace(self, range_degc=(scale.centre - 0.8 * scale.half, scale.centre + 0.8 * scale.half))

    @property
    def amplitudes(self) -> tuple[tuple[str, str], ...]:
        """The amplitude a."""
        return (("a", "deg/h per degC/min" if self.of == "rate" else "deg/h"),)

    def columns(self, record: Dataset, theta: Theta) -> FloatArray:
        """Rate [degC/min] or loop [1] where it acts (n, 1)."""
        temperature = record.channel("temperature")
        if self.of == "rate":
            acting = 60.0 * slope(record.time, temperature, 60.0)
        else:
            acting = (temperature - play(temperature, _LOOP_DEGC)) / _LOOP_DEGC
        step = 0.5 * (1.0 + np.tanh((temperature - theta["at_degc"]) / _WIDTH_DEGC))
        return np.asarray(acting * (step if self.side == "above" else 1.0 - step))[:, None]
