"""What the wires of a station carry: what each unit does not say, and whether its frames fit on their bus."""

from __future__ import annotations

from collections.abc import Container, Iterable, Iterator, Mapping

from bench.acquisition.profile.preflight import Finding, Recording
from bench.acquisition.station.settings.framing import FramingSettings
from bench.acquisition.station.settings.instrument import InstrumentSettings
from bench.acquisition.station.settings.station import StationSettings
from drivers.bus_load import load
from drivers.errors import ConfigError
from drivers.layout import layout_of
from drivers.sim.axes import SAMPLE_MS as SIMULATED_MS
from drivers.wire import Message, load_dbc

BITS_PER_BYTE = 10
"""Of a serial line, with start bit and stop bit."""
FULL, BUSY = 1.0, 0.7
"""Shares of a bus that its frames cannot have, and from which other traffic delays them."""
BYTES_PER_FRAME = 33.3
"""Disk of a frame of up to 8 bytes, longer ones need more: 24 in the journal, the rest in the compressed tables."""


def wire_findings(station: StationSettings, sent: Container[str] = ()) -> Iterator[Finding]:
    """What to know of mapped units and of buses whose bit rate is stated; an error where the frames do not fit.

    `sent` are serial numbers of simulated units whose frames are not the simulator's. ConfigError where a DBC or a
    mapping does not describe a unit.
    """
    traffic: dict[str, list[Message]] = {name: [] for name in station.buses}
    bits_per_s = dict.fromkeys(station.buses, 0.0)
    for unit in station.units:
        layout = layout_of(unit.dbc, unit.mapping)
        every = {} if unit.dbc is None else load_dbc(unit.dbc)
        messages = [*{**every, **{message.name: message for message in layout.messages}}.values()]
        traffic[unit.bus] += messages
        for text in layout.lacks():
            yield Finding("info", f"unit {unit.serial}: {text}")
        if unit.identity is not None and (layout.beat is None or "serial" not in layout.beat.signals):
            text = f"unit {unit.serial}: identity {unit.identity} is to be checked, but it says no serial number"
            yield Finding("error", f"{text}; map `serial` in `signals`, or leave `identity` out")
        own = unit.serial in sent or "imu" in (unit.simulation or {})
        if station.simulated and layout.interval_ms != SIMULATED_MS and not own:
            text = (
                f"unit {unit.serial}: its layout says a sample every {layout.interval_ms:g} ms; a simulated one sends"
            )
            yield Finding("error", f"{text} every {SIMULATED_MS:g} ms")
        framing = station.buses[unit.bus].framing
        if framing is not None:
            yield from _packets(unit.serial, messages, framing)
            cycles = [(one.length, one.cycle_ms or layout.interval_ms) for one in messages]
            bits_per_s[unit.bus] += sum(BITS_PER_BYTE * length / ms * 1e3 for length, ms in cycles)
            continue
        longest = max(messages, key=lambda message: message.length)
        if longest.length > 8 and not station.buses[unit.bus].fd:
            text = f"unit {unit.serial}: {longest.name} has {longest.length} bytes, bus {unit.bus} is classical CAN"
            yield Finding("error", f"{text}; state `fd: true` for it")
    for name, bus in station.buses.items():
        if bus.bitrate is not None and bus.framing is not None:
            yield from _load(name, bits_per_s[name] / bus.bitrate)
        elif bus.bitrate is not None and traffic[name]:
            yield from _load(name, load(traffic[name], bus.bitrate, bus.data_bitrate, bus.fd))
    yield from _instruments(station)


def _instruments(station: StationSettings) -> Iterator[Finding]:
    """What each instrument does; an error where its address cannot be used here, or units send what it measures."""
    sent = {unit.serial: layout_of(unit.dbc, unit.mapping).channels for unit in station.units}
    for instrument in station.instruments:
        yield from _instrument(instrument, sent)


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
    if instrument.needed:
        yield Finding("info", f"instrument {instrument.told()}")


def _packets(serial: str, messages: Iterable[Message], framing: FramingSettings) -> Iterator[Finding]:
    """Whether the packets that a unit's signals are of are those of its line."""
    for message in messages:
        text = f"unit {serial}: packet {message.id} has {message.length} bytes by its signals"
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


def _load(name: str, share: float) -> Iterator[Finding]:
    text = f"bus {name}: its units take {share:.0%} of it"
    if share > FULL:
        text += ", more than there is; spread them over more buses, raise the bit rate, or send less often"
        yield Finding("error", text)
    else:
        yield Finding("warning" if share > BUSY else "info", text + (", others delay them" if share > BUSY else ""))
