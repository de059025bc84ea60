"""A simulated gyro on a virtual CAN bus, or behind a serial-line adapter on a pty, for tests of programs."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from typing import TYPE_CHECKING, Any

from bench import acquisition
from bench.testing.chamber import SimulatedChamber
from bench.testing.passing import staged

if TYPE_CHECKING:
    import can

    from bench.testing.stations import BenchStation
    from drivers.clock import SimClock
    from drivers.sim.slcan_adapter import SlcanAdapter


class SimulatedGyro(SimulatedChamber):
    """A gyro in its chamber; it sends while time passes."""

    def __init__(
        self,
        stage: acquisition.Stage,
        clock: SimClock,
        bus: dict[str, Any],
        stack: ExitStack,
        adapter: SlcanAdapter | None = None,
    ) -> None:
        super().__init__(stage, clock)
        self.bus = bus
        """How its bus is opened: arguments of `can.Bus`."""
        self._stack, self._adapter = stack, adapter

    def open(self) -> can.BusABC:
        """Its bus, open, which the fixture closes; only what is sent afterwards is received."""
        bus = opened(self.bus, self._stack)
        until_s = time.monotonic() + 5.0
        while self._adapter is not None and not self._adapter.is_open and time.monotonic() < until_s:
            time.sleep(0.001)  # it obeys in a thread of its own
        return bus


@contextmanager
def open_unit(station: BenchStation, *, slcan: bool = False) -> Iterator[SimulatedGyro]:
    """The unit of a station; `slcan`: its bus is a pty that an adapter of this protocol is behind."""
    import can

    with ExitStack() as stack:
        stage, clock = stack.enter_context(staged(station, units=True))
        bus = stage.buses[station.settings.units[0].bus]
        where: dict[str, Any] = {"interface": bus.interface, "channel": bus.channel, **bus.options}
        adapter = None
        if slcan:
            from drivers.sim.slcan_adapter import SlcanAdapter

            adapter = stack.enter_context(closing(SlcanAdapter(opened(where, stack))))
            where = {"interface": "slcan", "channel": adapter.path, "bitrate": 500_000, "sleep_after_open": 0.0}
        elif bus.fd:
            where["protocol"] = can.CanProtocol.CAN_FD
        yield SimulatedGyro(stage, clock, where, stack, adapter)


def opened(bus: dict[str, Any], stack: ExitStack) -> can.BusABC:
    """A bus that is closed with the stack."""
    import can

    found = can.Bus(ignore_config=True, **bus)
    stack.callback(found.shutdown)
    return found
