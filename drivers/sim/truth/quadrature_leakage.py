"""Quadrature that a demodulation phase error turns into rate."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from drivers.sim.truth.base import Contribution, FloatArray, Mechanism, Scene


class QuadratureLeakage(Mechanism):
    """Phase error of the demodulator: B = q sin(phi0 + phi1 (T - T0)); 1 deg/s and 1 mrad make 3.6 deg/h."""

    mechanism: Literal["quadrature_leakage"] = "quadrature_leakage"
    effect: ClassVar[str | None] = "quadrature_leakage"
    phase_mrad: float = Field(1.0, description="phi0 [mrad] at T0")
    phase_slope_mrad_per_degc: float = Field(0.0, description="phi1 [mrad/degC], drift of the electronics' phase")
    reference_degc: float = Field(25.0, description="T0 [degC]")

    def start(self, node_s: float, rng: np.random.Generator) -> Contribution:
        """The bias of this mechanism from power-on; the phase follows the electronics, at the thermometer."""

        def contribute(scene: Scene) -> FloatArray:
            phase = self.phase_mrad + self.phase_slope_mrad_per_degc * (scene.sensor - self.reference_degc)
            leaked: FloatArray = 3600.0 * scene.quadrature_dps * np.sin(1e-3 * phase)
            return leaked

        return contribute
