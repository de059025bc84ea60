"""The section of the station file on the units under test."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field, model_validator

from bench.acquisition.station.settings.signals import SignalSettings
from bench.base import OUTPUTS, STRICT, THERMOMETERS, PlacedError
from drivers.command_memory import Commands, wrong_place
from drivers.errors import ConfigError
from drivers.flash_objects import Addresses
from drivers.gyro import GyroDecoder
from drivers.layout import layout_of

Number = Annotated[int, Field(ge=0, le=15)]
Text = Annotated[str, Field(min_length=1)]


class FlashSettings(BaseModel):
    """How the unit's calibration memory is reached: on the bus of the unit, or by commands of your own."""

    model_config = STRICT

    protocol: Literal["canopen", "uds", "command"] = "canopen"
    """CANopen SDO, UDS over ISO-TP, or commands that are started on this computer."""
    node: Annotated[int, Field(ge=1, le=127)] | None = None
    """CANopen: node number; left out: 16 + the unit's number."""
    transfer: Literal["segmented", "expedited"] = "segmented"
    """CANopen: a whole image in one transfer, or word by word for units without segmented transfer."""
    request: Annotated[int, Field(ge=0, le=0x7FF)] | None = None
    """UDS: CAN identifier of our requests; left out: 0x6C0 + the unit's number."""
    answer: Annotated[int, Field(ge=0, le=0x7FF)] | None = None
    """UDS: CAN identifier of its answers; left out: 0x6D0 + the unit's number."""

    write: tuple[Text, ...] = ()
    """Command: program and arguments that write the image to the unit and print the bytes that they read back. The
    image is the standard input, or a file where an argument has `{image}`; `{serial}` and `{number}` are the unit's."""
    read: tuple[Text, ...] = ()
    """Command: program and arguments that print the image in force in the unit, nothing where there is none."""
    compensate: tuple[Text, ...] = ()
    """Command: program and arguments that switch the unit's correction, `{state}` is on or off; left out: a unit that
    holds a calibration cannot be calibrated again."""
    timeout_s: Annotated[float, Field(gt=0, le=3600)] = 30.0
    """Command: longest time that it may take [s]."""
    folder: Text | None = None
    """Command: where it is started, relative to the station file; left out: the folder of the station file."""

    @model_validator(mode="after")
    def _commands_are_whole(self) -> FlashSettings:
        for name in ("write", "read", "compensate"):
            if text := wrong_place(name, getattr(self, name)):
                raise PlacedError(text, (name,))
            if self.protocol == "command" and name != "compensate" and not getattr(self, name):
                text = f"protocol command needs `{name}`, a list of a program and its arguments"
                raise PlacedError(text, ("protocol",))
            if self.protocol != "command" and getattr(self, name):
                text = f"a command needs `protocol: command`; this is {self.protocol}"
                raise PlacedError(text, (name,))
        return self

    def beside(self, folder: Path) -> FlashSettings:
        """The same with commands that are started in the folder of the station file, or relative to it."""
        return self.model_copy(update={"folder": str((folder / (self.folder or "")).absolute())})

    def commands(self, unit: UnitSettings) -> Commands:
        """The commands for a unit."""
        names = {"serial": unit.serial, "number": str(unit.number)}
        folder = Path(self.folder or "").absolute()
        return Commands(self.write, self.read, self.compensate, self.timeout_s, folder, names, unit.identity)

    def addresses(self, number: int) -> Addresses:
        """On its bus, for the unit of this number; behind a command, those of a simulated one."""
        usual = Addresses.usual(number)
        return Addresses(
            "uds" if self.protocol == "uds" else "canopen",
            usual.node if self.node is None else self.node,
            usual.request if self.request is None else self.request,
            usual.answer if self.answer is None else self.answer,
        )


class UnitSettings(BaseModel):
    """One gyro under test."""

    model_config = STRICT

    serial: Text
    """Serial number as it stands on the unit."""
    identity: Annotated[int, Field(ge=0)] | None = None
    """Serial number in the unit's heartbeat; a unit that says another is refused. Left out: not checked."""
    bus: Text
    """Name of the bus that it is on."""
    number: Number = 0
    """Added to the CAN identifiers of the layout."""
    gyro: Text = "vibratory"
    """Name of a shipped DBC, or the path of a DBC file."""
    signals: SignalSettings | None = None
    """Which signals are what; left out: the DBC has the names that the bench knows."""
    thermometers: dict[str, str] = {}
    """Thermometer that sits at each output, such as `rate_x: temperature_1`; others have the first thermometer."""
    flash: FlashSettings = FlashSettings()
    """How its calibration memory is reached."""
    simulation: dict[str, Any] | None = None
    """Truth, noise and channels of a simulated unit; left out: the default unit."""

    @model_validator(mode="after")
    def _thermometers_are_mapped(self) -> UnitSettings:
        sent = {} if self.signals is None else self.signals.content()
        for output, thermometer in self.thermometers.items():
            for name, kind in ((output, OUTPUTS), (thermometer, THERMOMETERS)):
                if name not in kind or name not in sent:
                    known = ", ".join(one for one in kind if one in sent) or "none"
                    raise PlacedError(
                        f"{name!r} is not one that `signals` maps; known: {known}", ("thermometers", output)
                    )
        return self

    def beside(self, folder: Path) -> UnitSettings:
        """The same with its DBC and its commands looked for in `folder`, that of the station file."""
        found: dict[str, Any] = {}
        if Path(self.gyro).suffix.lower() == ".dbc":
            found["gyro"] = str((folder / self.gyro).absolute())
        if self.flash.protocol == "command":
            found["flash"] = self.flash.beside(folder)
        return self.model_copy(update=found) if found else self

    @property
    def dbc(self) -> str | None:
        """The DBC of its frames; None where the mapping describes every signal."""
        return None if self.signals is not None and "gyro" not in self.model_fields_set else self.gyro

    @property
    def mapping(self) -> dict[str, Any] | None:
        """Its signals, where the station file maps them."""
        return None if self.signals is None else self.signals.content()

    @property
    def channels(self) -> frozenset[str] | None:
        """What it sends, by the names that models use; None where DBC and mapping do not describe its frames."""
        try:
            sent = layout_of(self.dbc, self.mapping).channels
        except ConfigError:  # the check of the station says what is wrong with them
            return None
        return frozenset({*sent, *(THERMOMETERS[:1] if {*sent} & {*THERMOMETERS} else ())})

    def decoder(self) -> GyroDecoder:
        """A decoder of its frames; ConfigError where DBC and mapping do not describe them."""
        return GyroDecoder(self.dbc, self.number, self.mapping)
