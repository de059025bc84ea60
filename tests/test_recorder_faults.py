"""The loop of a capture process on buses that fail: what is journalled, what its health says, and that it goes on."""

from __future__ import annotations

import multiprocessing
import time

import can
import numpy as np
import pytest

from drivers import capture as capture_module
from drivers.backoff import BackOff
from drivers.capture import Recorder
from drivers.errors import LinkError
from drivers.health import Beat
from drivers.journal import JournalWriter, Kind, read_blocks


class ScriptedBus(can.BusABC):
    """Yields what it was given: messages, None, or exceptions to raise; afterwards nothing."""

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
        return step, False


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


def test_error_frames_and_unreadable_ones_are_counted_and_summed_up_in_the_journal(tmp_path):
    script = [frame(1), error_frame(0x8), ValueError("garbled"), can.Message(is_fd=True, data=bytes(12)), frame(2)]
    rig = Rig(tmp_path, [script])
    assert rig.frames() == [1, 2]
    health = rig.beat.health()
    assert (health.error_frames, health.unreadable, health.state) == (1, 2, "ok")
    assert '"error_frames": 1, "unreadable": 2' in rig.events()[-1]


def test_a_quiet_capture_leaves_no_event(tmp_path):
    assert Rig(tmp_path, [[frame(1)]]).events() == []
