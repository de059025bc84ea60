"""The resonator follows the thermometer with one time constant."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from drivers.sim.truth.base import FloatArray, Mechanism


class ThermalLag(Mechanism):
    """Resonator behind the thermometer: T_r' = (T_s - T_r) / tau; on a ramp the bias errs by -b'(T) tau dT/dt."""

    mechanism: Literal["thermal_lag"] = "thermal_lag"
    kind: ClassVar[Literal["thermal", "static", "bias"]] = "thermal"
    effect: ClassVar[str | None] = "thermal_lag"
    tau_s: float = Field(60.0, gt=0.0, description="time constant [s]; die 5-60, module 60-600, vacuum 1e3-1e4")

    def network(self) -> tuple[FloatArray, FloatArray]:
        """A [1/s] and b [1/s] of x' = A x + b T_s; the last state is the resonator."""
        return np.array([[-1.0 / self.tau_s]]), np.array([1.0 / self.tau_s])
