"""A disturbance that drifts and is not logged."""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import Field

from drivers.sim.truth.base import Contribution, FloatArray, Mechanism, OrnsteinUhlenbeck, Scene


class UnloggedDrift(Mechanism):
    """Ornstein-Uhlenbeck process, such as a magnetic field or a tilt of the floor. Deliberately outside the library."""

    mechanism: Literal["unlogged_drift"] = "unlogged_drift"
    sigma_dph: float = Field(0.2, ge=0.0, description="standard deviation [deg/h]")
    tau_s: float = Field(1800.0, gt=0.0, description="correlation time [s]")

    def start(self, node_s: float, rng: np.random.Generator) -> Contribution:
        """The bias of this mechanism."""
        cause = OrnsteinUhlenbeck(np.array([self.tau_s]), np.array([self.sigma_dph]), node_s, rng)

        def contribute(scene: Scene) -> FloatArray:
            return cause(len(scene.time))

        return contribute
