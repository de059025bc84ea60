"""The loop of a capture process on buses that fail: what is journalled, what its health says, and that it goes on."""

from __future__ import annotations

import json
import multiprocessing
import re
import time
from types import SimpleNamespace

import can
import numpy as np
import pytest

from drivers import capture as capture_module
from drivers import lag as lag_module
from drivers.backoff import BackOff
from drivers.capture import Recorder
from drivers.errors import LinkError
from drivers.health import Beat
from drivers.journal import JournalWriter, Kind, read_blocks
from drivers.lag import Lag, both_clocks


class ScriptedBus(can.BusABC):
    """Yields what it was given: messages or what makes them, None, exceptions to raise; afterwards nothing."""

    reported = can.BusState.ACTIVE

    @property
    def state(self) -> can.BusState:
        return self.reported

    def __init__(self, script: list) -> None:
        self.script = script
        self.channel_info = "scripted"
        super().__init__(channel="scripted")

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        raise NotImplementedError

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if not self.script:
            return None, False
        step = self.script.pop(0)
        if isinstance(step, Exception):
            raise step
        if isinstance(step, can.BusState):
            self.reported, step = step, None
        return step() if callable(step) else step, False


def frame(k: int) -> can.Message:
    return can.Message(arbitration_id=0x120, is_extended_id=False, data=[k])


def error_frame(kind: int) -> can.Message:
    return can.Message(arbitration_id=kind, is_error_frame=True, dlc=8, data=bytes(8))


class Rig:
    """A recorder in this process; it stops when all buses have nothing more to say."""

    def __init__(self, path, openings: list) -> None:
        """`openings`: what each attempt to open the bus yields, a script or an error."""
        self.path = path / "j"
        self.openings = list(openings)
        self.beat = Beat(multiprocessing.get_context("spawn"), "CAN bus scripted:0")
        self.states: list[str] = []
        self.bus: ScriptedBus | None = None
        writer = JournalWriter(self.path)
        Recorder(self.open, writer, self.beat, time.monotonic_ns()).run(lambda: None, self.stopped)
        writer.close()

    def open(self) -> can.BusABC:
        opening = self.openings.pop(0)
        if isinstance(opening, Exception):
            raise opening
        self.bus = ScriptedBus(opening)
        return self.bus

    def stopped(self) -> bool:
        state = self.beat.health().state
        if self.states[-1:] != [state]:
            self.states.append(state)
        return not self.openings and not self.bus.script

    def events(self) -> list[str]:
        return [b.payload.decode() for b in read_blocks(self.path) if b.kind is Kind.EVENT]

    def frames(self) -> list[int]:
        parts = [b.frames() for b in read_blocks(self.path) if b.kind is Kind.FRAMES]
        frames = np.concatenate(parts)
        return frames["data"][frames["id"] == 0x120][:, 0].tolist()


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    monkeypatch.setattr(capture_module, "BACK_OFF", BackOff(first_s=0.01, most_s=0.02))
    monkeypatch.setattr(capture_module, "POLL_S", 0.005)


@pytest.mark.parametrize("error", [can.CanOperationError("bus off"), OSError(19, "No such device")])
def test_after_bus_off_the_bus_is_opened_until_it_opens_and_frames_go_on(tmp_path, error: Exception):
    away = LinkError("adapter not there")
    rig = Rig(tmp_path, [[frame(1), frame(2), error], away, away, away, [frame(3), None]])
    assert rig.frames() == [1, 2, 3]
    health = rig.beat.health()
    assert (health.state, health.frames, health.recoveries, health.since_s) == ("ok", 3, 1, None)
    assert rig.states == ["ok", "degraded", "ok"]
    failed, again, summary = rig.events()
    assert "bus failed" in failed
    assert "open again after" in again
    assert "3 frames, 0 error frames, 0 unreadable, 1 times open again" in summary


def test_socketcan_says_bus_off_by_an_error_frame_and_recovers_by_itself(tmp_path):
    rig = Rig(tmp_path, [[frame(1), error_frame(0x40), None, error_frame(0x40), None, frame(2), None]])
    assert rig.frames() == [1, 2]
    assert (rig.beat.health().error_frames, rig.beat.health().recoveries) == (2, 1)
    off, again, _ = rig.events()
    assert "bus off" in off
    assert "restart-ms" in off
    assert "again" in again


