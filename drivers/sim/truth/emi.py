"""Interference from the heater."""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import Field

from drivers.sim.truth.base import Contribution, FloatArray, Mechanism, Scene


class Emi(Mechanism):
    """Heater switching aliased into the band: B = u (a sin(2 pi f t) + d), u the share. Outside the library."""

    mechanism: Literal["emi"] = "emi"
    amplitude_dph: float = Field(0.3, description="a [deg/h] at full heater; 0.05-1")
    alias_hz: float = Field(0.013, gt=0.0, le=5.0, description="f [Hz], where the aliased line falls")
    offset_dph: float = Field(0.1, description="d [deg/h] at full heater")

    def start(self, node_s: float, rng: np.random.Generator) -> Contribution:
        """The bias of this mechanism."""

        def contribute(scene: Scene) -> FloatArray:
            line = self.amplitude_dph * np.sin(2.0 * np.pi * self.alias_hz * scene.time)
            return scene.heater * (line + self.offset_dph)

        return contribute
