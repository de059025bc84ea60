"""The station file: chamber, buses, units and interlocks of a bench, checked whole before anything is opened."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, Field, PrivateAttr, model_validator
from pydantic.json_schema import SkipJsonSchema

from bench.acquisition.profile.guards import GuardSettings
from bench.acquisition.profile.orientation import OrientationSettings
from bench.acquisition.profile.placing import Reach
from bench.acquisition.profile.preflight import Limits
from bench.acquisition.profile.standing import ProtectionSettings, Standing, standing_guards
from bench.acquisition.station.settings.bus import LOCAL_INTERFACES, Bus
from bench.acquisition.station.settings.chamber import ChamberSettings, Degc
from bench.acquisition.station.settings.faults import FaultSettings
from bench.acquisition.station.settings.fixture import FixtureSettings
from bench.acquisition.station.settings.instrument import InstrumentSettings
from bench.acquisition.station.settings.rate_table import RateTableSettings
from bench.acquisition.station.settings.safety import SafeStateSettings, WatchdogSettings
from bench.acquisition.station.settings.unit import UnitSettings
from bench.base import STRICT, Document, InputError, PlacedError
from bench.record import slug
from drivers.registers import is_map_file
from drivers.sim.plant import Plant, PlantParameters

Text = Annotated[str, Field(min_length=1)]

MOST_TIMEOUTS = 6
"""Time for which one question to a silent chamber may hold the bench up: three attempts, each with the wait for a late
answer to its end."""


class StationSettings(BaseModel):
    """A station: the equipment of a bench."""

    model_config = STRICT

    name: Text
    """What the station is called."""
    simulated: bool = False
    """The embedded simulator takes the place of all equipment."""
    orientation: OrientationSettings | None = None
    """Latitude, axis and azimuth: with them the Earth rate is removed from the bias."""
    seed: Annotated[int, Field(ge=0)] = 1
    """Of a simulated station: same seed, same run."""
    ambient_degc: Degc = 23.0
    """Where the safe state takes the chamber."""
    chamber: ChamberSettings
    """The thermal chamber."""
    buses: dict[str, Bus]
    """CAN buses by a name of your own."""
    rate_table: RateTableSettings | None = None
    """The rate table, where there is one."""
    fixture: FixtureSettings | None = None
    """What holds the units in their attitudes, where there is such."""
    supply: SkipJsonSchema[Any] = Field(default=None, exclude=True)
    """Of older station files."""
    instruments: tuple[InstrumentSettings, ...] = ()
    """Instruments beside chamber and units: thermometer, supply, multimeter, hygrometer."""
    units: Annotated[tuple[UnitSettings, ...], Field(min_length=1)]
    """Gyros that may be tested here."""
    guards: tuple[GuardSettings, ...] = ()
    """Interlocks, beside those of every run; one with the name of one of those takes its place."""
    protection: ProtectionSettings = ProtectionSettings()
    """Margins of the guards that every run has."""
    safe_state: SafeStateSettings = SafeStateSettings()
    """How the safe state is reached."""
    watchdog: WatchdogSettings = WatchdogSettings()
    """When a real station is made safe without the bench."""
    faults: tuple[FaultSettings, ...] = ()
    """What goes wrong in a simulated station, and when: for rehearsals."""
    eeproms: Text | None = None
    """Folder where simulated units keep their calibration memory; left out: `.units` beside the run folders."""
    laboratory: Text | None = None
    """Laboratory file of certificates, beside the station file, or the name of a shipped one; each run keeps a copy."""
    equipment: Text | None = None
    """Equipment file, beside the station file, or the name of a shipped one; each run keeps a copy."""
    notify: Text | None = None
    """Notification file, beside the station file: who is told of ends, trips and holds. It is not copied anywhere."""
    unit_silent_s: Annotated[float, Field(gt=0, le=3600)] = 5.0
    """A unit that sends nothing sound for this long leaves a run of several units [s]."""

    _written: Document | None = PrivateAttr(None)
    """The station file, for errors that are found later."""

    @model_validator(mode="after")
    def _consistent(self) -> StationSettings:
        if self.supply is not None:
            new = "instruments: [{name: supply, address: …, powers_units: true, leave_on: true}]"
            raise PlacedError(f"the supply of the units is an instrument now: write {new}", ("supply",))
        chamber = self.chamber
        if not chamber.lowest_degc <= self.ambient_degc <= chamber.highest_degc:
            text = f"ambient_degc is {self.ambient_degc:g}, outside the chamber's {chamber.lowest_degc:g} to"
            raise PlacedError(f"{text} {chamber.highest_degc:g} degC: there would be no safe state", ("ambient_degc",))
        if chamber.simulation is not None and not self.simulated:
            raise PlacedError("only a simulated chamber has it; this station is real", ("chamber", "simulation"))
        if not self.simulated and chamber.connection is None:
            raise PlacedError("a real station needs a `connection`", ("chamber",))
        if chamber.connection is not None and self.watchdog.silent_s < MOST_TIMEOUTS * chamber.connection.timeout_s:
            text = f"silent_s is {self.watchdog.silent_s:g}: a bench that waits for a chamber which does not answer is"
            text += f" silent for up to {MOST_TIMEOUTS} times its timeout_s, {chamber.connection.timeout_s:g}; raise it"
            raise PlacedError(text, ("watchdog", "silent_s"))
        self._check_buses()
        self._check_units()
        self._check_table()
        self._check_axes()
        self._check_faults()
        self._check_instruments()
        if self.fixture is not None and self.fixture.operator == "simulated" and not self.simulated:
            text = "a simulated operator turns only a simulated fixture; this station is real, remove `operator`"
            raise PlacedError(text, ("fixture", "operator"))
        for guard in self.guards:
            if guard.name == "unit silent" and guard.above is not None and guard.above < self.unit_silent_s:
                text = f"unit_silent_s is {self.unit_silent_s:g}: the guard `unit silent` ends the run of all units"
                raise PlacedError(f"{text} before, at {guard.above:g} s", ("unit_silent_s",))
        return self

    def _check_buses(self) -> None:
        for name, bus in self.buses.items():
            if name.lower() == "bench" or slug(name) != name:
                text = "the name of a bus is that of its journal: letters, digits, . _ + - inside, and not 'bench'"
                raise PlacedError(f"{name!r}: {text}", ("buses", name))
            if bus.framing is None and self.simulated != (bus.interface in LOCAL_INTERFACES):
                local = " or ".join(LOCAL_INTERFACES)
                text = f"a simulated station runs on {local}, a real one never does; this one is on {bus.interface!r}"
                raise PlacedError(text, ("buses", name, "interface"))

    def _check_faults(self) -> None:
        if self.faults and not self.simulated:
            raise PlacedError("faults are rehearsed on a simulated station; this one is real", ("faults",))
        for i, fault in enumerate(self.faults):
            serials, instruments = (unit.serial for unit in self.units), (one.name for one in self.instruments)
            if text := fault.wrong(self.buses, serials, instruments):
                raise PlacedError(text, ("faults", i))

    def _check_instruments(self) -> None:
        measured: dict[str, str] = {}
        for i, one in enumerate(self.instruments):
            if one.name in {other.name for other in self.instruments[:i]}:
                raise PlacedError(f"name {one.name!r} stands twice", ("instruments", i, "name"))
            if one.powers_units and any(other.powers_units for other in self.instruments[:i]):
                raise PlacedError("only one instrument switches the units", ("instruments", i, "powers_units"))
            if self.simulated != (one.address is None):
                text = "is simulated: remove the address" if self.simulated else "is real: it needs an address"
                place = ("instruments", i, *(("address",) if self.simulated else ()))
                raise PlacedError(f"instrument {one.name!r} of this station {text}", place)
            for k, reading in enumerate(one.read):
                if (other := measured.setdefault(reading.channel, one.name)) != one.name or reading in one.read[:k]:
                    text = f"{reading.channel} is measured by {other!r} already"
                    raise PlacedError(text, ("instruments", i, "read", k, "channel"))

        periods: dict[str, float] = {
            reading.channel: reading.period_s for one in self.instruments for reading in one.read
        }
        for i, guard in enumerate(self.guards):
            if guard.max_age_s <= (period_s := periods.get(guard.signal, 0.0)):
                text = f"max_age_s is {guard.max_age_s:g}, but {guard.signal} is read every {period_s:g} s: the guard"
                raise PlacedError(f"{text} would trip between two readings; raise it", ("guards", i, "max_age_s"))

    def _check_table(self) -> None:
        table = self.rate_table
        if table is None:
            return
        if self.simulated and table.driver != "cia402":
            raise PlacedError("a simulated station has a table with driver cia402", ("rate_table", "driver"))
        if table.simulation is not None and not self.simulated:
            raise PlacedError("only a simulated table has it; this station is real", ("rate_table", "simulation"))
        if table.bus is not None and table.bus not in self.buses:
            text = f"bus {table.bus!r} is not in this station; known: {', '.join(self.buses)}"
            raise PlacedError(text, ("rate_table", "bus"))
        for i, unit in enumerate(self.units):
            if unit.bus == table.bus:
                text = f"{unit.serial} is on {unit.bus}, the bus of the rate table, whose frames may have the same"
                raise PlacedError(f"{text} identifiers; give the table a bus of its own", ("units", i, "bus"))

    def _check_axes(self) -> None:
        nodes = {(table.bus, table.node) for table in (self.rate_table,) if table is not None and table.bus is not None}
        for i, axis in enumerate(() if self.fixture is None else self.fixture.axes):
            place = ("fixture", "axes", i)
            if axis.bus not in self.buses:
                text = f"bus {axis.bus!r} is not in this station; known: {', '.join(self.buses)}"
                raise PlacedError(text, (*place, "bus"))
            if any(unit.bus == axis.bus for unit in self.units):
                text = f"units are on {axis.bus}, too, whose frames may have the same identifiers; choose another bus"
                raise PlacedError(text, (*place, "bus"))
            if (axis.bus, axis.node) in nodes:
                raise PlacedError(f"node {axis.node} stands twice on {axis.bus}", (*place, "node"))
            nodes.add((axis.bus, axis.node))

    def _check_units(self) -> None:
        for i, unit in enumerate(self.units):
            if unit.bus not in self.buses:
                known = ", ".join(self.buses)
                raise PlacedError(f"bus {unit.bus!r} is not in this station; known: {known}", ("units", i, "bus"))
            if unit.flash.protocol == "command" and unit.flash.timeout_s >= self.watchdog.silent_s:
                text = f"timeout_s is {unit.flash.timeout_s:g}: a bench that waits for a command is silent, and the"
                text += f" watchdog ends it after silent_s, {self.watchdog.silent_s:g}; make it shorter"
                raise PlacedError(text, ("units", i, "flash", "timeout_s"))
            for other in self.units[:i]:
                if other.serial == unit.serial:
                    raise PlacedError(f"serial number {unit.serial} stands twice", ("units", i, "serial"))
                if (other.bus, other.number) == (unit.bus, unit.number):
                    text = f"{unit.serial} and {other.serial} are both number {unit.number} on {unit.bus}"
                    raise PlacedError(text, ("units", i))
                if unit.identity is not None and (other.bus, other.identity) == (unit.bus, unit.identity):
                    text = f"identity is {unit.identity}, as that of {other.serial} on {unit.bus}: one in the place of"
                    text += " the other would not be noticed; write the serial number that each sends, or leave it out"
                    raise PlacedError(text, ("units", i, "identity"))

    def chosen(self, serials: Sequence[str] = ()) -> tuple[UnitSettings, ...]:
        """The units with these serial numbers, or all; InputError that lists them where one is not known."""
        known = {unit.serial: unit for unit in self.units}
        for serial in serials:
            if serial not in known:
                raise InputError(
                    f"unit {serial!r} is not in station {self.name!r}; choose from {', '.join(known)}, or write "
                    f"{serial}@{next(iter(known))} for a new unit in that slot"
                )
        return tuple(known[serial] for serial in dict.fromkeys(serials)) or self.units

    def plant(self, seed: int) -> Plant:
        """The simulated chamber."""
        physics = self.chamber.simulation or PlantParameters()
        return Plant(physics.model_copy(update={"ambient_degc": self.ambient_degc}), seed)

    def beside(self, file: Document) -> StationSettings:
        """The same, read from `file`, with the files that it names by relative paths looked for in the same folder."""
        found: dict[str, Any] = {}
        folder = Path(file.file).parent
        if is_map_file(self.chamber.map):
            found["chamber"] = self.chamber.model_copy(update={"map": str((folder / self.chamber.map).absolute())})
        if self.eeproms is not None:
            found["eeproms"] = str(folder / self.eeproms)
        if self.fixture is not None:
            found["fixture"] = self.fixture.beside(folder)
        found["units"] = tuple(unit.beside(folder) for unit in self.units)
        for name in ("laboratory", "equipment"):
            if (given := getattr(self, name)) is not None and is_map_file(given):
                found[name] = str((folder / given).absolute())
        if self.notify is not None:
            found["notify"] = str((folder / self.notify).absolute())
        copied = self.model_copy(update=found)
        copied._written = file
        return copied

    def files(self) -> tuple[Path, ...]:
        """Files that the station file names: map, DBCs, laboratory, equipment, notification; not shipped ones."""
        named = (self.chamber.map, self.laboratory, self.equipment, self.notify, *(unit.dbc for unit in self.units))
        return tuple(Path(file) for file in dict.fromkeys(named) if file is not None and Path(file).is_absolute())

    def place(self, *path: str | int) -> tuple[str | None, int | None]:
        """File and line of what stands at `path` in the station file; None where it was not read from one."""
        return (None, None) if self._written is None else (self._written.file, self._written.line(path))

    def remembering(self, out: Path) -> StationSettings:
        """The same with simulated units that find below `out`, the folder of the runs, what was flashed before."""
        if not self.simulated or self.eeproms is not None:
            return self
        return self.model_copy(update={"eeproms": str(out / ".units")})

    def limits(self) -> Limits:
        """What the station allows and its chamber can do."""
        chamber = self.chamber
        return Limits(
            chamber.lowest_degc,
            chamber.highest_degc,
            chamber.heating_degc_per_min,
            chamber.cooling_degc_per_min,
            self.ambient_degc,
            None if self.rate_table is None else self.rate_table.highest_dps,
            switches_power=any(one.powers_units for one in self.instruments),
            orientation=self.orientation,
            fixture=None
            if self.fixture is None
            else Reach(self.fixture.names, self.fixture.takes_s, self.fixture.driven),
        )

    def measured(self) -> tuple[str, ...]:
        """Channels that its instruments measure."""
        return tuple(reading.channel for one in self.instruments for reading in one.read)

    def opened(self, switches_power: bool) -> tuple[InstrumentSettings, ...]:
        """The instruments that a run needs, which may switch the units' power."""
        return tuple(one for one in self.instruments if one.needed or (one.powers_units and switches_power))

    def standing_guards(self) -> tuple[Standing, ...]:
        """The guards that every run on this station has."""
        return standing_guards(self.limits(), self.protection)

    def seeds(self, occasion: str) -> dict[str, int]:
        """Seeds that make a simulated run repeatable; two occasions (profiles) do not share their noise."""
        return {"station": self.seed, "run": zlib.crc32(f"{self.seed} {occasion}".encode())} if self.simulated else {}
