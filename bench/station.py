"""The equipment of a bench, opened: chamber, buses, units; real, or simulated in lock-step.

`open_station` is the one context manager that opens everything and closes everything, in the right order.
"""

from __future__ import annotations

import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager

import can

from bench.assemble import Decoded
from bench.equipment import LOCAL_INTERFACES, Bus, Connection, StationSettings, UnitSettings
from bench.errors import EquipmentError, InputError
from bench.guards import Signal
from bench.recorder import Recorder
from drivers.canbus import Capture, InProcessCapture, ProcessCapture, open_bus
from drivers.chamber import Chamber, Write
from drivers.clock import Clock, SimClock, WallClock
from drivers.gyro import GyroDecoder
from drivers.journal import FrameArray, JournalWriter
from drivers.modbus import ModbusLink
from drivers.registers import RegisterMap, load_map
from drivers.samples import SampleClock
from drivers.sim.can_gyro import CanGyro
from drivers.sim.plant import Plant, PlantParameters
from drivers.sim.resonator import Resonator, default_unit
from drivers.sim.resonator import UnitSettings as GyroPhysics
from drivers.sim.station import SimulatedStation, SimulatedUnit

__all__ = ["Bus", "LiveUnit", "Station", "StationSettings", "open_station", "simulate"]


class LiveUnit:
    """A unit while it is being captured: newest values for guards, settling and the display."""

    def __init__(self, settings: UnitSettings, clock: Clock) -> None:
        self.settings = settings
        self.decoder = GyroDecoder(settings.gyro, settings.number)
        self.sample_clock = SampleClock(self.decoder.interval_s)
        self.temperature: Signal | None = None
        self.newest_frame_s: float | None = None
        self._clock = clock

    @property
    def serial(self) -> str:
        """Serial number in the station file."""
        return self.settings.serial

    def take(self, frames: FrameArray) -> None:
        """Decode newly captured frames of this unit's bus."""
        block = self.decoder.decode(frames)
        self.sample_clock.add(block.index, block.t_ns)
        if len(block.t_ns):
            self.newest_frame_s = float(block.t_ns[-1]) * 1e-9
        if "temperature" in block.slow and len(block.slow["temperature"].value):
            at_s = self.newest_frame_s if self.newest_frame_s is not None else self._clock.now()
            self.temperature = Signal(float(block.slow["temperature"].value[-1]), at_s)

    def missing(self) -> str | None:
        """What was not heard of the unit yet; None when it is there."""
        if self.newest_frame_s is None:
            return "no sound rate frame"
        if self.temperature is None:
            return "no temperature"
        if self.settings.identity is not None and self.decoder.identity is None:
            return "no heartbeat with its serial number"
        return None

    def check_identity(self) -> None:
        """InputError when the unit on the bus is not the one that the station file names."""
        found, wanted = self.decoder.identity, self.settings.identity
        if found is not None and wanted is not None and found.serial != wanted:
            raise InputError(
                f"unit {self.serial}: {found.serial} answers as number {self.settings.number}, the station file says"
                f" identity {wanted}; connect the right unit or name the one that is there with --unit"
            )

    def decoded(self) -> Decoded:
        """What live decoding found, for `assemble`."""
        return Decoded(self.decoder, self.sample_clock)


