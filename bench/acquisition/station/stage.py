"""The simulated equipment of a station on private buses, with the faults of the station file: moved by whoever asks."""

from __future__ import annotations

import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass

from bench.acquisition.station.fault_injection import TIMEOUT_S, FaultInjection
from bench.acquisition.station.occasion import Occasion
from bench.acquisition.station.records import Records
from bench.acquisition.station.settings.bus import Bus
from bench.acquisition.station.settings.chamber import Connection
from bench.acquisition.station.settings.station import StationSettings
from bench.acquisition.station.settings.unit import UnitSettings
from bench.acquisition.station.simulation import simulate
from drivers.registers import load_map
from drivers.sim.station import SimulatedStation


@dataclass(frozen=True)
class Stage:
    """Simulated equipment that is there."""

    station: SimulatedStation
    buses: Mapping[str, Bus]
    """Under names that no other station in this process uses."""
    connection: Connection
    """How its chamber is reached."""
    advance: Callable[[float, float], None]
    """Lets time pass, from one bench time to another [s]."""
    injection: FaultInjection | None = None
    """What goes wrong on purpose."""


@contextmanager
def open_stage(
    settings: StationSettings,
    units: Sequence[UnitSettings],
    occasion: Occasion | None = None,
    records: Records | None = None,
) -> Iterator[Stage]:
    """The simulated chamber, rate table, supply and these units; `records` are told when a fault begins and ends."""
    with ExitStack() as stack:
        buses = _private(settings.buses)
        station = stack.enter_context(closing(simulate(settings, units, buses, stack, occasion)))
        connection = Connection(url=f"tcp://127.0.0.1:{station.modbus_port}")
        if not settings.faults:
            yield Stage(station, buses, connection, station.advance)
            return
        registers = load_map(settings.chamber.map)
        injection = FaultInjection(settings, units, station, registers, stack, records or Records())
        if injection.proxy is not None:
            connection = Connection(url=injection.proxy.url, timeout_s=TIMEOUT_S)
        yield Stage(station, buses, connection, injection.advance, injection)


def _private(buses: Mapping[str, Bus]) -> dict[str, Bus]:
    """The same buses under names that no other station in this process uses."""
    suffix = uuid.uuid4().hex[:8]
    options = {"virtual": {"preserve_timestamps": True}}
    found = {}
    for name, bus in buses.items():
        line = "memory:" if bus.framing is not None else ""
        own = {} if line else options.get(bus.interface, {}) | bus.options  # what is of a port is not of memory
        found[name] = bus.model_copy(update={"channel": f"{line}{bus.channel}-{suffix}", "options": own})
    return found
