"""An error with the square of the temperature rate."""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import Field

from drivers.sim.truth.base import Contribution, FloatArray, Lag, Mechanism, Scene


class RateSquared(Mechanism):
    """Thermoelastic pull in both directions alike: B = k (dT/dt)^2. Deliberately outside the library."""

    mechanism: Literal["rate_squared"] = "rate_squared"
    k_dph_per_degc2_per_min2: float = Field(0.1, description="k [deg/h per (degC/min)^2]")
    tau_s: float = Field(20.0, gt=0.0, description="time constant of the gradient [s]")

    def start(self, node_s: float, rng: np.random.Generator) -> Contribution:
        """The bias of this mechanism from the unit's first moment."""
        wall = Lag(self.tau_s)

        def contribute(scene: Scene) -> FloatArray:
            gradient = (scene.sensor - wall(scene.node_s, scene.sensor)) * (60.0 / self.tau_s)
            return self.k_dph_per_degc2_per_min2 * gradient * gradient

        return contribute
