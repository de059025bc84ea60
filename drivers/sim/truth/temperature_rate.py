"""A gradient across the unit while its temperature changes."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from drivers.sim.truth.base import Contribution, FloatArray, Lag, Mechanism, Scene


class TemperatureRate(Mechanism):
    """Gradient through a wall of time constant tau: B = k (T_s - T_wall) / tau, about k dT/dt on a ramp."""

    mechanism: Literal["temperature_rate"] = "temperature_rate"
    effect: ClassVar[str | None] = "temperature_rate"
    k_dph_per_degc_per_min: float = Field(0.3, description="k [deg/h per degC/min]; 0.2-2")
    tau_s: float = Field(20.0, gt=0.0, description="tau of the wall [s]")

    def start(self, node_s: float, rng: np.random.Generator) -> Contribution:
        """The bias of this mechanism from the unit's first moment."""
        wall = Lag(self.tau_s)
        gain = self.k_dph_per_degc_per_min * 60.0 / self.tau_s

        def contribute(scene: Scene) -> FloatArray:
            return gain * (scene.sensor - wall(scene.node_s, scene.sensor))

        return contribute
