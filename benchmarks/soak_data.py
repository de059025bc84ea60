"""Wrong data from the unit at random times of a long run."""

from __future__ import annotations

import functools
import itertools
import random
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any
from unittest.mock import patch

import bench.acquisition.station.stage as opening
from benchmarks.spoiled_unit_data import KINDS, State
from drivers.sim.station import SimulatedStation

DATA = (
    "status 3", "RateValid 0", "LoopLocked 0", "CompensationActive 1", "rate 7FFFFFFF", "rate frozen",
    "temperature + 20", "temperature frozen", "temperature missing", "heartbeat stopped", "heartbeat missing",
)  # fmt: skip
"""Kinds of wrong data from the unit that a run survives for some seconds (`benchmarks.spoiled_unit_data`)."""
DATA_S = 6.0


def random_data(faults: list[dict[str, Any]], seed: int) -> list[tuple[float, str]]:
    """Times [s] and kinds of wrong data from the unit: in every pause between faults that is long enough."""
    rng, found = random.Random(f"data {seed}"), []
    for fault, following in itertools.pairwise(faults):
        over_s = fault["at_s"] + fault.get("for_s", 0) + 2 * fault.get("seconds", 0.0) + 20.0
        if following["at_s"] - over_s > 2 * DATA_S + 20.0:
            found.append((rng.uniform(over_s, following["at_s"] - DATA_S - 20.0), rng.choice(DATA)))
    return found


class Spoiler:
    """Stands between the simulated unit and its bus."""

    def __init__(self, bus: Any, data: list[tuple[float, str]], seed: int) -> None:
        self._bus, self._seed, self._data = bus, seed, list(reversed(data))
        self._state = State(seed)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._bus, name)

    def send_block(self, frames: Any) -> None:
        """Send FRAME records (n,), those of the kind that is due spoiled."""
        t_s = frames["t_ns"][0] * 1e-9 if len(frames) else 0.0
        while self._data and t_s >= self._data[-1][0] + DATA_S:
            self._data.pop()
            self._state = State(self._seed)
        if self._data and t_s >= self._data[-1][0]:
            frames = KINDS[self._data[-1][1]](frames, self._state)
        self._bus.send_block(frames)


@contextmanager
def spoiled(data: list[tuple[float, str]], seed: int) -> Iterator[None]:
    """Stations that are simulated meanwhile have units that send wrong data."""
    simulate = opening.simulate

    @functools.wraps(simulate)
    def made(*args: Any, **options: Any) -> SimulatedStation:
        world = simulate(*args, **options)
        for unit in world.units:
            unit.wire.bus = Spoiler(unit.wire.bus, data, seed)
        return world

    with patch.object(opening, "simulate", made):
        yield
