"""The pytest plugin: fixtures that make simulated equipment, and whole runs on it.

pytest imports this module wherever the bench is installed, so everything else is imported by the fixtures.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from bench.testing.chamber import SimulatedChamber
    from bench.testing.stations import BenchStation
    from bench.testing.table import SimulatedRateTable
    from bench.testing.unit import SimulatedGyro


@pytest.fixture(scope="session")
def bench_station(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., BenchStation]:
    """Makes stations to run profiles on: `bench_station(**options).run()`; see `bench.testing.stations.content`."""
    from bench.testing.stations import BenchStation

    return lambda **options: BenchStation.make(tmp_path_factory.mktemp("bench"), options)


@pytest.fixture
def bench_chamber(bench_station: Callable[..., BenchStation]) -> Iterator[Callable[..., SimulatedChamber]]:
    """Makes simulated chambers behind a Modbus TCP server each: `bench_chamber(chamber="watlow_f4t").url`."""
    from bench.testing.chamber import open_chamber

    with ExitStack() as stack:
        yield lambda **options: stack.enter_context(open_chamber(bench_station(**options)))


@pytest.fixture
def bench_unit(bench_station: Callable[..., BenchStation]) -> Iterator[Callable[..., SimulatedGyro]]:
    """Makes simulated gyros on a virtual CAN bus each: `bench_unit().open()`; with `slcan=True` also on a pty."""
    from bench.testing.unit import open_unit

    with ExitStack() as stack:

        def make(*, slcan: bool = False, **options: object) -> SimulatedGyro:
            return stack.enter_context(open_unit(bench_station(**options), slcan=slcan))

        yield make


@pytest.fixture
def bench_rate_table(bench_station: Callable[..., BenchStation]) -> Iterator[Callable[..., SimulatedRateTable]]:
    """Makes simulated rate tables, CiA 402 drives on a virtual CAN bus each: `bench_rate_table().open()`."""
    from bench.testing.table import open_rate_table

    with ExitStack() as stack:
        yield lambda **options: stack.enter_context(open_rate_table(bench_station(rate_table=True, **options)))
