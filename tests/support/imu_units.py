"""The record of a simulated inertial unit, made in memory."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from bench.analysis.imu.diagnosis import Diagnosis
from bench.analysis.imu.fitting import fit_imu
from bench.analysis.imu.plan import ImuPlan, StaySettings
from bench.analysis.imu.rows import ImuRows
from bench.analysis.imu.stored import ImuCalibration
from bench.record import ImuRecord, ImuSource
from benchmarks import imu_data
from drivers.sim.truth.imu.drawn import drawn


@lru_cache(maxsize=3)
def fitted(model=None):
    """Both triads of a short calibration, and their fit by a model, or the usual one."""
    rows = imu_data.record(drawn(1), imu_data.at_home(), 1, imu_data.calibration(1, (-30.0, 20.0, 70.0), 4.0))
    return ImuRows(*rows, 0), fit_imu(*rows, model)


@lru_cache(maxsize=3)
def imu_record(model=None) -> ImuRecord:
    """The record of this calibration, without anything that is wrong."""
    rows, fit = fitted(model)
    plan = ImuPlan(
        latitude_deg=imu_data.LATITUDE_DEG,
        gyro_thermometers=("temperature_1", "temperature_2", "temperature_3"),
        accelerometer_thermometers=("temperature_4",) * 3,
        stays=(StaySettings(from_s=0.0, to_s=1e5, attitude="x_up"),),
    )
    estimates = tuple(e for triad in fit.triads for e in triad.estimates((-20.0, 25.0, 60.0)))
    noise = np.random.default_rng(1).standard_normal((6, 5000))
    names = [f"{what}_{axis}" for what in ("rate", "acceleration") for axis in "xyz"]
    columns = {"time": 0.01 * np.arange(5000.0), **dict(zip(names, noise, strict=True))}
    made = ImuCalibration("SIM-IMU-0042", plan, rows, Diagnosis((), fit), (-28.0, 70.0), estimates, ())
    return made.record(columns, [ImuSource(file="imu.csv", sha256="0" * 64)])
