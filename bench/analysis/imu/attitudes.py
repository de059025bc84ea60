"""What gravity, Earth and table are in the axes of a unit that stands in an attitude on the table."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.base import DPH_PER_DPS, BoolArray, FloatArray, IntArray
from bench.record import EARTH_DPH

STANDARD_GRAVITY = 9.80665
"""Conventional value of one g [m/s^2] (ISO 80000-3)."""


def gravity_at(latitude_deg: float) -> float:
    """Normal gravity at sea level [m/s^2]: the closed form of Somigliana on the ellipsoid WGS 84 (NGA.STND.0036)."""
    square = np.sin(np.radians(latitude_deg)) ** 2
    return float(9.7803253359 * (1.0 + 0.00193185265241 * square) / np.sqrt(1.0 - 0.00669437999013 * square))


STANDING_DPS = 1e-3
"""A table whose mean rate over a row is less than this stands."""


@dataclass(frozen=True)
class Stay:
    """Where a row was measured: the inputs of all rows are arrays over them."""

    attitude: FloatArray
    """(n, 3, 3)."""
    angle_deg: FloatArray
    """(n,) of the table, at the middle of the row."""
    rate_dps: FloatArray
    """(n,) of the table."""
    interval_s: float
    """Length of a row."""

    @property
    def stands(self) -> BoolArray:
        """(n,) whether the table stands; an encoder that stands still reads no exact 0."""
        return np.asarray(np.abs(self.rate_dps) < STANDING_DPS)

    def rows(self, chosen: FloatArray | IntArray) -> Stay:
        """Only these rows."""
        return Stay(self.attitude[chosen], self.angle_deg[chosen], self.rate_dps[chosen], self.interval_s)


def inputs(stay: Stay, latitude_deg: float, gravity: float | None = None) -> tuple[FloatArray, FloatArray]:
    """Rate [deg/h] and specific force [m/s^2] along the unit's axes (n, 3), means over each row.

    `gravity` [m/s^2]: that of the place; left out, normal gravity at sea level.
    """
    earth = in_table(earth_vector(latitude_deg), stay)
    earth[:, 2] += DPH_PER_DPS * stay.rate_dps
    up = np.array([0.0, 0.0, gravity_at(latitude_deg) if gravity is None else gravity])
    return np.einsum("nij,nj->ni", stay.attitude, earth), stay.attitude @ up


def earth_vector(latitude_deg: float) -> FloatArray:
    """Rotation of the Earth (east, north, up) [deg/h]."""
    latitude = np.radians(latitude_deg)
    return EARTH_DPH * np.array([0.0, np.cos(latitude), np.sin(latitude)])


def in_table(vector: FloatArray, stay: Stay) -> FloatArray:
    """A vector (east, north, up) in the frame of the turning table, mean over each row (n, 3)."""
    turned = np.radians(stay.angle_deg)
    # Over a row the table sweeps an arc; the mean of a turning vector is that of its middle times a sinc.
    arc = np.sinc(stay.rate_dps * stay.interval_s / 360.0)
    c, s = arc * np.cos(turned), arc * np.sin(turned)
    east, north = c * vector[0] + s * vector[1], c * vector[1] - s * vector[0]
    return np.stack([east, north, np.full(len(turned), vector[2])], axis=1)
