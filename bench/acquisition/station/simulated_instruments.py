"""The instruments of a simulated station: each is played by a server that answers as its station file describes it."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from bench.acquisition.station.settings.instrument import InstrumentSettings, ReadingSettings
from drivers.instrument import Reading, Setting
from drivers.register import Value
from drivers.sim.instrument import ModbusInstrument, ScpiInstrument
from drivers.sim.plant import Plant
from drivers.sim.station import Instrument as Listens

SHOWN = {
    "supply": 12.0,
    "supply_current": 0.15,
    "humidity": 12.0,
    "pressure": 1013.25,
    "voltage": 5.0,
    "current": 0.02,
    "resistance": 100.0,
}
"""What simulated instruments measure, in the unit of the channel; reference thermometers measure the plant's air."""
_OF_SUPPLY = ("supply", "supply_current")


class SimulatedInstrument:
    """One of them; `address` is where it listens."""

    def __init__(self, settings: InstrumentSettings, plant: Plant) -> None:
        self.settings = settings
        self.shown = dict(SHOWN)
        """What it measures; change it to let something happen."""
        self._plant = plant
        self._on, off = settings.switch
        self.server: ScpiInstrument | ModbusInstrument
        if settings.speaks_modbus:
            entries: list[Reading | Setting] = [
                *settings.read,
                *settings.set,
                *filter(None, [settings.on, settings.off]),
            ]
            self.server = ModbusInstrument([entry.modbus for entry in entries if entry.modbus is not None])
            if settings.powers_units and self._on.modbus is not None:
                self.server.show(self._on.modbus, self._on.value)
        else:
            switched = [self._on, off] if settings.powers_units or settings.off is not None else []
            first = {self._on.query: _text(self._on.value)} if settings.powers_units and self._on.query else {}
            self.server = ScpiInstrument(
                f"BENCH,SIMULATED,{settings.identity or settings.name.upper().replace(',', ' ')},1.0",
                {reading.query: self._answer(reading) for reading in settings.read if reading.query},
                [_scpi(setting) for setting in (*settings.set, *switched)],
                first=first,
            )
        self.follow()

    @property
    def address(self) -> str:
        """Where it listens."""
        return self.server.address

    @property
    def on(self) -> bool:
        """Whether its output is on; one without a switch always is."""
        if self.settings.off is None and not self.settings.powers_units:
            return True
        if isinstance(self.server, ModbusInstrument):
            assert self._on.modbus is not None  # checked with the file
            return self.server.value(self._on.modbus) == self._on.value
        return self.server.reads(self._on.query or "") == _text(self._on.value)

    def follow(self) -> None:
        """Show in its registers what it measures now; a SCPI instrument measures when it is asked."""
        if isinstance(self.server, ModbusInstrument):
            for reading in self.settings.read:
                assert reading.modbus is not None  # checked with the file
                self.server.show(reading.modbus, self._number(reading))

    def fail(self, fault: str, value: float | None, *, on: bool) -> None:
        """Begin or end a fault of `OF_INSTRUMENT`."""
        off = self.settings.switch[1]
        if fault == "silence":
            self.server.silent = on
        elif fault == "ignore":
            self.server.disobeys = on
        elif fault == "switched_off":
            if isinstance(self.server, ModbusInstrument) and off.modbus is not None and on:
                self.server.show(off.modbus, off.value)
            elif isinstance(self.server, ScpiInstrument) and on:
                self.server.take(off.command or "")
        else:
            for reading in self.settings.read[: 1 if fault == "value" else None]:
                if not on:
                    self.shown.pop(reading.channel)
                    self.shown |= {name: usual for name, usual in SHOWN.items() if name == reading.channel}
                else:
                    self.shown[reading.channel] = self._true(reading.channel) if value is None else value

    def close(self) -> None:
        """Stop its server."""
        self.server.close()

    def _answer(self, reading: ReadingSettings) -> Callable[[], str]:
        return lambda: reading.answer.replace("{value}", f"{self._number(reading):.9g}").replace("{any}", "")

    def _number(self, reading: ReadingSettings) -> float:
        """What it says, so that the bench makes the true value of it."""
        convert, true = reading.conversion(), self._true(reading.channel)
        return ((true - convert.offset) / convert.factor - reading.offset) / reading.scale

    def _true(self, channel: str) -> float:
        shown = self.shown.get(channel, self._plant.state.air)
        return shown if self.on or channel not in _OF_SUPPLY else 0.0


def _scpi(setting: Setting) -> tuple[str, str, str]:
    return setting.command or "", setting.query or "", _text(setting.value)


def _text(value: Value) -> str:
    return value if isinstance(value, str) else f"{value:g}"


def located(
    settings: tuple[InstrumentSettings, ...], simulated: Mapping[str, Listens]
) -> tuple[InstrumentSettings, ...]:
    """The same at the addresses where they are played."""
    return tuple(
        one.model_copy(update={"address": simulated[one.name].address}) if one.name in simulated else one
        for one in settings
    )
