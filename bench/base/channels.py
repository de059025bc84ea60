"""The vocabulary of the data: channel names, units and meanings; the only unit conversions of the bench.

A dataset, an imported table and `data.parquet` use these names as columns. Missing samples stay gaps (NaN, null).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

DPH_PER_DPS = 3600.0
"""One degree per second is this many degrees per hour."""

DPH_PER_RADPS = 3600.0 * 180.0 / np.pi
"""One radian per second is this many degrees per hour."""


@dataclass(frozen=True)
class Channel:
    """One column of a dataset."""

    name: str
    unit: str
    meaning: str
    required: bool = False


CHANNELS: dict[str, Channel] = {
    channel.name: channel
    for channel in (
        Channel(
            "time",
            "s",
            "since the start of the run, from the unit's own sample counter where it has one",
            True,
        ),
        Channel("rate", "deg/h", "gyro output, raw (zero-rate output when nothing turns)", True),
        Channel("temperature", "degC", "the unit's own sensor", True),
        Channel("frequency", "Hz", "resonance frequency"),
        Channel("drive", "V", "excitation (antinode) amplitude"),
        Channel("quadrature", "V", "quadrature amplitude"),
        Channel("supply", "V", "supply voltage"),
        Channel("chamber_temperature", "degC", "chamber air"),
        Channel("chamber_setpoint", "degC", "set point in force"),
        Channel("compressor", "0/1", "compressor running"),
        Channel("applied_rate", "deg/s", "rate table, from its own encoder"),
    )
}

REQUIRED = tuple(name for name, channel in CHANNELS.items() if channel.required)
