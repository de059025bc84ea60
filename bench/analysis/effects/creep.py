"""Glue, solder and stress that follow the temperature for hours.

Equation: B = k (x - T), tau dx/dt = T - x: what is still missing from equilibrium; the settled part is the static
curve's. At the start of the record x = T (`initial: settled`), or anything (`initial: free`, + c exp(-t / tau)).
Units: B and c [deg/h], T and x [degC], k [deg/h/degC], tau [h], t time since the start of the record [h].
Source: standard linear solid (Zener model) of viscoelasticity; recoveries of soldered units within 24 h are usual.
When left out: slow relaxation in soaks after each change of temperature; loops whose width depends on the ramp rate.
Look-alikes: hysteresis (no relaxation in a soak), aging and warm_up (do not follow the temperature), thermal_lag with a
long time constant (acts through the bias curve, not beside it).
Separated by: soaks of hours after a step, and coming back a day later.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.analysis.effects.base import Effect, Parameter, Theta, check_choice
from bench.analysis.effects.operators import ramp_invariant_lag
from bench.base import FloatArray
from bench.record import Dataset


@dataclass(frozen=True)
class Creep(Effect):
    """One relaxing term; `initial` settled or free."""

    name = "creep"
    needs = ("temperature",)
    parameters = (Parameter("tau_h", "h", 0.5, 24.0, 2.0, log=True, meaning="time constant of the relaxation"),)

    initial: str = "settled"

    def __post_init__(self) -> None:
        check_choice(self.name, "initial", self.initial, ("settled", "free"))

    def columns(self, record: Dataset, theta: Theta) -> FloatArray:
        """What is missing, x - T [degC] (n, 1), and the decay of a free initial state (n, 2)."""
        temperature, tau_s = record.channel("temperature"), 3600.0 * theta["tau_h"]
        missing = ramp_invariant_lag(record.time, temperature, tau_s) - temperature
        if self.initial == "settled":
            return missing[:, None]
        return np.column_stack([missing, np.exp(-record.time / tau_s)])

    def shapes(self) -> tuple[Effect, ...]:
        """Settled when the record begins, and not."""
        return (Creep("settled"), Creep("free"))

    @property
    def amplitudes(self) -> tuple[tuple[str, str], ...]:
        """k, and c of a free initial state."""
        return (("k", "deg/h/degC"), ("c", "deg/h"))[: 1 if self.initial == "settled" else 2]

    @property
    def of_each_run(self) -> tuple[int, ...]:
        """The decay of a free initial state."""
        return () if self.initial == "settled" else (1,)
