"""`bench doctor`: what a station file says beside what the equipment says, read-only.

Writes no register and sends no frame. Everything is asked once and told, also after something disagreed; what only a
weak source knows is marked, so that one look at the real chamber settles it.
"""

from __future__ import annotations

import json
import operator
import statistics
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from bench.acquisition.station.instruments import worker_of
from bench.acquisition.station.serve import serve_station
from bench.acquisition.station.settings.bus import Bus
from bench.acquisition.station.settings.chamber import ChamberSettings
from bench.acquisition.station.settings.instrument import InstrumentSettings
from bench.acquisition.station.settings.station import StationSettings
from bench.acquisition.station.settings.unit import UnitSettings
from bench.base import CHANNELS
from drivers.can_record import FD_BYTES, FLAG_ERROR, FrameArray
from drivers.canbus import open_bus
from drivers.chamber import Chamber
from drivers.clock import Clock, SimClock, WallClock
from drivers.errors import ConfigError, DriverError, IdentityError, LimitError, LinkError, RefusedError
from drivers.frames import to_frames, to_record
from drivers.framing import Framing
from drivers.instrument import plausible
from drivers.modbus import ModbusLink
from drivers.registers import RegisterMap, load_map

ROUNDS = 10
"""Polls that the latency is judged by."""
_LEAST_SAMPLES, _LEAST_S = 20, 1.0
_WINDOW_S = 0.5
"""From so many on, over so long, their number says how often they come."""
_PIECE_S = 0.1
_DRAIN_S = 0.5

Verdict = Literal["agrees", "disagrees", "no link", "unknown", "told"]


@dataclass(frozen=True)
class Finding:
    """One thing that was compared: `told` is a value that nothing is known to compare with."""

    what: str
    verdict: Verdict
    detail: str
    uncertain: bool = False
    """Its address has a weak source: compare it with the panel."""


@dataclass
class Examination:
    """Everything that was found."""

    station: str
    findings: list[Finding] = field(default_factory=list)
    latency_s: dict[str, float] = field(default_factory=dict)

    def add(self, what: str, verdict: Verdict, detail: str, *, uncertain: bool = False) -> None:
        """One more finding."""
        self.findings.append(Finding(what, verdict, detail, uncertain))

    @property
    def exit_code(self) -> int:
        """0 all agrees, 1 something disagrees, 4 no link."""
        verdicts = {finding.verdict for finding in self.findings}
        return 4 if "no link" in verdicts else 1 if "disagrees" in verdicts else 0


def examine(settings: StationSettings, listen_s: float = 2.0) -> Examination:
    """Ask chamber and buses of a station, listening `listen_s` [s] to each bus; raises ConfigError for a bad map."""
    with reachable(settings) as (real, clock):
        found = Examination(settings.name)
        _chamber(found, real, clock)
        for name, bus in real.buses.items():
            _bus(found, name, bus, [unit for unit in real.units if unit.bus == name], clock, listen_s)
        for one in real.instruments:
            _instrument(found, one)
        if settings.rate_table is not None:
            found.add("rate table", "unknown", "not asked: a drive is only spoken to when a run begins")
        if settings.fixture is not None and settings.fixture.axes:
            reached = f"reaches {len(settings.fixture.names)} attitudes"
            found.add("fixture", "unknown", f"{reached}; not asked: a drive is only spoken to when a run begins")
        return found


@contextmanager
def reachable(settings: StationSettings) -> Iterator[tuple[StationSettings, Clock]]:
    """The station as one that is there: a simulated one behind its servers, advancing with its clock."""
    if not settings.simulated:
        yield settings, WallClock()
        return
    with serve_station(settings) as served:
        clock = SimClock()
        clock.attach(served.station.advance)
        yield StationSettings.model_validate_json(json.dumps(served.station_file())), clock


# ---- chamber --------------------------------------------------------------------------------------------------------


