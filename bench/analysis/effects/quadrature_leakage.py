"""Quadrature that the demodulator lets through, because its phase is a little wrong and drifts with temperature.

Equation: B = q (a + b (T - 25 degC)).
Units: B [deg/h], q quadrature amplitude [V], T [degC], a [deg/h/V], b [deg/h/V/degC]. With q as a rate, 1 deg/s of
quadrature and 1 mrad of phase make 3.6 deg/h.
Source: IEEE 1431 (quadrature); Saukoski, Aaltonen, Halonen, IEEE Sensors J. 7 (2007) 1639, on demodulation phase.
When left out: the residual follows the quadrature, most where parasitic modes cross and quadrature is large.
Look-alikes: drive_amplitude, resonance_frequency, supply_voltage where they move together with the quadrature; a static
curve takes what is a function of temperature alone.
Separated by: moving the quadrature set point or the demodulation phase at constant temperature.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.analysis.effects.base import REFERENCE_DEGC, Effect, Scale, Theta, check_choice
from bench.base import FloatArray
from bench.record import Dataset


@dataclass(frozen=True)
class QuadratureLeakage(Effect):
    """One or two terms in the quadrature; `phase_drift` false leaves b out."""

    name = "quadrature_leakage"
    family = "quadrature"
    needs = ("quadrature", "temperature")

    phase_drift: bool = True

    def __post_init__(self) -> None:
        check_choice(self.name, "phase_drift", self.phase_drift, (True, False))

    def prepare(self, records: Sequence[Dataset]) -> QuadratureLeakage:
        """Checks that the quadrature moves."""
        Scale.of(records, "quadrature")
        return self

    def columns(self, record: Dataset, theta: Theta) -> FloatArray:
        """Quadrature q [V] and q (T - 25 degC) [V degC], (n, 1 or 2)."""
        quadrature = record.channel("quadrature")
        drift = quadrature * (record.channel("temperature") - REFERENCE_DEGC)
        return np.column_stack([quadrature, drift][: 1 + self.phase_drift])

    @property
    def amplitudes(self) -> tuple[tuple[str, str], ...]:
        """Leakage a and its drift b."""
        return (("a", "deg/h/V"), ("b", "deg/h/V/degC"))[: 1 + self.phase_drift]

    def state(self) -> dict[str, Any]:
        """Reference temperature [degC]."""
        return {"reference_degc": REFERENCE_DEGC}
