"""The resonator follows the thermometer through two lags in series."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from drivers.sim.truth.base import FloatArray, Mechanism


class TwoPoleLag(Mechanism):
    """Two lags in series: T_1' = (T_s - T_1)/tau_1, T_r' = (T_1 - T_r)/tau_2. Deliberately outside the library."""

    mechanism: Literal["two_pole_lag"] = "two_pole_lag"
    kind: ClassVar[Literal["thermal", "static", "bias"]] = "thermal"
    first_tau_s: float = Field(120.0, gt=0.0, description="tau_1 [s]")
    second_tau_s: float = Field(400.0, gt=0.0, description="tau_2 [s]")

    def network(self) -> tuple[FloatArray, FloatArray]:
        """A [1/s] and b [1/s] of x' = A x + b T_s; the last state is the resonator."""
        first, second = 1.0 / self.first_tau_s, 1.0 / self.second_tau_s
        return np.array([[-first, 0.0], [second, -second]]), np.array([first, 0.0])
