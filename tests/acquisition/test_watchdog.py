"""The watchdog, with real processes: the bench is killed or hangs, and the chamber is safe all the same.

The chamber is served by `bench sim` in a process of its own and asked by a Modbus client that is not ours.
"""

import json
import os
import signal
import struct
import subprocess
import sys
import time
from pathlib import Path

import pytest
import yaml
from modbus_tk import modbus_tcp

from bench.acquisition.station.watchdog import EVENTS, Listener
from bench.record.folder import RunFolder
from tests.support import acquisition

SETPOINT, MODE, OFF, AUTO = 2782, 2730, 62, 10
PATIENCE_S = 60.0
COMMAND = "from bench.cli import main; main()"


class Panel:
    """The chamber as an independent Modbus client sees it."""

    def __init__(self, url):
        self.master = modbus_tcp.TcpMaster("127.0.0.1", int(url.rpartition(":")[2]), timeout_in_sec=5.0)

    def look(self):
        """Set point [degC] and whether the chamber is on."""
        words = self.master.execute(1, 3, SETPOINT, 2)
        (mode,) = self.master.execute(1, 3, MODE, 1)
        return struct.unpack("<f", struct.pack("<2H", *words))[0], mode == AUTO

    def wait_for(self, setpoint, on):
        deadline_s = time.monotonic() + PATIENCE_S
        while self.look() != (setpoint, on):
            assert time.monotonic() < deadline_s, f"chamber stands at {self.look()}"
            time.sleep(0.02)


class World:
    """`bench sim` and `bench run` as processes of their own."""

    def __init__(self, folder):
        self.folder, self.started = folder, []

    def start(self, *args, **options):
        command = [sys.executable, "-c", COMMAND, *map(str, args)]
        pipe = subprocess.PIPE
        self.started.append(subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True, **options))
        return self.started[-1]

    def simulate(self, retry_min):
        path = self.folder / "station.yaml"
        self.sim = self.start("sim", "--write-station", path)
        while "ready" not in self.sim.stderr.readline():
            assert self.sim.poll() is None
        content = yaml.safe_load(path.read_text())
        content["watchdog"] = {"silent_s": 4.0, "retry_min": retry_min}
        content["chamber"]["link"] = {"degraded_after_s": 1.0, "lost_after_s": 3.0}
        content["chamber"]["connection"]["timeout_s"] = 0.5
        content["safe_state"] = {"retry_min": 0.0}
        path.write_text(yaml.safe_dump(content))
        self.panel = Panel(content["chamber"]["connection"]["url"])
        assert self.panel.look()[1] is False

    def run(self):
        """A run in the middle of its ramp, its process group its own."""
        profile = self.folder / "long.yaml"
        profile.write_text(acquisition.LONG)
        out = self.folder / "out"
        station = self.folder / "station.yaml"
        bench = self.start("run", profile, "--station", station, "--out", out, start_new_session=True)
        said = bench.stderr.readline()
        assert "ramp to 85" in said, said + bench.stderr.read()
        self.panel.wait_for(85.0, True)
        (folder,) = out.glob("*/*")
        return bench, RunFolder(folder)

    def close(self):
        for process in self.started:
            if process.poll() is None:
                process.send_signal(signal.SIGCONT)
                process.kill()
            process.communicate()


@pytest.fixture
def world(tmp_path, request):
    world = World(tmp_path)
    try:
        world.simulate(getattr(request, "param", 0.05))
        yield world
    finally:
        world.close()


def events(run):
    return [json.loads(line) for line in (run.path / EVENTS).read_text().splitlines()]


@pytest.mark.slow
def test_a_killed_bench_leaves_a_safe_chamber(world):
    bench, run = world.run()
    bench.kill()
    world.panel.wait_for(23.0, False)
    said = bench.stderr.read()  # to its end: the watchdog, which writes there too, has ended
    assert "bench watchdog: the bench ended unexpectedly: making the equipment safe" in said
    found = events(run)
    assert [event["kind"] for event in found] == [
        "watchdog",
        "write",
        "write",
        "write",
        *["safe_state"] * 3,
        "watchdog",
    ]
    assert [event["ok"] for event in found if event["kind"] == "safe_state"] == [True] * 3
    assert found[-1]["ok"] is True
    assert "equipment is safe, verified after" in found[-1]["text"]
    assert all(event["t_s"] > 0 and event["utc"] for event in found)


