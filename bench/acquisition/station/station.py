"""The equipment of a bench, opened: chamber, buses, units; real, or simulated in lock-step.

`open_station` is the one context manager that opens everything and closes everything, in the right order.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

import can

from bench.acquisition.recording.recorder import Recorder
from bench.acquisition.station.claim import claimed
from bench.acquisition.station.fault_injection import FaultInjection
from bench.acquisition.station.fixture import Fixture
from bench.acquisition.station.instruments import Instruments
from bench.acquisition.station.links import Link
from bench.acquisition.station.occasion import Occasion
from bench.acquisition.station.powering import UnitPower
from bench.acquisition.station.rate_table import open_table
from bench.acquisition.station.records import Records
from bench.acquisition.station.settings.bus import Bus
from bench.acquisition.station.settings.station import StationSettings
from bench.acquisition.station.settings.unit import UnitSettings
from bench.acquisition.station.simulated_instruments import located
from bench.acquisition.station.stage import open_stage
from bench.acquisition.station.turning import Turntable
from bench.acquisition.station.turning_axes import FixtureAxes, open_axes
from bench.acquisition.station.unit import LiveUnit, Trouble
from bench.base import EquipmentError, FloatArray
from bench.record import share
from drivers.canbus import Capture, CaptureHealth, InProcessCapture, ProcessCapture, open_bus
from drivers.chamber import Chamber
from drivers.clock import Clock, SimClock, WallClock
from drivers.journal import FrameArray, JournalWriter
from drivers.modbus import ModbusLink
from drivers.rate_table import SafeStep
from drivers.registers import RegisterMap, load_map
from drivers.sim.station import SimulatedStation

__all__ = ["Bus", "Dropped", "LiveUnit", "Station", "StationSettings", "open_station"]


@dataclass(frozen=True)
class Dropped:
    """A unit that had to leave a run which went on without it."""

    unit: LiveUnit
    reason: str
    sound_until_s: float
    """Bench time up to which its data are its own [s]."""


@dataclass(frozen=True)
class Opened:
    """Equipment beside chamber and clock that is open."""

    buses: Mapping[str, Bus]
    """Under the names that they are open by: a simulated station has private ones."""
    local_buses: Mapping[str, can.BusABC] = field(default_factory=dict)
    """Those that live inside this process."""
    turntable: Turntable | None = None
    """The rate table that the units are on, where there is one."""
    instruments: Instruments | None = None
    """The instruments that the occasion needs."""
    power: UnitPower | None = None
    """What switches the units' power, where the occasion needs it."""
    turn: Callable[[FloatArray], None] | None = None
    """Turns a simulated fixture into an attitude."""
    axes: FixtureAxes | None = None
    """The driven axes of the fixture, where it has such."""
    claim: int | None = None
    """Descriptor of the claim on the chamber of a real station."""
    injection: FaultInjection | None = None
    """What goes wrong in a simulated station on purpose."""
    records: Records = field(default_factory=Records)
    """Where all of it is recorded."""


