"""What the wires of a station carry: what each unit does not say, and whether its frames fit on their bus."""

from __future__ import annotations

from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

from bench.acquisition.profile.guards import GuardSettings, guards_of, told_by
from bench.acquisition.profile.preflight import Finding, Recording
from bench.acquisition.station.settings.bus import Bus
from bench.acquisition.station.settings.instrument import InstrumentSettings
from bench.acquisition.station.settings.station import StationSettings
from bench.acquisition.station.settings.unit import UnitSettings
from bench.acquisition.station.simulation import try_unit
from bench.base import InputError
from drivers.bus_load import load
from drivers.errors import ConfigError
from drivers.framing import Framing
from drivers.layout import Layout, layout_of
from drivers.modbus import unknown_host
from drivers.register import ORDER_ASSUMED
from drivers.registers import map_text, parse_map
from drivers.wire import Message, load_dbc

BITS_PER_BYTE = 10
"""Of a serial line, with start bit and stop bit."""
FULL, BUSY = 1.0, 0.7
"""Shares of a bus that its frames cannot have, and from which other traffic delays them."""
ASSUMED_BITRATE = 500_000
"""Of a bus whose bit rate the operating system sets, or a timing, so that an overfull one is told."""
BYTES_PER_FRAME = 33.3
"""Disk of a frame of up to 8 bytes, longer ones need more: 24 in the journal, the rest in the compressed tables."""


def wire_findings(
    station: StationSettings, sent: Container[str] = (), guards: Sequence[GuardSettings] = ()
) -> Iterator[Finding]:
    """What to know of the equipment before it is opened, with file and line; an error where a run cannot begin.

    `sent` are serial numbers of simulated units whose frames are not the simulator's, `guards` those of the profile.
    """
    yield from _chamber(station, guards)
    yield from _hosts(station)
    traffic: dict[str, list[Message]] = {name: [] for name in station.buses}
    bits_per_s = dict.fromkeys(station.buses, 0.0)
    channels: dict[str, Container[str]] = {}
    for i, unit in enumerate(station.units):
        place = station.place("units", i)
        try:
            layout = layout_of(unit.dbc, unit.mapping)
        except ConfigError as error:
            yield Finding("error", f"unit {unit.serial}: {error}", *place)
            continue
        every = {} if unit.dbc is None else load_dbc(unit.dbc)
        messages = [*{**every, **{message.name: message for message in layout.messages}}.values()]
        traffic[unit.bus] += messages
        channels[unit.serial] = layout.channels
        bus = station.buses[unit.bus]
        if bus.framing is not None:
            cycles = [(one.length, one.cycle_ms or layout.interval_ms) for one in messages]
            bits_per_s[unit.bus] += sum(BITS_PER_BYTE * length / ms * 1e3 for length, ms in cycles)
        own = unit.serial in sent or not station.simulated
        for finding in (*_unit(unit, layout, messages, bus), *(() if own else _simulated(station, unit))):
            yield _placed(replace(finding, text=f"unit {unit.serial}: {finding.text}"), place)
    for name, bus in station.buses.items():
        yield from _filled(name, bus, traffic[name], bits_per_s[name], station.place("buses", name))
    for i, instrument in enumerate(station.instruments):
        place = station.place("instruments", i)
        for finding in _instrument(instrument, channels):
            yield _placed(finding, place)


def _placed(finding: Finding, place: tuple[str | None, int | None]) -> Finding:
    """An error with file and line; what is only to be known has none."""
    return replace(finding, file=place[0], line=place[1]) if finding.level == "error" else finding


def _chamber(station: StationSettings, guards: Sequence[GuardSettings]) -> Iterator[Finding]:
    """Whether the register map can be used, has the chamber's range, and tells what guards watch."""
    chamber = station.chamber
    try:
        text, name = map_text(chamber.map)
    except ConfigError as error:
        yield Finding("error", str(error), *station.place("chamber", "map"))
        return
    try:
        registers = parse_map(text, name)
    except ConfigError as error:
        yield Finding("error", str(error))  # it names the file of the map
        return
    for text in registers.doubts():
        yield Finding("warning", text, *station.place("chamber", "map"))
    register = registers["setpoint"]
    for key, beyond in (
        ("lowest_degc", register.low is not None and chamber.lowest_degc < register.low),
        ("highest_degc", register.high is not None and chamber.highest_degc > register.high),
    ):
        if beyond:
            low, high = ("-" if one is None else f"{one:g}" for one in (register.low, register.high))
            text = f"chamber.{key} is {getattr(chamber, key):g}: the map writes set points from {low} to {high} degC"
            text += "; correct one of them"
            yield Finding("error", text, *station.place("chamber", key))
    told = {*told_by(registers.registers), *station.measured()}
    standing = [one.guard for one in station.standing_guards()]
    own = [(guard, station.place("guards", i)) for i, guard in enumerate(station.guards)]
    for guard, place in (*own, *((guard, (None, None)) for guard in guards)):
        try:
            guards_of([guard], (), told, standing=standing)
        except InputError as error:
            yield Finding("error", str(error), *place)


