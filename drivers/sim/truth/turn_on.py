"""A new random bias at each power-on."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from drivers.sim.truth.base import Contribution, FloatArray, Mechanism, Scene


class TurnOn(Mechanism):
    """Turn-on repeatability: B drawn from N(0, sigma) at each power-on, constant until the next.

    Power-on number n has the n-th draw of the unit's stream, however it came about.
    """

    mechanism: Literal["turn_on"] = "turn_on"
    effect: ClassVar[str | None] = "bias_jump"
    lifelong: ClassVar[bool] = True
    sigma_dph: float = Field(0.1, ge=0.0, description="sigma [deg/h]; 0.1-1")

    def start(self, node_s: float, rng: np.random.Generator) -> Contribution:
        """The bias of this mechanism."""
        bias, drawn = 0.0, 0

        def contribute(scene: Scene) -> FloatArray:
            nonlocal bias, drawn
            while scene.powered and drawn < scene.power_on:
                bias, drawn = self.sigma_dph * float(rng.standard_normal()), drawn + 1
            return np.full(len(scene.time), bias)

        return contribute
