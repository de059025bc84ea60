"""Scale factor that differs between the two directions of rotation."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from drivers.sim.truth.base import Contribution, FloatArray, Mechanism, Scene


class ScaleFactorEven(Mechanism):
    """Even-order error: adds |Omega| (a_1 + a_2 |Omega| / 100), Omega in deg/s; even in the rate, 0 at rest.

    a_1 is the asymmetry of IEEE Std 528: half the difference of the scale factors of both directions.
    """

    mechanism: Literal["scale_factor_even"] = "scale_factor_even"
    effect: ClassVar[str | None] = "surface"
    asymmetry_ppm: float = Field(0.0, description="a_1 [ppm]; 1-100")
    square_ppm: float = Field(10.0, description="a_2 [ppm at 100 deg/s]")

    def start(self, node_s: float, rng: np.random.Generator) -> Contribution:
        """The error of this mechanism."""

        def contribute(scene: Scene) -> FloatArray:
            size = np.abs(scene.applied_rate)
            return 3600e-6 * size * (self.asymmetry_ppm + self.square_ppm * size / 100.0)

        return contribute
