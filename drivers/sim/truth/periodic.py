"""A periodic disturbance from outside."""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import Field

from drivers.sim.truth.base import Contribution, FloatArray, Mechanism, Scene


class Periodic(Mechanism):
    """Air conditioning or a neighbour's duty cycle: B = a sin(2 pi t / P + phase). Deliberately outside the library."""

    mechanism: Literal["periodic"] = "periodic"
    amplitude_dph: float = Field(0.2, description="a [deg/h]")
    period_s: float = Field(1500.0, gt=0.0, description="P [s], 900-2400")
    phase_rad: float = Field(0.0, description="phase [rad]")

    def start(self, node_s: float, rng: np.random.Generator) -> Contribution:
        """The bias of this mechanism."""

        def contribute(scene: Scene) -> FloatArray:
            bias: FloatArray = self.amplitude_dph * np.sin(2.0 * np.pi * scene.time / self.period_s + self.phase_rad)
            return bias

        return contribute
