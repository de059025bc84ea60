"""Resonator in whole-angle mode, damped unequally in two directions."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from drivers.sim.truth.base import Contribution, FloatArray, Mechanism, Scene


class PatternAngle(Mechanism):
    """The wave lags rotation by the gain g and drifts with its angle a: a' = -g (W + b).

    The output is -a'/g, so that b = b_2 sin 2(a - p) + b_4 sin 4a is the bias; the angle is integrated with its own
    drift (D. D. Lynch, Symposium Gyro Technology, Stuttgart 1995).
    """

    mechanism: Literal["pattern_angle"] = "pattern_angle"
    effect: ClassVar[str | None] = "pattern_angle"
    second_dph: float = Field(2.0, description="bias by unequal damping [deg/h]; 0.01-10")
    fourth_dph: float = Field(0.3, description="fourth harmonic [deg/h]")
    axis_deg: float = Field(20.0, description="p, axis of the strongest damping [deg]")
    gain: float = Field(0.277, gt=0.0, le=1.0, description="angular gain; 0.277 of a hemisphere")

    def start(self, node_s: float, rng: np.random.Generator) -> Contribution:
        """The bias of this mechanism; the wave starts at angle 0."""
        angle = 0.0

        def contribute(scene: Scene) -> FloatArray:
            nonlocal angle
            out = np.empty_like(scene.applied_rate)
            last = len(out) - 1
            for i, rate in enumerate(scene.applied_rate.tolist()):
                second = np.sin(2.0 * np.radians(angle - self.axis_deg))
                out[i] = self.second_dph * second + self.fourth_dph * np.sin(4.0 * np.radians(angle))
                if i < last:  # the last node is the first of the next step
                    angle -= self.gain * (rate + out[i] / 3600.0) * scene.node_s
            return out

        return contribute
