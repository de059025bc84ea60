"""A hysteresis loop made of many relays."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from drivers.sim.truth.base import Contribution, FloatArray, Mechanism, Scene, straight


class Preisach(Mechanism):
    """Ensemble of micro-slips in glue and solder: relays up at c + h, down at c - h, B = a mean(state) (Preisach 1935).

    Centres c are spread evenly, half widths h exponentially. Which relays a unit has belongs to the unit, not to
    the run, hence a separate seed.
    """

    mechanism: Literal["preisach"] = "preisach"
    effect: ClassVar[str | None] = "hysteresis"
    amplitude_dph: float = Field(0.5, description="a [deg/h], bias of all relays up")
    half_width_degc: float = Field(8.0, gt=0.0, description="mean of h [degC]")
    from_degc: float = Field(-60.0, description="lowest centre [degC]")
    to_degc: float = Field(105.0, description="highest centre [degC]")
    relays: int = Field(4000, ge=100, le=100_000, description="number of relays; the steps are 2 a / relays")
    relay_seed: int = Field(1, ge=0, description="which relays this unit has")

    def start(self, node_s: float, rng: np.random.Generator) -> Contribution:
        """The bias of this mechanism from the unit's first moment, relaxed around its temperature then."""
        unit = np.random.default_rng(self.relay_seed)
        centre = unit.uniform(self.from_degc, self.to_degc, self.relays)
        half = unit.exponential(self.half_width_degc, self.relays)
        relays: _Relays | None = None

        def contribute(scene: Scene) -> FloatArray:
            nonlocal relays
            if relays is None:
                relays = _Relays(centre, half, float(scene.sensor[0]))
            before = relays.mean
            after = relays.move_to(float(scene.sensor[-1]))
            return self.amplitude_dph * straight(before, after, len(scene.sensor))

        return contribute


class _Relays:
    """Relays sorted by their thresholds, so that a step updates only those that it passes."""

    def __init__(self, centre: FloatArray, half: FloatArray, start_degc: float) -> None:
        self._thresholds = tuple((np.argsort(x), np.sort(x)) for x in (centre - half, centre + half))
        self._up = centre < start_degc
        self._temperature = start_degc

    @property
    def mean(self) -> float:
        """Mean state, -1 to 1."""
        return 2.0 * float(np.count_nonzero(self._up)) / len(self._up) - 1.0

    def move_to(self, temperature: float) -> float:
        """Mean state after a monotonic change to a temperature [degC]."""
        rising = temperature > self._temperature
        order, sorted_thresholds = self._thresholds[rising]
        first, last = np.searchsorted(sorted_thresholds, sorted((self._temperature, temperature)))
        self._up[order[first:last]] = rising
        self._temperature = temperature
        return self.mean
