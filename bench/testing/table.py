"""A simulated rate table, a CiA 402 drive on a virtual CAN bus, for tests of programs that drive one."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, Any

from bench import acquisition
from bench.testing.passing import Passing, staged
from bench.testing.unit import opened

if TYPE_CHECKING:
    import can

    from bench.testing.stations import BenchStation
    from drivers.clock import SimClock
    from drivers.sim.cia402_table import SimulatedTable


class SimulatedRateTable(Passing):
    """A drive and its axis."""

    def __init__(
        self,
        stage: acquisition.Stage,
        clock: SimClock,
        table: SimulatedTable,
        where: tuple[dict[str, Any], int],
        stack: ExitStack,
    ) -> None:
        super().__init__(stage, clock)
        self.bus, self.node = where
        """Arguments of `can.Bus`, and its CANopen node."""
        self._table, self._stack = table, stack

    @property
    def rate_dps(self) -> float:
        """True rate of its axis [deg/s]."""
        return self._table.rate_dps

    @property
    def angle_deg(self) -> float:
        """True angle of its axis [deg]."""
        return self._table.angle_deg

    def open(self) -> can.BusABC:
        """Its bus, open, which the fixture closes."""
        return opened(self.bus, self._stack)


@contextmanager
def open_rate_table(station: BenchStation) -> Iterator[SimulatedRateTable]:
    """The rate table of a station alone."""
    with ExitStack() as stack:
        stage, clock = stack.enter_context(staged(station, units=False))
        settings, table = station.settings.rate_table, stage.station.table
        assert settings is not None  # the station was made with one
        assert settings.bus is not None
        assert table is not None
        bus = stage.buses[settings.bus]
        where = {"interface": bus.interface, "channel": bus.channel, **bus.options}
        yield SimulatedRateTable(stage, clock, table, (where, settings.node), stack)