class Station:
    """Everything that is open: one clock, one chamber, the buses and the units on them."""

    def __init__(
        self,
        settings: StationSettings,
        clock: Clock,
        link: ModbusLink,
        registers: RegisterMap,
        units: Sequence[UnitSettings],
    ) -> None:
        limits = settings.chamber.lowest_degc, settings.chamber.highest_degc
        self.settings, self.clock = settings, clock
        self.chamber = Chamber(link, registers, limits, clock, journal=self._written)
        self.units = [LiveUnit(unit, clock) for unit in units]
        self.on_write: Callable[[Write], None] = lambda write: None
        """Sees every register of the chamber that is written."""
        self.local_buses: dict[str, can.BusABC] = {}
        self._captures: dict[str, Capture] = {}

    def start_capture(self, recorder: Recorder) -> None:
        """Capture every bus that a unit is on into a journal of the run."""
        for name in sorted({unit.settings.bus for unit in self.units}):
            path = recorder.run.journal / f"{name}.gtbj"
            if name in self.local_buses:
                writer = JournalWriter(path)
                recorder.keep_synced(writer)
                self._captures[name] = InProcessCapture(self.local_buses[name], writer)
            else:
                started_ns = self.clock.started_monotonic_ns if isinstance(self.clock, WallClock) else 0
                self._captures[name] = ProcessCapture(self.settings.buses[name].to_driver(), path, started_ns)

    def poll(self) -> None:
        """Take in what was captured since the last call.

        Raises EquipmentError when a capture fails, InputError when another unit than the described one answers.
        """
        for name, capture in self._captures.items():
            self._take(name, capture.poll())
            if error := capture.health().error:
                raise EquipmentError(f"capture of bus {name} failed: {error}")
        for unit in self.units:
            unit.check_identity()

    def missing_units(self) -> list[str]:
        """Units that were not heard yet, each with what is missing and what to look at."""
        found = []
        for unit in self.units:
            if what := unit.missing():
                bus = self.settings.buses[unit.settings.bus]
                frames = self._captures[unit.settings.bus].health().frames if self._captures else 0
                found.append(
                    f"unit {unit.serial}: {what} as number {unit.settings.number} on bus {unit.settings.bus} "
                    f"({bus.interface} {bus.channel}, {frames} frames); check its power, number and bit rate"
                )
        return found

    def stop_capture(self) -> None:
        """Take what is left and stop capturing; a second call does nothing."""
        while self._captures:
            name, capture = self._captures.popitem()
            try:
                self._take(name, capture.poll())
            finally:
                capture.close()
            self._take(name, capture.poll())  # what a process still journalled at its end

    def losses(self) -> dict[str, int]:
        """Frame counts of all units together."""
        counts = [unit.decoder.losses.as_dict() for unit in self.units]
        return {name: sum(count[name] for count in counts) for name in counts[0]}

    def _written(self, write: Write) -> None:
        self.on_write(write)

    def _take(self, bus: str, frames: FrameArray) -> None:
        for unit in self.units:
            if unit.settings.bus == bus:
                unit.take(frames)


@contextmanager
def open_station(settings: StationSettings, units: Sequence[UnitSettings], occasion: str = "") -> Iterator[Station]:
    """Open what `units` need: the chamber, identified, and the buses; closed again in reverse order.

    `occasion`, the name of what is run, makes the noise of a simulated station its own.
    """
    registers = load_map(settings.chamber.map)
    with ExitStack() as stack:
        clock: Clock
        if settings.simulated:
            clock = SimClock()
            buses = _private_buses(settings)
            simulation = stack.enter_context(closing(simulate(settings, units, buses, stack, occasion)))
            clock.attach(simulation.advance)
            connection = Connection(url=f"tcp://127.0.0.1:{simulation.modbus_port}")
        else:
            clock, buses = WallClock(), settings.buses
            assert settings.chamber.connection is not None  # checked with the file
            connection = settings.chamber.connection
        link = ModbusLink(connection.url, device_id=connection.device, timeout_s=connection.timeout_s)
        stack.enter_context(closing(link))
        station = Station(settings, clock, link, registers, units)
        for name in {unit.bus for unit in units}:
            if buses[name].interface in LOCAL_INTERFACES:
                bus = open_bus(buses[name].to_driver())
                stack.callback(bus.shutdown)
                station.local_buses[name] = bus
        station.chamber.identify()
        stack.callback(station.stop_capture)
        yield station


def simulate(
    settings: StationSettings,
    units: Sequence[UnitSettings],
    buses: Mapping[str, Bus],
    stack: ExitStack,
    occasion: str = "",
    modbus_port: int = 0,
) -> SimulatedStation:
    """The simulated chamber and units of a station file, on these buses; `stack` closes the buses."""
    seed = settings.seeds(occasion)["run"]
    plant = Plant(PlantParameters(ambient_degc=settings.ambient_degc), seed=seed)
    simulated = []
    for unit in units:
        physics = default_unit() if unit.simulation is None else GyroPhysics.parse(unit.simulation)
        bus = open_bus(buses[unit.bus].to_driver())
        stack.callback(bus.shutdown)
        wire = CanGyro(bus, unit.number, unit.identity or unit.number + 1, layout=unit.gyro)
        simulated.append(SimulatedUnit(Resonator(physics, seed=seed + settings.units.index(unit)), wire))
    return SimulatedStation(load_map(settings.chamber.map), plant, simulated, modbus_port)


def _private_buses(settings: StationSettings) -> dict[str, Bus]:
    """The same buses under names that no other station in this process uses."""
    suffix = uuid.uuid4().hex[:8]
    options = {"virtual": {"preserve_timestamps": True}, "blocks": {}}
    return {
        name: bus.model_copy(
            update={"channel": f"{bus.channel}-{suffix}", "options": options[bus.interface] | bus.options}
        )
        for name, bus in settings.buses.items()
    }
