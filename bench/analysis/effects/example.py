"""A small made-up run with every channel, on which effects are tried and drawn."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from bench.base import DPH_PER_DPS
from bench.record import Dataset, Segment

_CORNERS = (
    (0.0, 25.0), (0.5, 25.0), (1.1, 85.0), (1.8, 85.0), (2.425, 10.0), (2.9, 67.0), (4.7, -40.0), (5.4, -40.0),
    (6.0, 30.0), (6.5, -25.0), (7.1, 40.0), (7.5, 85.0), (8.1, 25.0), (9.0, 25.0),
)  # fmt: skip
"""Time [h] and temperature [degC]: soaks, ramps at 1 to 2 degC/min, minor loops on the way."""


@lru_cache(maxsize=1)
def example() -> Dataset:
    """Run of nine hours at 30 s with every channel; channels wander on their own, so that each effect can be seen."""
    interval_s = 30.0
    hours, corners = np.array(_CORNERS).T
    time = (np.arange(round(hours[-1] * 3600.0 / interval_s)) + 0.5) * interval_s
    temperature = np.interp(time / 3600.0, hours, corners) + 0.02 * np.sin(time / 700.0)
    warmer = temperature - 25.0
    table = 50.0 * np.array([0.0, 1.0, -1.0, 0.0, 2.0, -2.0])[(time // 600.0).astype(np.int64) % 6]
    running = ((time % 900.0 < 500.0) & (temperature < 0.0)).astype(np.float64)
    channels = {
        "temperature": temperature,
        "frequency": 14000.0 * (1.0 - 8e-6 * warmer - 1.2e-8 * warmer**2) + 0.02 * np.sin(time / 1900.0),
        "drive": 2.5 * (1.0 + 1.2e-4 * warmer + 2e-3 * np.sin(time / 2600.0)),
        "quadrature": 0.5 + 0.004 * warmer + 1.5 / (1.0 + ((temperature + 8.0) / 10.0) ** 2),
        "supply": 5.0 + 0.01 * np.sin(time / 1100.0) - 0.02 * running,
        "chamber_temperature": temperature + 1.0,
        "chamber_setpoint": np.interp(time / 3600.0, hours, corners),
        "compressor": running,
        "applied_rate": table,
        "rate": DPH_PER_DPS * table,
    }
    piece = np.searchsorted(hours[1:] * 3600.0, time).astype(np.int64)
    ends = list(zip(hours[:-1] * 3600.0, hours[1:] * 3600.0, np.diff(corners), strict=True))
    names = {1.0: "heating", -1.0: "cooling", 0.0: "constant"}
    segments = tuple(
        Segment(i, f"{names[float(np.sign(way))]} {i}", "ramp" if way else "soak", float(a), float(b),
                names[float(np.sign(way))])
        for i, (a, b, way) in enumerate(ends)
    )  # fmt: skip
    return Dataset("example", time, channels, piece, segments, interval_s)
