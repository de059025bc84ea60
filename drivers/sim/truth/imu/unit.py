"""A simulated inertial unit: dies that warm and cool, a thermometer on each, elements, crosstalk and noise."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import cast

import numpy as np
from pydantic import BaseModel, ConfigDict, Field
from scipy.signal import lfilter

from drivers.sim.truth.base import Contribution, FloatArray, Scene
from drivers.sim.truth.bouc_wen import BoucWen
from drivers.sim.truth.imu.elements import AccelerometerSettings, ElementSettings, GyroSettings, along, powers, pulled
from drivers.sim.truth.imu.mounting import Mounting, MountingSettings, Stand
from drivers.sim.truth.noise import NoiseSettings, RateNoise

Matrix = tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]
NO_CROSSTALK: Matrix = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


class DieSettings(BaseModel):
    """A die with its thermometer: T' = (T_case + rise - T) / tau, of a bonded die 5-60 s."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    tau_s: float = Field(20.0, gt=0.0, description="behind the case [s]; 5-60")
    rise_degc: float = Field(3.0, description="by its own heat [degC]; 2-15")
    noise_degc: float = Field(0.005, ge=0.0, description="of a thermometer's mean over a second [degC]")
    offset_degc: float = Field(0.0, description="calibration error of the thermometer [degC]")


