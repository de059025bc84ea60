"""Physics of a thermal chamber with its controller and load: no I/O, no clock.

By default one lumped heat capacity of 3.29 kJ/K, a 465 W heater and a cooling power that falls with temperature
reproduce the printed pull-down times of a TestEquity 107 (manual p. 7-1 and 8-4), which
`tests/drivers/test_plant.py` compares. The station file may describe another chamber (`chamber: simulation:`). The
fixture and the gyro's case are coupled to the air by conductances, so they lag it by minutes.
"""

from __future__ import annotations

import math
import random
from bisect import bisect_right
from dataclasses import dataclass
from itertools import pairwise

from pydantic import BaseModel, ConfigDict, Field, field_validator

NET_COOLING_W = (
    (-45.4, 0.0),
    (-40.0, 35.0),
    (-30.0, 100.0),
    (0.0, 155.0),
    (23.0, 200.0),
    (85.0, 331.0),
    (130.0, 331.0),
)
"""Live load that full cooling removes at an air temperature [degC, W]: manual p. 7-1; 85 degC from the pull-down."""


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Gains(_Strict):
    """One side of the controller."""

    band_k: float = Field(gt=0.0, description="proportional band [K]")
    integral_s: float = Field(gt=0.0, description="integral time [s]")
    derivative_s: float = Field(ge=0.0, description="derivative time [s]")


