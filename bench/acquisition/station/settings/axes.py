"""Driven axes of a fixture: their section in the station file, and the positions in which they hold an attitude.

Positions are closed-form: rotations about two axes that take one direction to another, then about the third
(subproblems 1 and 2 of B. Paden, "Kinematics and Control of Robot Manipulators", 1986; R. M. Murray, Z. Li and S. S.
Sastry, "A Mathematical Introduction to Robotic Manipulation", 1994, section 3.3.2).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import BaseModel, Field, FiniteFloat, PositiveFloat, model_validator

from bench.base import STRICT, FloatArray, PlacedError
from bench.record import Attitude

EXACT = 1e-6
"""Largest difference between an attitude and the one that positions give [rad]."""
Angle = Annotated[FiniteFloat, Field(ge=-3600, le=3600)]


class AxisSettings(BaseModel):
    """One axis of a fixture, with a CiA 402 drive in profile position mode."""

    model_config = STRICT

    bus: Annotated[str, Field(min_length=1)]
    """Name of the bus that the drive is on; no unit may be on it."""
    node: Annotated[int, Field(ge=1, le=126)]
    """Node number of the drive."""
    counts_per_degree: PositiveFloat
    """Units of position in one degree of the axis, gear included; velocity is in the same per second."""
    about: tuple[FiniteFloat, FiniteFloat, FiniteFloat]
    """Direction of the axis where all axes and the rate table are at 0: east, north, up. Positive positions turn
    counter-clockwise when one looks against it."""
    from_deg: Angle = -180.0
    """Lowest position that it may have [deg]."""
    to_deg: Angle = 180.0
    """Highest position that it may have [deg]."""
    speed_dps: PositiveFloat
    """Speed at which it goes from one position to another [deg/s]."""
    accel_dps2: PositiveFloat
    """Acceleration [deg/s^2]; what fixture and cables bear."""
    heartbeat_s: Annotated[float, Field(ge=2, le=60)] = 10.0
    """Longest silence of bench or drive before the axis is stopped."""

    @model_validator(mode="after")
    def _turns(self) -> AxisSettings:
        if not np.linalg.norm(self.about) > 0:
            raise PlacedError(f"about is {list(self.about)}, allowed are three numbers that are not all 0", ("about",))
        if not self.from_deg < self.to_deg:
            raise PlacedError(
                f"to_deg is {self.to_deg:g}, allowed is more than from_deg, {self.from_deg:g}", ("to_deg",)
            )
        return self

    @property
    def direction(self) -> FloatArray:
        """Unit vector (3,) of the axis."""
        return np.asarray(np.asarray(self.about) / np.linalg.norm(self.about))


@dataclass(frozen=True)
class Positions:
    """Positions of the axes [deg], and by how much the attitude is turned against its heading with its name [deg]."""

    degrees: tuple[float, ...]
    heading_deg: float


def positions(axes: Sequence[AxisSettings], zero: Attitude, wanted: Attitude) -> Positions | None:
    """Where two or three axes hold `wanted`; None: nowhere.

    `zero` is the attitude with all axes at 0. Two axes bring the right direction upwards, with a heading that follows
    from it; three bring the heading, too. Of several solutions the one with the shortest way from 0 and, with two axes,
    the nearest heading is taken.
    """
    turned = zero.matrix.T @ wanted.matrix  # from the frame at the wanted attitude back to that at zero
    found = [
        Positions(within, heading)
        for angles, heading in _solutions([axis.direction for axis in axes], turned)
        if (within := _within(axes, angles)) is not None
    ]
    return min(found, key=lambda one: (abs(one.heading_deg), sum(map(abs, one.degrees))), default=None)


def _solutions(directions: Sequence[FloatArray], turned: FloatArray) -> Iterator[tuple[list[float], float]]:
    """Angles [rad] and headings [deg] of all solutions, each verified by multiplying the rotations."""
    first, second, *third = directions
    # The fixture's rotation R has to be turned^T, up to a rotation about the vertical where there are two axes only.
    inner = third[0] if third else turned[:, 2]
    outer = turned.T @ inner if third else np.array([0.0, 0.0, 1.0])
    for angles in _two(first, second, inner, outer):
        rotation = _about(first, angles[0]) @ _about(second, angles[1])
        if third:
            across = np.cross(third[0], np.eye(3)[int(np.argmin(np.abs(third[0])))])
            angles.append(_one(third[0], across, rotation.T @ turned.T @ across))
            rotation = rotation @ _about(third[0], angles[2])
        rest = turned.T @ rotation.T  # a rotation about the vertical is left of two axes
        heading = float(np.degrees(np.arctan2(rest[0, 1], rest[0, 0])))
        if np.linalg.norm(rest[:, 2] - [0.0, 0.0, 1.0]) < EXACT and (not third or abs(heading) < np.degrees(EXACT)):
            yield angles, heading if abs(heading) > np.degrees(EXACT) else 0.0


def _two(first: FloatArray, second: FloatArray, start: FloatArray, end: FloatArray) -> Iterator[list[float]]:
    """Angles about `first` and `second` that take `start` to `end`: none, one or two pairs (subproblem 2)."""
    along = float(first @ second)
    across = np.cross(first, second)
    if 1.0 - along**2 < EXACT:
        return
    a = (along * (second @ start) - first @ end) / (along**2 - 1.0)
    b = (along * (first @ end) - second @ start) / (along**2 - 1.0)
    square = float((start @ start - a * a - b * b - 2.0 * a * b * along) / (across @ across))
    if square < -EXACT:
        return
    for sign in (1.0, -1.0) if square > EXACT else (0.0,):
        between = a * first + b * second + sign * np.sqrt(max(square, 0.0)) * across
        yield [_one(first, between, end), _one(second, start, between)]


def _one(axis: FloatArray, start: FloatArray, end: FloatArray) -> float:
    """Angle about `axis` that takes `start` to `end` (subproblem 1); 0 where both lie on the axis."""
    start, end = start - (axis @ start) * axis, end - (axis @ end) * axis
    if np.linalg.norm(start) < EXACT:
        return 0.0
    return float(np.arctan2(axis @ np.cross(start, end), start @ end))


def _about(axis: FloatArray, angle: float) -> FloatArray:
    """Matrix of the rotation about a unit vector (Rodrigues)."""
    x, y, z = axis
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * skew + (1.0 - np.cos(angle)) * skew @ skew)


def _within(axes: Sequence[AxisSettings], angles: Sequence[float]) -> tuple[float, ...] | None:
    """Positions [deg] within the ranges of the axes, each as near to 0 as it can be; None: there are none."""
    found = []
    for axis, angle in zip(axes, angles, strict=True):
        turns = np.degrees(angle) + 360.0 * np.arange(-11, 12)
        allowed = turns[(turns >= axis.from_deg - 1e-6) & (turns <= axis.to_deg + 1e-6)]
        if not len(allowed):
            return None
        found.append(round(float(allowed[np.argmin(np.abs(allowed))]), 6))
    return tuple(found)
