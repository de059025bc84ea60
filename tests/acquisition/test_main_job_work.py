"""What a simulated second of the main job costs, counted, not timed: calls, requests, blocks. More is a regression."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from bench.acquisition.run.runner import run_job
from bench.acquisition.run.status import Status
from bench.acquisition.station.station import Station
from drivers.journal import Kind, read_blocks
from drivers.sim.blockbus import BlockBus
from drivers.sim.modbus_chamber import ModbusChamber
from tests.support.acquisition import job

SOAK = """\
name: soak
segments:
  - {kind: soak, duration_min: 3}
"""
WARM_S, COUNTED_S = 30, 100
"""Ticks before everything that is made once is made, and those that are counted."""


@pytest.fixture
def counted(tmp_path: Path) -> Callable[[], Any]:
    """Runs a soak and calls `begin` and `end` around the counted ticks."""

    def run(begin: Callable[[Station], None], end: Callable[[Station], None]) -> Any:
        ticks = 0

        def look(station: Station, status: Status) -> None:
            nonlocal ticks
            ticks += 1
            if ticks == WARM_S:
                begin(station)
            elif ticks == WARM_S + COUNTED_S:
                end(station)

        result = run_job(job(tmp_path, SOAK), look)
        assert result.error is None
        return result

    return run


def test_a_tick_makes_fewer_calls_than_there_are_frames_and_samples_in_it(counted):
    """601 frames pass through simulation, bus, journal and decoder in a tick, none by a call of its own; a fifth of the
    calls are pymodbus'."""
    calls: Counter[str] = Counter()

    def count(frame: Any, event: str, argument: Any) -> None:
        calls[event] += 1

    counted(lambda station: sys.setprofile(count), lambda station: sys.setprofile(None))
    assert calls["call"] / COUNTED_S < 1000
    assert calls["c_call"] / COUNTED_S < 1100


def test_a_simulated_second_is_one_poll_of_the_chamber_and_its_slow_registers_every_five(counted, monkeypatch):
    requests: list[int] = []
    answer = ModbusChamber._answer

    def told(self: ModbusChamber, code: int, *rest: Any) -> Any:
        requests.append(code)
        return answer(self, code, *rest)

    monkeypatch.setattr(ModbusChamber, "_answer", told)
    before: list[int] = []
    links = {}

    def begin(station: Station) -> None:
        before.append(len(requests))
        links["counters"] = station.chamber._controller._link.counters

    counted(begin, lambda station: before.append(len(requests)))
    assert set(requests[before[0] : before[1]]) == {3}, "nothing is written while nothing changes"
    assert (before[1] - before[0]) / COUNTED_S == pytest.approx(1 + 7 / 5, abs=0.1)
    assert (links["counters"].connections, links["counters"].retries) == (1, 0)


def test_the_frames_of_a_tick_are_one_block_on_the_bus_and_one_in_the_journal(counted, monkeypatch):
    blocks: list[int] = []
    send = BlockBus.send_block
    monkeypatch.setattr(BlockBus, "send_block", lambda self, frames: blocks.append(len(frames)) or send(self, frames))
    result = counted(lambda station: None, lambda station: None)
    assert set(blocks[1:]) == {602}, "500 rates, 2 x 50 slow, supply, heartbeat"
    kept = [len(b.frames()) for b in read_blocks(result.run.journal / "can0.gtbj") if b.kind is Kind.FRAMES]
    assert kept == blocks


def test_blocks_that_look_alike_are_sorted_once(counted):
    """The decoder finds the frames of each message by comparing whole heads, once for all ticks that are alike."""
    looks: list[Any] = []

    def found(station: Station) -> None:
        looks.append(station.units[0].decoder._rows["GYRO_RATE"][1])

    counted(found, found)
    assert looks[0] is looks[1]