def _hosts(station: StationSettings) -> Iterator[Finding]:
    """Hosts whose names this computer does not know; the one that runs may know them."""
    if station.simulated or station.chamber.connection is None:
        return
    urls: dict[tuple[str | int, ...], str] = {("chamber", "connection", "url"): station.chamber.connection.url}
    urls |= {("buses", name, "channel"): bus.channel for name, bus in station.buses.items() if "://" in bus.channel}
    urls |= {("instruments", i, "address"): one.address or "" for i, one in enumerate(station.instruments)}
    for place, url in urls.items():
        if text := unknown_host(url):
            yield Finding("warning", f"{url}{text}; correct it, or run where it is known", *station.place(*place))


def _unit(unit: UnitSettings, layout: Layout, messages: Sequence[Message], bus: Bus) -> Iterator[Finding]:
    """What a unit does not say, and whether its frames or packets are those of its bus."""
    framing = None if bus.framing is None else bus.framing.to_driver()
    for text in layout.lacks(framing):
        yield Finding("info", text)
    if unit.identity is not None and (layout.beat is None or "serial" not in layout.beat.signals):
        text = f"identity {unit.identity} is to be checked, but it says no serial number"
        yield Finding("error", f"{text}; map `serial` in `signals`, or leave `identity` out")
    if framing is not None:
        yield from _packets(messages, framing)
        return
    longest = max(messages, key=lambda message: message.length)
    if longest.length > 8 and not bus.fd:
        text = f"{longest.name} has {longest.length} bytes, bus {unit.bus} is classical CAN"
        yield Finding("error", f"{text}; state `fd: true` for it")


def _simulated(station: StationSettings, unit: UnitSettings) -> Iterator[Finding]:
    """Whether the simulator can be this unit."""
    try:
        try_unit(station, unit)
    except ConfigError as error:
        yield Finding("error", str(error))


def _instrument(instrument: InstrumentSettings, sent: Mapping[str, Container[str]]) -> Iterator[Finding]:
    if instrument.address is not None:
        try:
            instrument.open()
        except ConfigError as error:
            yield Finding("error", f"instrument {instrument.name}: {error}")
    for reading in instrument.read:
        if both := [serial for serial, channels in sent.items() if reading.channel in channels]:
            text = f"instrument {instrument.name}: unit {', '.join(both)} sends {reading.channel} itself"
            yield Finding("error", f"{text}; measure it as `voltage`, or leave it out")
        if reading.modbus is not None and reading.modbus.order_assumed:
            yield Finding("warning", f"instrument {instrument.name}: {reading.channel} {ORDER_ASSUMED}")
    if instrument.needed:
        yield Finding("info", f"instrument {instrument.told()}")


def _packets(messages: Iterable[Message], framing: Framing) -> Iterator[Finding]:
    """Whether the packets that a unit's signals are of are those of its line, and the signals between its own bytes."""
    for message in messages:
        for signal in message.signals.values():
            touched = {*(signal.places // 8).tolist()}
            for what, taken in framing.taken(message.length):
                if both := touched & {*taken}:
                    text = f"packet {message.id}: the signal at {signal.name} is in byte {min(both)}, which is of the"
                    yield Finding("error", f"{text} {what}; bytes count from the first of the packet, header included")
        text = f"packet {message.id} has {message.length} bytes by its signals"
        if framing.length is not None and message.length != framing.length:
            how = f"state `bytes: {framing.length}` in one of them, or correct the line's `length`"
            yield Finding("error", f"{text}, {framing.length} by the framing of its line; {how}")
        elif message.length > framing.longest and framing.length is None:
            yield Finding("error", f"{text}, the longest of its line {framing.longest}; raise `longest`")


def recording_of(station: StationSettings, free_bytes: float) -> Recording:
    """What the units of a station send, as their layouts say; ConfigError where one does not describe its unit."""
    rates, bytes_per_s = [], 0.0
    for unit in station.units:
        layout = layout_of(unit.dbc, unit.mapping)
        rates.append(1e3 / layout.interval_ms)
        for message in layout.messages:
            frame_bytes = BYTES_PER_FRAME + max(message.length - 8, 0)
            bytes_per_s += 1e3 / (message.cycle_ms or layout.interval_ms) * frame_bytes
    return Recording(rates, bytes_per_s, free_bytes)


def _filled(
    name: str, bus: Bus, traffic: Sequence[Message], bits_per_s: float, place: tuple[str | None, int | None]
) -> Iterator[Finding]:
    """How full a bus is; that nobody knows where its bit rate is not stated, and its units may be too many."""
    if bus.bitrate is not None and bus.framing is not None:
        yield from _load(name, bits_per_s / bus.bitrate, place)
    elif bus.bitrate is not None and traffic:
        yield from _load(name, load(traffic, bus.bitrate, bus.data_bitrate, bus.fd), place)
    elif not bus.local and (share := load(traffic, ASSUMED_BITRATE, fd=bus.fd)) > BUSY:
        text = f"bus {name}: its bit rate is not stated, so nobody knows whether all frames fit; at "
        text += f"{ASSUMED_BITRATE} bit/s its units take {share:.0%} of it; state `bitrate`"
        yield Finding("warning", f"{text}, and `data_bitrate` of CAN FD" if bus.fd else text)


def _load(name: str, share: float, place: tuple[str | None, int | None]) -> Iterator[Finding]:
    text = f"bus {name}: its units take {share:.0%} of it"
    if share > FULL:
        text += ", more than there is; spread them over more buses, raise the bit rate, or send less often"
        yield Finding("error", text, *place)
    else:
        yield Finding("warning" if share > BUSY else "info", text + (", others delay them" if share > BUSY else ""))
