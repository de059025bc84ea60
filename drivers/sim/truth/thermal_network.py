"""The resonator is heated by the case directly and by a slow frame."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from drivers.sim.truth.base import FloatArray, Mechanism


class ThermalNetwork(Mechanism):
    """Two nodes: T_f' = (T_s - T_f)/tau_f (frame), T_r' = (T_s - T_r)/tau_d + (T_f - T_r)/tau_m (resonator)."""

    mechanism: Literal["thermal_network"] = "thermal_network"
    kind: ClassVar[Literal["thermal", "static", "bias"]] = "thermal"
    effect: ClassVar[str | None] = "thermal_lag"
    direct_tau_s: float = Field(60.0, gt=0.0, description="tau_d [s], radiation and leads between case and resonator")
    mount_tau_s: float = Field(60.0, gt=0.0, description="tau_m [s], mount between frame and resonator")
    frame_tau_s: float = Field(400.0, gt=0.0, description="tau_f [s], frame behind the thermometer")

    def network(self) -> tuple[FloatArray, FloatArray]:
        """A [1/s] and b [1/s] of x' = A x + b T_s; the last state is the resonator."""
        frame, direct, mount = 1.0 / self.frame_tau_s, 1.0 / self.direct_tau_s, 1.0 / self.mount_tau_s
        return np.array([[-frame, 0.0], [mount, -direct - mount]]), np.array([frame, direct])
