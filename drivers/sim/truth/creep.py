"""Viscoelastic relaxation with a spectrum of time constants."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from drivers.sim.truth.base import Contribution, FloatArray, Mechanism, Scene


class Creep(Mechanism):
    """Glue that relaxes for hours: tau_j x_j' = T - x_j for tau_j spread evenly in log, B = k mean(x_j - T_start)."""

    mechanism: Literal["creep"] = "creep"
    effect: ClassVar[str | None] = "creep"
    k_dph_per_degc: float = Field(0.01, description="k [deg/h per degC]")
    shortest_h: float = Field(0.5, gt=0.0, description="shortest time constant [h]")
    longest_h: float = Field(8.0, gt=0.0, description="longest time constant [h]")
    elements: int = Field(6, ge=1, le=50, description="number of time constants")

    def start(self, node_s: float, rng: np.random.Generator) -> Contribution:
        """The bias of this mechanism from the unit's first moment, relaxed at its temperature then."""
        tau_s = 3600.0 * np.geomspace(self.shortest_h, self.longest_h, self.elements)
        x: FloatArray | None = None
        origin = 0.0

        def contribute(scene: Scene) -> FloatArray:
            nonlocal x, origin
            t0, t1 = float(scene.sensor[0]), float(scene.sensor[-1])
            if x is None:
                x, origin = np.full(self.elements, t0), t0
            duration_s = scene.node_s * (len(scene.sensor) - 1)
            lead = (t1 - t0) / duration_s * tau_s
            before = float(x.mean())
            x = t1 - lead + (x - t0 + lead) * np.exp(-duration_s / tau_s)
            return self.k_dph_per_degc * (np.linspace(before, float(x.mean()), len(scene.sensor)) - origin)

        return contribute
