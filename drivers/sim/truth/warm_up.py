"""Self-heating after power-on."""

from __future__ import annotations

import math
from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from drivers.sim.truth.base import Contribution, FloatArray, Lag, Mechanism, Scene


class WarmUp(Mechanism):
    """Electronics that heat up: a fast and a slow node, B = a (1 - heat), back to a after a long time without power."""

    mechanism: Literal["warm_up"] = "warm_up"
    effect: ClassVar[str | None] = "warm_up"
    amplitude_dph: float = Field(1.0, description="a [deg/h], bias at a cold power-on; 1-10")
    tau_s: float = Field(600.0, gt=0.0, description="time constant of the package [s], 180-1800")
    fast_share: float = Field(0.15, ge=0.0, le=1.0, description="share that a node six times faster takes")

    def start(self, node_s: float, rng: np.random.Generator) -> Contribution:
        """The bias of this mechanism, cold before its power came on."""
        slow, fast = Lag(self.tau_s), Lag(self.tau_s / 6.0)
        slow.value = fast.value = None

        def contribute(scene: Scene) -> FloatArray:
            for node in (slow, fast):
                if node.value is None:  # a unit that was powered before the record began
                    node.value = -math.expm1(-float(scene.on[0]) / node.tau_s)
            power = np.full(len(scene.time), float(scene.powered))
            heat = (1.0 - self.fast_share) * slow(scene.node_s, power) + self.fast_share * fast(scene.node_s, power)
            return self.amplitude_dph * (1.0 - heat)

        return contribute
