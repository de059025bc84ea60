"""A mapping of signals for a unit that nobody described, from listening to its bus; the user confirms it.

Nothing is sent and nothing moves. What frames cannot tell (scale, unit, serial number) is marked `CONFIRM`, which
`bench check` refuses until it is replaced.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Any

from bench.acquisition.station.doctor import listen, reachable
from bench.acquisition.station.settings.chamber import ChamberSettings
from bench.acquisition.station.settings.station import StationSettings
from bench.base import InputError
from drivers.errors import DriverError
from drivers.layout import ACCELERATIONS, RATES
from drivers.modbus import ModbusLink
from drivers.registers import load_map
from drivers.unknown_frames import LEAST_FRAMES, Field, Heard, heard, thermometers

CONFIRM = "CONFIRM"
_CYCLES_MS = (0.5, 1.0, 2.0, 2.5, 4.0, 5.0, 8.0, 10.0, 20.0, 25.0, 40.0, 50.0, 100.0, 200.0, 250.0, 500.0, 1000.0)


@dataclass(frozen=True)
class Proposal:
    """What was heard on each bus, and a unit for each bus on which something like one was."""

    heard: dict[str, tuple[Heard, ...]]
    air_degc: float | None
    """Air of the chamber while listening; None: it does not say."""
    units: dict[str, dict[str, tuple[dict[str, Any], str]]]
    """By bus and by key of `signals`: bits, and what was seen in them."""
    missing: dict[str, tuple[str, ...]]
    """By bus: what was not found, and what is lost without it."""

    def yaml(self) -> str:
        """Units of a station file, with what is to be confirmed."""
        return "\n".join(self._lines()) + "\n"

    def _lines(self) -> Iterator[str]:
        yield f"# Proposed by `bench doctor`. Replace each {CONFIRM} and put the units into the station file."
        yield "units:"
        for bus, signals in self.units.items():
            yield f"  - serial: {CONFIRM}    # as it stands on the unit"
            yield f"    bus: {bus}"
            yield "    signals:"
            counters = [_spell(bits) for key, (bits, _) in signals.items() if key.startswith("counter")]
            for key, (bits, seen) in signals.items():
                if not key.startswith("counter"):
                    yield f"      {key}: {_spell(bits)}    # {seen}"
            if counters:
                yield f"      counter: [{', '.join(counters)}]"
            yield from (f"      # not found: {text}" for text in self.missing[bus])


def propose(settings: StationSettings, listen_s: float) -> Proposal:
    """Listen `listen_s` [s] to each bus; InputError where nothing looks like a unit, LinkError without a bus."""
    with reachable(settings) as (real, clock):
        air_degc = _air(real.chamber)
        found = {
            name: heard(listen(bus, clock, listen_s), listen_s, bus.to_driver().framing)
            for name, bus in real.buses.items()
        }
    units = {name: signals for name, one in found.items() if (signals := _signals(one, air_degc))}
    if not units:
        seen = "; ".join(f"{name}: {sum(x.frames for x in one)} frames" for name, one in found.items())
        text = f"nothing looks like a unit that sends samples ({seen} in {listen_s:g} s)"
        raise InputError(f"{text}: switch it on, check bit rate and `fd`, or listen longer with --listen")
    missing = {name: tuple(_missing(signals, air_degc)) for name, signals in units.items()}
    return Proposal(found, air_degc, units, missing)


def _signals(found: Sequence[Heard], air_degc: float | None) -> dict[str, tuple[dict[str, Any], str]]:
    told = [one for one in found if one.frames >= LEAST_FRAMES]
    warm = {} if air_degc is None else thermometers(told, air_degc)
    fastest = [one for one in told if one.rate_hz > 0.9 * max(other.rate_hz for other in told)]
    numbers = [(one, field) for one in fastest for field in one.of_kind("number")]
    places = [(one, field) for one, field in numbers if (one.id, field.first) not in warm]
    if numbers and not places:  # a unit has an output, which scatters most
        places = [max(numbers, key=lambda place: place[1].scatter)]
        warm = {place: read for place, read in warm.items() if place != (places[0][0].id, places[0][1].first)}
    names = ("rate",) if len(places) == 1 else (*RATES[1:], *ACCELERATIONS)
    signals = {}
    for name, (one, field) in zip(names, places, strict=False):
        bits = _bits(one, field, scale=1.0, unit=CONFIRM)
        signals[name] = bits, f"raw {field.mean:.6g}, scatter {field.scatter:.3g}, {one.rate_hz:.4g} frames a second"
    if not signals:
        return {}
    for place, ((identifier, _), (field, scale, unit)) in enumerate(warm.items()):
        one = next(x for x in told if x.id == identifier)
        name = "temperature" if len(warm) == 1 else f"temperature_{place + 1}"
        seen = f"{CONFIRM}: reads {field.mean * scale:.2f} {unit}, the air of the chamber is at {air_degc:.2f} degC"
        signals[name] = _bits(one, field, scale=scale, unit=unit), seen
    used = {int(bits["id"]) for bits, _ in signals.values()}
    for one in (x for x in told if x.id in used):
        for field in one.of_kind("counter")[:1]:
            if one in fastest or signals.get("counter 0"):
                step = f"goes on by {field.mean:g} a frame"
                bits = _bits(one, field) | ({} if field.mean == 1 else {"scale": float(f"{1 / field.mean:.12g}")})
                signals[f"counter {sum(key.startswith('counter') for key in signals)}"] = bits, step
    return signals


def _bits(one: Heard, field: Field, **more: Any) -> dict[str, Any]:
    long = {"extended": True} if one.extended and one.id <= 0x7FF else {}
    cycle_ms = 1e3 / one.rate_hz
    near = min(_CYCLES_MS, key=lambda known: abs(known - cycle_ms))
    cycle = {"cycle_ms": near if abs(near - cycle_ms) < 0.1 * near else float(f"{cycle_ms:.3g}")} if more else {}
    return {**field.bits(one.id), **long, **more, **cycle}


def _missing(signals: dict[str, tuple[dict[str, Any], str]], air_degc: float | None) -> Iterator[str]:
    if "counter 0" not in signals:
        yield "a counter; samples are then counted by their cycle time"
    if air_degc is None:
        yield "a thermometer: the chamber does not say its temperature, which one is told by"
    elif not any(name.startswith("temperature") for name in signals):
        yield "a thermometer near the air of the chamber; its air then takes the place of one"
    yield "serial, state, status: frames do not tell them; map those that the data sheet has"


def _air(chamber: ChamberSettings) -> float | None:
    connection, registers = chamber.connection, load_map(chamber.map)
    if connection is None or registers["temperature"].decimals:
        return None
    link = ModbusLink(connection.url, device_id=connection.device, timeout_s=connection.timeout_s, attempts=1)
    with closing(link):
        try:
            return float(link.read(registers["temperature"]))
        except DriverError:
            return None


def _spell(bits: dict[str, Any]) -> str:
    known = {**bits, "id": f"0x{bits['id']:X}"}
    words = (f"{key}: {'true' if value is True else value}" for key, value in known.items())
    return f"{{{', '.join(words)}}}"
