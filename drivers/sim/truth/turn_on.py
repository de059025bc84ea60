"""A new random bias at each power-on."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from drivers.sim.truth.base import Contribution, FloatArray, Mechanism, Scene


class TurnOn(Mechanism):
    """Turn-on repeatability: B drawn from N(0, sigma) at each power-on, constant until the next."""

    mechanism: Literal["turn_on"] = "turn_on"
    effect: ClassVar[str | None] = "bias_jump"
    sigma_dph: float = Field(0.1, ge=0.0, description="sigma [deg/h]; 0.1-1")

    def start(self, node_s: float, rng: np.random.Generator) -> Contribution:
        """The bias of this mechanism."""
        bias = 0.0

        def contribute(scene: Scene) -> FloatArray:
            nonlocal bias
            if scene.powered and scene.on[0] == 0.0:
                bias = self.sigma_dph * float(rng.standard_normal())
            return np.full(len(scene.time), bias)

        return contribute