class Station:
    """Everything that is open: one clock, one chamber, the buses and the units on them.

    `units` are those alive, `dropped` those that had to leave: a unit that fails alone does not end the run of the
    others. When it is the last one, or when all fail together, nobody leaves and the guards of the run decide.
    """

    def __init__(
        self,
        settings: StationSettings,
        clock: Clock,
        link: ModbusLink,
        registers: RegisterMap,
        units: Sequence[UnitSettings],
        opened: Opened | None = None,
    ) -> None:
        """`opened` is what else of the equipment is open."""
        opened = opened or Opened(settings.buses)
        limits = settings.chamber.lowest_degc, settings.chamber.highest_degc
        self.settings, self.clock = settings, clock
        self.started_s = clock.now()
        """Bench time at which it was opened [s]."""
        self.chamber = Chamber(link, registers, limits, clock, journal=opened.records.write)
        self.everyone = tuple(LiveUnit(unit, clock) for unit in units)
        self.units = list(self.everyone)
        self.dropped: list[Dropped] = []
        self.injection, self.claim = opened.injection, opened.claim
        self.turntable, self.power = opened.turntable, opened.power
        self.instruments = opened.instruments or Instruments((), clock, opened.records, ExitStack())
        if self.power is not None:
            self.power.units = self.units
        own = settings.fixture
        self.fixture = (
            None if own is None else Fixture(own, clock, opened.records, self.units, opened.turn, opened.axes)
        )
        self.buses = opened.buses
        self.local_buses, self._records = opened.local_buses, opened.records
        self._recorder: Recorder | None = None
        self._captures: dict[str, Capture] = {}
        self._links: dict[str, Link] = {}
        self._complete = False

    def start_capture(self, recorder: Recorder) -> None:
        """Capture every bus that a unit is on into one journal, which the run folders of all units on it share."""
        self._recorder = recorder
        self._records.begin(recorder)
        folders = list(zip(self.everyone, recorder.runs, strict=True))
        for name in sorted({unit.settings.bus for unit in self.everyone}):
            path, *others = (run.journal / f"{name}.gtbj" for unit, run in folders if unit.settings.bus == name)
            path.touch()
            for other in others:
                share(path, other)
            self._captures[name] = self._capture(name, path, recorder)
            self._links[name] = Link(f"bus {name}", self.settings.buses[name].link, self._records.event)

    def _capture(self, name: str, path: Path, recorder: Recorder) -> Capture:
        if name in self.local_buses:
            writer = JournalWriter(path)
            recorder.keep_synced(writer)
            room = self.buses[name].to_driver().room
            return InProcessCapture(self.local_buses[name], writer, now=self.clock.now, room=room)
        started_ns = self.clock.started_monotonic_ns if isinstance(self.clock, WallClock) else 0
        heard = [unit.settings for unit in self.everyone if unit.settings.bus == name]
        return ProcessCapture(self.settings.buses[name].to_driver(heard), path, started_ns)

    def poll(self) -> None:
        """Take in what was captured since the last call; drop units that fail alone.

        Raises EquipmentError when no unit is left on a bus that works, InputError when another unit than the
        described one answers before all were heard, or in the place of the last one; DriverError or EquipmentError
        when the rate table or an axis of the fixture fails.
        """
        if self.turntable is not None:
            self.turntable.poll()
        if self.fixture is not None:
            self.fixture.poll()
        self.instruments.poll()
        for name, capture in self._captures.items():
            self._take(name, capture.poll())
        lost = self._lost_buses()
        for unit in self.units:
            for text in unit.news():
                self._records.event("unit", text, unit=unit.serial)
        if self._complete and not (self.power is not None and self.power.cycling):
            self._drop(lost)
        if left := {unit.settings.bus for unit in self.units} & lost.keys():
            raise EquipmentError("; ".join(lost[name] for name in sorted(left)))
        for unit in self.units:
            unit.check_identity()
        self._complete = self._complete or not any(unit.missing() for unit in self.units)

    def stop_moving(self) -> list[SafeStep]:
        """Stop the rate table and the axes of the fixture, verified."""
        table = [] if self.turntable is None else self.turntable.safe()
        return table if self.fixture is None else [*table, *self.fixture.safe()]

    @property
    def bus_failed_s(self) -> float:
        """How long a bus has failed, the longest of those that fail now [s]."""
        return max((link.silent_s(self.clock.now()) for link in self._links.values()), default=0.0)

    def _lost_buses(self) -> dict[str, str]:
        """Buses whose capture has failed for too long, each with what is wrong."""
        now_s, lost = self.clock.now(), {}
        for name, capture in self._captures.items():
            link, health = self._links[name], capture.health()
            try:
                if health.error is None:
                    link.answered(now_s)
                elif health.state == "lost":
                    link.gone(now_s, health.error)
                else:
                    link.failed(now_s, health.error)
                    if self._silent(name, now_s):
                        link.gone(now_s, health.error)
            except EquipmentError as trouble:
                lost[name] = str(trouble)
        return lost

    def _silent(self, bus: str, now_s: float) -> bool:
        """Whether no unit on a bus has sent for as long as units may be silent; not while they have no power."""
        heard = [unit.newest_frame_s for unit in self.units if unit.settings.bus == bus]
        latest_s = max((t_s for t_s in heard if t_s is not None), default=now_s)
        powered = self.power is None or not self.power.cycling
        return powered and now_s - latest_s > self.settings.unit_silent_s

    def _drop(self, lost: Mapping[str, str]) -> None:
        """Let units leave that cannot go on, unless nobody would be left."""
        troubles: list[tuple[LiveUnit, Trouble]] = []
        for unit in self.units:
            trouble = unit.trouble(self.settings.unit_silent_s)
            if failed := lost.get(unit.settings.bus):
                trouble = Trouble(failed, self.clock.now())
            if trouble is not None:
                troubles.append((unit, trouble))
        if len(troubles) == len(self.units):
            return
        for unit, trouble in troubles:
            self.units.remove(unit)
            self.dropped.append(Dropped(unit, trouble.reason, trouble.sound_until_s))
            self._tell(self.dropped[-1])

    def _tell(self, gone: Dropped) -> None:
        """A unit leaves: its own run folder ends here with the reason, those of the others go on."""
        if self._recorder is not None:
            folder = self._recorder.runs[self.everyone.index(gone.unit)]
            self._recorder.leave(folder, gone.reason, state="failed", sound_until_s=gone.sound_until_s)
        text = f"unit {gone.unit.serial} left the run: {gone.reason}"
        self._records.event("dropped", text, unit=gone.unit.serial)

    def captures(self) -> list[CaptureHealth]:
        """How the capture of each bus is, by its name in the station file."""
        return [replace(capture.health(), bus=name) for name, capture in self._captures.items()]

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
        """Frame counts of all units together, those that have left included."""
        counts = [unit.decoder.losses.as_dict() for unit in self.everyone]
        return {name: sum(count[name] for count in counts) for name in counts[0]}

    def _take(self, bus: str, frames: FrameArray) -> None:
        for unit in self.units:
            if unit.settings.bus == bus:
                unit.take(frames)


