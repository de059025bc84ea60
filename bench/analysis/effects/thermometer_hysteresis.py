"""Thermometer that reads differently on the way up and on the way down: the loop is in the temperature, not the bias.

Equation: T_g = T + h l, and every term of the model is a function of T_g; l is the loop of `hysteresis` with play
half-width w (`width_degc`, fitted if 0), +1 while heating. `reads: low` on heating (h counts up), `high` (h counts
down).
Units: T thermometer, T_g gyro, h half the opening of the loop and w [degC].
Source: IEC 60751 and ASTM E644 test platinum thermometers for it (0.01-0.5 degC, strain of the winding or film); glued
thermistors and thermometers in plastic housings 0.1-2 degC.
When left out: two branches over temperature, as far apart as the bias curve is steep, at any ramp rate; none where the
curve is flat.
Look-alikes: hysteresis (as wide where the curve is flat), thermometer_lag (grows with the ramp rate), thermal_lag.
Separated by: minor loops about a flat and a steep place of the curve; a second thermometer.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bench.analysis.effects.base import Effect, Parameter, Theta, check_choice, check_number
from bench.analysis.effects.operators import play
from bench.base import FloatArray
from bench.record import Dataset

READS = ("low", "high")
_WIDTHS_DEGC = (0.2, 2.0, 7.0)  # the first of a backlash, which closes at once after each turn


@dataclass(frozen=True)
class ThermometerHysteresis(Effect):
    """Moves the abscissa of all terms by a loop; `reads` low or high on heating, `width_degc` 0 to 40."""

    name = "thermometer_hysteresis"
    needs = ("temperature",)
    rarity = 1.0

    reads: str = "low"
    width_degc: float = 0.0

    def __post_init__(self) -> None:
        check_choice(self.name, "reads", self.reads, READS)
        check_number(self.name, "width_degc", self.width_degc, 0.0, 40.0)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Half opening of the loop, and half-width of the play."""
        opening = Parameter("opening_degc", "degC", 0.02, 10.0, 0.3, log=True, meaning="half the opening of the loop")
        width = Parameter("width_degc", "degC", 0.1, 40.0, 5.0, log=True, meaning="half-width of the play")
        return (opening,) if self.width_degc else (opening, width)

    def shapes(self) -> tuple[Effect, ...]:
        """Loops of three widths and either sign, one effect for a ranking."""
        return tuple(replace(self, reads=reads, width_degc=width) for width in _WIDTHS_DEGC for reads in READS)

    def abscissa(self, record: Dataset, theta: Theta) -> FloatArray:
        """Temperature of the gyro (n,) [degC]."""
        temperature, width = record.channel("temperature"), self.width_degc or theta["width_degc"]
        loop = (temperature - play(temperature, width)) / width
        sign = 1.0 if self.reads == "low" else -1.0
        return np.asarray(temperature + sign * theta["opening_degc"] * loop)
