"""Vibration of the compressor, rectified."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from drivers.sim.truth.base import Contribution, FloatArray, Lag, Mechanism, Scene


class Compressor(Mechanism):
    """Vibration rectification: B = k g^2 with the level g that follows the compressor's run-up."""

    mechanism: Literal["compressor"] = "compressor"
    effect: ClassVar[str | None] = "compressor"
    k_dph_per_g2: float = Field(2.0, description="k [deg/h per g^2]; k g^2 0.05-1 deg/h")
    level_g: float = Field(0.3, ge=0.0, description="vibration at full speed, RMS [g]")
    run_up_s: float = Field(4.0, gt=0.0, description="time constant of run-up and run-down [s]")

    def start(self, node_s: float, rng: np.random.Generator) -> Contribution:
        """The bias of this mechanism."""
        speed = Lag(self.run_up_s)

        def contribute(scene: Scene) -> FloatArray:
            level = self.level_g * speed(scene.node_s, np.full(len(scene.time), scene.compressor))
            return self.k_dph_per_g2 * level * level

        return contribute
