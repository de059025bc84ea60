"""Clocks of temperature and rate that disagree: one of the two channels is late, the other is not.

Equation: every term sees T(t - d): `late: rate`, the rate belongs to the temperature d before; T(t + d): `late:
temperature`, the temperature was read, or stamped, d too late. d > 0.
Units: T [degC], t and d [s].
Source: two clocks, polling of a bus, buffers, filters of constant delay; 0.1-5 s is usual between a polled chamber and
a bus, minutes where two loggers were merged by hand.
When left out: loops over temperature as wide as the bias curve is steep, proportional to the ramp rate.
Look-alikes: thermal_lag (rate late; the same to first order), thermometer_lag (temperature late), temperature_rate.
Separated by: steps, and many fast reversals (a delay shifts a corner and keeps it sharp); time marks in both logs.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from bench.analysis.effects.base import Effect, Parameter, Theta, check_choice
from bench.analysis.effects.operators import shifted
from bench.base import FloatArray
from bench.record import Dataset

LATE = ("rate", "temperature")


@dataclass(frozen=True)
class ClockDelay(Effect):
    """Moves the abscissa of all terms in time; `late` rate or temperature."""

    name = "clock_delay"
    needs = ("temperature",)
    rarity = 1.0
    parameters = (Parameter("delay_s", "s", 3.0, 1200.0, 30.0, log=True, meaning="how late the channel is"),)

    late: str = "rate"

    def __post_init__(self) -> None:
        check_choice(self.name, "late", self.late, LATE)

    def shapes(self) -> tuple[Effect, ...]:
        """Either channel late, one effect for a ranking."""
        return tuple(replace(self, late=late) for late in LATE)

    def abscissa(self, record: Dataset, theta: Theta) -> FloatArray:
        """Temperature that belongs to the rate (n,) [degC]."""
        delay_s = theta["delay_s"] if self.late == "rate" else -theta["delay_s"]
        return shifted(record.time, record.channel("temperature"), delay_s)
