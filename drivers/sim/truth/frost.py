"""Frost that melts on the way up."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from drivers.sim.truth.base import Contribution, FloatArray, Mechanism, Scene


class Frost(Mechanism):
    """Moisture freezes below T_f, melts and dries over w while heating: a bump above T_f on the warming branch only.

    ice' = (1 - ice) / tau below T_f; above it each degree of warming melts and dries a share 1 / w of what is left.
    """

    mechanism: Literal["frost"] = "frost"
    effect: ClassVar[str | None] = "frost"
    amplitude_dph: float = Field(0.3, description="largest bias at 40 % relative humidity [deg/h]; 0-0.3 sealed")
    freezing_degc: float = Field(0.0, description="T_f [degC]")
    width_degc: float = Field(3.0, gt=0.0, description="w [degC], 2-6")
    freezing_s: float = Field(900.0, gt=0.0, description="tau [s], time to gather the ice")
    drying_s: float = Field(3600.0, gt=0.0, description="time to dry without warming [s]")

    def start(self, node_s: float, rng: np.random.Generator) -> Contribution:
        """The bias of this mechanism, dry at the first moment."""
        ice = water = 0.0

        def contribute(scene: Scene) -> FloatArray:
            nonlocal ice, water
            t0, t1 = float(scene.sensor[0]), float(scene.sensor[-1])
            duration_s = scene.node_s * (len(scene.time) - 1)
            before = water
            if t1 < self.freezing_degc:
                share = -np.expm1(-duration_s / self.freezing_s)
                ice, water = ice + share * (1.0 - ice), water * (1.0 - share)
            else:
                share = float(-np.expm1(-max(0.0, t1 - max(t0, self.freezing_degc)) / self.width_degc))
                melted = share * ice
                water = (water * (1.0 - share) + melted) * float(np.exp(-duration_s / self.drying_s))
                ice -= melted
            # Equal melting and drying peak at 1/e of the ice; the amplitude is defined at the peak.
            full = self.amplitude_dph * np.e * scene.humidity / 0.4
            return full * np.linspace(before, water, len(scene.time))

        return contribute
