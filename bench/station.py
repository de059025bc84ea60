"""The equipment of a bench, from its YAML file: chamber, buses, units; real, or simulated in lock-step.

`open_station` is the one context manager that opens everything and closes everything, in the right order.
"""

from __future__ import annotations

import uuid
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from importlib.resources import files
from typing import Annotated, Any

import can
import yaml
from pydantic import BaseModel, Field, PositiveFloat, model_validator

from bench.assemble import Decoded
from bench.config import STRICT
from bench.errors import EquipmentError, InputError
from bench.guards import GuardSettings, Signal
from bench.preflight import Limits
from bench.recorder import Recorder
from drivers.canbus import BusSettings, Capture, InProcessCapture, ProcessCapture, open_bus
from drivers.chamber import Chamber
from drivers.clock import Clock, SimClock, WallClock
from drivers.gyro import GyroDecoder
from drivers.journal import FrameArray, JournalWriter
from drivers.modbus import ModbusLink
from drivers.registers import RegisterMap, load_map
from drivers.samples import SampleClock
from drivers.sim.can_gyro import CanGyro
from drivers.sim.plant import Plant, PlantParameters
from drivers.sim.resonator import Resonator
from drivers.sim.resonator import UnitSettings as GyroPhysics
from drivers.sim.station import SimulatedStation, SimulatedUnit

LOCAL_INTERFACES = ("virtual", "blocks")
"""python-can interfaces that live inside one process: captured in it. Everything else gets a process of its own."""


class _Settings(BaseModel):
    model_config = STRICT


class Connection(_Settings):
    """How the chamber's controller is reached."""

    url: str = Field(description="tcp://host:port, rtu+tcp://host:port or rtu:///dev/ttyUSB0?baudrate=9600")
    device: Annotated[int, Field(ge=0, le=247)] = 1
    timeout_s: Annotated[float, Field(gt=0, le=60)] = 1.5


Speed = PositiveFloat | Annotated[tuple[tuple[float, PositiveFloat], ...], Field(min_length=1)]


class ChamberSettings(_Settings):
    """The chamber: which register map, where, and what it may be asked for."""

    map: str = Field(description="name of a shipped register map, or a YAML file beside the station file")
    connection: Connection | None = Field(None, description="left out in a simulated station")
    lowest_degc: float
    highest_degc: float
    heating_degc_per_min: Speed = Field(
        description="fastest ramp that the chamber follows: a number, or [degC, rate] pairs"
    )
    cooling_degc_per_min: Speed = Field(description="the same when cooling; small chambers are slow near their lowest")

    @model_validator(mode="after")
    def _ordered(self) -> ChamberSettings:
        if self.lowest_degc >= self.highest_degc:
            raise ValueError(f"lowest_degc ({self.lowest_degc}) must be below highest_degc ({self.highest_degc})")
        return self


class Bus(_Settings):
    """One CAN bus, by the name of its python-can interface."""

    interface: str
    channel: str
    bitrate: int | None = None
    options: dict[str, Any] = Field(default_factory=dict, description="further options of the interface")

    def to_driver(self) -> BusSettings:
        """The same for the driver."""
        return BusSettings(interface=self.interface, channel=self.channel, bitrate=self.bitrate, options=self.options)


class UnitSettings(_Settings):
    """One gyro under test."""

    identity: int | None = Field(
        None, description="serial number in the unit's heartbeat; refused when another answers"
    )
    serial: Annotated[str, Field(min_length=1)]
    bus: str
    number: Annotated[int, Field(ge=0, le=15, description="added to the CAN identifiers of the layout")] = 0
    gyro: str = Field("vibratory", description="name of a shipped DBC, or a DBC file")
    simulation: dict[str, Any] | None = Field(None, description="truth, noise and channels of a simulated unit")


class StationSettings(_Settings):
    """A station file."""

    name: str
    simulated: bool = False
    seed: int = Field(1, description="of a simulated station: same seed, same run")
    ambient_degc: float = Field(23.0, description="where the safe state takes the chamber")
    chamber: ChamberSettings
    buses: dict[str, Bus]
    units: Annotated[tuple[UnitSettings, ...], Field(min_length=1)]
    guards: tuple[GuardSettings, ...] = ()

    @model_validator(mode="after")
    def _consistent(self) -> StationSettings:
        for unit in self.units:
            if unit.bus not in self.buses:
                raise ValueError(f"unit {unit.serial} is on bus {unit.bus!r}; the station has {sorted(self.buses)}")
        if not self.simulated and self.chamber.connection is None:
            raise ValueError("a real station needs chamber.connection")
        serials = [unit.serial for unit in self.units]
        if len(set(serials)) != len(serials):
            raise ValueError(f"serial numbers must differ: {serials}")
        return self

    def unit(self, serial: str | None) -> UnitSettings:
        """The unit with this serial number, or the only one; InputError that lists them otherwise."""
        if serial is None and len(self.units) == 1:
            return self.units[0]
        known = [unit.serial for unit in self.units]
        for unit in self.units:
            if unit.serial == serial:
                return unit
        raise InputError(f"unit {serial!r} is not in station {self.name!r}; choose one of {known} with --unit")

    def limits(self) -> Limits:
        """What the station allows and its chamber can do."""
        chamber = self.chamber
        return Limits(
            chamber.lowest_degc,
            chamber.highest_degc,
            chamber.heating_degc_per_min,
            chamber.cooling_degc_per_min,
            self.ambient_degc,
        )

    def seeds(self) -> dict[str, int]:
        """Seeds that make a simulated run repeatable."""
        return {"station": self.seed} if self.simulated else {}


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

    def check_identity(self) -> None:
        """InputError when the unit on the bus is not the one that the station file names."""
        found, wanted = self.decoder.identity, self.settings.identity
        if found is not None and wanted is not None and found.serial != wanted:
            raise InputError(
                f"unit {self.serial}: serial number {found.serial} answers, the station file says {wanted}"
            )

    def decoded(self) -> Decoded:
        """What live decoding found, for `assemble`."""
        return Decoded(self.decoder, self.sample_clock)