def _chamber(found: Examination, settings: StationSettings, clock: Clock) -> None:
    chamber, connection = settings.chamber, settings.chamber.connection
    registers = load_map(chamber.map)
    assert connection is not None  # checked with the file
    for text in registers.doubts():
        found.add("word order", "unknown", text)
    link = ModbusLink(connection.url, device_id=connection.device, timeout_s=connection.timeout_s, attempts=1)
    with closing(link):
        try:
            link.read(registers[registers.poll[0]].whole_word)
        except LinkError as error:
            found.add("chamber", "no link", str(error))
            return
        except DriverError:
            pass  # it answers; what, is told below
        found.add("chamber", "agrees", f"{connection.url} answers")
        with suppress(LinkError):
            registers = _recognised(found, registers, link)
            _limits(found, chamber, registers, link)
            _registers(found, registers, link)
            _driver(found, chamber, registers, link, clock)
            _latency(found, registers, link, connection.timeout_s)
            return
        found.add("chamber", "no link", f"{connection.url} stopped answering")


def _recognised(found: Examination, registers: RegisterMap, link: ModbusLink) -> RegisterMap:
    """Every identify rule and the decimals; the map with them."""
    for rule in registers.identify:
        register = registers[rule.register]
        try:
            value = link.read(register)
        except (RefusedError, LimitError) as error:
            found.add(f"rule {rule.register}", "disagrees", f"{error}; {rule.why}", uncertain=register.uncertain)
            continue
        text = value if isinstance(value, str) else f"{value:g}"
        agrees = rule.accepts(value)
        detail = f"reads {text}" if agrees else f"reads {text}; {rule.why}"
        found.add(f"rule {rule.register}", "agrees" if agrees else "disagrees", detail, uncertain=register.uncertain)
    if registers.unit_register is None:
        found.add("unit", "unknown", "no register tells it: compare the temperature below with the panel in degC")
    if not registers.identify:
        found.add("model", "unknown", "no register tells it")
    places = {}
    for name in registers.decimals:
        try:
            places[name] = round(float(link.read(registers[name])))
            found.add(f"decimals {name}", "agrees", f"the controller implies {places[name]}")
        except (RefusedError, LimitError) as error:
            places[name] = 0
            found.add(f"decimals {name}", "disagrees", str(error))
    return registers.with_decimals(places)


def _limits(found: Examination, chamber: ChamberSettings, registers: RegisterMap, link: ModbusLink) -> None:
    """Set points of the station file that the controller would refuse."""
    for name, station, inside in (
        ("setpoint_low", chamber.lowest_degc, operator.le),
        ("setpoint_high", chamber.highest_degc, operator.ge),
    ):
        if name not in registers:
            found.add(name, "unknown", f"the controller does not tell; the station file says {station:g} degC")
            continue
        with suppress(RefusedError, LimitError):
            own = float(link.read(registers[name]))
            verdict: Verdict = "agrees" if inside(own, station) else "disagrees"
            found.add(name, verdict, f"controller {own:g} degC, station file {station:g} degC")


def _registers(found: Examination, registers: RegisterMap, link: ModbusLink) -> None:
    for name, register in registers.registers.items():
        what = f"register {name} ({register.address})"
        try:
            value = link.read(register)
        except RefusedError as error:
            text = registers.exceptions.get(error.code)
            detail = f"refused: {error}" + (f" ({text})" if text else "")
            found.add(what, "unknown" if register.optional else "disagrees", detail, uncertain=register.uncertain)
        except LimitError as error:
            found.add(what, "disagrees", f"not plausible: {error}", uncertain=register.uncertain)
        else:
            text = value if isinstance(value, str) else f"{value:g} {register.unit}".rstrip()
            alarm = "; that is an alarm" if register.is_alarm(value) else ""
            verdict: Verdict = "disagrees" if alarm else "told"
            found.add(what, verdict, f"{text}{alarm}", uncertain=register.uncertain)


