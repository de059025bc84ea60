"""A change of the slope of the bias at one temperature."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from drivers.sim.truth.base import FloatArray, Mechanism


class BiasKink(Mechanism):
    """A mount that loosens above T_k: slope changes by k over a rounding w, B = k w ln(1 + exp((T - T_k) / w))."""

    mechanism: Literal["bias_kink"] = "bias_kink"
    kind: ClassVar[Literal["thermal", "static", "bias"]] = "static"
    effect: ClassVar[str | None] = "bias_kink"
    slope_dph_per_degc: float = Field(0.02, description="k [deg/h per degC]")
    at_degc: float = Field(40.0, description="T_k [degC]")
    rounding_degc: float = Field(0.5, gt=0.0, description="w [degC]")

    def bias(self, temperature: FloatArray) -> FloatArray:
        """Bias [deg/h] at resonator temperatures [degC], same shape."""
        w = self.rounding_degc
        return self.slope_dph_per_degc * w * np.logaddexp(0.0, (temperature - self.at_degc) / w)
