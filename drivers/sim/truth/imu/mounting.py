"""How a unit stands in the world: table, fixture and what is wrong with them, as a chain of rotations.

The rate of the unit is what its orientation does from one instant to the next, so that a wobbling table needs no
formula of its own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydantic import BaseModel, ConfigDict, Field
from scipy.spatial.transform import Rotation

from drivers.sim.truth.base import FloatArray

SIDEREAL_DAY_S = 86164.0905
"""Mean sidereal day (IERS)."""
_ARCSEC = np.pi / 180.0 / 3600.0
_INSTANTS_PER_S = 25


class MountingSettings(BaseModel):
    """Where the unit is and what is wrong with its mounting; rotations as vectors (east, north, up or x, y, z)."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    latitude_deg: float = Field(45.0, ge=-90.0, le=90.0, description="latitude, north positive [deg]")
    gravity: float = Field(9.80620, gt=9.7, lt=9.9, description="at the place [m/s^2]; 9.780 to 9.832")
    table_tilt_deg: tuple[float, float] = Field((0.0, 0.0), description="of the table's axis about east, north [deg]")
    fixture_on_table_deg: tuple[float, float, float] = Field(
        (0.0, 0.0, 0.0), description="rotation of the fixture on the table [deg]"
    )
    unit_in_fixture_deg: tuple[float, float, float] = Field(
        (0.0, 0.0, 0.0), description="rotation of the unit in the fixture [deg]"
    )
    attitude_arcsec: float = Field(
        0.0, ge=0.0, description="standard deviation of an attitude, the same each time it is taken up"
    )
    visit_arcsec: float = Field(4.0, ge=0.0, description="the same, drawn anew each time; 2-5 of a two-axis table")
    wobble_arcsec: float = Field(5.0, ge=0.0, description="of the table's axis, once and twice a turn; 2-10")


@dataclass(frozen=True, slots=True)
class Stand:
    """One stay of the unit: whole seconds in one attitude, the table at a steady rate."""

    seconds: int
    attitude: FloatArray
    """(3, 3): from the table's frame (east, north, up where it stands at 0) to the unit's, as it should be."""
    turn_dps: float = 0.0
    """Rate of the table, counter-clockwise from above [deg/s]."""
    visit: int = 0
    """Number of the time that an attitude was taken up; the same number, the same small error."""


class Mounting:
    """The chain from the world to the unit; the table keeps its angle from one stand to the next."""

    def __init__(self, settings: MountingSettings, seed: int) -> None:
        self._settings, self._seed = settings, seed
        self.angle_deg = 0.0
        self._last: tuple[int, FloatArray, Rotation] | None = None
        self._unit = Rotation.from_rotvec(settings.unit_in_fixture_deg, degrees=True)
        self._fixture = Rotation.from_rotvec(settings.fixture_on_table_deg, degrees=True)
        self._base = Rotation.from_rotvec([*settings.table_tilt_deg, 0.0], degrees=True)
        self._phase = np.random.default_rng([seed, 7]).uniform(0.0, 2.0 * np.pi, 2)

    def stay(self, stand: Stand) -> tuple[FloatArray, FloatArray]:
        """Rate [deg/h] and specific force [m/s^2] in the frame of the unit, means over each second (seconds, 3)."""
        instants = _INSTANTS_PER_S if stand.turn_dps else 1
        steps = stand.seconds * instants if stand.turn_dps else 1
        rate, force = self.turned(stand, self.angle_deg + stand.turn_dps * np.arange(steps + 1) / instants, instants)
        if not stand.turn_dps:
            return np.repeat(rate, stand.seconds, axis=0), np.repeat(force, stand.seconds, axis=0)
        shape = (stand.seconds, instants, 3)
        return rate.reshape(shape).mean(axis=1), force.reshape(shape).mean(axis=1)

    def turned(self, stand: Stand, angles_deg: FloatArray, rate_hz: float) -> tuple[FloatArray, FloatArray]:
        """Rate [deg/h] and specific force [m/s^2] (n, 3), means over the n steps between angles (n + 1,) of the table.

        Of the stand only attitude and visit count; `rate_hz` is one over the time of a step.
        """
        self.angle_deg = float(angles_deg[-1])
        angles = np.radians(angles_deg)
        middle = self._pose(stand, 0.5 * (angles[1:] + angles[:-1]))
        latitude = np.radians(self._settings.latitude_deg)
        earth = 360.0 * 3600.0 / SIDEREAL_DAY_S * np.array([0.0, np.cos(latitude), np.sin(latitude)])
        rate = middle.apply(earth)
        if np.ptp(angles) > 0.0:
            pose = self._pose(stand, angles)
            # The frame of the unit turns against the world by the inverse of how vectors turn in it.
            rate = rate + np.degrees((pose[:-1] * pose[1:].inv()).as_rotvec()) * rate_hz * 3600.0
        return rate, middle.apply([0.0, 0.0, self._settings.gravity])

    def _pose(self, stand: Stand, angles: FloatArray) -> Rotation:
        """Rotation of world vectors (east, north, up) to the unit at angles (n,) [rad] of the table."""
        settings = self._settings
        wobble = settings.wobble_arcsec * _ARCSEC * np.stack(
            [np.sin(angles + self._phase[0]), np.sin(2.0 * angles + self._phase[1]), np.zeros_like(angles)], axis=1
        )  # fmt: skip
        turned = Rotation.from_rotvec(-angles[:, None] * [0.0, 0.0, 1.0])
        placed = self._small(stand.attitude, stand.visit) * Rotation.from_matrix(stand.attitude)
        return self._unit * placed * self._fixture * Rotation.from_rotvec(wobble) * turned * self._base

    def _small(self, attitude: FloatArray, visit: int) -> Rotation:
        """What the attitude is off, every time and this time."""
        if self._last is not None and self._last[0] == visit and np.array_equal(self._last[1], attitude):
            return self._last[2]
        key = [self._seed, 11, *(np.round(1000.0 * attitude).astype(np.int64).ravel() % 99991).tolist()]
        every = np.random.default_rng(key).standard_normal(3) * self._settings.attitude_arcsec
        now = np.random.default_rng([self._seed, 13, visit]).standard_normal(3) * self._settings.visit_arcsec
        off = Rotation.from_rotvec((every + now) * _ARCSEC)
        self._last = visit, attitude, off
        return off
