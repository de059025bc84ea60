"""The calibration memory of a unit of a station, opened; and what a run needs of it: raw or corrected output.

A calibration needs the raw rate. A unit that corrects itself is told to stop for the time of the run, and to go on
after it; it forgets that with its power, so a run during which it starts anew ends.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from typing import Literal

from bench.acquisition.station.occasion import Occasion
from bench.acquisition.station.settings.bus import Bus
from bench.acquisition.station.settings.station import StationSettings
from bench.acquisition.station.settings.unit import UnitSettings
from bench.acquisition.station.station import Station, open_station
from bench.acquisition.station.unit import LiveUnit
from bench.base import EquipmentError, InputError
from drivers.clock import Clock, WallClock
from drivers.command_memory import CommandMemory
from drivers.errors import DriverError
from drivers.interfaces import open_bus
from drivers.layout import layout_of
from drivers.unit_line import UnitLine
from drivers.unit_memory import UnitMemory

Compensated = Literal["off", "on"]
HEARD_S = 3.0
"""Heartbeats come once a second."""


@contextmanager
def open_store(bus: Bus, clock: Clock, unit: UnitSettings) -> Iterator[UnitMemory]:
    """The memory of a unit, behind its commands or over a connection to its bus of its own."""
    if unit.flash.protocol == "command":
        yield CommandMemory(unit.flash.commands(unit), f"unit {unit.serial}")
        return
    if bus.framing is not None:
        text = f"unit {unit.serial} is on a line of packets, {bus.channel}, where no protocol writes coefficients"
        raise EquipmentError(f"{text}; name commands of your own: `flash: {{protocol: command, ...}}`")
    wire = open_bus(bus.to_driver())
    try:
        line = UnitLine(wire, clock, layout_of(unit.dbc, unit.mapping), unit.number)
        addresses = unit.flash.addresses(unit.number)
        if addresses.protocol == "uds":
            from drivers.uds_store import UdsStore  # an extra: only who flashes by UDS needs it

            yield UdsStore(line, addresses.request, addresses.answer)
        else:
            from drivers.canopen_store import CanopenStore

            yield CanopenStore(line, addresses.node, unit.flash.transfer)
    finally:
        wire.shutdown()


@contextmanager
def open_alone(settings: StationSettings, unit: UnitSettings) -> Iterator[UnitMemory]:
    """The memory of a unit when nothing runs; of real equipment only the unit's bus is opened."""
    if not settings.simulated or unit.flash.protocol == "command":
        with open_store(settings.buses[unit.bus], WallClock(), unit) as store:
            yield store
        return
    with (
        open_station(settings, [unit], Occasion("flash")) as station,
        open_store(station.buses[unit.bus], station.clock, unit) as store,
    ):
        yield store


class Output:
    """Sees to it that the units of a run send what the run is about."""

    def __init__(self, station: Station, wanted: Compensated, report: Callable[..., None]) -> None:
        """`report` takes kind, text and numbers of an event."""
        self._station, self._wanted, self._report = station, wanted, report
        self._silenced: list[LiveUnit] = []
        self._held: dict[str, bool] = {}
        """Whether a unit that its heartbeat does not tell it of holds a calibration."""
        self._established = False

    @property
    def _trouble(self) -> str:
        return "its power came back, but the run cannot go on" if self._established else "not started"

    def establish(self) -> None:
        """Raw or corrected rate from all units, proved by their heartbeats, or set by their commands.

        InputError for a unit without calibration where the corrected rate is wanted, DriverError or EquipmentError for
        one that goes on correcting.
        """
        for unit in self._station.units:
            self._wait(partial(_is_known, unit), f"unit {unit.serial}: no heartbeat")
            corrects = self._corrects(unit)
            if self._wanted == "on" and not corrects:
                text = f"unit {unit.serial} sends its raw rate; write a calibration with `bench flash {unit.serial}`"
                raise InputError(text)
            if self._wanted == "on" and unit.settings.flash.compensate:
                with self._store(unit) as store:
                    store.compensate(True)
            if self._wanted == "off" and corrects:
                self._silence(unit)
        self._established = True

    def check(self) -> None:
        """EquipmentError when a unit has changed its mind: it lost its power, and what it sends is another quantity."""
        if not self._established:
            return
        for unit in self._station.units:
            number = _set_of(unit)
            if number is not None and bool(number) != (self._wanted == "on"):
                now = "corrects its rate again" if self._wanted == "off" else "sends its raw rate"
                raise EquipmentError(f"unit {unit.serial} started anew and {now}: the run mixes two quantities")

    def restore(self) -> None:
        """Let the units correct their rate again; a unit that does not answer does so after its next power cycle."""
        for unit in self._silenced:
            try:
                with self._store(unit) as store:
                    store.compensate(True)
                self._report("compensation", f"unit {unit.serial} corrects its rate again", unit=unit.serial)
            except DriverError as error:
                text = f"unit {unit.serial} sends its raw rate until its next power cycle: {error}"
                self._report("compensation", text, unit=unit.serial, ok=False)

    def _corrects(self, unit: LiveUnit) -> bool:
        """Whether it corrects its rate: by its heartbeat; where that does not tell, by what a command reads from it."""
        number = _set_of(unit)
        if number is not None or unit.settings.flash.protocol != "command":
            return bool(number)
        if unit.serial not in self._held:
            with self._store(unit) as store:
                self._held[unit.serial] = bool(store.held().image)
        return self._held[unit.serial]

    def _silence(self, unit: LiveUnit) -> None:
        number = _set_of(unit)
        which = "by the calibration that it holds" if number is None else f"(coefficient set {number})"
        try:
            with self._store(unit) as store:
                store.compensate(False)
        except DriverError as error:
            text = f"unit {unit.serial} corrects its rate {which} and cannot be told to stop"
            raise EquipmentError(
                f"{self._trouble}: {text}: {error}; see `flash` of the unit in the station file"
            ) from error
        if unit not in self._silenced:
            self._silenced.append(unit)
        self._wait(lambda: not _set_of(unit), f"unit {unit.serial} still corrects its rate")
        how = "its command has switched its calibration off" if number is None else f"coefficient set {number} is off"
        text = f"unit {unit.serial} sends its raw rate for this run ({how})"
        self._report("compensation", text, unit=unit.serial, coefficient_set=number)

    def _wait(self, condition: Callable[[], bool], trouble: str) -> None:
        clock = self._station.clock
        until_s = clock.now() + HEARD_S
        while not condition():
            if clock.now() >= until_s:
                raise EquipmentError(f"{self._trouble}: {trouble} within {HEARD_S:g} s")
            clock.sleep_until(clock.now() + 0.1)
            self._station.poll()

    def _store(self, unit: LiveUnit) -> AbstractContextManager[UnitMemory]:
        return open_store(self._station.buses[unit.settings.bus], self._station.clock, unit.settings)


def _is_known(unit: LiveUnit) -> bool:
    """Whether it has said who it is, if it ever does."""
    beat = unit.decoder.layout.beat
    return beat is None or "serial" not in beat.signals or unit.decoder.identity is not None


def _set_of(unit: LiveUnit) -> int | None:
    """Number of the coefficients in force; None where the unit does not tell, 0 where it has said nothing yet."""
    beat, identity = unit.decoder.layout.beat, unit.decoder.identity
    if beat is None or "coefficient_set" not in beat.signals:
        return None
    return 0 if identity is None else identity.coefficient_set
