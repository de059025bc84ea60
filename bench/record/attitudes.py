"""Attitudes of a unit by name: the vocabulary of profiles, of fixtures and of plans of a calibration.

The table's frame is (east, north, up) where the table stands at 0; its axis is vertical and positive rates are
counter-clockwise from above. An attitude is the matrix from this frame to the unit's axes. Plans of 6, 12 and 24
positions follow IEEE Std 1293 (tumble) and D. Tedaldi et al., ICRA 2014 (well spread positions).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product

import numpy as np

from bench.base import FloatArray, InputError

AXES = ("x", "y", "z")
TUMBLES = (6, 12, 24)
WRONG_DEG = 10.0
"""Gravity that points further from where it should is another attitude, not an error of the unit."""


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


ATTITUDES: Mapping[str, Attitude] = {a.name: a for positions in reversed(TUMBLES) for a in tumble(positions)}
"""Attitudes that have a name: x_up to z_down, and the edges and corners of the tumbles, such as +x-y_up."""


def nearest_attitude(up: FloatArray) -> Attitude:
    """The one with a name whose direction upwards is nearest to `up` (3,), of any length."""
    return max(ATTITUDES.values(), key=lambda attitude: float(attitude.matrix[:, 2] @ up))


def off_deg(up: FloatArray, force: FloatArray) -> FloatArray:
    """Angle (...) [deg] between directions upwards and specific forces, both (..., 3)."""
    along = np.sum(up * force, axis=-1) / np.linalg.norm(force, axis=-1)
    return np.asarray(np.degrees(np.arccos(np.clip(along, -1.0, 1.0))))