@pytest.mark.slow
def test_ctrl_c_and_sigterm_to_everybody_leave_it_to_the_bench(world):
    bench, run = world.run()
    (child,) = [
        int(pid)
        for pid in Path(f"/proc/{bench.pid}/task/{bench.pid}/children").read_text(encoding="utf-8").split()
        if "bench.acquisition.station.watchdog" in Path(f"/proc/{pid}/cmdline").read_text(encoding="utf-8")
    ]
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        os.kill(child, number)
    os.killpg(bench.pid, signal.SIGINT)
    assert bench.wait(PATIENCE_S) == 3
    world.panel.wait_for(23.0, False)
    assert "bench watchdog" not in bench.stderr.read()
    assert not (run.path / EVENTS).exists()
    assert [event["pid"] for event in run.events() if event["kind"] == "watchdog"] == [child]


@pytest.mark.slow
def test_what_the_watchdog_cannot_verify_it_says_loudly(world):
    bench, run = world.run()
    world.sim.kill()
    world.sim.wait()
    bench.kill()
    said = bench.stderr.read()
    assert "bench watchdog: SAFE STATE NOT VERIFIED: set point to 23 degC" in said
    assert "switch the chamber off by hand" in said
    assert events(run)[-1]["ok"] is False


@pytest.mark.parametrize("world", [10.0], indirect=True)
@pytest.mark.slow
def test_a_chamber_that_comes_back_after_the_bench_gave_up_is_made_safe(world):
    bench, run = world.run()
    world.sim.send_signal(signal.SIGSTOP)
    said = bench.stderr.readline()
    while "SAFE STATE NOT VERIFIED" not in said:
        assert said, "the bench did not say it"
        said = bench.stderr.readline()
    assert "the watchdog goes on trying" in said
    world.sim.send_signal(signal.SIGCONT)
    world.panel.wait_for(23.0, False)
    assert "bench watchdog: equipment is safe" in bench.stderr.read()
    assert bench.wait(PATIENCE_S) == 4
    assert events(run)[0]["text"].startswith("the bench could not reach the safe state")


@pytest.fixture
def pipe():
    read, write = os.pipe()
    yield read, os.fdopen(write, "wb", buffering=0)
    os.close(read)


def heard(pipe, words, silent_s=60.0):
    read, write = pipe
    listener = Listener(read, silent_s)
    write.write(words)
    if silent_s > 1.0:
        write.close()
    return listener.wait(), listener.armed


def test_a_bench_that_is_done_needs_no_watchdog(pipe):
    assert heard(pipe, b"armed\nbeat 0\nbeat 60\ndone\n") == ("", True)


@pytest.mark.parametrize(("words", "moved"), [(b"instruments\n", False), (b"instruments\narmed\n", True)])
def test_before_the_chamber_is_commanded_only_instruments_are_watched(pipe, words, moved):
    read, write = pipe
    write.write(words)
    write.close()
    listener = Listener(read, 60.0)
    assert listener.wait() == "the bench ended unexpectedly"
    assert (listener.armed, listener.moved) == (True, moved)


def test_a_bench_that_ends_before_anything_moved_leaves_it_as_it_was(pipe):
    assert heard(pipe, b"beat 0\nbeat 0\n") == ("the bench ended unexpectedly", False)


def test_a_bench_that_gives_up_is_replaced(pipe):
    assert heard(pipe, b"armed\nfailed\n") == ("the bench could not reach the safe state", True)


def test_a_silent_bench_is_replaced_while_its_pipe_is_open(pipe):
    assert heard(pipe, b"armed\nbeat 0\n", silent_s=0.01) == ("the bench was silent for 0.01 s", True)
    pipe[1].close()


def test_words_may_come_in_pieces(pipe):
    read, write = pipe
    listener = Listener(read, 60.0)
    write.write(b'{"a": 1}\nar')
    assert listener.task() == {"a": 1}
    write.write(b"med\ndone\n")
    write.close()
    assert (listener.wait(), listener.armed) == ("", True)
