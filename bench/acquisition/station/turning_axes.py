"""Driven axes of a fixture during a run: opened, moved, watched at every tick, and stopped at the end."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack, closing

import numpy as np

from bench.acquisition.station.records import Journal
from bench.acquisition.station.settings.axes import AxisSettings, Positions
from bench.acquisition.station.settings.bus import Bus
from bench.acquisition.station.settings.fixture import FixtureSettings
from bench.base import EquipmentError
from bench.record import ATTITUDES
from drivers.canbus import open_bus
from drivers.canopen_axis import CanopenAxis
from drivers.canopen_drive import Drive
from drivers.clock import Clock, WallClock
from drivers.errors import DriverError, LinkError
from drivers.rate_table import SafeStep, TableLimits
from drivers.sim.cia402_table import SimulatedTable, TableSettings
from drivers.sim.fixture import SimulatedFixture


class FixtureAxes:
    """The axes of a fixture, each prepared; they are switched on when they first move."""

    def __init__(self, axes: Mapping[str, CanopenAxis], clock: Clock, journal: Journal) -> None:
        """`axes` by what they are called in messages, from the rate table to the units."""
        self._axes, self._clock, self._journal = axes, clock, journal
        self._until_s: float | None = None
        self._silent = ""

    def go(self, to: Positions) -> None:
        """Start towards positions; one axis after the other is commanded, all move at once."""
        longest_s = 0.0
        for (name, axis), degrees in zip(self._axes.items(), to.degrees, strict=True):
            if not axis.enabled:
                if lacks := axis.prepare():  # again: it may have been without power since
                    self._journal.event("fixture", f"{name} does not support: {'; '.join(lacks)}")
                axis.enable()
            longest_s = max(longest_s, axis.longest_s(degrees))
            axis.go(degrees)
        told = ", ".join(f"{degrees:g}" for degrees in to.degrees)
        self._journal.event("fixture", f"axes commanded to {told} deg", positions_deg=list(to.degrees))
        self._until_s = self._clock.now() + longest_s

    @property
    def arrived(self) -> bool:
        """Whether all stand where they were commanded to.

        EquipmentError where they have not got there in twice the time that they need.
        """
        late = [name for name, axis in self._axes.items() if not axis.arrived]
        if late and self._until_s is not None and self._clock.now() > self._until_s:
            raise EquipmentError(f"{', '.join(late)}: not at the commanded position in time; look at drive and load")
        return not late

    def poll(self) -> None:
        """See what the drives say, and tell them that the bench is alive; EquipmentError when one has failed."""
        trouble = ""
        for axis in self._axes.values():
            try:
                axis.poll()
            except LinkError as error:
                if axis.enabled:
                    raise
                trouble = str(error)  # an axis that is off does not end a run
        if trouble != self._silent:
            self._silent = trouble
            told = f"a fixture axis does not answer: {trouble}" if trouble else "all fixture axes answer again"
            self._journal.event("link", told)

    def safe(self) -> list[SafeStep]:
        """Quick stop and off, verified; axes that were not switched on are left as they were found."""
        return [step for axis in self._axes.values() for step in axis.safe()]


def open_axes(
    fixture: FixtureSettings | None, clock: Clock, buses: Mapping[str, Bus], stack: ExitStack, journal: Journal
) -> FixtureAxes | None:
    """The driven axes of a fixture, identified and prepared, nothing moved; None without. `stack` closes them.

    Raises DriverError when one is not there or not the one described.
    """
    if fixture is None or not fixture.axes:
        return None
    opened = {}
    for number, chosen in enumerate(fixture.axes, 1):
        axis = _open(chosen, clock, buses, stack)
        axis.identify()
        axis.prepare()
        opened[f"fixture axis {number}"] = axis
    return FixtureAxes(opened, clock, journal)


def simulate_axes(
    fixture: FixtureSettings | None, buses: Mapping[str, Bus], stack: ExitStack, seed: int
) -> SimulatedFixture | None:
    """The simulated drives and axes of a fixture; None without driven axes. `stack` closes their buses."""
    if fixture is None or not fixture.axes:
        return None
    axes = []
    for number, chosen in enumerate(fixture.axes, 1):
        bus = open_bus(buses[chosen.bus].to_driver())
        stack.callback(bus.shutdown)
        truth = TableSettings(counts_per_degree=chosen.counts_per_degree, wobble_dps=0.0)
        axes.append(SimulatedTable(bus, chosen.node, truth, seed + number))
    directions = np.array([chosen.direction for chosen in fixture.axes])
    return SimulatedFixture(axes, directions, ATTITUDES[fixture.zero].matrix)


def halt_axes(fixture: FixtureSettings | None, buses: Mapping[str, Bus]) -> list[SafeStep]:
    """Stop the axes of a real fixture from outside, when the bench that moved them is gone; never raises."""
    steps: list[SafeStep] = []
    for chosen in () if fixture is None else fixture.axes:
        with ExitStack() as stack:
            try:
                axis = _open(chosen, WallClock(), buses, stack)
                axis.identify()
            except DriverError as error:
                text = f"{error}; press its emergency stop"
                steps.append(SafeStep(f"fixture axis node {chosen.node} stop", False, text))
                continue
            axis.enabled = True  # for all that we know
            steps += axis.safe()
    return steps


def _open(chosen: AxisSettings, clock: Clock, buses: Mapping[str, Bus], stack: ExitStack) -> CanopenAxis:
    bus = open_bus(buses[chosen.bus].to_driver())
    stack.callback(bus.shutdown)
    drive = Drive(chosen.node, chosen.counts_per_degree, heartbeat_s=chosen.heartbeat_s)
    limits = TableLimits(chosen.speed_dps, chosen.accel_dps2)
    return stack.enter_context(closing(CanopenAxis(bus, drive, limits, clock)))
