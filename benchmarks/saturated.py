"""Saturated buses captured in separate processes while a report is rendered: frames lost, and the CPU share.

    python -m benchmarks.saturated [--buses 4] [--rate 8500] [--seconds 30]

Each bus has one process with sender and broker, the capture is that of the bench, frames carry a counter: the proof is
that the journal contains every number once and in order. CPU is that of each process over the same time, from /proc.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.rounds import Table
from drivers.can_record import FD_BYTES, frame_type
from drivers.canbus import BusSettings, ProcessCapture
from drivers.health import CaptureHealth
from drivers.journal import FLAG_FAST, FLAG_FD, FRAME, Kind, read_blocks

PERIOD_NS = 1_000_000
"""Frames leave in packets of this long, as those of a USB adapter do."""
_TICKS_PER_S = os.sysconf("SC_CLK_TCK")


class Sending(NamedTuple):
    """What one bus carries."""

    rate: float
    """Frames per second; 0: as fast as possible."""
    seconds: float
    frames_of: Callable[[int, int], np.ndarray]
    """Makes the frames with numbers from one to below another."""
    fd: bool


def send(sending: Sending, parent: Connection) -> None:
    """The sender's process: a broker, and numbered frames."""
    from drivers.sim.loopcan import Broker, LoopBus

    rate, seconds, frames_of, fd = sending
    broker = Broker(fd=fd)
    bus = LoopBus(broker.port, fd=fd)
    parent.send(broker.port)
    parent.recv()
    sent, begun = 0, time.monotonic_ns()
    end = begun + round(seconds * 1e9)
    while (now := time.monotonic_ns()) < end:
        due = round((now - begun) * 1e-9 * rate) if rate else sent + 256
        if due > sent:
            bus.send_block(frames_of(sent, min(due, sent + 4096)))
            sent = min(due, sent + 4096)
        if rate:
            time.sleep(max(PERIOD_NS - (time.monotonic_ns() - now), 0) * 1e-9)
    parent.send((sent, (time.monotonic_ns() - begun) * 1e-9))
    parent.recv()
    bus.shutdown()
    parent.send(broker.dropped_clients)
    broker.close()


def counted(start: int, end: int) -> np.ndarray:
    """Frames with 8 bytes each that contain their number."""
    frames = np.zeros(end - start, dtype=FRAME)
    frames["id"], frames["len"] = 0x120, 8
    frames["data"] = np.arange(start, end, dtype="<u8").view(np.uint8).reshape(-1, 8)
    return frames


IMU_FRAME = frame_type(FD_BYTES)


