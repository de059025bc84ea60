"""The simulated station as servers of its own on 127.0.0.1: Modbus TCP and CAN (`loopcan`), for other programs and CI.

It runs on wall time, or `speed` times as fast. A station file that names these ports drives it like real equipment.
"""

from __future__ import annotations

import signal
import socket
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, field
from typing import Any

import yaml

from bench.acquisition.station.occasion import Occasion
from bench.acquisition.station.settings.bus import Bus
from bench.acquisition.station.settings.station import StationSettings
from bench.acquisition.station.simulation import simulate
from bench.base import EquipmentError
from drivers.clock import Clock, WallClock
from drivers.sim.loopcan import Broker
from drivers.sim.ptys import PtyPair
from drivers.sim.station import SimulatedStation

STEP_S = 0.02
"""Simulated time between two looks at the commands: ten rate samples of one housekeeping cycle."""


@dataclass(frozen=True)
class Served:
    """A simulated station that other processes can reach."""

    settings: StationSettings
    station: SimulatedStation
    can_ports: dict[str, int]
    lines: Mapping[str, str] = field(default_factory=dict)
    """Channels of the lines that carry packets: the path of a pty, or udp://127.0.0.1:PORT."""

    def station_file(self) -> dict[str, Any]:
        """A station file that drives these servers as if they were real."""
        inside = {"seed", "simulated", "units", "faults", "eeproms"}
        content = self.settings.model_dump(mode="json", exclude_defaults=True, exclude=inside)
        content["name"] = f"{self.settings.name}-remote"
        content["chamber"]["connection"] = {"url": f"tcp://127.0.0.1:{self.station.modbus_port}"}
        content["buses"] = {
            name: {"interface": "loopcan", "channel": str(port), "fd": self.settings.buses[name].fd}
            for name, port in self.can_ports.items()
        } | {name: content["buses"][name] | {"channel": channel} for name, channel in self.lines.items()}
        for one in content.get("instruments", []):
            one["address"] = self.station.instruments[one["name"]].address
        simulated = {"chamber": ["simulation"], "rate_table": ["simulation"], "fixture": ["operator", "forgets"]}
        for section, names in simulated.items():
            for name in names:
                content.get(section, {}).pop(name, None)
        units = [unit.model_dump(mode="json", exclude_defaults=True) for unit in self.settings.units]
        content["units"] = [{key: value for key, value in unit.items() if key != "simulation"} for unit in units]
        return content

    def station_yaml(self) -> str:
        """The same as YAML text."""
        return yaml.safe_dump(self.station_file(), sort_keys=False)


@contextmanager
def serve_station(settings: StationSettings, modbus_port: int = 0, can_port: int = 0) -> Iterator[Served]:
    """Open the servers; `can_port` is the first bus's, further buses get free ports. EquipmentError: port taken."""
    with ExitStack() as stack:
        ports: dict[str, int] = {}
        lines: dict[str, str] = {}
        buses: dict[str, Bus] = {}
        for name, bus in settings.buses.items():
            if bus.framing is not None:
                buses[name], lines[name] = _line(bus, stack)
                continue
            try:
                broker = stack.enter_context(closing(Broker(port=can_port if not ports else 0, fd=bus.fd)))
            except OSError as error:
                raise EquipmentError(f"cannot serve bus {name} on 127.0.0.1:{can_port}: {error.strerror}") from None
            ports[name] = broker.port
        for name, port in ports.items():
            buses[name] = Bus(interface="loopcan", channel=str(port), fd=settings.buses[name].fd)
        simulated = simulate(
            settings, settings.units, buses, stack, Occasion(switches_power=True), modbus_port=modbus_port
        )
        stack.enter_context(closing(simulated))
        yield Served(settings, simulated, ports, lines)


def _line(bus: Bus, stack: ExitStack) -> tuple[Bus, str]:
    """A line that carries packets: the simulator's end, and the channel of the other one."""
    if bus.channel.startswith(("udp:", "daq:")):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as found:
            found.bind(("127.0.0.1", 0))
            where = f"127.0.0.1:{found.getsockname()[1]}"
        return bus.model_copy(update={"channel": f"udp-to://{where}", "options": {}}), f"udp://{where}"
    pair = stack.enter_context(closing(PtyPair()))
    return bus.model_copy(update={"channel": pair.left, "options": {}}), pair.right


def keep_running(
    advance: Callable[[float, float], object], speed: float, stopped: Callable[[], bool], clock: Clock | None = None
) -> None:
    """Let simulated time pass at `speed` times wall time until `stopped`; `advance` has its two ends [s]."""
    clock = clock or WallClock()
    step = 0
    while not stopped():
        advance(step * STEP_S, (step + 1) * STEP_S)
        step += 1
        clock.sleep_until(step * STEP_S / speed)


def until_signal() -> Callable[[], bool]:
    """A condition that becomes true with Ctrl-C or SIGTERM."""
    seen: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda received, frame: seen.append(received))
    return lambda: bool(seen)
