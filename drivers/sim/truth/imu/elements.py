"""One sensing element of an inertial unit: where its axis points, and what it makes of what happens along it.

Every element has a direction of its own, given by two angles that drift with temperature; a triad is not a matrix here.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from drivers.sim.truth.base import FloatArray

REFERENCE_DEGC = 25.0
STANDARD_GRAVITY = 9.80665
"""Conventional value of one g [m/s^2] (ISO 80000-3)."""
_NEXT, _OVER_NEXT = (1, 2, 0), (2, 0, 1)

Three = tuple[float, float, float]
NOTHING: Three = (0.0, 0.0, 0.0)
Coefficients = Annotated[tuple[float, ...], Field(min_length=1, max_length=6)]


class _Settings(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class ElementSettings(_Settings):
    """What gyros and accelerometers have in common; d is the temperature of the element less 25 degC.

    Magnitudes: bias and scale factor of MEMS as in docs/effects.md; misalignment of dies and packages 0.1 to 1 mrad
    bonded, up to 10 mrad of a single package (data sheets of tactical units).
    """

    bias: Coefficients = Field((0.0,), description="a_k that the order k adds 50 K from 25 degC [unit of the output]")
    scale_ppm: float = Field(0.0, description="scale factor error at 25 degC [ppm]; 100-5000 before calibration")
    scale_ppm_per_degc: float = Field(0.0, description="its slope [ppm/degC]; 20-200")
    scale_ppb_per_degc2: float = Field(0.0, description="its curvature [ppb/degC^2]")
    tilt_mrad: tuple[float, float] = Field((0.0, 0.0), description="of the axis towards the next two axes [mrad]; 1-10")
    tilt_urad_per_degc: tuple[float, float] = Field((0.0, 0.0), description="their slopes [urad/degC]; 1-5")
    lag_s: float = Field(0.0, ge=0.0, description="the element behind the thermometer of its die [s]; 5-60")
    loop: float = Field(0.0, description="half opening of the mount's hysteresis loop [unit of the output]")
    loop_degc: float = Field(12.0, gt=0.0, description="way until the loop is open [degC]")


class GyroSettings(ElementSettings):
    """One gyro; outputs in deg/h. g-sensitivity 5-50 deg/h/g of a MEMS unit."""

    g_sensitivity: Three = Field(NOTHING, description="along x, y, z [deg/h/g]; 5-50")
    g_sensitivity_per_degc: Three = Field(NOTHING, description="its slope [deg/h/g/degC]; up to 1 % of it")


class AccelerometerSettings(ElementSettings):
    """One accelerometer; outputs in m/s^2. Second order 10-100 ug/g^2 (IEEE Std 1293, K2 of pendulous units)."""

    second_order_ug_per_g2: float = Field(0.0, description="K2 at 25 degC [ug/g^2]; 10-100")
    second_order_ug_per_g2_per_degc: float = Field(0.0, description="its slope [ug/g^2/degC]")


def powers(coefficients: Coefficients, temperature: FloatArray) -> FloatArray:
    """Sum of a_k (d / 50)^k at temperatures (n,) [degC]."""
    x, total = (temperature - REFERENCE_DEGC) / 50.0, np.zeros_like(temperature)
    for a in reversed(coefficients):
        total = total * x + a
    return total


def direction(element: ElementSettings, own: int, temperature: FloatArray) -> FloatArray:
    """Unit vector (n, 3) of the axis nominally along `own`, at temperatures (n,) [degC]: longitude and latitude."""
    d = temperature - REFERENCE_DEGC
    first, second = (
        1e-3 * at + 1e-6 * slope * d
        for at, slope in zip(element.tilt_mrad, element.tilt_urad_per_degc, strict=True)
    )  # fmt: skip
    axis = np.empty((len(temperature), 3))
    axis[:, own] = np.cos(second) * np.cos(first)
    axis[:, _NEXT[own]] = np.cos(second) * np.sin(first)
    axis[:, _OVER_NEXT[own]] = np.sin(second)
    return axis


def along(element: ElementSettings, own: int, vectors: FloatArray, temperature: FloatArray) -> FloatArray:
    """What an element makes (n,) of vectors (n, 3) in the frame of the unit: projected, then scaled."""
    d = temperature - REFERENCE_DEGC
    gain = 1e-6 * (element.scale_ppm + element.scale_ppm_per_degc * d) + 1e-9 * element.scale_ppb_per_degc2 * d**2
    seen = np.einsum("nk,nk->n", direction(element, own, temperature), vectors)
    if isinstance(element, AccelerometerSettings):
        k2 = element.second_order_ug_per_g2 + element.second_order_ug_per_g2_per_degc * d
        seen = seen + 1e-6 * k2 * seen * (seen / STANDARD_GRAVITY)
    out: FloatArray = seen + gain * seen
    return out


def pulled(gyro: GyroSettings, force: FloatArray, temperature: FloatArray) -> FloatArray:
    """Bias (n,) [deg/h] that specific force (n, 3) [m/s^2] makes of a gyro."""
    d = temperature - REFERENCE_DEGC
    total = np.zeros_like(temperature)
    for k in range(3):
        total += (gyro.g_sensitivity[k] + gyro.g_sensitivity_per_degc[k] * d) * force[:, k] / STANDARD_GRAVITY
    return total
