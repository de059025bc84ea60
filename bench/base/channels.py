"""The vocabulary of the data: channel names, units and meanings; the only unit conversions of the bench.

A dataset, an imported table and `data.parquet` use these names as columns. Missing samples stay gaps (NaN, null).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

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
        Channel("supply_current", "A", "supply current, by an instrument"),
        Channel("chamber_temperature", "degC", "chamber air"),
        Channel("chamber_setpoint", "degC", "set point in force"),
        Channel("compressor", "0/1", "compressor running"),
        Channel("applied_rate", "deg/s", "rate table, from its own encoder"),
        Channel("table_angle", "deg", "the same; of runs whose profile names attitudes"),
        *(Channel(f"rate_{axis}", "deg/h", f"output of the gyro {axis}, raw") for axis in "xyz"),
        *(Channel(f"acceleration_{axis}", "m/s^2", f"output of the accelerometer {axis}, raw") for axis in "xyz"),
        *(Channel(f"temperature_{number}", "degC", f"thermometer {number} of the unit") for number in range(1, 10)),
        Channel("reference_temperature", "degC", "reference thermometer of the station"),
        *(Channel(f"reference_temperature_{n}", "degC", f"its reference thermometer {n}") for n in range(2, 5)),
        Channel("humidity", "%", "relative humidity, by an instrument"),
        Channel("pressure", "hPa", "pressure of the air, by an instrument"),
        Channel("voltage", "V", "voltage that a multimeter measures"),
        Channel("current", "A", "current that a multimeter measures"),
        Channel("resistance", "ohm", "resistance that a multimeter measures"),
        *(
            Channel(f"other_{n}", "1", f"further quantity {n} of an imported table, as it stands there")
            for n in range(1, 5)
        ),
    )
}

RATES = ("rate", "rate_x", "rate_y", "rate_z")
"""Outputs of gyros."""
ACCELERATIONS = ("acceleration_x", "acceleration_y", "acceleration_z")
"""Outputs of accelerometers."""
OUTPUTS = (*RATES, *ACCELERATIONS)
"""What a unit measures; every unit has one of them or more."""
THERMOMETERS = ("temperature", *(f"temperature_{number}" for number in range(1, 10)))
"""A unit's own sensors; the first that it has is the one of its models."""

Measured = Literal[
    "supply",
    "supply_current",
    "reference_temperature",
    "reference_temperature_2",
    "reference_temperature_3",
    "reference_temperature_4",
    "humidity",
    "pressure",
    "voltage",
    "current",
    "resistance",
]
INSTRUMENTS: tuple[str, ...] = get_args(Measured)
"""What instruments of a station may measure; `supply` where no unit sends it itself."""
OTHERS = tuple(f"other_{number}" for number in range(1, 5))
"""Quantities of imported tables that no other channel is, such as a vibration or a magnetic field."""
