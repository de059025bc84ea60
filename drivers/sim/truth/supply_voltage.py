"""Bias that follows the supply."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from drivers.sim.truth.base import Contribution, FloatArray, Mechanism, Scene


class SupplyVoltage(Mechanism):
    """References that leak the supply: B = k (V - V_0); V wanders and sags while the compressor runs."""

    mechanism: Literal["supply_voltage"] = "supply_voltage"
    effect: ClassVar[str | None] = "supply_voltage"
    k_dph_per_v: float = Field(2.0, description="k [deg/h per V]; 0.5-5")
    reference_v: float = Field(5.0, description="V_0 [V]")

    def start(self, node_s: float, rng: np.random.Generator) -> Contribution:
        """The bias of this mechanism."""

        def contribute(scene: Scene) -> FloatArray:
            return self.k_dph_per_v * (scene.supply - self.reference_v)

        return contribute
