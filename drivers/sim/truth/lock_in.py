"""Ring laser whose beams couple."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from drivers.sim.truth.base import Contribution, FloatArray, Mechanism, Scene

PHASES = 720


class LockIn(Mechanism):
    """The beat phase p follows dp/dt = W - W_L sin p; the counted rate is one turn over the time that a turn takes.

    The time is summed over the phase; below W_L the phase stands still (F. Aronowitz, Laser Applications 1 (1971) 113).
    """

    mechanism: Literal["lock_in"] = "lock_in"
    effect: ClassVar[str | None] = "lock_in"
    threshold_dps: float = Field(0.1, gt=0.0, description="W_L [deg/s]; 0.01-0.3 without dither")

    def start(self, node_s: float, rng: np.random.Generator) -> Contribution:
        """The error of this mechanism."""
        sine = np.sin(2.0 * np.pi * (np.arange(PHASES) + 0.5) / PHASES)
        seen: dict[float, float] = {}

        def counted(rate: float) -> float:
            if abs(rate) <= self.threshold_dps:
                return 0.0
            return float(1.0 / np.mean(1.0 / (rate - self.threshold_dps * sine)))

        def contribute(scene: Scene) -> FloatArray:
            out = np.empty_like(scene.applied_rate)
            for i, rate in enumerate(np.round(scene.applied_rate, 6).tolist()):
                if rate not in seen:
                    seen[rate] = 3600.0 * (counted(rate) - rate)
                out[i] = seen[rate]
            return out

        return contribute
