"""A whole inertial unit on its bus: the truth of three gyros and three accelerometers, sample by sample.

It follows the chamber, the table's rate and the attitude of the fixture.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from drivers.errors import ConfigError
from drivers.layout import THERMOMETERS, Layout
from drivers.sim.resonator import DIVIDER, Environment
from drivers.sim.truth.base import FloatArray
from drivers.sim.truth.imu.drawn import drawn
from drivers.sim.truth.imu.mounting import MountingSettings, Stand
from drivers.sim.truth.imu.unit import ImuSettings, SimulatedImu


class InertialSettings(BaseModel):
    """The truth of a simulated inertial unit, as under `simulation: {imu: …}` of a station file."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    drawn: int = Field(1, ge=0, description="number by which the parameters are drawn, where `unit` is left out")
    unit: ImuSettings | None = Field(None, description="parameters of the unit")
    mounting: MountingSettings = Field(
        MountingSettings(), description="place and fixture; left out: the station's latitude, and gravity there"
    )

    def truth(self) -> ImuSettings:
        """Parameters of the unit."""
        return drawn(self.drawn) if self.unit is None else self.unit

    def place(self, latitude_deg: float | None) -> MountingSettings:
        """The mounting, at the station's latitude where it states none."""
        given = self.mounting.model_fields_set
        if latitude_deg is None or "latitude_deg" in given:
            return self.mounting
        known = {"latitude_deg": latitude_deg}
        if "gravity" not in given:
            square, double = np.sin(np.radians([latitude_deg, 2.0 * latitude_deg])) ** 2
            # Gravity formula 1980 (H. Moritz, Geodetic Reference System 1980, truncated series).
            known["gravity"] = float(9.780327 * (1.0 + 0.0053024 * square - 0.0000058 * double))
        return self.mounting.model_copy(update=known)


class InertialUnit:
    """Physics of a unit with the channels of a layout; deterministic by seed."""

    def __init__(
        self, layout: Layout, simulation: Mapping[str, Any], seed: int, latitude_deg: float | None = None
    ) -> None:
        """`simulation` as in the station file. ConfigError for keys or channels that such a unit does not have."""
        try:
            settings = InertialSettings.model_validate(simulation["imu"] or {})
        except ValidationError as error:
            wrong = "; ".join(f"{'.'.join(map(str, one['loc']))}: {one['msg']}" for one in error.errors())
            raise ConfigError(f"simulation: imu: {wrong}") from None
        if others := simulation.keys() - {"imu"}:
            raise ConfigError(f"simulation: {', '.join(sorted(others))} does not go with imu; remove it")
        outputs = (*(f"rate_{axis}" for axis in "xyz"), *(f"acceleration_{axis}" for axis in "xyz"))
        self._columns = {name: outputs.index(name) for name in layout.channels if name in outputs}
        self._thermometers = [name for name in layout.channels if THERMOMETERS.fullmatch(name)]
        if others := layout.channels.keys() - self._columns.keys() - {*self._thermometers}:
            raise ConfigError(f"signals: a simulated inertial unit does not send {', '.join(sorted(others))}")
        self._standing: tuple[tuple[int, float, bytes], tuple[FloatArray, FloatArray]] | None = None
        self._sample_s = layout.interval_ms * 1e-3
        self.imu = SimulatedImu(settings.truth(), settings.place(latitude_deg), seed, self._sample_s * DIVIDER)

    def advance(self, environment: Environment) -> dict[str, FloatArray]:
        """Values (samples,) of all channels, in their units; slow physics in steps of ten samples."""
        steps = environment.samples // DIVIDER
        step_s = self._sample_s * DIVIDER
        rates = np.asarray(environment.applied_rate_dps, dtype=np.float64)
        edges = np.interp(np.linspace(0.0, 1.0, steps + 1), np.linspace(0.0, 1.0, len(rates)), rates)
        turned = np.concatenate([[0.0], np.cumsum(0.5 * step_s * (edges[1:] + edges[:-1]))])
        stand = Stand(0, np.eye(3) if environment.attitude is None else environment.attitude, visit=environment.visit)
        angles = self.imu.mounting.angle_deg + turned
        rate, force = self._driven(stand, angles, 1.0 / step_s)
        case = np.linspace(*environment.fixture_temperature, steps + 1)[1:]
        signals = self.imu.measured(rate, force, case)
        outputs = np.repeat(np.hstack([signals.rate, signals.acceleration]), DIVIDER, axis=0)
        outputs += self.imu.white(len(outputs), 1.0 / self._sample_s)
        values = {name: outputs[:, column] for name, column in self._columns.items()}
        for place, name in enumerate(self._thermometers):
            values[name] = np.repeat(signals.temperatures[:, place % 4], DIVIDER)
        return values

    def _driven(self, stand: Stand, angles: FloatArray, rate_hz: float) -> tuple[FloatArray, FloatArray]:
        """Rates and forces (steps, 3) while the table goes through these angles (steps + 1,); one that stands is asked
        once.
        """
        if np.ptp(angles) > 0.0:
            return self.imu.mounting.turned(stand, angles, rate_hz)
        key = stand.visit, float(angles[0]), stand.attitude.tobytes()
        if self._standing is None or self._standing[0] != key:
            self._standing = key, self.imu.mounting.turned(stand, angles[:2], rate_hz)
        rate, force = (np.repeat(one, len(angles) - 1, axis=0) for one in self._standing[1])
        return rate, force
