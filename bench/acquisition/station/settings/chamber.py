"""The sections of the station file on the chamber: how it is reached, what it may be asked for."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, Field, model_validator

from bench.acquisition.station.settings.link import LinkSettings
from bench.base import STRICT, PlacedError
from drivers.errors import ConfigError
from drivers.modbus import address
from drivers.sim.plant import PlantParameters

Text = Annotated[str, Field(min_length=1)]
Degc = Annotated[float, Field(ge=-273.15, le=1000)]
"""Temperature [degC] above absolute zero."""
DegcPerMin = Annotated[float, Field(gt=0, le=1000)]
Speed = DegcPerMin | Annotated[tuple[tuple[Degc, DegcPerMin], ...], Field(min_length=1)]


class Connection(BaseModel):
    """How the chamber's controller is reached."""

    model_config = STRICT

    url: Text
    """tcp://host:port, rtu+tcp://host:port or rtu:///dev/ttyUSB0?baudrate=9600"""
    device: Annotated[int, Field(ge=0, le=247)] = 1
    """Modbus address."""
    timeout_s: Annotated[float, Field(gt=0, le=60)] = 1.5
    """Longer than the controller's slowest answer."""

    @model_validator(mode="after")
    def _possible(self) -> Connection:
        try:
            address(self.url)
        except ConfigError as error:
            raise PlacedError(str(error), ("url",)) from None
        return self


class ChamberSettings(BaseModel):
    """The chamber: which register map, where, and what it may be asked for."""

    model_config = STRICT

    map: Text
    """Name of a shipped register map, or the path of a YAML file."""
    connection: Connection | None = None
    """Left out in a simulated station."""
    lowest_degc: Degc
    """Lowest set point that is ever sent."""
    highest_degc: Degc
    """Highest set point that is ever sent."""
    heating_degc_per_min: Speed
    """Fastest ramp that the chamber follows when heating: a number, or a list of [degC, rate] pairs."""
    cooling_degc_per_min: Speed
    """The same when cooling; small chambers are slow near their lowest temperature."""
    link: LinkSettings = LinkSettings()
    """What its silence means."""
    simulation: PlantParameters | None = None
    """Physics of a simulated chamber; left out: a bench chamber of 28 litres that reaches -42 degC."""

    @model_validator(mode="after")
    def _ordered(self) -> ChamberSettings:
        if self.lowest_degc >= self.highest_degc:
            raise ValueError(f"lowest_degc ({self.lowest_degc:g}) must be below highest_degc ({self.highest_degc:g})")
        if self.simulation is not None and "ambient_degc" in self.simulation.model_fields_set:
            raise PlacedError("the room has the station's ambient_degc; remove it here", ("simulation", "ambient_degc"))
        return self
