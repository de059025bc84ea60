"""What a run measured, for other programs: every sample as MF4 (ASAM MDF 4), and the noise as Kalibr's imu.yaml."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from bench.base import CHANNELS, InputError
from bench.record import RunFolder, SampleFile, use

MEASURED = ("mf4", "kalibr")
"""Formats of measured data; they need no calibration."""
_RADIANS = np.pi / 180.0
_PER_SQRT_S = 60.0
"""Square root of an hour in square roots of seconds."""


def write_mf4(folder: Path, path: Path) -> None:
    """Every sample of a run: a group for each channel, with the times of its own samples; a gap stays a gap.

    InputError without asammdf, or where the run has no data.
    """
    try:
        from asammdf import MDF, Signal
    except ImportError:
        raise InputError("MF4 needs asammdf: pip install 'gyro-thermal-bench[mf4]'", folder) from None
    run = RunFolder(folder)
    manifest = run.manifest()
    if not run.data.is_file():
        raise InputError("data.parquet is missing: the run has no samples", folder)
    use(folder, run.data.name)
    path.parent.mkdir(parents=True, exist_ok=True)
    with (
        SampleFile(run.data) as table,
        MDF(version="4.10") as made,
        tempfile.TemporaryDirectory(dir=path.parent, prefix=".mf4-") as scratch,
    ):
        time = table.read(["time"])["time"]
        made.start_time = datetime.fromisoformat(manifest.created)
        made.header.comment = f"{manifest.unit}, run {manifest.run}, profile {manifest.profile}"
        for name in table.names:
            if name == "time":
                continue
            column = table.read([name])[name]
            there = np.isfinite(column)
            values = column[there] if name != "segment" else column[there].astype(np.int16)
            if not values.size:
                continue
            known = CHANNELS.get(name)
            unit, words = ("", "") if known is None else (known.unit, known.meaning)
            made.append(
                Signal(values, time[there], name=name, unit=unit, comment=words), comment=name, common_timebase=True
            )
        whole = Path(scratch) / "run.mf4"
        made.save(whole, overwrite=True, compression=2)
        whole.replace(path)


def kalibr_yaml(noise: Mapping[str, Any], sample_hz: float | None, source: str) -> str:
    """Kalibr's imu.yaml of a gyro: N as noise density, K as random walk; `noise` is what `bench noise` found.

    1 deg/sqrt(h) is pi/180/60 rad/s/sqrt(Hz), 1 deg/h/sqrt(h) is pi/180/3600/60 rad/s^2/sqrt(Hz).
    """
    white, walk = noise["angle_random_walk"], noise["rate_random_walk"]
    density, _ = _stated(white, _RADIANS / _PER_SQRT_S)
    drift, told = _stated(walk, _RADIANS / 3600.0 / _PER_SQRT_S)
    why = "" if told else "; not told from zero by these data: the upper end of its 95 % interval"
    return (
        f"# Noise of a gyro for Kalibr, from {source}\n"
        "# One axis was measured, at rest; larger values are usual for filters outside the laboratory.\n"
        "rostopic: /imu0\n"
        f"update_rate: {'null    # not known: fill in' if sample_hz is None else float(sample_hz)}    # Hz\n"
        f"gyroscope_noise_density: {density:.6e}    # rad/s/sqrt(Hz), angle random walk N\n"
        f"gyroscope_random_walk: {drift:.6e}    # rad/s^2/sqrt(Hz), rate random walk K{why}\n"
        "# The bench measured no accelerometer. Kalibr needs both: fill them in from the data sheet, it refuses null.\n"
        "accelerometer_noise_density: null    # m/s^2/sqrt(Hz)\n"
        "accelerometer_random_walk: null    # m/s^3/sqrt(Hz)\n"
    )


def _stated(found: Any, factor: float) -> tuple[float, bool]:
    """The value, or where it is not told from zero the upper end of its interval; whether it was told."""
    told = found.value > 0
    return (found.value if told else found.high) * factor, told
