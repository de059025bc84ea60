"""Sudden lasting changes of the bias."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field, model_validator

from drivers.sim.truth.base import Contribution, FloatArray, Mechanism, Scene


class BiasJump(Mechanism):
    """Stress release and charging: steps at given times, and at random ones of a Poisson process drawn by run."""

    mechanism: Literal["bias_jump"] = "bias_jump"
    effect: ClassVar[str | None] = "bias_jump"
    at_s: tuple[float, ...] = Field((), description="times of the steps [s of bench time]")
    step_dph: tuple[float, ...] = Field((), description="their sizes [deg/h]; 0.05-0.5")
    per_hour: float = Field(0.0, ge=0.0, description="random steps an hour")
    sigma_dph: float = Field(0.2, ge=0.0, description="standard deviation of the random steps [deg/h]")

    @model_validator(mode="after")
    def _pairs(self) -> BiasJump:
        if len(self.at_s) != len(self.step_dph):
            raise ValueError(f"{len(self.at_s)} times in at_s but {len(self.step_dph)} sizes in step_dph")
        return self

    def start(self, node_s: float, rng: np.random.Generator) -> Contribution:
        """The bias of this mechanism."""
        steps = sorted(zip(self.at_s, self.step_dph, strict=True))
        passed = 0.0
        next_s: float | None = None

        def contribute(scene: Scene) -> FloatArray:
            nonlocal next_s, passed, steps
            if next_s is None:
                next_s = float(scene.time[0]) + wait_s()
            while next_s <= scene.time[-1]:
                steps.append((next_s, self.sigma_dph * float(rng.standard_normal())))
                next_s += wait_s()
            bias = np.full(len(scene.time), passed)
            for at_s, size in steps:
                bias += size * (scene.time >= at_s)
            passed = float(bias[-1])
            steps = [(at_s, size) for at_s, size in steps if at_s > scene.time[-1]]
            return bias

        def wait_s() -> float:
            return 3600.0 / self.per_hour * float(rng.standard_exponential()) if self.per_hour else np.inf

        return contribute
