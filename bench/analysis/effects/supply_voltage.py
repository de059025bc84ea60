"""Bias that follows the supply voltage.

Equation: B = k (V - V_0), V_0 the middle of the fitted range.
Units: B [deg/h], V and V_0 [V], k [deg/h/V].
Source: IEEE 1431 (sensitivity of bias to supply voltage); 0.5-5 deg/h/V for a 1 deg/h class.
When left out: the residual follows the supply, also at constant temperature.
Look-alikes: compressor (its load sags the supply when it starts), drive_amplitude (its reference is fed by the supply).
Separated by: stepping the supply at constant temperature with the compressor in one state.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from bench.analysis.effects.base import Effect, Scale, Theta, prepared
from bench.base import FloatArray
from bench.record import Dataset


@dataclass(frozen=True)
class SupplyVoltage(Effect):
    """One term in the supply voltage."""

    name = "supply_voltage"
    family = "supply"
    needs = ("supply",)
    amplitudes = (("k", "deg/h/V"),)

    scale: Scale | None = field(default=None, repr=False, metadata={"fitted": True})

    def prepare(self, records: Sequence[Dataset]) -> SupplyVoltage:
        """Fix V_0; InputError where the supply does not move."""
        return replace(self, scale=Scale.of(records, "supply"))

    def columns(self, record: Dataset, theta: Theta) -> FloatArray:
        """V - V_0 [V] (n, 1)."""
        return (record.channel("supply") - prepared(self.scale).centre)[:, None]

    def state(self) -> dict[str, Any]:
        """V_0 [V]."""
        return {"nominal_v": prepared(self.scale).centre}
