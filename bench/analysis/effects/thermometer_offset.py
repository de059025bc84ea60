"""Offset of the thermometer that changes during the run; a constant one nobody can see, the static curve takes it in.

Equation: T_g = T + s c t (`over: time`, a drift), T_g = T + s c sqrt(t t_1), t_1 = 1 h (`over: root`, a drift that
slows down) or T_g = T + s c (T_air - T) (`over: air`, a thermometer that feels the air or its leads), and every term of
the model is a function of T_g. s = 1 for `reads: low`, -1 for `reads: high`.
Units: T thermometer, T_g gyro, T_air chamber [degC], t time since the start of the record [h], c [degC/h] over time
(over its root in the first hour) and [1] over air.
Source: stem conduction and immersion error (ASTM E644, 0.1-10 % of the difference to the air); drift of thermistors;
voltage references drift with the root of time (their data sheets), as does heat that soaks in.
When left out: a drift that is largest where the bias curve is steep and changes its sign with the slope; or loops like
those of a lag that follow the air, not the unit. An offset that is constant, a wrong scale and a bent characteristic
of the only thermometer give another static curve and no misfit: no diagnosis finds them, and the calibration is right
as long as the same thermometer is used.
Look-alikes: aging and warm_up (do not follow the slope of the curve), thermal_lag and thermometer_lag (follow the unit,
not the air).
Separated by: coming back to a steep and a flat place of the curve; a second thermometer; a fan that changes the air.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bench.analysis.effects.base import Effect, Parameter, Theta, check_choice
from bench.base import FloatArray
from bench.record import Dataset

OVER = ("time", "root", "air")
READS = ("low", "high")


@dataclass(frozen=True)
class ThermometerOffset(Effect):
    """Moves the abscissa of all terms; `over` time, its root or air, `reads` low or high where that is positive."""

    name = "thermometer_offset"
    rarity = 1.0

    over: str = "time"
    reads: str = "low"

    def __post_init__(self) -> None:
        check_choice(self.name, "over", self.over, OVER)
        check_choice(self.name, "reads", self.reads, READS)

    @property
    def needs(self) -> tuple[str, ...]:
        """The air's temperature only where it is used."""
        return ("temperature", "chamber_temperature") if self.over == "air" else ("temperature",)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Size of the offset, in degC/h or as a share of the difference to the air."""
        if self.over == "air":
            return (Parameter("share", "1", 0.001, 0.5, 0.05, log=True, meaning="share of the air's temperature"),)
        meaning = "drift of the thermometer"
        return (Parameter("drift_degc_per_h", "degC/h", 0.003, 3.0, 0.1, log=True, meaning=meaning),)

    def shapes(self) -> tuple[Effect, ...]:
        """Either sign and law of a drift; the air only where it is asked for, nearly a lag that it is."""
        laws = (self.over,) if self.over == "air" else OVER[:2]
        return tuple(replace(self, over=over, reads=reads) for over in laws for reads in READS)

    def abscissa(self, record: Dataset, theta: Theta) -> FloatArray:
        """Temperature of the gyro (n,) [degC]."""
        temperature, sign = record.channel("temperature"), 1.0 if self.reads == "low" else -1.0
        if self.over == "air":
            behind = record.channel("chamber_temperature") - temperature
            return np.asarray(temperature + sign * theta["share"] * behind)
        hours = record.time / 3600.0
        drifted = hours if self.over == "time" else np.sqrt(np.maximum(hours, 0.0))
        return np.asarray(temperature + sign * theta["drift_degc_per_h"] * drifted)
