"""Self-heating after power-on that the unit's own thermometer does not show.

Equation: B = a exp(-(t - t_on) / tau) from t_on, 0 before; `power_on_s` is t_on, the start of the record unless given.
Units: B and a [deg/h], t and t_on time of the run [s], tau [s].
Source: heat balance of one node with constant power; 3-30 min are usual (IEEE 952, warm-up time).
When left out: the first half hour of the residual decays to a constant whatever the temperature does.
Look-alikes: aging (does not end), creep (follows the temperature), bias_jump (at once), slow noise.
Separated by: switching the power off and on at constant temperature, cold and hot.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.analysis.effects.base import Effect, Parameter, Theta, check_number
from bench.base import FloatArray
from bench.record import Dataset


@dataclass(frozen=True)
class WarmUp(Effect):
    """One decaying term; `power_on_s` is the time of power-on in the run [s], negative if before it."""

    name = "warm_up"
    parameters = (Parameter("tau_s", "s", 60.0, 7200.0, 600.0, log=True, meaning="time constant of the warm-up"),)
    amplitudes = (("a", "deg/h"),)

    power_on_s: float = 0.0

    def __post_init__(self) -> None:
        check_number(self.name, "power_on_s", self.power_on_s, -1e6, 1e6)

    def columns(self, record: Dataset, theta: Theta) -> FloatArray:
        """The decay (n, 1)."""
        on_s = record.time - self.power_on_s
        return np.where(on_s >= 0.0, np.exp(-np.maximum(on_s, 0.0) / theta["tau_s"]), 0.0)[:, None]
