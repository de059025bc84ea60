"""Thermometer and resonator at different temperatures while heat flows: all terms see the temperature of the resonator.

Equation: tau dT_r/dt = T - T_r, and every term of the model is a function of T_r; the error of leaving it out is about
-B'(T) tau dT/dt. Exact for ramps at any sampling; settled at the start of the record.
With `second` T_r passes a second such lag, of that share of tau: a module on a board. With `uneven` tau is that of a
sensor warmer than the resonator, and times `cooling` where it is colder: a fan or a valve that works one way only.
Units: T sensor, T_r resonator [degC], tau [s], second, cooling [1].
Source: heat balance of one node behind one resistance; tau of a bonded die 5-60 s, of a module 60-600 s, of a
hemispherical resonator in vacuum 1e3-1e4 s.
When left out: loops over temperature that are as wide as the bias curve is steep, grow with the ramp rate and die in a
soak; none where the curve is flat.
Look-alikes: temperature_rate (present where the curve is flat, too), hysteresis (as wide at any rate), creep (hours),
resonance_frequency (frequency follows the resonator).
Separated by: ramps at two rates with soaks between; standing still and reversing.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from bench.analysis.effects.base import Effect, Parameter, Theta, check_choice, check_number
from bench.analysis.effects.operators import ramp_invariant_lag, uneven_lag
from bench.base import FloatArray
from bench.record import Dataset

_SECOND = 0.35
_TAU = Parameter("tau_s", "s", 3.0, 1e4, 60.0, log=True, meaning="time constant between sensor and resonator")
_COOLING = Parameter("cooling", "", 0.1, 10.0, 1.0, log=True, meaning="time constant of cooling over that of heating")


@dataclass(frozen=True)
class ThermalLag(Effect):
    """Moves the abscissa of all terms; `second` 0 to 1, time constant of a second pole as a share of the first; with
    `uneven` heating and cooling have time constants of their own.
    """

    name = "thermal_lag"
    family = "lag"
    needs = ("temperature",)

    second: float = 0.0
    uneven: bool = False

    def __post_init__(self) -> None:
        check_number(self.name, "second", self.second, 0.0, 1.0)
        check_choice(self.name, "uneven", self.uneven, (True, False))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The time constant, and how much longer it is while cooling."""
        return (_TAU, _COOLING) if self.uneven else (_TAU,)

    @property
    def rarity(self) -> float:
        """A second pole is to show before it is counted."""
        return 1.0 if self.second else 0.0

    def shapes(self) -> tuple[Effect, ...]:
        """One pole, or two, the second faster, or one that differs between heating and cooling: one effect for a
        ranking.
        """
        chosen = self.second or self.uneven
        return (self,) if chosen else (self, replace(self, second=_SECOND), replace(self, uneven=True))

    def abscissa(self, record: Dataset, theta: Theta) -> FloatArray:
        """Temperature of the resonator (n,) [degC]."""
        if self.uneven:
            cooling_s = theta["tau_s"] * theta["cooling"]
            return uneven_lag(record.time, record.channel("temperature"), theta["tau_s"], cooling_s)
        first = ramp_invariant_lag(record.time, record.channel("temperature"), theta["tau_s"])
        return ramp_invariant_lag(record.time, first, self.second * theta["tau_s"]) if self.second else first
