"""A ripple of the bias over temperature."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from drivers.sim.truth.base import FloatArray, Mechanism


class Etalon(Mechanism):
    """Interference in the read-out path: B = a sin(2 pi T / P + phase). Deliberately outside the library."""

    mechanism: Literal["etalon"] = "etalon"
    kind: ClassVar[Literal["thermal", "static", "bias"]] = "static"
    amplitude_dph: float = Field(0.2, description="a [deg/h]")
    period_degc: float = Field(9.0, gt=0.0, description="P [degC], 6-12")
    phase_rad: float = Field(0.0, description="phase [rad]")

    def bias(self, temperature: FloatArray) -> FloatArray:
        """Bias [deg/h] at resonator temperatures [degC], same shape."""
        ripple: FloatArray = self.amplitude_dph * np.sin(2.0 * np.pi * temperature / self.period_degc + self.phase_rad)
        return ripple
