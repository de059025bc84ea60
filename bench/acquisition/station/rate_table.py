"""Opens the rate table of a station file: a real one, or a simulated one on the buses of a simulated station."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack, closing

from bench.acquisition.station.records import Journal
from bench.acquisition.station.settings.bus import Bus
from bench.acquisition.station.settings.rate_table import RateTableSettings
from bench.acquisition.station.settings.station import StationSettings
from bench.acquisition.station.turning import Turntable
from drivers.aerosmith_table import AerosmithTable, Line
from drivers.canbus import open_bus
from drivers.canopen_drive import Drive
from drivers.canopen_table import CanopenTable
from drivers.clock import Clock, WallClock
from drivers.errors import DriverError
from drivers.rate_table import RateTable, SafeStep, TableLimits
from drivers.sim.cia402_table import SimulatedTable, TableSettings


def open_table(
    settings: StationSettings, clock: Clock, buses: Mapping[str, Bus], stack: ExitStack, journal: Journal
) -> Turntable | None:
    """The station's table, identified and prepared, nothing moved; None without one. `stack` closes it.

    Raises DriverError when it is not there or not the one described.
    """
    chosen = settings.rate_table
    if chosen is None:
        return None
    table = stack.enter_context(closing(_driver(chosen, clock, buses, stack)))
    table.identify()
    turntable = Turntable(table, clock, chosen.tolerance_dps, journal)
    turntable.lacks = table.prepare()
    return turntable


def halt(settings: StationSettings) -> list[SafeStep]:
    """Stop the table of a real station from outside, when the bench that turned it is gone; never raises."""
    chosen = settings.rate_table
    if chosen is None:
        return []
    with ExitStack() as stack:
        try:
            table = stack.enter_context(closing(_driver(chosen, WallClock(), settings.buses, stack)))
            table.identify()
        except DriverError as error:
            return [SafeStep("rate table stop", False, f"{error}; press its emergency stop")]
        table.enabled = True  # for all that we know
        return table.safe()


def simulate_table(
    settings: StationSettings, buses: Mapping[str, Bus], stack: ExitStack, seed: int
) -> SimulatedTable | None:
    """The simulated drive and axis of a station file; None without one. `stack` closes its bus."""
    chosen = settings.rate_table
    if chosen is None or chosen.bus is None or chosen.counts_per_degree is None:
        return None
    bus = open_bus(buses[chosen.bus].to_driver())
    stack.callback(bus.shutdown)
    truth = {} if chosen.simulation is None else chosen.simulation.model_dump()
    return SimulatedTable(bus, chosen.node, TableSettings(counts_per_degree=chosen.counts_per_degree, **truth), seed)


def _driver(chosen: RateTableSettings, clock: Clock, buses: Mapping[str, Bus], stack: ExitStack) -> RateTable:
    limits = TableLimits(chosen.highest_dps, chosen.accel_dps2)
    if chosen.driver == "aerosmith" or chosen.bus is None or chosen.counts_per_degree is None:
        return AerosmithTable(Line(str(chosen.port)), limits, clock, chosen.jog_unit)
    bus = open_bus(buses[chosen.bus].to_driver())
    stack.callback(bus.shutdown)
    latency_s = chosen.latency_ms / 1000
    drive = Drive(chosen.node, chosen.counts_per_degree, chosen.sample_ms, chosen.heartbeat_s, latency_s)
    return CanopenTable(bus, drive, limits, clock)