class ImuSettings(BaseModel):
    """A simulated inertial unit. Dies: one of each gyro, and one of the accelerometers."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    gyros: tuple[GyroSettings, GyroSettings, GyroSettings] = (GyroSettings(), GyroSettings(), GyroSettings())
    accelerometers: tuple[AccelerometerSettings, AccelerometerSettings, AccelerometerSettings] = (
        AccelerometerSettings(), AccelerometerSettings(), AccelerometerSettings(),
    )  # fmt: skip
    gyro_crosstalk_ppm: Matrix = Field(NO_CROSSTALK, description="of row's output from column's [ppm]; 100-3000")
    accelerometer_crosstalk_ppm: Matrix = Field(NO_CROSSTALK, description="the same of the accelerometers [ppm]")
    dies: tuple[DieSettings, DieSettings, DieSettings, DieSettings] = (
        DieSettings(tau_s=18.0), DieSettings(tau_s=22.0), DieSettings(), DieSettings(tau_s=30.0, rise_degc=2.0),
    )  # fmt: skip
    gyro_noise: NoiseSettings = Field(
        NoiseSettings(angle_random_walk=0.1, bias_instability=0.5, rate_random_walk=0.2),
        description="of a tactical unit: 0.1-0.6 deg/sqrt(h), 0.5-10 deg/h",
    )
    velocity_random_walk: float = Field(0.03, ge=0.0, description="of the accelerometers [m/s/sqrt(h)]; 0.02-0.1")
    acceleration_instability: float = Field(2e-4, ge=0.0, description="their bias instability [m/s^2]; 10-100 ug")


@dataclass(frozen=True, slots=True)
class ImuSignals:
    """Means over each step (n, ...), of `stay` a second, and what they should have been."""

    rate: FloatArray
    """(n, 3) [deg/h]."""
    acceleration: FloatArray
    """(n, 3) [m/s^2]."""
    temperatures: FloatArray
    """(n, 4) [degC]: gyros x, y, z and accelerometers."""
    true_rate: FloatArray
    """(n, 3) [deg/h] in the frame of the unit."""
    true_force: FloatArray
    """(n, 3) [m/s^2]."""


class _Follower:
    """First-order lag of a record in steps, kept from one stay to the next; starts in equilibrium."""

    def __init__(self, tau_s: float, step_s: float) -> None:
        self._keep = float(np.exp(-step_s / tau_s)) if tau_s > 0.0 else 0.0
        self._last: float | None = None

    def __call__(self, value: FloatArray) -> FloatArray:
        start = float(value[0]) if self._last is None else self._last
        out, _ = lfilter([1.0 - self._keep], [1.0, -self._keep], value, zi=[self._keep * start])
        self._last = float(out[-1])
        return np.asarray(out)


class SimulatedImu:
    """One inertial unit in its mounting; deterministic by seed."""

    def __init__(self, settings: ImuSettings, mounting: MountingSettings, seed: int, step_s: float = 1.0) -> None:
        self.settings, self.mounting, self._step_s = settings, Mounting(mounting, seed), step_s
        self._dies = [_Follower(die.tau_s, step_s) for die in settings.dies]
        self._own = [_Follower(element.lag_s, step_s) for element in self._elements]
        self._loops = [
            BoucWen(amplitude_dph=element.loop, length_degc=element.loop_degc).start(1.0, np.random.default_rng(0))
            for element in self._elements
        ]
        gyro, of_force = settings.gyro_noise, NoiseSettings(
            # RateNoise turns deg/sqrt(h) into deg/h by 60; (m/s)/sqrt(h) into m/s^2 takes 1/60.
            angle_random_walk=settings.velocity_random_walk / 3600.0,
            bias_instability=settings.acceleration_instability, rate_random_walk=0.0,
        )  # fmt: skip
        self._noise = [
            RateNoise(gyro if i < 3 else of_force, step_s, [np.random.default_rng([seed, 3, i, k]) for k in range(3)])
            for i in range(6)
        ]
        self._thermometers = np.random.default_rng([seed, 5])

    @property
    def _elements(self) -> tuple[ElementSettings, ...]:
        return (*self.settings.gyros, *self.settings.accelerometers)

    def stay(self, stand: Stand, case: FloatArray) -> ImuSignals:
        """Stay in one attitude while the case has these temperatures (seconds,) [degC]."""
        signals = self.measured(*self.mounting.stay(stand), case)
        white = self.white(len(case), 1.0)
        return replace(signals, rate=signals.rate + white[:, :3], acceleration=signals.acceleration + white[:, 3:])

    def white(self, samples: int, rate_hz: float) -> FloatArray:
        """White noise of the outputs (samples, 6), gyros first."""
        return np.stack([noise.white(samples, rate_hz) for noise in self._noise], axis=1)

    def measured(self, rate: FloatArray, force: FloatArray, case: FloatArray) -> ImuSignals:
        """Signals without white noise of rates [deg/h] and forces [m/s^2] (n, 3) in the frame of the unit, means over
        each step, while the case has these temperatures (n,) [degC].
        """
        dies = [follow(case + die.rise_degc) for follow, die in zip(self._dies, self.settings.dies, strict=True)]
        inner = [follow(dies[min(i, 3)]) for i, follow in enumerate(self._own)]
        outputs = respond(self.settings, rate, force, inner)
        for i, (noise, loop, element) in enumerate(zip(self._noise, self._loops, self._elements, strict=True)):
            outputs[:, i] += noise.slow(len(case) + 1)[1:]
            if element.loop:
                outputs[:, i] += _opened(loop, inner[i])
        read = np.stack(
            [t + d.offset_degc + d.noise_degc / np.sqrt(self._step_s) * self._thermometers.standard_normal(len(t))
             for t, d in zip(dies, self.settings.dies, strict=True)], axis=1,
        )  # fmt: skip
        return ImuSignals(outputs[:, :3], outputs[:, 3:], read, rate, force)


def _opened(loop: Contribution, temperature: FloatArray) -> FloatArray:
    """The loop second by second; of the scene it reads the thermometer only."""
    return np.array([
        loop(cast(Scene, SimpleNamespace(sensor=np.array([at, at]))))[-1] for at in temperature.tolist()
    ])  # fmt: skip


def respond(settings: ImuSettings, rate: FloatArray, force: FloatArray, inner: list[FloatArray]) -> FloatArray:
    """Outputs (n, 6) without noise and memory, of rates [deg/h] and forces [m/s^2] (n, 3), elements at `inner`."""
    out = np.empty((len(rate), 6))
    gyros = np.stack([along(g, i, rate, inner[i]) for i, g in enumerate(settings.gyros)], axis=1)
    others = np.stack([along(a, i, force, inner[3 + i]) for i, a in enumerate(settings.accelerometers)], axis=1)
    out[:, :3] = gyros + 1e-6 * gyros @ np.array(settings.gyro_crosstalk_ppm).T
    out[:, 3:] = others + 1e-6 * others @ np.array(settings.accelerometer_crosstalk_ppm).T
    for i, gyro in enumerate(settings.gyros):
        out[:, i] += powers(gyro.bias, inner[i]) + pulled(gyro, force, inner[i])
    for i, accelerometer in enumerate(settings.accelerometers):
        out[:, 3 + i] += powers(accelerometer.bias, inner[3 + i])
    return out
