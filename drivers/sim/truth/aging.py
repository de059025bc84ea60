"""Drift with powered time."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from drivers.sim.truth.base import Contribution, FloatArray, Mechanism, Scene, straight


class Aging(Mechanism):
    """Charging and outgassing: B' = k_a + k_l / (t_0 + t) while powered, a line and a logarithm."""

    mechanism: Literal["aging"] = "aging"
    effect: ClassVar[str | None] = "aging"
    linear_dph_per_h: float = Field(0.004, description="k_a [deg/h per h]; 0.01-0.1 deg/h a day")
    logarithmic_dph: float = Field(0.0, description="k_l [deg/h]")
    settled_h: float = Field(1.0, gt=0.0, description="t_0 [h], how long it has aged already")

    def start(self, node_s: float, rng: np.random.Generator) -> Contribution:
        """The bias of this mechanism, zero at the first moment."""
        bias = age_h = 0.0

        def contribute(scene: Scene) -> FloatArray:
            nonlocal bias, age_h
            passed_h = scene.node_s * (len(scene.time) - 1) / 3600.0 if scene.powered else 0.0
            before = bias
            growth = np.log1p(passed_h / (self.settled_h + age_h))
            bias += self.linear_dph_per_h * passed_h + self.logarithmic_dph * float(growth)
            age_h += passed_h
            return straight(before, bias, len(scene.time))

        return contribute
