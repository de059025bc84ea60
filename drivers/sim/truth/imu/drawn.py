"""Inertial units with truths of their own: every parameter drawn from what such units scatter by."""

from __future__ import annotations

import numpy as np

from drivers.sim.truth.base import FloatArray
from drivers.sim.truth.imu.elements import AccelerometerSettings, ElementSettings, GyroSettings
from drivers.sim.truth.imu.unit import DieSettings, ImuSettings, Matrix

_OFF_DIAGONAL = 1.0 - np.eye(3)


def drawn(seed: int) -> ImuSettings:
    """A tactical unit before calibration (the magnitudes of `elements`), the same for the same seed."""
    rng = np.random.default_rng([seed, 17])
    gyros = [
        GyroSettings(
            bias=tuple(rng.normal(0.0, (300.0, 150.0, 60.0, 20.0)).tolist()),
            g_sensitivity=_three(rng.normal(0.0, 15.0, 3)),
            g_sensitivity_per_degc=_three(rng.normal(0.0, 0.1, 3)),
            **_common(rng).model_dump(exclude={"bias"}),
        )
        for _ in range(3)
    ]
    accelerometers = [
        AccelerometerSettings(
            bias=tuple(rng.normal(0.0, (0.05, 0.02, 0.006, 0.002)).tolist()),
            second_order_ug_per_g2=float(rng.normal(0.0, 100.0)),
            second_order_ug_per_g2_per_degc=float(rng.normal(0.0, 0.5)),
            **_common(rng).model_dump(exclude={"bias"}),
        )
        for _ in range(3)
    ]
    dies = [DieSettings(tau_s=float(rng.uniform(10.0, 40.0)), rise_degc=float(rng.uniform(2.0, 6.0))) for _ in range(4)]
    return ImuSettings(
        gyros=(gyros[0], gyros[1], gyros[2]),
        accelerometers=(accelerometers[0], accelerometers[1], accelerometers[2]),
        gyro_crosstalk_ppm=_matrix(rng.normal(0.0, 300.0, (3, 3)) * _OFF_DIAGONAL),
        accelerometer_crosstalk_ppm=_matrix(rng.normal(0.0, 300.0, (3, 3)) * _OFF_DIAGONAL),
        dies=(dies[0], dies[1], dies[2], dies[3]),
    )


def _common(rng: np.random.Generator) -> ElementSettings:
    tilt, drift = rng.normal(0.0, 1.0, 2).tolist(), rng.normal(0.0, 2.0, 2).tolist()
    return ElementSettings(
        scale_ppm=float(rng.normal(0.0, 2000.0)),
        scale_ppm_per_degc=float(rng.normal(0.0, 60.0)),
        scale_ppb_per_degc2=float(rng.normal(0.0, 200.0)),
        tilt_mrad=(tilt[0], tilt[1]),
        tilt_urad_per_degc=(drift[0], drift[1]),
    )


def _three(values: FloatArray) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])


def _matrix(values: FloatArray) -> Matrix:
    return _three(values[0]), _three(values[1]), _three(values[2])