def _driver(
    found: Examination, chamber: ChamberSettings, registers: RegisterMap, link: ModbusLink, clock: Clock
) -> None:
    """Whether a run would begin: identification as the driver does it."""
    driver = Chamber(link, load_map(chamber.map), (chamber.lowest_degc, chamber.highest_degc), clock)
    try:
        identity = driver.identify()
    except (IdentityError, LimitError, RefusedError) as error:
        found.add("identification", "disagrees", f"a run would be refused: {error}")
        return
    low, high = identity.limits
    how = "its own ramp" if registers.native_ramp else "set points stepped by the bench"
    found.add("identification", "agrees", f"{identity.model}, set points {low:g} to {high:g} degC, {how}")


def _latency(found: Examination, registers: RegisterMap, link: ModbusLink, timeout_s: float) -> None:
    """How long requests take beside how long the driver waits for them."""
    took = []
    for _ in range(ROUNDS):
        for block in registers.blocks:
            start = time.perf_counter()
            with suppress(RefusedError, LimitError):
                link.read_block(block)
            took.append(time.perf_counter() - start)
    worst, median = max(took), statistics.median(took)
    found.latency_s = {"worst": worst, "median": median, "timeout": timeout_s}
    detail = f"worst {1e3 * worst:.1f} ms, median {1e3 * median:.1f} ms of {len(took)}; timeout_s is {timeout_s:g}"
    if worst > timeout_s / 2:
        found.add("latency", "disagrees", f"{detail}: raise timeout_s above {3 * worst:.1f}")
    else:
        found.add("latency", "agrees", detail)


# ---- instruments ----------------------------------------------------------------------------------------------------


def _instrument(found: Examination, one: InstrumentSettings) -> None:
    """Who it is, each of its values once, and how it is set now."""
    what = f"instrument {one.name}"
    try:
        driver = one.open()
    except ConfigError as error:
        found.add(what, "disagrees", str(error))
        return
    worker = worker_of(one)
    with ExitStack() as stack:
        stack.callback(worker.close, driver.close)
        try:
            said = worker.do(one.identify, driver)
        except (LinkError, IdentityError) as error:
            silent: Verdict = "unknown" if one.optional else "no link"
            found.add(what, silent if isinstance(error, LinkError) else "disagrees", str(error))
            return
        found.add(what, "agrees", said or f"{one.address} is not asked who it is")
        for reading in one.read:
            try:
                convert = reading.conversion()
                value = plausible(reading, convert.factor * worker.do(driver.read, reading) + convert.offset)
            except DriverError as error:
                found.add(f"{what} {reading.channel}", "disagrees", str(error))
            else:
                found.add(f"{what} {reading.channel}", "told", f"{value:g} {CHANNELS[reading.channel].unit}")
        switch = one.switch if one.powers_units else ((one.on,) if one.on is not None else ())
        for setting in (*one.set, *switch[:1]):
            try:
                state = "is set already" if worker.do(driver.is_set, setting) else "is not set now; a run sets it"
            except DriverError as error:
                found.add(f"{what} {setting.what}", "disagrees", str(error))
            else:
                found.add(f"{what} {setting.what}", "told", state)


# ---- buses ----------------------------------------------------------------------------------------------------------


def _bus(found: Examination, name: str, bus: Bus, units: list[UnitSettings], clock: Clock, listen_s: float) -> None:
    what = f"bus {name}"
    try:
        frames = listen(bus, clock, listen_s)
    except LinkError as error:
        found.add(what, "no link", str(error))
        return
    silence: Verdict = "disagrees" if units else "unknown"
    text = f"{len(frames)} frames in {listen_s:g} s"
    none = bool(np.all(frames["flags"] & FLAG_ERROR))
    if len(frames) and none and bus.framing is not None:
        text += ", all of them bytes that are no packet: compare framing, check sum and baud rate"
    found.add(what, silence if none else "agrees", text)
    for unit in units:
        _unit(found, unit, frames, listen_s, bus.to_driver().framing)


