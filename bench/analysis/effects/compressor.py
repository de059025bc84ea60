"""Vibration of the chamber's compressor, rectified by the resonator.

Equation: B = a s, s = 1 while the compressor runs; with `lag_s` s follows through a first-order lag (run-up).
Units: B and a [deg/h], s [1], lag_s [s].
Source: vibration rectification, B = k g^2 (IEEE 1431, IEEE 952 sect. on vibration sensitivity); 0.05-1 deg/h usual.
When left out: the residual is a square wave of the compressor's 3-15 min cycle, most in cold soaks.
Look-alikes: supply_voltage (sags with the compressor), bias_jump where it switches once.
Separated by: switching the blower or the compressor off for some minutes at one temperature.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from bench.analysis.effects.base import Effect, Scale, Theta, check_number
from bench.analysis.effects.operators import ramp_invariant_lag
from bench.base import FloatArray
from bench.record import Dataset


@dataclass(frozen=True)
class Compressor(Effect):
    """One term in the compressor's state; `lag_s` 0 to 3600."""

    name = "compressor"
    needs = ("compressor",)
    amplitudes = (("a", "deg/h"),)

    lag_s: float = 0.0

    def __post_init__(self) -> None:
        check_number(self.name, "lag_s", self.lag_s, 0.0, 3600.0)

    def prepare(self, records: Sequence[Dataset]) -> Compressor:
        """Checks that the compressor switched."""
        Scale.of(records, "compressor")
        return self

    def columns(self, record: Dataset, theta: Theta) -> FloatArray:
        """Share of the time that it ran, lagged (n, 1)."""
        return ramp_invariant_lag(record.time, record.channel("compressor"), self.lag_s)[:, None]
