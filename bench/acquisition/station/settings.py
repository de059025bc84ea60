"""The station file: chamber, buses, units and interlocks of a bench, checked whole before anything is opened."""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field, PositiveFloat, model_validator

from bench.acquisition.profile.guards import GuardSettings
from bench.acquisition.profile.preflight import Limits
from bench.acquisition.profile.standing import ProtectionSettings, Standing, standing_guards
from bench.acquisition.station.faults import FaultSettings
from bench.base import STRICT, InputError, PlacedError
from drivers.flash_objects import Addresses
from drivers.interfaces import BusSettings, unit_filters
from drivers.registers import is_map_file

LOCAL_INTERFACES = ("virtual", "blocks")
"""python-can interfaces that live inside one process: captured in it. Everything else gets a process of its own."""
MOST_TIMEOUTS = 6
"""Time for which one question to a silent chamber may hold the bench up: three attempts, each with the wait for a late
answer to its end."""


Number = Annotated[int, Field(ge=0, le=15)]
Text = Annotated[str, Field(min_length=1)]
Degc = Annotated[float, Field(ge=-273.15, le=1000)]
Speed = PositiveFloat | Annotated[tuple[tuple[Degc, PositiveFloat], ...], Field(min_length=1)]


class Connection(BaseModel):
    """How the chamber's controller is reached."""

    model_config = STRICT

    url: Text
    """tcp://host:port, rtu+tcp://host:port or rtu:///dev/ttyUSB0?baudrate=9600"""
    device: Annotated[int, Field(ge=0, le=247)] = 1
    """Modbus address."""
    timeout_s: Annotated[float, Field(gt=0, le=60)] = 1.5
    """Longer than the controller's slowest answer."""


class LinkSettings(BaseModel):
    """What silence of a device means, and what to do when it answers again."""

    model_config = STRICT

    degraded_after_s: Annotated[float, Field(gt=0, le=3600)] = 10.0
    """Silent for this long: degraded; the run goes on, what it did not say is missing in the data."""
    lost_after_s: Annotated[float, Field(gt=0, le=3600)] = 60.0
    """Silent for this long: lost; the run ends, through the safe state."""
    retry_most_s: Annotated[float, Field(ge=1, le=600)] = 10.0
    """Longest time between two attempts to reach it; the first come after 1, 2, 4, … s."""
    on_return: Literal["continue", "abort"] = "continue"
    """When a degraded device answers again, is the one described and does what we told it: go on, or end the run."""

    @model_validator(mode="after")
    def _ordered(self) -> LinkSettings:
        if self.degraded_after_s >= self.lost_after_s:
            text = f"degraded_after_s ({self.degraded_after_s:g}) must be below lost_after_s ({self.lost_after_s:g})"
            raise ValueError(text)
        return self


class SafeStateSettings(BaseModel):
    """How the safe state is reached: set point to ambient, warmed up where it is cold, then off."""

    model_config = STRICT

    near_degc: Annotated[float, Field(gt=0, le=50)] = 5.0
    """Colder than ambient by more than this: warmed up before it is switched off, so that nothing frosts."""
    warm_up_min: Annotated[float, Field(ge=0, le=600)] = 60.0
    """Longest time for that; 0: never wait."""
    step_s: Annotated[float, Field(gt=0, le=600)] = 10.0
    """Longest time of each step."""
    retry_min: Annotated[float, Field(ge=0, le=600)] = 2.0
    """A chamber that does not answer is tried again for this long."""


class WatchdogSettings(BaseModel):
    """The process that makes a real station safe when the bench is killed or hangs."""

    model_config = STRICT

    silent_s: Annotated[float, Field(ge=1, le=3600)] = 60.0
    """A bench that is silent for longer hangs: it is killed, and the equipment made safe without it."""
    retry_min: Annotated[float, Field(ge=0, le=1440)] = 30.0
    """A chamber that does not answer is tried again for this long."""


