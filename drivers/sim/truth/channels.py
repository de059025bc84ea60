"""Channels that the unit reports beside the rate: thermometer, resonance frequency, drive, quadrature, supply."""

from __future__ import annotations

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from drivers.sim.truth.base import FloatArray, Lag, OrnsteinUhlenbeck, Scene

REFERENCE_DEGC = 25.0


class _Settings(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class ThermometerSettings(_Settings):
    """The unit's own temperature sensor."""

    tau_s: float = Field(8.0, gt=0.0, description="lag behind the case [s]")
    noise_degc: float = Field(0.01, ge=0.0, description="white noise of one sample at 50 Hz [degC]")
    step_degc: float = Field(0.005, ge=0.0, description="quantisation [degC]; 0 for none")
    offset_degc: float = Field(0.0, description="calibration error [degC]")


class FrequencySettings(_Settings):
    """Resonance frequency of the drive mode; follows the resonator's temperature."""

    nominal_hz: float = Field(14000.0, gt=0.0, description="at 25 degC [Hz]")
    tcf_ppm_per_degc: float = Field(
        -8.0, description="first-order coefficient [ppm/degC]; elinvar +-1..10, silicon -30"
    )
    tcf2_ppb_per_degc2: float = Field(-12.0, description="second-order coefficient [ppb/degC^2]")
    wander_ppm: float = Field(0.05, ge=0.0, description="slow wander, standard deviation [ppm]")
    wander_tau_s: float = Field(2400.0, gt=0.0, description="its correlation time [s]")
    noise_hz: float = Field(0.0005, ge=0.0, description="white noise of one sample at 50 Hz [Hz]")


class DriveSettings(_Settings):
    """Amplitude of the drive mode as the gain control holds it."""

    nominal_v: float = Field(2.5, gt=0.0, description="at 25 degC [V]")
    slope_ppm_per_degc: float = Field(120.0, description="drift of the amplitude reference [ppm/degC]; usual 50-500")
    curve_ppm_per_degc2: float = Field(0.6, description="its curvature [ppm/degC^2]")
    wander_ppm: float = Field(80.0, ge=0.0, description="slow wander, standard deviation [ppm]")
    wander_tau_s: float = Field(1800.0, gt=0.0, description="its correlation time [s]")
    noise_v: float = Field(0.0001, ge=0.0, description="white noise of one sample at 50 Hz [V]")


class Crossing(_Settings):
    """A parasitic mode that crosses the drive mode at one temperature and raises the quadrature there."""

    at_degc: float = Field(description="temperature of the crossing [degC]")
    width_degc: float = Field(gt=0.0, description="half width at half height [degC]")
    height_dps: float = Field(description="quadrature at the crossing [deg/s]")


class QuadratureSettings(_Settings):
    """Residual quadrature: stiffness anisotropy, smooth over temperature, with mode crossings."""

    volt_per_dps: float = Field(0.05, gt=0.0, description="scale of the reported amplitude [V per deg/s]")
    offset_dps: float = Field(2.0, description="at 25 degC [deg/s]")
    slope_dps_per_degc: float = Field(0.01, description="[deg/s per degC]")
    curve_dps_per_degc2: float = Field(0.0, description="[deg/s per degC^2]")
    crossings: tuple[Crossing, ...] = Field((), description="mode crossings")
    wander_dps: float = Field(0.002, ge=0.0, description="slow wander, standard deviation [deg/s]")
    wander_tau_s: float = Field(1200.0, gt=0.0, description="its correlation time [s]")
    noise_v: float = Field(0.0001, ge=0.0, description="white noise of one sample at 50 Hz [V]")


class SupplySettings(_Settings):
    """Supply at the unit's pins."""

    wander_v: float = Field(0.005, ge=0.0, description="slow wander, standard deviation [V]")
    wander_tau_s: float = Field(900.0, gt=0.0, description="its correlation time [s]")
    sag_v: float = Field(0.02, description="sag while the compressor loads the mains [V]")
    sag_tau_s: float = Field(3.0, gt=0.0, description="time constant of the sag [s]")


class ChannelSettings(_Settings):
    """Settings of all channels, each with defaults."""

    thermometer: ThermometerSettings = ThermometerSettings()
    frequency: FrequencySettings = FrequencySettings()
    drive: DriveSettings = DriveSettings()
    quadrature: QuadratureSettings = QuadratureSettings()
    supply: SupplySettings = SupplySettings()


class Channels:
    """Fills a scene with the channels' physics, then reads them as the unit's electronics would."""

    def __init__(self, settings: ChannelSettings, node_s: float, rngs: list[np.random.Generator]) -> None:
        self._s = settings
        read, *wander = rngs
        f, a, q, v = settings.frequency, settings.drive, settings.quadrature, settings.supply
        sizes = (f.wander_ppm * 1e-6, a.wander_ppm * 1e-6, q.wander_dps, v.wander_v)
        taus = (f.wander_tau_s, a.wander_tau_s, q.wander_tau_s, v.wander_tau_s)
        self._wander = [
            OrnsteinUhlenbeck(np.array([tau]), np.array([size]), node_s, rng)
            for tau, size, rng in zip(taus, sizes, wander, strict=True)
        ]
        self._sag = Lag(v.sag_tau_s)
        self._read = read

    def supply(self, nominal_v: float, compressor: float, nodes: int, node_s: float) -> FloatArray:
        """Supply at the pins [V] over the nodes of a step, shape `(nodes,)`."""
        sag = self._sag(node_s, np.full(nodes, compressor))
        return nominal_v + self._wander[3](nodes) - self._s.supply.sag_v * sag

    def fill(self, scene: Scene) -> None:
        """Set frequency, drive and quadrature of the scene from the resonator's temperature."""
        f, a, q = self._s.frequency, self._s.drive, self._s.quadrature
        t = scene.resonator
        d, nodes = t - REFERENCE_DEGC, len(t)
        shift = (1e-6 * f.tcf_ppm_per_degc + 1e-9 * f.tcf2_ppb_per_degc2 * d) * d + self._wander[0](nodes)
        scene.frequency = f.nominal_hz * (1.0 + shift)
        scene.drive_share = 1e-6 * (a.slope_ppm_per_degc + a.curve_ppm_per_degc2 * d) * d + self._wander[1](nodes)
        scene.drive = a.nominal_v * (1.0 + scene.drive_share)
        quadrature = q.offset_dps + (q.slope_dps_per_degc + q.curve_dps_per_degc2 * d) * d + self._wander[2](nodes)
        for crossing in q.crossings:
            quadrature += crossing.height_dps / (1.0 + ((t - crossing.at_degc) / crossing.width_degc) ** 2)
        scene.quadrature_dps = quadrature

    def read(self, scene: Scene) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Reported temperature [degC], frequency [Hz], drive [V] and quadrature [V], each `(m,)`."""
        t, f, a, q = self._s.thermometer, self._s.frequency, self._s.drive, self._s.quadrature
        white = self._read.standard_normal((len(scene.time) - 1, 4))
        temperature = scene.sensor[:-1] + t.offset_degc + t.noise_degc * white[:, 0]
        if t.step_degc:
            temperature = np.round(temperature / t.step_degc) * t.step_degc
        frequency = scene.frequency[:-1] + f.noise_hz * white[:, 1]
        drive = scene.drive[:-1] + a.noise_v * white[:, 2]
        quadrature = q.volt_per_dps * scene.quadrature_dps[:-1] + q.noise_v * white[:, 3]
        return temperature, frequency, drive, quadrature