class PlantParameters(_Strict):
    """A bench chamber of the 28 litre class with a fixture and a gyro in it."""

    air_j_per_k: float = Field(3290.0, gt=0.0, description="heat capacity of air, liner and coil [J/K]")
    heater_w: float = Field(465.0, gt=0.0, description="heater [W]")
    wall_w_per_k: float = Field(
        2.0, ge=0.0, description="conductance of the wall [W/K]; the cooling table is net of it"
    )
    ambient_degc: float = Field(23.0, description="room [degC]")
    net_cooling_w: tuple[tuple[float, float], ...] = Field(
        NET_COOLING_W, min_length=1, description="heat that full cooling removes beyond the wall's share [degC, W]"
    )
    cooling_lag_s: float = Field(11.0, gt=0.0, description="evaporator [s]")
    sensor_lag_s: float = Field(12.0, gt=0.0, description="the controller's sensor [s]")
    sensor_noise_k: float = Field(0.01, ge=0.0, description="its noise [K]")
    sensor_step_k: float = Field(0.1, ge=0.0, description="resolution of the published value [K], 0 for none; F4: 0.1")
    disturbance_k: float = Field(
        0.1,
        ge=0.0,
        description="slow wander of the air (OU) [K]; without it the air is quieter than the manual's +-0.2 K",
    )
    disturbance_s: float = Field(120.0, gt=0.0, description="its correlation time [s]")
    heating: Gains = Gains(band_k=8.0, integral_s=240.0, derivative_s=20.0)
    cooling: Gains = Gains(band_k=5.0, integral_s=300.0, derivative_s=20.0)
    integral_zone_k: float = Field(
        3.0,
        gt=0.0,
        description="farther from the set point the integral acts only if the error has stalled [K]: approach "
        "control, keeps 85 -> 23 degC from undershooting by 4 K without leaving a droop",
    )
    compressor_delay_s: tuple[float, float] = Field(
        (10.0, 30.0), description="how long cooling must be wanted, or not, before the compressor starts, or stops [s]"
    )
    compressor_minimum_s: tuple[float, float] = Field(
        (60.0, 180.0), description="shortest time on, and off [s]; protects it against short cycling"
    )
    fixture_j_per_k: float = Field(600.0, gt=0.0, description="heat capacity of the fixture [J/K]")
    fixture_w_per_k: float = Field(2.0, ge=0.0, description="air to fixture [W/K]")
    case_j_per_k: float = Field(120.0, gt=0.0, description="heat capacity of the gyro [J/K]")
    case_w_per_k: float = Field(1.0, gt=0.0, description="fixture to gyro [W/K]")
    case_heat_w: float = Field(0.6, ge=0.0, description="what the gyro's electronics dissipate [W]")
    door_w_per_k: float = Field(25.0, ge=0.0, description="exchange through the open door [W/K]")
    relative_humidity: float = Field(
        0.4, ge=0.0, le=1.0, description="of the room's air that the chamber was closed with"
    )

    @property
    def reach(self) -> tuple[float, float]:
        """Set points that its controller accepts [degC]."""
        return float(math.ceil(self.net_cooling_w[0][0])), self.net_cooling_w[-1][0]

    @field_validator("net_cooling_w")
    @classmethod
    def _cooling_rises(cls, pairs: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
        for (before, _), (after, _) in pairwise(pairs):
            if after <= before:
                raise ValueError(f"temperatures must rise from pair to pair; {after:g} follows {before:g} degC")
        if any(watts < 0.0 for _, watts in pairs):
            raise ValueError("cooling cannot be negative; 0 W is the lowest that the chamber reaches")
        return pairs


@dataclass(frozen=True, slots=True)
class PlantState:
    """State of the chamber at the end of a step; temperatures in degC."""

    air: float
    """Air at the fixture, true."""
    process_value: float
    """Reading of the controller's sensor: lagged, noisy, quantised."""
    setpoint: float
    """Final set point in force."""
    working_setpoint: float
    """Set point after the controller's own ramp generator."""
    fixture: float
    case: float
    """Outside of the gyro: the temperature input of its physics."""
    power: float
    """Controller output, -1 (full cooling) to 1 (full heating)."""
    heater: float
    """Share of the heater's power, 0 to 1."""
    compressor: bool
    compressor_starts: int
    on: bool
    humidity: float
    """Relative humidity at room temperature of the gas inside, 0 to 1."""


def net_cooling_w(air_degc: float, table: tuple[tuple[float, float], ...] = NET_COOLING_W) -> float:
    """Heat that full cooling removes beyond the wall's share [W] at an air temperature [degC]; 0 below the table."""
    i = bisect_right(table, (air_degc, math.inf))
    if i == 0:
        return 0.0
    if i == len(table):
        return table[-1][1]
    (t0, w0), (t1, w1) = table[i - 1], table[i]
    return w0 + (w1 - w0) * (air_degc - t0) / (t1 - t0)


class _Compressor:
    """On and off with delays and minimum times; counts its starts."""

    def __init__(self, parameters: PlantParameters) -> None:
        self._delay_s = parameters.compressor_delay_s
        self._minimum_s = parameters.compressor_minimum_s
        self.running = False
        self.starts = 0
        self._demand_s = 0.0
        self._state_s = math.inf

    def step(self, dt_s: float, power: float, on: bool) -> bool:
        """Whether it runs during the coming step; switching the chamber off stops it at once."""
        self._state_s += dt_s
        change = power > 0.25 if self.running else power < -0.02
        self._demand_s = self._demand_s + dt_s if change else 0.0
        i = 1 if self.running else 0
        due = self._demand_s >= self._delay_s[i] and self._state_s >= self._minimum_s[1 - i]
        if (on and due) or (self.running and not on):
            self.running = not self.running
            self.starts += self.running
            self._demand_s = self._state_s = 0.0
        return self.running


class _Controller:
    """PID with separate gains for heating and cooling and a native ramp generator."""

    SLOPE_LAG_S = 5.0
    STALLED_K_PER_S = 0.005

    def __init__(self, parameters: PlantParameters, start_degc: float) -> None:
        self._heating, self._cooling = parameters.heating, parameters.cooling
        self._zone_k = parameters.integral_zone_k
        self.working_setpoint = start_degc
        self._previous_pv = start_degc
        self._integral = 0.0
        self._slope = 0.0
        self._cools = False

    def follow(self, pv: float) -> None:
        """While off: track the current temperature, so that the controller starts there when it is switched on."""
        self.working_setpoint = self._previous_pv = pv
        self._integral = self._slope = 0.0

    def step(self, dt_s: float, pv: float, setpoint: float, ramp_degc_per_min: float | None) -> float:
        """Output, -1 to 1, for the coming step."""
        reach = math.inf if ramp_degc_per_min is None else abs(ramp_degc_per_min) * dt_s / 60.0
        before = self.working_setpoint
        distance = setpoint - before
        self.working_setpoint = (
            setpoint if abs(distance) <= reach else self.working_setpoint + math.copysign(reach, distance)
        )
        error = self.working_setpoint - pv
        self._slope += ((pv - self._previous_pv) / dt_s - self._slope) * dt_s / (dt_s + self.SLOPE_LAG_S)
        self._previous_pv = pv
        gains = self._cooling if self._cools else self._heating
        demand = (error - gains.derivative_s * self._slope) / gains.band_k + self._integral
        self._cools = demand < 0.0
        output = min(1.0, max(-1.0, demand))
        closing = (self.working_setpoint - before) / dt_s - self._slope
        near = abs(error) < self._zone_k or abs(closing) < self.STALLED_K_PER_S
        if near and (output == demand or error * demand < 0.0):
            self._integral += error * dt_s / (gains.band_k * gains.integral_s)
        return output


class Plant:
    """A chamber that is stepped; deterministic by seed.

    `ambient_degc` and `door_open` may be changed between steps.
    """

    MAX_STEP_S = 1.0

    def __init__(
        self, parameters: PlantParameters | None = None, seed: int = 0, start_degc: float | None = None
    ) -> None:
        self.parameters = parameters or PlantParameters()
        self.ambient_degc = self.parameters.ambient_degc
        self.door_open = False
        start = self.ambient_degc if start_degc is None else start_degc
        self._random = random.Random(seed)
        self._bulk = self._sensor = self._fixture = self._case = start
        p = self.parameters
        self._fixture += p.case_heat_w / p.fixture_w_per_k if p.fixture_w_per_k else 0.0
        self._case = self._fixture + p.case_heat_w / p.case_w_per_k
        self._disturbance = self._random.gauss(0.0, self.parameters.disturbance_k)
        self._cooling_w = 0.0
        self._measured = start
        self._compressor = _Compressor(self.parameters)
        self._controller = _Controller(self.parameters, start)
        self.state = self._observe(start, 0.0, False)

    def step(self, dt_s: float, setpoint: float, on: bool = True, ramp_degc_per_min: float | None = None) -> PlantState:
        """Advance by `dt_s` [s] towards `setpoint` [degC], at the controller's own ramp rate if one is given."""
        pieces = max(1, math.ceil(dt_s / self.MAX_STEP_S - 1e-9))
        power = 0.0
        for _ in range(pieces):
            power = self._piece(dt_s / pieces, setpoint, on, ramp_degc_per_min)
        self.state = self._observe(setpoint, power, on)
        return self.state

    def _piece(self, dt_s: float, setpoint: float, on: bool, ramp_degc_per_min: float | None) -> float:
        p = self.parameters
        if on:
            power = self._controller.step(dt_s, self._measured, setpoint, ramp_degc_per_min)
        else:
            power = 0.0
            self._controller.follow(self._measured)
        running = self._compressor.step(dt_s, power, on)
        wall_w = p.wall_w_per_k * (self.ambient_degc - self._bulk)
        demand_w = max(0.0, net_cooling_w(self._bulk, p.net_cooling_w) + wall_w) * max(-power, 0.0) if running else 0.0
        self._cooling_w += (demand_w - self._cooling_w) * (1.0 - math.exp(-dt_s / p.cooling_lag_s))
        air = self._bulk + self._disturbance
        to_fixture_w = p.fixture_w_per_k * (air - self._fixture)
        to_case_w = p.case_w_per_k * (self._fixture - self._case)
        door_w = p.door_w_per_k * (self.ambient_degc - self._bulk) if self.door_open else 0.0
        heat_w = p.heater_w * max(power, 0.0) - self._cooling_w + wall_w + door_w - to_fixture_w
        self._bulk += heat_w * dt_s / p.air_j_per_k
        self._fixture += (to_fixture_w - to_case_w) * dt_s / p.fixture_j_per_k
        self._case += (to_case_w + p.case_heat_w) * dt_s / p.case_j_per_k
        keep = math.exp(-dt_s / p.disturbance_s)
        kick = p.disturbance_k * math.sqrt(1.0 - keep * keep)
        self._disturbance = self._disturbance * keep + self._random.gauss(0.0, kick)
        self._sensor += (air - self._sensor) * (1.0 - math.exp(-dt_s / p.sensor_lag_s))
        self._measured = self._sensor + self._random.gauss(0.0, p.sensor_noise_k)
        return power

    def _observe(self, setpoint: float, power: float, on: bool) -> PlantState:
        step_k = self.parameters.sensor_step_k
        return PlantState(
            air=self._bulk + self._disturbance,
            process_value=round(self._measured / step_k) * step_k if step_k else self._measured,
            setpoint=setpoint,
            working_setpoint=self._controller.working_setpoint,
            fixture=self._fixture,
            case=self._case,
            power=power,
            heater=max(power, 0.0),
            compressor=self._compressor.running,
            compressor_starts=self._compressor.starts,
            on=on,
            humidity=self.parameters.relative_humidity,
        )
