"""The rotation of the Earth, as the sensitive axis of the unit sees it."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from drivers.sim.truth.base import Contribution, FloatArray, Mechanism, Scene

SIDEREAL_DAY_S = 86164.0905
"""Mean sidereal day (IERS)."""


class EarthRate(Mechanism):
    """Earth rate: the scalar product of the Earth's rotation with the sensitive axis, both north, east, up.

    On a rate table, whose axis is vertical, the axis turns with it: positive rates are counter-clockwise from above.
    """

    mechanism: Literal["earth_rate"] = "earth_rate"
    effect: ClassVar[str | None] = "polynomial"
    latitude_deg: float = Field(45.0, ge=-90.0, le=90.0, description="latitude, north positive [deg]")
    azimuth_deg: float = Field(0.0, description="azimuth of the axis, clockwise from north [deg]")
    elevation_deg: float = Field(0.0, ge=-90.0, le=90.0, description="its elevation [deg]; 0 level, 90 up")

    def start(self, node_s: float, rng: np.random.Generator) -> Contribution:
        """The rate along the axis from the unit's first moment, where the table stands at 0."""
        turned_deg = 0.0
        size_dph = 360.0 * 3600.0 / SIDEREAL_DAY_S
        latitude, elevation = np.radians(self.latitude_deg), np.radians(self.elevation_deg)
        earth = size_dph * np.array([np.cos(latitude), 0.0, np.sin(latitude)])

        def contribute(scene: Scene) -> FloatArray:
            nonlocal turned_deg
            rate = scene.applied_rate
            steps = 0.5 * scene.node_s * (rate[1:] + rate[:-1])
            angles = turned_deg + np.concatenate([[0.0], np.cumsum(steps)])
            turned_deg = float(angles[-1])
            heading = np.radians(self.azimuth_deg - angles)
            level = np.cos(elevation)
            up = np.full(len(heading), np.sin(elevation))
            axis = np.stack([level * np.cos(heading), level * np.sin(heading), up])
            seen: FloatArray = earth @ axis
            return seen

        return contribute
