"""Bias that follows the drive amplitude."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from drivers.sim.truth.base import Contribution, FloatArray, Mechanism, Scene


class DriveAmplitude(Mechanism):
    """Coupling of the drive into the sense axis: B = k 100 (A / A_0 - 1), with the wander of the amplitude control."""

    mechanism: Literal["drive_amplitude"] = "drive_amplitude"
    effect: ClassVar[str | None] = "drive_amplitude"
    k_dph_per_percent: float = Field(0.5, description="k [deg/h per % of amplitude]; 0.1-1")

    def start(self, node_s: float, rng: np.random.Generator) -> Contribution:
        """The bias of this mechanism."""

        def contribute(scene: Scene) -> FloatArray:
            return 100.0 * self.k_dph_per_percent * scene.drive_share

        return contribute
