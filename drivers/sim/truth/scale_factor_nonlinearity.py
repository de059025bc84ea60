"""Scale factor that depends on the rate."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from drivers.sim.truth.base import Contribution, FloatArray, Mechanism, Scene


class ScaleFactorNonlinearity(Mechanism):
    """Nonlinearity: adds Omega (c_2 |Omega| / 100 + c_3 (Omega / 100)^2), Omega in deg/s; odd in the rate."""

    mechanism: Literal["scale_factor_nonlinearity"] = "scale_factor_nonlinearity"
    effect: ClassVar[str | None] = "scale_factor_nonlinearity"
    linear_ppm: float = Field(0.0, description="c_2 [ppm at 100 deg/s]")
    square_ppm: float = Field(100.0, description="c_3 [ppm at 100 deg/s]")

    def start(self, node_s: float, rng: np.random.Generator) -> Contribution:
        """The error of this mechanism."""

        def contribute(scene: Scene) -> FloatArray:
            x = np.abs(scene.applied_rate) / 100.0
            return 3600e-6 * scene.applied_rate * (self.linear_ppm + self.square_ppm * x) * x

        return contribute
