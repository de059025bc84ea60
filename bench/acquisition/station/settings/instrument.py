"""The section of the station file on its instruments beside chamber and units."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, Field, model_validator

from bench.acquisition.station.settings.link import LinkSettings
from bench.base import CHANNELS, STRICT, Measured, PlacedError
from drivers.errors import ConfigError
from drivers.instrument import MODBUS, Instrument, Reading, Setting, open_line
from drivers.units import Conversion, conversion

Text = Annotated[str, Field(min_length=1)]
_OUTPUT_ON = Setting(command="OUTP ON", query="OUTP?", value=1)
_OUTPUT_OFF = Setting(command="OUTP OFF", query="OUTP?", value=0)


class ReadingSettings(Reading):
    """One value that is read again and again, as a channel of the run."""

    channel: Measured
    """Channel of the run that it becomes; each is measured once in a station."""

    @model_validator(mode="after")
    def _converts(self) -> ReadingSettings:
        try:
            self.conversion()
        except ConfigError as error:
            raise PlacedError(str(error), ("unit",)) from None
        return self

    def conversion(self) -> Conversion:
        """From the unit of the instrument into that of the channel."""
        kept = CHANNELS[self.channel].unit
        return conversion(self.unit or kept, kept, self.channel)


class InstrumentSettings(BaseModel):
    """An instrument beside chamber and units: thermometer, supply, multimeter, hygrometer."""

    model_config = STRICT

    name: Text
    """What the instrument is called in events and messages."""
    address: Text | None = None
    """SCPI: socket://HOST:PORT, a serial port such as /dev/ttyUSB1, or a VISA resource such as
    TCPIP::192.168.1.20::INSTR (extra `instruments`). Modbus: tcp://HOST:PORT, rtu+tcp://HOST:PORT or
    rtu:///dev/ttyUSB0?baudrate=9600. Left out in a simulated station."""
    baudrate: Annotated[int, Field(ge=300, le=1_000_000)] = 9600
    """Of a serial port with SCPI."""
    device: Annotated[int, Field(ge=0, le=247)] = 1
    """Modbus address."""
    timeout_s: Annotated[float, Field(gt=0, le=10)] = 2.0
    """Longest time for an answer."""
    visa_library: Text = "@py"
    """VISA library: `@py` is pyvisa-py, `@ivi` that of a maker."""
    identity: Text | None = None
    """Text that the answer to `*IDN?` contains, such as the serial number: another instrument is refused."""
    identifies: bool = True
    """Off: an old instrument that does not know `*IDN?`."""
    read: tuple[ReadingSettings, ...] = ()
    """What is read and recorded."""
    set: tuple[Setting, ...] = ()
    """What is set before a run, in this order, and read back."""
    on: Setting | None = None
    """What switches it on, after `set`."""
    off: Setting | None = None
    """What switches it off: part of the safe state, unless `leave_on`."""
    leave_on: bool = False
    """The safe state leaves it on: a supply whose units keep their power after a run."""
    powers_units: bool = False
    """A supply that all units are on: segments of kind `power_cycle` switch it. Without `on` and `off` by OUTP ON and
    OUTP OFF."""
    optional: bool = False
    """Its silence is noted and ends no run."""
    link: LinkSettings = LinkSettings(lost_after_s=30.0)
    """What its silence means."""

    @model_validator(mode="after")
    def _consistent(self) -> InstrumentSettings:
        if self.powers_units and (self.on is None) != (self.off is None):
            missing = "on" if self.on is None else "off"
            raise PlacedError("a supply that switches the units needs both `on` and `off`, or none", (missing,))
        if self.on is not None and self.off is None:
            raise PlacedError("what is switched on needs an `off`, for the safe state", ("on",))
        if self.optional and (self.off is not None or self.powers_units):
            raise PlacedError("what the bench switches cannot be optional: it has to be off in the end", ("optional",))
        if not (self.needed or self.powers_units):
            raise ValueError("does nothing: give it `read`, `set`, `on` and `off`, or `powers_units`")
        scpi = {f"{name}.{i}": entry.query is not None for name in ("read", "set") for i, entry in
                enumerate(getattr(self, name))} | {
            name: entry.query is not None for name in ("on", "off") if (entry := getattr(self, name)) is not None
        }  # fmt: skip
        if len({*scpi.values()}) > 1:
            raise ValueError("has queries (SCPI) and registers (Modbus): it speaks one of them")
        if self.address is not None:
            modbus = self.address.startswith(MODBUS)
            if any(one is modbus for one in scpi.values()):
                spoken = "Modbus, which has `modbus`" if modbus else "SCPI, which has `query`"
                raise PlacedError(f"{self.address} is an address of {spoken}", ("address",))
        return self

    @property
    def speaks_modbus(self) -> bool:
        """Whether it speaks Modbus."""
        entries: list[Reading | Setting] = [*self.read, *self.set, *filter(None, [self.on, self.off])]
        return any(entry.modbus is not None for entry in entries)

    @property
    def switch(self) -> tuple[Setting, Setting]:
        """What switches the units on, and what off."""
        return self.on or _OUTPUT_ON, self.off or _OUTPUT_OFF

    @property
    def needed(self) -> bool:
        """Whether every run needs it; a supply that only switches the units is needed where a profile does so."""
        return bool(self.read or self.set or (self.off and not self.leave_on) or (self.on and not self.powers_units))

    def open(self) -> Instrument:
        """Its driver; nothing is sent yet. ConfigError without the library that the address needs."""
        assert self.address is not None  # checked with the file
        line = open_line(
            self.address,
            baudrate=self.baudrate,
            timeout_s=self.timeout_s,
            device=self.device,
            library=self.visa_library,
        )
        return Instrument(self.name, line, self.identity)

    def identify(self, instrument: Instrument) -> str:
        """What it says it is; empty where it does not tell. IdentityError for another one."""
        return "" if self.speaks_modbus or not self.identifies else instrument.identify()

    def told(self) -> str:
        """What it is for, for people."""
        reads = [f"{reading.channel} every {reading.period_s:g} s" for reading in self.read]
        does = [*reads, *(f"set {setting.what}" for setting in self.set)]
        does += ["switches the units' power"] if self.powers_units else []
        does += [f"off in the safe state by {self.off.what}"] if self.off is not None and not self.leave_on else []
        return f"{self.name}{' (optional)' if self.optional else ''}: {', '.join(does)}"