class ChamberSettings(BaseModel):
    """The chamber: which register map, where, and what it may be asked for."""

    model_config = STRICT

    map: Text
    """Name of a shipped register map, or the path of a YAML file."""
    connection: Connection | None = None
    """Left out in a simulated station."""
    lowest_degc: Degc
    """Lowest set point that is ever sent."""
    highest_degc: Degc
    """Highest set point that is ever sent."""
    heating_degc_per_min: Speed
    """Fastest ramp that the chamber follows when heating: a number, or a list of [degC, rate] pairs."""
    cooling_degc_per_min: Speed
    """The same when cooling; small chambers are slow near their lowest temperature."""
    link: LinkSettings = LinkSettings()
    """What its silence means."""

    @model_validator(mode="after")
    def _ordered(self) -> ChamberSettings:
        if self.lowest_degc >= self.highest_degc:
            raise ValueError(f"lowest_degc ({self.lowest_degc:g}) must be below highest_degc ({self.highest_degc:g})")
        return self


class Bus(BaseModel):
    """One CAN bus, by the name of its python-can interface."""

    model_config = STRICT

    interface: Text
    """python-can interface: socketcan, pcan, kvaser, …; `blocks` or `virtual` in a simulated station."""
    channel: Text
    """Channel of that interface, such as can0."""
    bitrate: Annotated[int, Field(gt=0)] | None = None
    """Bit rate [bit/s]; left out where the operating system sets it."""
    fd: bool = False
    """CAN FD; frames of up to 8 bytes are captured, longer ones counted."""
    data_bitrate: Annotated[int, Field(gt=0)] | None = None
    """Bit rate [bit/s] of the data phase of CAN FD."""
    timing: dict[str, int | float] | None = None
    """Instead of bit rates: fields of python-can's BitTiming, or of BitTimingFd with `fd`; with a sample point in them,
    those of its `from_sample_point`."""
    filtered: bool = True
    """Only frames of the station's units are received; off: the journal keeps everything on the bus."""
    options: dict[str, Any] = Field(default_factory=dict)
    """Further options of the interface."""
    link: LinkSettings = LinkSettings(degraded_after_s=1.0, lost_after_s=4.0)
    """What a failure of its capture means; units on a bus that is lost leave the run, where others are left."""

    @model_validator(mode="after")
    def _fits(self) -> Bus:
        if self.data_bitrate is not None and not self.fd:
            text = f"data_bitrate is {self.data_bitrate}: only CAN FD has one; add `fd: true`"
            raise PlacedError(text, ("data_bitrate",))
        if self.timing is not None and (self.bitrate or self.data_bitrate):
            raise PlacedError("timing and bit rates exclude each other; leave one of them out", ("timing",))
        return self

    def to_driver(self, units: Iterable[UnitSettings] = ()) -> BusSettings:
        """The same for the driver; filtered for these units, if there are any."""
        heard = [(unit.gyro, unit.number) for unit in units] if self.filtered else []
        return BusSettings(
            interface=self.interface,
            channel=self.channel,
            bitrate=self.bitrate,
            options=self.options,
            fd=self.fd,
            data_bitrate=self.data_bitrate,
            timing=self.timing,
            filters=unit_filters(heard),
        )