def _unit(found: Examination, unit: UnitSettings, frames: FrameArray, listen_s: float, framing: Framing | None) -> None:
    """What a unit says beside what its layout and the station file say it does."""
    what = f"unit {unit.serial}"
    decoder = unit.decoder()
    layout, block = decoder.layout, decoder.decode(frames)
    samples = len(block.t_ns)
    said = None if decoder.identity is None else decoder.identity.serial
    text = f"{samples} samples as number {unit.number}, serial number {'not heard' if said is None else said}"
    strange = unit.identity is not None and said is not None and said != unit.identity
    if strange:
        text += f", the station file says {unit.identity}"
    found.add(what, "disagrees" if strange or not samples else "agrees", text)
    step = unit.decoder().counter_step(frames)
    if step != 1:
        grows = 0 < step < 1 << decoder.counter_bits - 1
        advice = f"give it the scale {1 / step:.6g}" if grows else "it counts no samples, leave it out of `signals`"
        found.add(f"{what} counter", "disagrees", f"grows by {step} from one frame to the next: {advice}")
    if not samples:
        return
    t_s = 1e-9 * (block.t_ns - block.t_ns[0])
    rate_hz, heard_hz = 1e3 / layout.interval_ms, (samples - 1) / max(float(t_s[-1]), 1e-9)
    # On a busy computer frames are heard late and in heaps: a slow unit is slow all the time, and so is a fast one.
    starts = np.arange(0.0, max(float(t_s[-1]) - _WINDOW_S, 0.0) + 0.5 * _WINDOW_S, 0.1 * _WINDOW_S)
    heaps_hz = np.diff(np.searchsorted(t_s, np.stack([starts, starts + _WINDOW_S])), axis=0) / _WINDOW_S
    off = heaps_hz.min() > 1.25 * rate_hz or heaps_hz.max() < 0.8 * rate_hz
    if t_s[-1] > _LEAST_S and samples > _LEAST_SAMPLES and off:
        detail = f"{heard_hz:.0f} samples in a second, its layout says {rate_hz:g}: state `cycle_ms` in `signals`"
        found.add(f"{what} rate", "disagrees", detail)
    slow = {channel for source in layout.others for channel in source.channels}
    cycles = {c: source.message.cycle_ms or 0.0 for source in layout.others for c in source.channels}
    for channel in sorted(slow - {name for name, values in block.slow.items() if len(values.value)}):
        if 2e-3 * cycles[channel] <= listen_s:
            found.add(f"{what} {channel}", "disagrees", f"not heard in {listen_s:g} s, though its layout has it")
    for text in layout.lacks(framing):
        found.add(what, "unknown", text)


def listen(bus: Bus, clock: Clock, listen_s: float) -> FrameArray:
    """All frames of a bus within `listen_s` [s]; LinkError where it cannot be opened or read."""
    opened = open_bus(bus.to_driver())
    try:
        return to_frames(list(_heard(opened.recv, clock, listen_s, max(FD_BYTES, bus.room))))
    except Exception as error:  # each interface has errors of its own
        raise LinkError(f"{bus.interface} {bus.channel}: {error}") from error
    finally:
        opened.shutdown()


def _heard(recv: Callable[[float], Any], clock: Clock, listen_s: float, room: int) -> Iterator[bytes]:
    """Records of the frames that arrive within `listen_s`, and of what is still under way then."""
    recv(_PIECE_S)  # an interface that was just opened gets a moment
    end_s = clock.now() + listen_s
    while clock.now() < end_s:
        clock.sleep_until(min(clock.now() + _PIECE_S, end_s))
        yield from _drain(recv, clock, 0.0, room)
    yield from _drain(recv, clock, _DRAIN_S, room)


def _drain(recv: Callable[[float], Any], clock: Clock, wait_s: float, room: int) -> Iterator[bytes]:
    until_s = clock.now() + _DRAIN_S  # a live bus never falls silent; a simulated one stands still meanwhile
    while clock.now() < until_s and (message := recv(wait_s)) is not None:
        yield to_record(message, round(clock.now() * 1e9), 0, room)
