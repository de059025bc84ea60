"""A local bump of the bias over temperature."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from drivers.sim.truth.base import FloatArray, Mechanism


class Knee(Mechanism):
    """Glass transition of a glue joint: B = h / cosh^2((T - T_b) / w), the same in both directions."""

    mechanism: Literal["knee"] = "knee"
    kind: ClassVar[Literal["thermal", "static", "bias"]] = "static"
    effect: ClassVar[str | None] = "spline"
    height_dph: float = Field(1.0, description="h [deg/h]; 0.2-2 for a vibratory gyro of the 1 deg/h class")
    at_degc: float = Field(55.0, description="T_b [degC]")
    width_degc: float = Field(6.0, gt=0.0, description="w [degC], 3-15")

    def bias(self, temperature: FloatArray) -> FloatArray:
        """Bias [deg/h] at resonator temperatures [degC], same shape."""
        bump: FloatArray = self.height_dph / np.cosh((temperature - self.at_degc) / self.width_degc) ** 2
        return bump