class FlashSettings(BaseModel):
    """How the unit's calibration memory is reached, on the bus of the unit."""

    model_config = STRICT

    protocol: Literal["canopen", "uds"] = "canopen"
    """CANopen SDO, or UDS over ISO-TP."""
    node: Annotated[int, Field(ge=1, le=127)] | None = None
    """CANopen: node number; left out: 16 + the unit's number."""
    transfer: Literal["segmented", "expedited"] = "segmented"
    """CANopen: a whole image in one transfer, or word by word for units without segmented transfer."""
    request: Annotated[int, Field(ge=0, le=0x7FF)] | None = None
    """UDS: CAN identifier of our requests; left out: 0x6C0 + the unit's number."""
    answer: Annotated[int, Field(ge=0, le=0x7FF)] | None = None
    """UDS: CAN identifier of its answers; left out: 0x6D0 + the unit's number."""

    def addresses(self, number: int) -> Addresses:
        """For the unit of this number."""
        usual = Addresses.usual(number)
        return Addresses(
            self.protocol,
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
    flash: FlashSettings = FlashSettings()
    """How its calibration memory is reached."""
    simulation: dict[str, Any] | None = None
    """Truth, noise and channels of a simulated unit; left out: the default unit."""


class RateTableSettings(BaseModel):
    """The rate table that the units are mounted on."""

    model_config = STRICT

    driver: Literal["cia402", "aerosmith"] = "cia402"
    """A CiA 402 drive in profile velocity mode on CAN, or an Ideal Aerosmith on a serial line."""
    bus: Text | None = None
    """CiA 402: name of the bus that the drive is on; no unit may be on it."""
    node: Annotated[int, Field(ge=1, le=126)] = 1
    """CiA 402: node number of the drive."""
    counts_per_degree: PositiveFloat | None = None
    """CiA 402: units of position in one degree of the table, gear included; velocity is in the same per second."""
    sample_ms: Annotated[int, Field(ge=5, le=1000)] = 20
    """CiA 402: interval of the encoder's readings."""
    latency_ms: Annotated[float, Field(ge=0, le=1000)] = 0.0
    """CiA 402: by how much a reading of the velocity lags behind the motion."""
    heartbeat_s: Annotated[float, Field(ge=2, le=60)] = 10.0
    """CiA 402: longest silence of bench or drive before the axis is stopped; longer than a chamber that misses one
    answer keeps the bench busy (three times its timeout, twice that on a serial line)."""
    port: Text | None = None
    """Aerosmith: serial port, such as /dev/ttyUSB0."""
    jog_unit: Literal["deg/s", "deg/min"] = "deg/s"
    """Aerosmith: unit of its JOG command; verified by position over time before anything turns."""
    highest_dps: PositiveFloat
    """Fastest rate that is ever commanded, either way [deg/s]."""
    accel_dps2: PositiveFloat
    """Acceleration [deg/s^2]; what table, fixture and cables bear."""
    tolerance_dps: PositiveFloat = 0.05
    """How far the mean over a second may be off its rate, beside 0.2 % of it."""

    @model_validator(mode="after")
    def _complete(self) -> RateTableSettings:
        needs = ("bus", "counts_per_degree") if self.driver == "cia402" else ("port",)
        if missing := [name for name in needs if getattr(self, name) is None]:
            raise ValueError(f"a table with driver {self.driver} needs {' and '.join(missing)}")
        return self


class StationSettings(BaseModel):
    """A station: the equipment of a bench."""

    model_config = STRICT

    name: Text
    """What the station is called."""
    simulated: bool = False
    """The embedded simulator takes the place of all equipment."""
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
    unit_silent_s: Annotated[float, Field(gt=0, le=3600)] = 5.0
    """A unit that sends nothing sound for this long leaves a run of several units [s]."""

    @model_validator(mode="after")
    def _consistent(self) -> StationSettings:
        chamber = self.chamber
        if not chamber.lowest_degc <= self.ambient_degc <= chamber.highest_degc:
            text = f"ambient_degc is {self.ambient_degc:g}, outside the chamber's {chamber.lowest_degc:g} to"
            raise PlacedError(f"{text} {chamber.highest_degc:g} degC: there would be no safe state", ("ambient_degc",))
        if not self.simulated and chamber.connection is None:
            raise PlacedError("a real station needs a `connection`", ("chamber",))
        if chamber.connection is not None and self.watchdog.silent_s < MOST_TIMEOUTS * chamber.connection.timeout_s:
            text = f"silent_s is {self.watchdog.silent_s:g}: a bench that waits for a chamber which does not answer is"
            text += f" silent for up to {MOST_TIMEOUTS} times its timeout_s, {chamber.connection.timeout_s:g}; raise it"
            raise PlacedError(text, ("watchdog", "silent_s"))
        for name, bus in self.buses.items():
            if self.simulated != (bus.interface in LOCAL_INTERFACES):
                local = " or ".join(LOCAL_INTERFACES)
                text = f"a simulated station runs on {local}, a real one never does; this one is on {bus.interface!r}"
                raise PlacedError(text, ("buses", name, "interface"))
        self._check_units()
        self._check_table()
        self._check_faults()
        for guard in self.guards:
            if guard.name == "unit silent" and guard.above is not None and guard.above < self.unit_silent_s:
                text = f"unit_silent_s is {self.unit_silent_s:g}: the guard `unit silent` ends the run of all units"
                raise PlacedError(f"{text} before, at {guard.above:g} s", ("unit_silent_s",))
        return self

    def _check_faults(self) -> None:
        if self.faults and not self.simulated:
            raise PlacedError("faults are rehearsed on a simulated station; this one is real", ("faults",))
        for i, fault in enumerate(self.faults):
            if text := fault.wrong(set(self.buses), {unit.serial for unit in self.units}):
                raise PlacedError(text, ("faults", i))

    def _check_table(self) -> None:
        table = self.rate_table
        if table is None:
            return
        if self.simulated and table.driver != "cia402":
            raise PlacedError("a simulated station has a table with driver cia402", ("rate_table", "driver"))
        if table.bus is not None and table.bus not in self.buses:
            text = f"bus {table.bus!r} is not in this station; known: {', '.join(self.buses)}"
            raise PlacedError(text, ("rate_table", "bus"))
        for i, unit in enumerate(self.units):
            if unit.bus == table.bus:
                text = f"{unit.serial} is on {unit.bus}, the bus of the rate table, whose frames may have the same"
                raise PlacedError(f"{text} identifiers; give the table a bus of its own", ("units", i, "bus"))

    def _check_units(self) -> None:
        for i, unit in enumerate(self.units):
            if unit.bus not in self.buses:
                known = ", ".join(self.buses)
                raise PlacedError(f"bus {unit.bus!r} is not in this station; known: {known}", ("units", i, "bus"))
            for other in self.units[:i]:
                if other.serial == unit.serial:
                    raise PlacedError(f"serial number {unit.serial} stands twice", ("units", i, "serial"))
                if (other.bus, other.number) == (unit.bus, unit.number):
                    text = f"{unit.serial} and {other.serial} are both number {unit.number} on {unit.bus}"
                    raise PlacedError(text, ("units", i))

    def chosen(self, serials: Sequence[str] = ()) -> tuple[UnitSettings, ...]:
        """The units with these serial numbers, or all; InputError that lists them where one is not known."""
        known = {unit.serial: unit for unit in self.units}
        for serial in serials:
            if serial not in known:
                text = f"unit {serial!r} is not in station {self.name!r}; choose from {[*known]} with --unit"
                raise InputError(text)
        return tuple(known[serial] for serial in dict.fromkeys(serials)) or self.units

    def beside(self, folder: Path) -> StationSettings:
        """The same with the files that it names by relative paths looked for in `folder`, that of the station file."""
        found: dict[str, Any] = {}
        if is_map_file(self.chamber.map):
            found["chamber"] = self.chamber.model_copy(update={"map": str(folder / self.chamber.map)})
        if self.eeproms is not None:
            found["eeproms"] = str(folder / self.eeproms)
        return self.model_copy(update=found)

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
        )

    def standing_guards(self) -> tuple[Standing, ...]:
        """The guards that every run on this station has."""
        return standing_guards(self.limits(), self.protection)

    def seeds(self, occasion: str) -> dict[str, int]:
        """Seeds that make a simulated run repeatable; two occasions (profiles) do not share their noise."""
        return {"station": self.seed, "run": zlib.crc32(f"{self.seed} {occasion}".encode())} if self.simulated else {}
