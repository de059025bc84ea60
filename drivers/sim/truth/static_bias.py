"""Bias that is a smooth function of the resonator's temperature."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from drivers.sim.truth.base import FloatArray, Mechanism


class StaticBias(Mechanism):
    """Smooth bias over temperature: elastic and damping anisotropy of the resonator.

    B = sum a_k ((T - T0) / 50 K)^k: a_k is what the order k contributes 50 K from T0, so every number is a bias.
    """

    mechanism: Literal["static_bias"] = "static_bias"
    kind: ClassVar[Literal["thermal", "static", "bias"]] = "static"
    effect: ClassVar[str | None] = "polynomial"
    coefficients_dph: tuple[float, ...] = Field((3.0,), description="a_0, a_1, ... [deg/h] at 50 K from T0")
    reference_degc: float = Field(25.0, description="T0 [degC]")

    def bias(self, temperature: FloatArray) -> FloatArray:
        """Bias [deg/h] at resonator temperatures [degC], same shape."""
        x = (temperature - self.reference_degc) / 50.0
        total = np.zeros_like(x)
        for a in reversed(self.coefficients_dph):
            total = total * x + a
        return total
