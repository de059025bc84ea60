"""The section of the station file on the rate table."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, Field, PositiveFloat, model_validator

from bench.base import STRICT

Text = Annotated[str, Field(min_length=1)]


class TableTruth(BaseModel):
    """What is wrong with a simulated rate table."""

    model_config = STRICT

    scale_error_ppm: Annotated[float, Field(gt=-10_000, lt=10_000)] = 0.0
    """How much more than the true angle its encoder counts [ppm]."""


class RateTableSettings(BaseModel):
    """The rate table that the units are mounted on."""

    model_config = STRICT

    driver: Literal["cia402", "aerosmith"] = "cia402"
    """A CiA 402 drive in profile velocity mode on CAN, or an Ideal Aerosmith on a serial line."""
    bus: Text | None = None
    """CiA 402: name of the bus that the drive is on; no unit may be on it."""
    node: Annotated[int, Field(ge=1, le=126)] = 1
    """CiA 402: node number of the drive."""
    counts_per_degree: PositiveFloat | None = None
    """CiA 402: units of position in one degree of the table, gear included; velocity is in the same per second."""
    sample_ms: Annotated[int, Field(ge=5, le=1000)] = 20
    """CiA 402: interval of the encoder's readings."""
    latency_ms: Annotated[float, Field(ge=0, le=1000)] = 0.0
    """CiA 402: by how much a reading of the velocity lags behind the motion."""
    heartbeat_s: Annotated[float, Field(ge=2, le=60)] = 10.0
    """CiA 402: longest silence of bench or drive before the axis is stopped; longer than a chamber that misses one
    answer keeps the bench busy (three times its timeout, twice that on a serial line)."""
    port: Text | None = None
    """Aerosmith: serial port, such as /dev/ttyUSB0."""
    jog_unit: Literal["deg/s", "deg/min"] = "deg/s"
    """Aerosmith: unit of its JOG command; verified by position over time before anything turns."""
    highest_dps: PositiveFloat
    """Fastest rate that is ever commanded, either way [deg/s]."""
    accel_dps2: PositiveFloat
    """Acceleration [deg/s^2]; what table, fixture and cables bear."""
    tolerance_dps: PositiveFloat = 0.05
    """How far the mean over a second may be off its rate, beside 0.2 % of it."""
    simulation: TableTruth | None = None
    """What is wrong with a simulated table; left out: nothing."""

    @model_validator(mode="after")
    def _complete(self) -> RateTableSettings:
        needs = ("bus", "counts_per_degree") if self.driver == "cia402" else ("port",)
        if missing := [name for name in needs if getattr(self, name) is None]:
            raise ValueError(f"a table with driver {self.driver} needs {' and '.join(missing)}")
        return self
