"""Attitudes of a unit on a table, and what gravity, Earth and table are in its axes then.

The table's frame is (east, north, up) where the table stands at 0; its axis is vertical and positive rates are
counter-clockwise from above. An attitude is the matrix from this frame to the unit's axes. Plans of 6, 12 and 24
positions follow IEEE Std 1293 (tumble) and D. Tedaldi et al., ICRA 2014 (well spread positions).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from bench.base import DPH_PER_DPS, FloatArray, InputError, IntArray
from bench.record import EARTH_DPH

STANDARD_GRAVITY = 9.80665
"""Conventional value of one g [m/s^2] (ISO 80000-3)."""
AXES = ("x", "y", "z")
TUMBLES = (6, 12, 24)


@dataclass(frozen=True, eq=False)
class Attitude:
    """One attitude: its name, and its matrix (3, 3) from the table's frame to the unit's axes."""

    name: str
    matrix: FloatArray

    @classmethod
    def of(cls, name: str, up: tuple[float, float, float], heading_deg: float = 0.0) -> Attitude:
        """The unit's direction `up` points up, then it is turned counter-clockwise from above by `heading_deg`.

        InputError where `up` is no direction.
        """
        size = float(np.linalg.norm(up))
        if not np.isfinite(size) or size < 1e-9:
            raise InputError(f"attitude '{name}': up is {list(up)}, allowed are three numbers that are not all 0")
        third = np.asarray(up, dtype=np.float64) / size
        # Of the unit's axes the one that is most level points east before the turn.
        most_level = np.eye(3)[int(np.argmin(np.abs(third)))]
        first = most_level - (most_level @ third) * third
        first /= np.linalg.norm(first)
        frame = np.stack([first, np.cross(third, first), third], axis=1)
        c, s = np.cos(np.radians(heading_deg)), np.sin(np.radians(heading_deg))
        return cls(name, frame @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]))


def faces() -> tuple[Attitude, ...]:
    """The six attitudes with an axis up or down, x_up to z_down; y_down and z_down are turned by 90 and 180 degrees.

    Without these turns a fixture that is tilted on a rate table could not be told from axes that are not orthogonal.
    """
    return tuple(
        Attitude.of(f"{axis}_{way}", _three(sign * np.eye(3)[k]), 90.0 * k if sign < 0 else 0.0)
        for (k, axis), (way, sign) in product(enumerate(AXES), (("up", 1.0), ("down", -1.0)))
    )


def tumble(positions: int) -> tuple[Attitude, ...]:
    """The attitudes of a tumble: 6 faces; 12 edges (an axis level, the others at 45 degrees); or 24, both and six
    corners; InputError for other numbers.

    Headings differ between neighbours, so that the level part of the Earth's rate is seen by every axis.
    """
    if positions not in TUMBLES:
        raise InputError(f"a tumble of {positions} positions is not known, allowed are 6, 12 and 24")
    if positions == 6:
        return faces()
    edges = [v for v in product((-1.0, 0.0, 1.0), repeat=3) if np.count_nonzero(v) == 2]
    if positions == 12:
        return tuple(_named(v, 90.0 * i) for i, v in enumerate(edges))
    corners = list(product((-1.0, 1.0), repeat=3))[:6]
    return (*faces(), *(_named(v, 90.0 * i) for i, v in enumerate([*edges, *corners])))


def _named(up: tuple[float, ...], heading_deg: float) -> Attitude:
    parts = "".join(f"{'+' if v > 0 else '-'}{axis}" for v, axis in zip(up, AXES, strict=True) if v)
    return Attitude.of(f"{parts}_up", _three(np.asarray(up)), heading_deg % 360.0)


def _three(values: FloatArray) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])


def gravity_at(latitude_deg: float) -> float:
    """Normal gravity at sea level [m/s^2]: the closed form of Somigliana on the ellipsoid WGS 84 (NGA.STND.0036)."""
    square = np.sin(np.radians(latitude_deg)) ** 2
    return float(9.7803253359 * (1.0 + 0.00193185265241 * square) / np.sqrt(1.0 - 0.00669437999013 * square))


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
