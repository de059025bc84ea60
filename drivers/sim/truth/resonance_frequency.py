"""Bias that follows the resonance frequency."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from drivers.sim.truth.base import Contribution, FloatArray, Mechanism, Scene


class ResonanceFrequency(Mechanism):
    """Mode split that pulls the bias: B = k (f - f_0), with the wander of the frequency that no thermometer sees."""

    mechanism: Literal["resonance_frequency"] = "resonance_frequency"
    effect: ClassVar[str | None] = "resonance_frequency"
    k_dph_per_hz: float = Field(0.1, description="k [deg/h per Hz]")
    reference_hz: float = Field(14000.0, gt=0.0, description="f_0 [Hz]")

    def start(self, node_s: float, rng: np.random.Generator) -> Contribution:
        """The bias of this mechanism."""

        def contribute(scene: Scene) -> FloatArray:
            return self.k_dph_per_hz * (scene.frequency - self.reference_hz)

        return contribute
