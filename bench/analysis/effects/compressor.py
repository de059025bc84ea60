"""Vibration of the chamber's compressor, rectified by the resonator.

Equation: B = a s, s = 1 while the compressor runs; with `lag_s` s follows through a first-order lag (run-up), with
`through: mass` through one that is fitted: what the vibration or the cold air heats and cools.
Units: B and a [deg/h], s [1], lag_s [s].
Source: vibration rectification, B = k g^2 (IEEE 1431, IEEE 952 sect. on vibration sensitivity); 0.05-1 deg/h usual.
When left out: the residual is a square wave of the compressor's 3-15 min cycle, most in cold soaks.
Look-alikes: supply_voltage (sags with the compressor), bias_jump where it switches once.
Separated by: switching the blower or the compressor off for some minutes at one temperature.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from bench.analysis.effects.base import Effect, Parameter, Scale, Theta, check_choice, check_number
from bench.analysis.effects.operators import ramp_invariant_lag
from bench.base import FloatArray
from bench.record import Dataset


@dataclass(frozen=True)
class Compressor(Effect):
    """One term in the compressor's state; `lag_s` 0 to 3600, `through` air or mass."""

    name = "compressor"
    needs = ("compressor",)
    amplitudes = (("a", "deg/h"),)

    lag_s: float = 0.0
    through: str = "air"

    def __post_init__(self) -> None:
        check_number(self.name, "lag_s", self.lag_s, 0.0, 3600.0)
        check_choice(self.name, "through", self.through, ("air", "mass"))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Time constant of the mass."""
        if self.through == "air":
            return ()
        return (Parameter("tau_s", "s", 60.0, 3600.0, 400.0, log=True, meaning="time constant of the mass"),)

    @property
    def rarity(self) -> float:
        """A mass is to show before it is counted."""
        return 0.0 if self.through == "air" else 0.5

    def shapes(self) -> tuple[Effect, ...]:
        """At once, or through a mass: one effect for a ranking."""
        return (self, replace(self, through="mass")) if self.through == "air" and not self.lag_s else (self,)

    def prepare(self, records: Sequence[Dataset]) -> Compressor:
        """Checks that the compressor switched."""
        Scale.of(records, "compressor")
        return self

    def columns(self, record: Dataset, theta: Theta) -> FloatArray:
        """Share of the time that it ran, lagged (n, 1)."""
        lag_s = self.lag_s if self.through == "air" else theta["tau_s"]
        return ramp_invariant_lag(record.time, record.channel("compressor"), lag_s)[:, None]
