"""Random errors of the rate: angle random walk, flicker (bias instability), rate random walk."""

from __future__ import annotations

import math

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from drivers.sim.truth.base import FloatArray, OrnsteinUhlenbeck


class NoiseSettings(BaseModel):
    """Coefficients as IEEE Std 952 defines them."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    angle_random_walk: float = Field(0.01, ge=0.0, description="N [deg/sqrt(h)]")
    bias_instability: float = Field(0.03, ge=0.0, description="B [deg/h]; the Allan floor is 0.664 B")
    rate_random_walk: float = Field(0.03, ge=0.0, description="K [deg/h/sqrt(h)]")


class RateNoise:
    """Noise of the rate, deterministic by its generators, independent of how the record is divided into steps."""

    FLICKER_TAU_S = 0.05 * 4.0 ** np.arange(12, dtype=np.float64)
    """One pole every factor of 4 from 0.05 s to 58 h: 1/f within 1 % between; faster, the angle random walk rules."""

    def __init__(self, settings: NoiseSettings, node_s: float, rngs: list[np.random.Generator]) -> None:
        self._white, flicker, self._walk = rngs
        self._n = settings.angle_random_walk
        self._walk_step = settings.rate_random_walk * math.sqrt(node_s / 3600.0)
        self._walk_value = 0.0
        # Two-sided density B^2/(2 pi f) = sigma^2/(2 f ln rho) of poles spaced by rho: sigma^2 = B^2 ln(rho)/pi.
        sigma = settings.bias_instability * math.sqrt(math.log(4.0) / math.pi)
        self._flicker = OrnsteinUhlenbeck(self.FLICKER_TAU_S, np.full(12, sigma), node_s, flicker)

    def white(self, samples: int, rate_hz: float) -> FloatArray:
        """Angle random walk [deg/h], shape `(samples,)`."""
        return self._n * 60.0 * math.sqrt(rate_hz) * self._white.standard_normal(samples)

    def slow(self, nodes: int) -> FloatArray:
        """Flicker and rate random walk [deg/h] at the nodes of a step, shape `(nodes,)`."""
        walk = np.empty(nodes)
        walk[0] = self._walk_value
        np.cumsum(self._walk_step * self._walk.standard_normal(nodes - 1), out=walk[1:])
        walk[1:] += self._walk_value
        self._walk_value = float(walk[-1])
        return walk + self._flicker(nodes)
