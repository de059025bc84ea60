"""The section of the station file on the supply that switches the units' power."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, Field

from bench.base import STRICT

Text = Annotated[str, Field(min_length=1)]


class SupplySettings(BaseModel):
    """The supply of the units, where the bench may switch it: profiles with a `power_cycle` need it."""

    model_config = STRICT

    driver: Literal["scpi"] = "scpi"
    """A programmable supply that speaks SCPI."""
    port: Text | None = None
    """Serial port, such as /dev/ttyUSB1, or socket://HOST:PORT; needed where the station is real."""
    output: Annotated[int, Field(ge=1, le=64)] | None = None
    """Output that all units are on; left out: the supply has one."""
    baudrate: Annotated[int, Field(ge=300, le=1_000_000)] = 9600
    """Of a serial port."""
    timeout_s: Annotated[float, Field(gt=0, le=60)] = 2.0
    """Longest time for an answer."""
