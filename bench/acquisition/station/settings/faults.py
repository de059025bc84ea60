"""Faults of a simulated station, to rehearse them: what, where and when, as written in its station file."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated

from pydantic import BaseModel, Field

from bench.base import STRICT
from drivers.sim.faults.named import ON_BUS, ON_MODBUS

CHAMBER = "chamber"
PANEL = {
    "door": "its door stands open",
    "alarm": "it reports an alarm",
    "sensor_break": "it has lost its sensor",
    "frozen": "its sensor shows the same for ever",
    "setpoint": "somebody at its panel sets `value` [degC]",
    "off": "somebody at its panel switches it off",
    "limits": "it takes set points up to `value` [degC] only",
    "restart": "its power is cut: nothing answers, and it comes back switched off, its set point at ambient",
}
"""What the controller of the chamber can show, whatever its wire does."""
REPLACED = "other_unit"
WIRE = {name: text for name, text in ON_MODBUS.items() if name != "echo"}
OF_CHAMBER = WIRE | PANEL
OF_UNIT = {name: text for name, text in ON_BUS.items() if name != "bus_off"} | {
    REPLACED: "another unit answers in its place, with serial number `value`"
}
OF_BUS = {name: text for name, text in ON_BUS.items() if name not in ("reset", "silent_reset", "twin")}
OF_INSTRUMENT = {
    "silence": "it answers nothing (on Modbus: its gateway says so)",
    "ignore": "it ignores commands",
    "frozen": "it shows the same for ever",
    "value": "it shows `value` for what is read first, in the unit of that channel",
    "switched_off": "somebody switches its output off at its panel",
}
NEED_VALUE = ("setpoint", "limits", "value", REPLACED)


class FaultSettings(BaseModel):
    """One fault of a simulated station."""

    model_config = STRICT

    at_s: Annotated[float, Field(ge=0)]
    """Bench time at which it begins [s]."""
    on: Annotated[str, Field(min_length=1)] = CHAMBER
    """`chamber`, a bus (what is received from it), the serial number of a unit (what it sends), or an instrument."""
    fault: Annotated[str, Field(min_length=1)]
    """Its name; docs/faults.md lists them."""
    for_s: Annotated[float, Field(gt=0)] | None = None
    """How long it lasts [s]; left out: to the end."""
    share: Annotated[float, Field(gt=0, le=1)] = 1.0
    """Share of the answers or frames that it strikes."""
    times: Annotated[int, Field(ge=1)] | None = None
    """Wire of the chamber: how many answers it strikes at most."""
    seconds: Annotated[float, Field(ge=0)] = 0.0
    """How late a delayed answer comes [s of wall time], how long a burst is held back or a reset takes [s]."""
    code: Annotated[int, Field(ge=1, le=255)] = 6
    """Number of an `exception`; 6: busy."""
    value: float | None = None
    """What `setpoint`, `limits`, `value` and `other_unit` need."""

    def __str__(self) -> str:
        value = "" if self.value is None else f" {self.value:g}"
        return f"{self.on}: {self.fault}{value}"

    def wrong(self, buses: Iterable[str], serials: Iterable[str], instruments: Iterable[str]) -> str:
        """What is wrong with it in a station with these buses, units and instruments; empty: nothing."""
        places = dict.fromkeys(instruments, OF_INSTRUMENT) | dict.fromkeys(serials, OF_UNIT)
        places |= dict.fromkeys(buses, OF_BUS) | {CHAMBER: OF_CHAMBER}
        known = places.get(self.on)
        if known is None:
            return f"on is {self.on!r}: must be chamber, a bus, a unit or an instrument of this station"
        if self.fault not in known:
            return f"fault {self.fault!r} on {self.on}: must be one of {', '.join(known)}"
        if self.fault in NEED_VALUE and self.value is None:
            return f"fault {self.fault!r} needs a `value`"
        return ""