def test_an_interface_that_tells_bus_off_by_its_state_alone_is_opened_again(tmp_path):
    rig = Rig(tmp_path, [[frame(1), can.BusState.PASSIVE, frame(2), can.BusState.ERROR], [frame(3), None]])
    assert rig.frames() == [1, 2, 3]
    assert rig.beat.health().recoveries == 1
    off, again, _ = rig.events()
    assert "bus failed: bus off: too many errors on the wire" in off
    assert "open again" in again


def test_error_frames_and_unreadable_ones_are_counted_and_summed_up_in_the_journal(tmp_path):
    script = [frame(1), error_frame(0x8), ValueError("garbled"), can.Message(is_fd=True, data=bytes(12)), frame(2)]
    rig = Rig(tmp_path, [script])
    assert rig.frames() == [1, 2]
    health = rig.beat.health()
    assert (health.error_frames, health.unreadable, health.state) == (1, 2, "ok")
    assert '"error_frames": 1, "unreadable": 2' in rig.events()[-1]


def test_a_quiet_capture_leaves_its_counts_and_no_news(tmp_path):
    (only,) = (json.loads(event) for event in Rig(tmp_path, [[frame(1)]]).events())
    assert (only["no_news"], only["most_behind_ms"], only["behind_spells"]) == (1, 0, 0)


def waited(seconds: float):
    """A frame that the bus has held for so long when it hands it over."""
    return lambda: can.Message(arbitration_id=0x120, is_extended_id=False, data=[1], timestamp=time.time() - seconds)


def test_a_capture_behind_its_bus_says_so_while_it_lasts_and_when_it_is_over(tmp_path):
    rig = Rig(tmp_path, [[waited(0.001), None, waited(0.6), None, waited(0.5), None, waited(0.001), None]])
    behind, caught_up, summary = (json.loads(event) for event in rig.events())
    assert re.search(r"the capture is 0\.\d\d s behind its bus", behind["text"])
    assert behind["most_behind_ms"] >= 600
    assert "caught up after" in caught_up["text"]
    assert (summary["behind_spells"], summary["most_behind_ms"]) == (1, caught_up["most_behind_ms"])
    assert "no_news" not in summary
    health = rig.beat.health()
    assert health.most_behind_s >= 0.6
    assert health.behind_s == 0.0


def test_frames_that_waited_are_stamped_with_the_time_at_which_the_bus_had_them(tmp_path):
    rig = Rig(tmp_path, [[waited(0.6), waited(0.2)]])
    first, second = np.concatenate([b.frames()["t_ns"] for b in read_blocks(rig.path) if b.kind is Kind.FRAMES])
    assert second - first >= 400_000_000


SECOND = 1_000_000_000


def test_a_backlog_of_many_seconds_is_believed_when_it_has_had_the_time_to_grow():
    lag = Lag()
    assert lag.age_ns(100 * SECOND, 1000) == 1000
    assert lag.age_ns(105 * SECOND, 5 * SECOND) == 5 * SECOND
    assert [lag.age_ns(105 * SECOND + k, 5 * SECOND - k) for k in (1000, 2000)] == [
        5 * SECOND - 1000,
        5 * SECOND - 2000,
    ]


@pytest.mark.parametrize("stamp", [-3600 * SECOND, -1, 5 * SECOND, 1_800_000_000 * SECOND])
def test_a_clock_that_was_set_is_no_backlog(stamp):
    """A stamp ahead, five seconds that cannot have passed, or seconds since the boot of an adapter."""
    lag = Lag()
    assert lag.age_ns(100 * SECOND, stamp) == 0
    assert [lag.age_ns(100 * SECOND + k * 2_000_000, stamp) for k in range(1, 500)] == [0] * 499
    lag.caught_up(200 * SECOND)
    assert lag.age_ns(200 * SECOND + 1, stamp) == 0


def test_an_interruption_between_the_two_clocks_makes_no_frame_older(monkeypatch):
    """On a busy machine frames of an adapter without a clock were stamped before those that came earlier."""
    monotonic = iter([0, 20_000_000, 20_000_300, 20_000_600])
    calendar = iter([7 * SECOND + 20_000_000, 7 * SECOND + 20_000_450])
    clocks = SimpleNamespace(monotonic_ns=lambda: next(monotonic), time_ns=lambda: next(calendar))
    monkeypatch.setattr(lag_module, "time", clocks)
    assert both_clocks() == (20_000_600, 7 * SECOND + 20_000_450)