def of_two_units(start: int, end: int) -> np.ndarray:
    """Frames of two inertial units in turn, as `profiles/stations/imu.yaml` maps them: six outputs, four temperatures,
    counter and status in 35 bytes of a frame with 48; the number of the frame is in the last eight.
    """
    frames, number = np.zeros(end - start, dtype=IMU_FRAME), np.arange(start, end)
    frames["id"], frames["len"], frames["flags"] = 0x200 + 0x10 * (number % 2), 48, FLAG_FD | FLAG_FAST
    frames["data"][:, 32:34] = (number // 2 % 65536).astype("<u2").view(np.uint8).reshape(-1, 2)
    frames["data"][:, 34] = 1
    frames["data"][:, 40:48] = number.astype("<u8").view(np.uint8).reshape(-1, 8)
    return frames


def cpu_s(pid: int) -> float:
    """CPU time of a process and all its threads so far [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / _TICKS_PER_S


@contextmanager
def reporting(folder: Path) -> Iterator[tuple[int, Callable[[], int]]]:
    """A process that renders a report of a simulated run repeatedly; yields their counter."""
    code = "import sys; from benchmarks.saturated import render; render(sys.argv[1], sys.argv[2])"
    command = [sys.executable, "-c", code, str(folder), str(folder / "count")]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    assert process.stdout is not None
    if process.stdout.readline().strip() != "ready":
        raise SystemExit("the report could not be rendered")
    try:
        yield process.pid, lambda: int((folder / "count").read_text())
    finally:
        process.kill()
        process.wait()


def render(folder: str, count: str) -> None:
    """Make a run, then its report repeatedly."""
    from bench.analysis.effects.model import load_model
    from bench.commands import acquisition, analysis

    models = [load_model(model) for model in analysis.DEFAULT_MODELS]
    done = acquisition.conduct(Path("profiles/quick.yaml"), None, acquisition.Task((), {}, Path(folder)), quiet=True)
    made = 0
    while True:
        Path(count).write_text(str(made), encoding="utf-8")
        if not made:
            print("ready", flush=True)
        analysis.report_on(done.run, models, done.error)
        made += 1


class Line:
    """One bus: its sender and its capture."""

    def __init__(self, context: Any, folder: Path, number: int, sending: Sending) -> None:
        self._pipe, theirs = context.Pipe()
        self.sender = context.Process(target=send, args=(sending, theirs), daemon=True)
        self.sender.start()
        self.journal = folder / f"bus{number}.gtbj"
        port = self._pipe.recv()
        settings = BusSettings("loopcan", f"127.0.0.1:{port}", fd=sending.fd)
        self.capture = ProcessCapture(settings, self.journal, time.monotonic_ns())
        self.cpu = (0.0, 0.0)
        self.seen: list[CaptureHealth] = []
        self.polled = 0

    def start(self) -> None:
        self.cpu = self._cpu()
        self._pipe.send("go")

    def poll(self) -> bool:
        """Poll as the loop of a run does once per second; returns whether the sender has ended."""
        self.polled += len(self.capture.poll())
        self.seen.append(self.capture.health())
        return self._pipe.poll(0)

    def _cpu(self) -> tuple[float, float]:
        assert self.capture.pid is not None
        return cpu_s(self.capture.pid), cpu_s(self.sender.pid)

    def finish(self) -> dict[str, Any]:
        """Let the capture catch up, close, and compare the journal with the counter."""
        sent, lasted_s = self._pipe.recv()
        begun = time.monotonic()
        while self.capture.health().frames < sent and time.monotonic() - begun < 60 and not self.capture.health().error:
            time.sleep(0.01)
        drain_s = time.monotonic() - begun
        capture_s, sender_s = (after - before for after, before in zip(self._cpu(), self.cpu, strict=True))
        health = self.capture.health()
        self.capture.close()
        self.polled += len(self.capture.poll())
        self._pipe.send("end")
        dropped = self._pipe.recv()
        self.sender.join()
        numbers, events = journalled(self.journal)
        return {
            "sent": sent,
            "rate": sent / lasted_s,
            "kept": len(numbers),
            "lost": sent - len(np.unique(numbers)),
            "in_order": bool((np.diff(numbers.astype(np.int64)) == 1).all()) if len(numbers) else False,
            "polled": self.polled,
            "capture_cpu": capture_s / lasted_s,
            "sender_cpu": sender_s / lasted_s,
            "us_per_frame": 1e6 * capture_s / max(len(numbers), 1),
            "most_behind_s": health.most_behind_s,
            "seen_behind_s": max(seen.behind_s for seen in self.seen),
            "drain_s": drain_s,
            "events": events,
            "dropped_clients": dropped,
        }


def journalled(path: Path) -> tuple[np.ndarray, list[str]]:
    """Numbers of the frames in a journal, and the events of its capture."""
    frames, events = [np.zeros(0, dtype="<u8")], []
    for block in read_blocks(path):
        if block.kind is Kind.FRAMES:
            data, length = block.frames()["data"], int(block.frames()["len"][0])
            frames.append(np.ascontiguousarray(data[:, length - 8 : length]).view("<u8")[:, 0])
        else:
            events.append(json.loads(block.payload)["text"])
    return np.concatenate(frames), events


def trial(
    buses: int,
    rate: float,
    seconds: float,
    report: bool = True,
    frames_of: Callable[[int, int], np.ndarray] = counted,
    fd: bool = False,
) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """A trial with the given number of buses and frame rate; result of each bus, and the load beside it."""
    context = multiprocessing.get_context("spawn")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "runs").mkdir()
        lines = [Line(context, folder, k, Sending(rate, seconds, frames_of, fd)) for k in range(buses)]
        if not report:
            return _watch(lines), {}
        with reporting(folder / "runs") as (pid, made):
            before = made(), cpu_s(pid), time.monotonic()
            found = _watch(lines)
            lasted_s = time.monotonic() - before[2]
            others = {"reports": made() - before[0], "report_cpu": (cpu_s(pid) - before[1]) / lasted_s}
        return found, others


def _watch(lines: Sequence[Line]) -> list[dict[str, Any]]:
    for line in lines:
        line.start()
    while not all([line.poll() for line in lines]):
        time.sleep(1.0)
    return [line.finish() for line in lines]


def unit_cpu(seconds: float) -> list[str]:
    """CPU shares at the rate of one unit at 500 Hz, 601 frames/s: capture; decoding a second of frames in the run."""
    (one,), _ = trial(1, 601.0, seconds, report=False)
    from benchmarks.can_frames import simulated
    from drivers.gyro import GyroDecoder

    frames, decoder = simulated(601 * 200), GyroDecoder("vibratory", 0)
    begun = time.process_time()
    for block in np.split(frames, 200):
        decoder.decode(block)
    decode = (time.process_time() - begun) / 200
    return ["one unit at 500 Hz", "601", f"{one['capture_cpu']:.2%}", f"{decode:.2%}", f"{one['lost']}"]


def imu_cpu(seconds: float) -> list[str]:
    """The same of four inertial units at 500 Hz, two on each of two buses with CAN FD; shares are of one unit."""
    found, _ = trial(2, 1000.0, seconds, report=False, frames_of=of_two_units, fd=True)
    from bench.base import parse_yaml
    from bench.commands.acquisition import load_station

    text = Path("profiles/stations/imu.yaml").read_text().replace("cycle_ms: 20}", "cycle_ms: 2}")
    decoder, seconds_of = load_station(parse_yaml(text, "imu.yaml")).units[0].decoder(), 200
    frames = of_two_units(0, 1000 * seconds_of)
    frames["t_ns"] = np.arange(len(frames)) * 1_000_000
    begun = time.process_time()
    for block in np.split(frames, seconds_of):  # with those of the other unit on the bus
        decoder.decode(block)
    decode = (time.process_time() - begun) / seconds_of
    assert decoder.samples == len(frames) // 2, decoder.losses
    capture = sum(one["capture_cpu"] for one in found) / 4
    name = "an inertial unit of four on two CAN FD buses, 6 outputs at 500 Hz"
    return [name, "500", f"{capture:.2%}", f"{decode:.2%}", str(sum(one["lost"] for one in found))]


HEAD = (
    "buses",
    "frames/s each",
    "bus load",
    "lost",
    "CPU of each capture",
    "of each sender",
    "of the reports",
    "reports",
    "us/frame",
    "most behind s",
    "reported as behind",
)
WIRE_BITS = 117.5
"""Bits of a classical frame with 8 bytes of a gyro, stuffing included: 8511 fill 1 Mbit/s."""


def row(rate: float, seconds: float, buses: int = 4, report: bool = True) -> list[str]:
    """One trial as a row."""
    found, others = trial(buses, rate, seconds, report)
    real = float(np.mean([one["rate"] for one in found]))
    lost, spells = sum(one["lost"] for one in found), sum("is" in e.split()[:3] for one in found for e in one["events"])
    assert all(one["in_order"] and one["polled"] == one["kept"] for one in found if not one["lost"])
    return [
        str(buses),
        f"{real:.0f}",
        f"{real * WIRE_BITS / 1e6:.0%}",
        str(lost),
        " ".join(f"{one['capture_cpu']:.1%}" for one in found),
        " ".join(f"{one['sender_cpu']:.1%}" for one in found),
        f"{others['report_cpu']:.0%}" if others else "",
        str(others["reports"]) if others else "",
        f"{np.mean([one['us_per_frame'] for one in found]):.1f}",
        f"{max(one['most_behind_s'] for one in found):.3f}",
        f"{spells} times",
    ]


def tables(seconds: float) -> list[Table]:
    """Four buses at 1 Mbit/s full of frames, at twice that, as fast as they can; and one unit."""
    rows = [row(8500.0, seconds), row(17000.0, seconds / 3), row(0.0, seconds / 6, report=False)]
    reading = (
        "Classical CAN at 1 Mbit/s carries 7,407 (most stuffing) to 9,009 (none) frames of 8 bytes per second, 8,511 "
        "of a gyro; shares are of one core, processes in parallel. Lost: counter numbers missing in the journals."
    )
    head = ("what", "frames/s", "CPU of the capture", "CPU of decoding and placing", "lost")
    return [
        Table("Saturated buses while reports are rendered", reading, HEAD, rows),
        Table("One unit", "Shares of one core for each unit.", head, [unit_cpu(seconds / 3), imu_cpu(seconds / 3)]),
    ]


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--buses", type=int, default=4)
    parser.add_argument("--rate", type=float, default=8500.0)
    parser.add_argument("--seconds", type=float, default=30.0)
    options = parser.parse_args()
    found, others = trial(options.buses, options.rate, options.seconds)
    for one in found:
        print(json.dumps(one))
    print(json.dumps(others), "load", os.getloadavg())


if __name__ == "__main__":
    main()