class Station:
    """Everything that is open: one clock, one chamber, the buses and the units on them."""

    def __init__(
        self, settings: StationSettings, clock: Clock, chamber: Chamber, units: Sequence[UnitSettings]
    ) -> None:
        self.settings, self.clock, self.chamber = settings, clock, chamber
        self.units = [LiveUnit(unit, clock) for unit in units]
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
        """Take in what was captured since the last call; EquipmentError when a capture died."""
        for name, capture in self._captures.items():
            frames = capture.poll()
            for unit in self.units:
                if unit.settings.bus == name:
                    unit.take(frames)
                    unit.check_identity()
            if error := capture.health().error:
                raise EquipmentError(f"capture of bus {name} failed: {error}")

    def stop_capture(self) -> None:
        """Take what is left and stop capturing; a second call does nothing."""
        captures, self._captures = self._captures, {}
        for name, capture in captures.items():
            for unit in self.units:
                if unit.settings.bus == name:
                    unit.take(capture.poll())
            capture.close()

    def losses(self) -> dict[str, int]:
        """Frame counts of all units together."""
        counts = [unit.decoder.losses.as_dict() for unit in self.units]
        return {name: sum(count[name] for count in counts) for name in counts[0]}


@contextmanager
def open_station(settings: StationSettings, units: Sequence[UnitSettings]) -> Iterator[Station]:
    """Open what `units` need: the chamber, identified, and the buses; closed again in reverse order."""
    registers = load_map(settings.chamber.map)
    with ExitStack() as stack:
        clock: Clock
        if settings.simulated:
            clock = SimClock()
            buses = _private_buses(settings)
            simulation = stack.enter_context(closing(simulate(settings, registers, units, buses, stack)))
            clock.attach(simulation.advance)
            connection = Connection(url=f"tcp://127.0.0.1:{simulation.modbus_port}")
        else:
            clock, buses = WallClock(), settings.buses
            assert settings.chamber.connection is not None  # checked with the file
            connection = settings.chamber.connection
        link = ModbusLink(connection.url, device_id=connection.device, timeout_s=connection.timeout_s)
        stack.enter_context(closing(link))
        station = Station(
            settings,
            clock,
            Chamber(link, registers, (settings.chamber.lowest_degc, settings.chamber.highest_degc), clock),
            units,
        )
        for name in {unit.bus for unit in units}:
            if buses[name].interface in LOCAL_INTERFACES:
                bus = open_bus(buses[name].to_driver())
                stack.callback(bus.shutdown)
                station.local_buses[name] = bus
        station.chamber.identify()
        yield station


def simulate(
    settings: StationSettings,
    registers: RegisterMap,
    units: Sequence[UnitSettings],
    buses: Mapping[str, Bus],
    stack: ExitStack,
    modbus_port: int = 0,
) -> SimulatedStation:
    """The simulated chamber and units of a station file, on these buses; `stack` closes the buses."""
    plant = Plant(PlantParameters(ambient_degc=settings.ambient_degc), seed=settings.seed)
    simulated = []
    for order, unit in enumerate(units):
        physics = GyroPhysics.parse(default_unit() if unit.simulation is None else unit.simulation)
        bus = open_bus(buses[unit.bus].to_driver())
        stack.callback(bus.shutdown)
        wire = CanGyro(bus, unit.number, unit.identity or unit.number + 1, layout=unit.gyro)
        simulated.append(SimulatedUnit(Resonator(physics, seed=settings.seed + order), wire))
    return SimulatedStation(registers, plant, simulated, modbus_port)


def default_unit() -> dict[str, Any]:
    """Truth, noise and channels of a simulated unit whose station file does not say."""
    content: dict[str, Any] = yaml.safe_load((files("drivers.sim") / "default_unit.yaml").read_text("utf-8"))
    return content


def _private_buses(settings: StationSettings) -> dict[str, Bus]:
    """The same buses under names that no other station in this process uses."""
    suffix = uuid.uuid4().hex[:8]
    for name, bus in settings.buses.items():
        if bus.interface not in LOCAL_INTERFACES:
            allowed = " or ".join(LOCAL_INTERFACES)
            raise InputError(f"bus {name}: a simulated station runs on {allowed}, not on {bus.interface!r}")
    options = {"virtual": {"preserve_timestamps": True}, "blocks": {}}
    return {
        name: bus.model_copy(
            update={"channel": f"{bus.channel}-{suffix}", "options": options[bus.interface] | bus.options}
        )
        for name, bus in settings.buses.items()
    }