@contextmanager
def open_station(
    settings: StationSettings, units: Sequence[UnitSettings], occasion: Occasion | None = None
) -> Iterator[Station]:
    """Open what `units` need: the chamber, identified, and the buses; closed again in reverse order.

    `occasion` is what is run; bench time begins at its start.
    """
    occasion = occasion or Occasion()
    registers = load_map(settings.chamber.map)
    buses: Mapping[str, Bus]
    injection: FaultInjection | None = None
    simulation: SimulatedStation | None = None
    claim: int | None = None
    records = Records()
    with ExitStack() as stack:
        clock: Clock
        if settings.simulated:
            stage = stack.enter_context(open_stage(settings, units, occasion, records))
            clock = SimClock(start_s=occasion.start_s)
            clock.attach(stage.advance)
            buses, connection, injection, simulation = stage.buses, stage.connection, stage.injection, stage.station
        else:
            clock, buses = WallClock(occasion.start_s), settings.buses
            assert settings.chamber.connection is not None  # checked with the file
            connection = settings.chamber.connection
            claim = stack.enter_context(claimed(connection))
        link = ModbusLink(connection.url, device_id=connection.device, timeout_s=connection.timeout_s)
        stack.enter_context(closing(link))
        local_buses = _local_buses(units, buses, injection, stack)
        turntable = open_table(settings, clock, buses, stack, records)
        chosen = settings.opened(occasion.switches_power)
        chosen = located(chosen, {} if simulation is None else simulation.instruments)
        instruments = Instruments(chosen, clock, records, stack)
        switch = instruments.unit_switch() if occasion.switches_power else None
        power = None if switch is None else UnitPower(switch, clock, records)
        axes = open_axes(settings.fixture, clock, buses, stack, records)
        turn = None if simulation is None or axes is not None else simulation.turn
        opened = Opened(buses, local_buses, turntable, instruments, power, turn, axes, claim, injection, records)
        station = Station(settings, clock, link, registers, units, opened)
        station.chamber.identify()
        stack.callback(station.stop_capture)
        if station.fixture is not None:
            stack.callback(station.fixture.close)
        yield station


def _local_buses(
    units: Sequence[UnitSettings], buses: Mapping[str, Bus], injection: FaultInjection | None, stack: ExitStack
) -> dict[str, can.BusABC]:
    """Buses of the units that live inside this process; `stack` closes them."""
    found: dict[str, can.BusABC] = {}
    for name, unit in {unit.bus: unit for unit in units}.items():
        if buses[name].local:
            bus = open_bus(buses[name].to_driver())
            stack.callback(bus.shutdown)
            if injection is not None and name in injection.where:
                bus = injection.around(name, bus, unit)
            found[name] = bus
    return found
