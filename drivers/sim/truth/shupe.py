"""Fibre coil that is heated from outside."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from drivers.sim.truth.base import Contribution, FloatArray, Lag, Mechanism, Scene


class Shupe(Mechanism):
    """Layers of fibre, each heated through the one outside it: B = k sum_l (1 - 2 l / n) dT_l/dt over the layers.

    Light that passes a layer early and late sees two temperatures (D. M. Shupe, Appl. Opt. 19 (1980) 654).
    """

    mechanism: Literal["shupe"] = "shupe"
    effect: ClassVar[str | None] = "shupe"
    k_dph_per_degc_per_min: float = Field(0.5, description="k [deg/h per degC/min]; 0.01-1 wound as a quadrupole")
    tau_s: float = Field(240.0, gt=0.0, description="whole coil [s]; 120-1200")
    layers: int = Field(6, ge=2, le=40, description="layers of fibre")

    def start(self, node_s: float, rng: np.random.Generator) -> Contribution:
        """The bias of this mechanism from the unit's first moment."""
        walls = [Lag(self.tau_s / self.layers) for _ in range(self.layers)]
        passes = 1.0 - 2.0 * (np.arange(self.layers) + 0.5) / self.layers
        gain = self.k_dph_per_degc_per_min * 60.0 / (self.tau_s / self.layers)

        def contribute(scene: Scene) -> FloatArray:
            outside, total = scene.case, np.zeros_like(scene.case)
            for wall, share in zip(walls, passes.tolist(), strict=True):
                inside = wall(scene.node_s, outside)
                total += share * (outside - inside)
                outside = inside
            return gain * total

        return contribute
