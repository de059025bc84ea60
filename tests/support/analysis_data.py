"""Small records of a gyro on a thermal cycle, with a known truth, for the tests of the analysis half."""

from __future__ import annotations

import numpy as np

from bench.base.channels import FloatArray
from bench.record.dataset import Dataset, Segment

LEGS = (("cold soak", -40.0, -40.0), ("up", -40.0, 85.0), ("hot soak", 85.0, 85.0), ("down", 85.0, 20.0))
LEGS += (("middle soak", 20.0, 20.0), ("down to cold", 20.0, -40.0))


def thermal_cycle(interval_s: float = 30.0, leg_s: float = 3600.0) -> Dataset:
    """A cycle with soaks at -40, 85 and 20 degC and all channels of the regression; the rate is zero."""
    rows = round(leg_s / interval_s)
    time = (np.arange(rows * len(LEGS)) + 0.5) * interval_s
    segment = np.repeat(np.arange(len(LEGS)), rows)
    inside = (np.arange(rows) + 0.5) / rows
    temperature = np.concatenate([begin + (end - begin) * inside for _, begin, end in LEGS])
    # Soaks creep a little, as real ones do.
    temperature = temperature + 0.05 * np.sin(time / 700.0)
    channels = {
        "rate": np.zeros(time.size),
        "temperature": temperature,
        "frequency": 14000.0 - 0.07 * temperature + 0.4 * np.sin(time / 900.0),
        "drive": 1.0 + 2e-4 * temperature + 3e-3 * np.cos(time / 1300.0),
        "quadrature": 0.05 * np.sin(time / 2100.0),
    }
    segments = []
    for i, (name, begin, end) in enumerate(LEGS):
        direction = "constant" if begin == end else "heating" if end > begin else "cooling"
        segments.append(
            Segment(i, name, "soak" if begin == end else "ramp", i * leg_s, (i + 1) * leg_s, direction, end)
        )
    return Dataset("cycle", time, channels, segment, tuple(segments), interval_s)


def with_bias(dataset: Dataset, bias: FloatArray, name: str = "cycle") -> Dataset:
    """The same record with this rate [deg/h]."""
    moved = dataset.with_channel("rate", bias)
    return Dataset(name, moved.time, moved.channels, moved.segment, moved.segments, moved.interval_s)


def curve(temperature: FloatArray) -> FloatArray:
    """A bias over temperature that a cubic cannot follow [deg/h]."""
    return 3.0 + 0.05 * temperature - 3e-4 * temperature**2 + 0.6 * np.sin(temperature / 11.0)


def white(dataset: Dataset, sigma_dph: float, seed: int = 0) -> FloatArray:
    """White noise [deg/h], (n,)."""
    return sigma_dph * np.random.default_rng(seed).normal(size=len(dataset))
