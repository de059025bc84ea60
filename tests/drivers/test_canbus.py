"""Captures write every frame of a bus to the journal, and report errors."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import can
import numpy as np
import pytest

from drivers.canbus import BusSettings, InProcessCapture, ProcessCapture, open_bus
from drivers.errors import ConfigError, LinkError
from drivers.journal import FRAME, JournalWriter, Kind, read_blocks
from drivers.sim.loopcan import Broker, LoopBus
from tests.support.waiting import until


def counted(count: int, start: int = 0) -> np.ndarray:
    frames = np.zeros(count, dtype=FRAME)
    frames["id"], frames["len"] = 0x120, 8
    frames["data"] = np.arange(start, start + count, dtype="<u8").view(np.uint8).reshape(-1, 8)
    return frames


def numbers(frames: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(frames["data"]).view("<u8")[:, 0]


def journalled(path: Path) -> np.ndarray:
    return np.concatenate([b.frames() for b in read_blocks(path) if b.kind is Kind.FRAMES])


def is_running(pid: int) -> bool:
    stat = Path(f"/proc/{pid}/stat")
    try:
        return (
            stat.read_text(encoding="utf-8").rpartition(")")[2].split()[0] != "Z"
        )  # an orphan may wait for its reaper
    except OSError:
        return False


@pytest.fixture
def plugin(tmp_path, monkeypatch):
    """The entry point of `loopcan` for processes started from here, installed or not."""
    info = tmp_path / "plugin" / "loopcan_test-0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: loopcan-test\nVersion: 0\n")
    (info / "entry_points.txt").write_text("[can.interface]\nloopcan = drivers.sim.loopcan:LoopBus\n")
    monkeypatch.syspath_prepend(info.parent)


@pytest.fixture
def broker():
    broker = Broker()
    yield broker
    broker.close()


@pytest.fixture
def capture(plugin, broker, tmp_path):
    settings = BusSettings("loopcan", f"127.0.0.1:{broker.port}")
    capture = ProcessCapture(settings, tmp_path / "can.gtbj", time.monotonic_ns())
    yield capture
    capture.close()


@pytest.mark.parametrize("interface", ["virtual", "blocks"])
def test_in_process_every_frame_is_journalled_and_handed_on(interface, tmp_path):
    settings = BusSettings(interface, f"capture {interface}", options={"preserve_timestamps": True})
    with open_bus(settings) as sender, open_bus(settings) as bus:
        writer = JournalWriter(tmp_path / "j")
        capture = InProcessCapture(bus, writer)
        assert len(capture.poll()) == 0
        for k in range(5):
            sender.send(can.Message(arbitration_id=0x100 + k, is_extended_id=False, data=[k], timestamp=100.0 + k))
        frames = capture.poll()
        assert frames["id"].tolist() == [0x100, 0x101, 0x102, 0x103, 0x104]
        assert frames["t_ns"].tolist() == [(100 + k) * 10**9 for k in range(5)]
        assert frames["len"].tolist() == [1] * 5
        sender.send(can.Message(arbitration_id=0x7FF, timestamp=106.0))
        capture.close()
        writer.close()
        assert journalled(tmp_path / "j")["id"].tolist() == [*range(0x100, 0x105), 0x7FF]
        health = capture.health()
        assert (health.frames, health.last_frame_s, health.error) == (6, 106.0, None)


def test_in_process_a_stamp_maps_the_time_of_the_bus(tmp_path):
    settings = BusSettings("blocks", "stamped", options={"preserve_timestamps": True})
    with open_bus(settings) as sender, open_bus(settings) as bus:
        writer = JournalWriter(tmp_path / "j")
        capture = InProcessCapture(bus, writer, stamp=lambda t_s: round((t_s - 1000.0) * 1e9))
        sender.send(can.Message(timestamp=1002.0))
        assert capture.poll()["t_ns"].tolist() == [2_000_000_000]
        writer.close()


def test_in_process_a_closed_bus_is_reported_and_not_raised(tmp_path):
    bus = open_bus(BusSettings("virtual", "closing"))
    writer = JournalWriter(tmp_path / "j")
    capture = InProcessCapture(bus, writer)
    bus.shutdown()
    assert len(capture.poll()) == 0
    assert "closed" in capture.health().error
    writer.close()


def test_settings_that_cannot_work_and_buses_that_are_not_there_are_told_apart():
    with pytest.raises(ConfigError, match="nonsense:can0"):
        open_bus(BusSettings("nonsense", "can0"))
    with pytest.raises((ConfigError, LinkError), match="CAN bus socketcan:can17"):
        open_bus(BusSettings("socketcan", "can17"))


def test_a_process_captures_every_frame(capture, broker, tmp_path):
    with LoopBus(broker.port) as sender:
        sender.send_block(counted(20_000))
        parts = []
        until(lambda: parts.append(capture.poll()) or sum(map(len, parts)) == 20_000)
        assert np.array_equal(numbers(np.concatenate(parts)), np.arange(20_000))
        health = capture.health()
        assert (health.frames, health.error) == (20_000, None)
        assert 0.0 <= health.last_frame_s < 60.0
        sender.send_block(counted(10, start=20_000))
        until(lambda: capture.health().frames == 20_010)
    capture.close()
    assert np.array_equal(numbers(journalled(tmp_path / "can.gtbj")), np.arange(20_010))
    assert numbers(capture.poll()).tolist() == list(range(20_000, 20_010))
    capture.close()


def test_the_journal_of_a_killed_capture_is_whole_and_the_death_is_noticed(capture, broker, tmp_path):
    with LoopBus(broker.port) as sender:
        sender.send_block(counted(5000))
        until(lambda: capture.health().frames == 5000)
        os.kill(capture.pid, signal.SIGKILL)
        until(lambda: capture.health().error is not None)
    assert "exit code -9" in capture.health().error
    assert np.array_equal(numbers(journalled(tmp_path / "can.gtbj")), np.arange(5000))
    assert len(capture.poll()) == 5000


def test_the_capture_ends_when_its_parent_is_killed(plugin, broker, tmp_path):
    script = tmp_path / "parent.py"
    script.write_text(
        "import sys, time, pathlib\n"
        "from drivers.canbus import BusSettings, ProcessCapture\n"
        "if __name__ == '__main__':\n"
        "    capture = ProcessCapture(BusSettings('loopcan', sys.argv[1]), pathlib.Path(sys.argv[2]), 0)\n"
        "    print(capture.pid, flush=True)\n"
        "    time.sleep(60)\n"
    )
    root, extra = Path(__file__).parents[2], tmp_path / "plugin"
    with subprocess.Popen(
        [sys.executable, script, str(broker.port), tmp_path / "j"],
        stdout=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": f"{root}{os.pathsep}{extra}"},
    ) as parent:
        pid = int(parent.stdout.readline())
        with LoopBus(broker.port) as sender:
            sender.send_block(counted(100))
            until(lambda: sum(block.count for block in read_blocks(tmp_path / "j")) == 100)
        parent.kill()
    until(lambda: not is_running(pid))
    assert np.array_equal(numbers(journalled(tmp_path / "j")), np.arange(100))


def test_a_silent_capture_is_an_error(capture):
    os.kill(capture.pid, signal.SIGSTOP)
    until(lambda: capture.health().error is not None)
    assert "silent" in capture.health().error
    os.kill(capture.pid, signal.SIGCONT)
    until(lambda: capture.health().error is None)


def test_a_bus_that_fails_is_reported_and_opened_again(plugin, tmp_path):
    broker = Broker()
    settings = BusSettings("loopcan", str(broker.port))
    capture = ProcessCapture(settings, tmp_path / "j", time.monotonic_ns())
    try:
        broker.close()
        until(lambda: capture.health().error is not None)
        assert capture.pid is not None
        broker = Broker(broker.port)
        until(lambda: capture.health().error is None)
        with LoopBus(broker.port) as sender:
            sender.send_block(counted(3))
            until(lambda: capture.health().frames == 3)
    finally:
        capture.close()
        broker.close()
    events = [b.payload for b in read_blocks(tmp_path / "j") if b.kind is Kind.EVENT]
    assert b"bus failed" in events[0]
    assert b"open again" in events[1]


def test_a_bus_that_does_not_open_is_raised_in_the_parent(plugin, broker, tmp_path):
    broker.close()
    with pytest.raises(LinkError, match="no broker"):
        ProcessCapture(BusSettings("loopcan", str(broker.port)), tmp_path / "j", time.monotonic_ns())
    with pytest.raises(ConfigError, match="nonsense"):
        ProcessCapture(BusSettings("nonsense", "x"), tmp_path / "j", time.monotonic_ns())


def test_a_journal_that_cannot_be_written_is_raised_in_the_parent(plugin, broker, tmp_path):
    settings = BusSettings("loopcan", str(broker.port))
    with pytest.raises(LinkError, match="No such file"):
        ProcessCapture(settings, tmp_path / "missing" / "j", time.monotonic_ns())
