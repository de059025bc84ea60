"""The noise of an inertial unit as Kalibr's imu.yaml.

Source: ethz-asl/kalibr, wiki "IMU Noise Model": noise density [rad/s/sqrt(Hz)], [m/s^2/sqrt(Hz)] and random walk
[rad/s^2/sqrt(Hz)], [m/s^3/sqrt(Hz)], one for each triad; zero is refused.
"""

from __future__ import annotations

import numpy as np

from bench.record import ImuRecord, ImuTriad

_RADIANS = np.pi / 180.0 / 3600.0
_TOLD = 1e-3
"""Share of the rows' variance below which a random walk is not told from zero."""


def kalibr(record: ImuRecord) -> tuple[str, tuple[str, ...]]:
    """The text of imu.yaml, and what it lacks, line by line."""
    rate = "null    # not known: fill in" if record.sample_hz is None else f"{record.sample_hz:.6g}"
    lines = [
        f"# Noise of inertial unit {record.unit or 'without a serial number'}, calibrated {record.created}, for Kalibr",
        "# Density of the noisiest axis, random walk of all three, at rest in a laboratory; filters outside need more.",
        "rostopic: /imu0",
        f"update_rate: {rate}    # Hz",
    ]
    names = {"gyro": ("gyroscope", "rad/s", "rad/s^2"), "accelerometer": ("accelerometer", "m/s^2", "m/s^3")}
    for triad in record.triads:
        name, unit, slope = names[triad.kind]
        density, walk, told = noise_of(triad, record)
        why = "" if told else "; not told from zero: a walk that would make all slow noise of this record"
        lines.append(f"{name}_noise_density: {_number(density)}    # {unit}/sqrt(Hz)")
        lines.append(f"{name}_random_walk: {walk:.6e}    # {slope}/sqrt(Hz){why}")
    lost = (
        "bias, scale factors, misalignment, g-sensitivity, second order: it holds noise alone",
        "noise of each axis",
    )
    return "\n".join((*lines, "")), lost


def noise_of(triad: ImuTriad, record: ImuRecord) -> tuple[float | None, float, bool]:
    """Density of the noisiest axis and random walk of all three, in rad or m and seconds, and whether a walk was seen.

    Where none was, the one that in the record's time would grow as large as flicker and white noise of a row.
    """
    size = _RADIANS if triad.kind == "gyro" else 1.0
    densities = [axis.noise_density for axis in triad.axes if axis.noise_density is not None]
    hours = max(record.interval_s, record.time_s[-1] - record.time_s[0]) / 3600.0
    walks = [axis.variances.get("walk", 0.0) for axis in triad.axes]
    slow = [axis.variances.get("flicker", 0.0) + axis.variances.get("white", 0.0) for axis in triad.axes]
    # How a bias walks, few hours tell of one axis: the mean of three.
    walk, rest = float(np.mean(walks)), float(np.mean(slow))
    told = walk * hours > _TOLD * rest
    variance = walk if told else rest / hours
    # K [unit / sqrt(h)] is K / 60 [unit / s / sqrt(Hz)].
    return (size * max(densities) if densities else None), size * float(np.sqrt(variance)) / 60.0, told


def _number(value: float | None) -> str:
    return (
        "null    # not measured: Kalibr needs it, fill it in from the data sheet" if value is None else f"{value:.6e}"
    )
