"""Scale factor that changes with temperature."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from drivers.sim.truth.base import Contribution, FloatArray, Mechanism, Scene


class ScaleFactorTemperature(Mechanism):
    """Scale factor over temperature: adds Omega (s_1 (T - T_0) + s_2 (T - T_0)^2); 0 at rest."""

    mechanism: Literal["scale_factor_temperature"] = "scale_factor_temperature"
    effect: ClassVar[str | None] = "scale_factor_temperature"
    ppm_per_degc: float = Field(60.0, description="s_1 [ppm/degC]; 20-200")
    ppb_per_degc2: float = Field(100.0, description="s_2 [ppb/degC^2]")
    reference_degc: float = Field(25.0, description="T_0 [degC]")

    def start(self, node_s: float, rng: np.random.Generator) -> Contribution:
        """The error of this mechanism."""

        def contribute(scene: Scene) -> FloatArray:
            d = scene.resonator - self.reference_degc
            return 3600.0 * scene.applied_rate * (1e-6 * self.ppm_per_degc + 1e-9 * self.ppb_per_degc2 * d) * d

        return contribute
