"""A smooth rate-independent hysteresis loop."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from drivers.sim.truth.base import Contribution, FloatArray, Mechanism, Scene


class BoucWen(Mechanism):
    """Friction in the mount: L dz/dT = 1 - (b sgn(z dT) + 1 - b) |z|^n, B = a z (Wen 1976); z stays within +-1."""

    mechanism: Literal["bouc_wen"] = "bouc_wen"
    effect: ClassVar[str | None] = "hysteresis"
    amplitude_dph: float = Field(0.3, description="a [deg/h]; the loop is at most 2 a wide")
    length_degc: float = Field(12.0, gt=0.0, description="L [degC], how far to run until the loop is open")
    exponent: float = Field(1.0, ge=1.0, description="n, sharpness of the knee")
    symmetry: float = Field(0.5, gt=0.0, le=1.0, description="b; 0.5 unloads along straight lines")

    def start(self, node_s: float, rng: np.random.Generator) -> Contribution:
        """The bias of this mechanism from the unit's first moment, relaxed."""
        last: float | None = None
        z = 0.0

        def contribute(scene: Scene) -> FloatArray:
            nonlocal last, z
            t = float(scene.sensor[-1])
            before = z
            z = self._advance(z, t - (float(scene.sensor[0]) if last is None else last))
            last = t
            return self.amplitude_dph * np.linspace(before, z, len(scene.sensor))

        return contribute

    def _advance(self, z: float, change_degc: float) -> float:
        """State after a monotonic change of temperature: Runge-Kutta in pieces of at most L/20."""
        pieces = int(abs(change_degc) / self.length_degc * 20.0) + 1
        h = change_degc / self.length_degc / pieces
        for _ in range(pieces):
            k1 = self._slope(z, h)
            k2 = self._slope(z + 0.5 * h * k1, h)
            k3 = self._slope(z + 0.5 * h * k2, h)
            k4 = self._slope(z + h * k3, h)
            z += h * (k1 + 2.0 * k2 + 2.0 * k3 + k4) / 6.0
        return z

    def _slope(self, z: float, direction: float) -> float:
        loading = 1.0 if z * direction > 0.0 else 1.0 - 2.0 * self.symmetry
        return 1.0 - loading * float(abs(z) ** self.exponent)
