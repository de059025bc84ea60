"""A process of its own that makes a real station safe when the bench is killed or hangs.

The bench tells it through a pipe that it is alive. When the pipe closes, or nothing comes for too long, the watchdog
kills what is left of the bench (gateways take one client at a time), opens a link of its own and goes to the safe
state. It has a session of its own, so that neither Ctrl-C nor a closing terminal reaches it. It cannot outlive the
computer: software is never the safety device.

What it did stands in `watchdog.jsonl` of the run folder (of the first unit), one event a line as in `events.jsonl`.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import subprocess
import sys
import time
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import IO, Any

from pydantic import TypeAdapter

from bench.acquisition.station.instruments import switch_off
from bench.acquisition.station.notices import Notifier
from bench.acquisition.station.rate_table import halt
from bench.acquisition.station.safety import SafeState, failures
from bench.acquisition.station.settings.station import StationSettings
from bench.acquisition.station.turning_axes import halt_axes
from bench.base import BenchError, EquipmentError
from drivers.chamber import Chamber, Known, SafeStep, Write
from drivers.clock import WallClock
from drivers.errors import DriverError
from drivers.modbus import ModbusLink, prepare
from drivers.registers import load_map

EVENTS = "watchdog.jsonl"
READY_S = 60.0
"""A watchdog that is not ready within this time is not there."""
KILLED_S = 10.0
UNVERIFIED = 4


class Watchdog:
    """The bench's end: started before anything moves, told at every tick that the bench is alive."""

    def __init__(
        self,
        settings: StationSettings,
        folder: Path,
        started_monotonic_ns: int,
        known: Known | None = None,
        claim: int | None = None,
    ) -> None:
        """Start the process and wait until it is ready; EquipmentError when it is not.

        `known` is what the chamber's controller said at the start, for the case that its answers make no sense later.
        `claim`: descriptor of the claim on the chamber, which the watchdog keeps when the bench is killed.
        """
        task = {
            "station": settings.model_dump(mode="json"),
            "folder": str(folder.resolve()),
            "started_monotonic_ns": started_monotonic_ns,
            "known": None if known is None else asdict(known),
        }
        self._process = subprocess.Popen(
            [sys.executable, "-m", "bench.acquisition.station.watchdog"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            start_new_session=True,
            pass_fds=() if claim is None else (claim,),
        )
        self._say(json.dumps(task))
        ready, _, _ = select.select([self._out], [], [], READY_S)
        if not ready or os.read(self._out.fileno(), 100) != b"ready\n":
            self._process.kill()
            self._close()
            raise EquipmentError("the watchdog process did not start; nothing was moved")
        os.set_blocking(self._in.fileno(), False)  # a watchdog that hangs must not hang the bench

    @property
    def pid(self) -> int:
        """Process id of the watchdog."""
        return self._process.pid

    def arm(self, instruments_only: bool = False) -> None:
        """From now on equipment moves, or only instruments: without us they are to be made safe.

        Before, all is left as it was found.
        """
        self._say("instruments" if instruments_only else "armed")

    def beat(self, allow_s: float = 0.0) -> None:
        """Say that the bench is alive, and may be silent for `allow_s` [s]; EquipmentError when the watchdog is not."""
        self._say(f"beat {allow_s:g}")

    def done(self) -> None:
        """The equipment is safe, or was never moved: the watchdog may go."""
        with contextlib.suppress(EquipmentError):
            self._say("done")
        self._close()

    def take_over(self) -> None:
        """The equipment is not verified to be safe: let the watchdog try on, without us."""
        with contextlib.suppress(EquipmentError):
            self._say("failed")
        self._process.stdin = self._close_pipe(self._in)
        self._out.close()
        self._process.returncode = 0  # it goes on alone; nobody waits for it here

    @property
    def _in(self) -> IO[bytes]:
        assert self._process.stdin is not None
        return self._process.stdin

    @property
    def _out(self) -> IO[bytes]:
        assert self._process.stdout is not None
        return self._process.stdout

    def _say(self, word: str) -> None:
        try:
            data = f"{word}\n".encode()
            while data:
                data = data[os.write(self._in.fileno(), data) :]
        except (OSError, ValueError) as error:
            code = self._process.poll()
            state = "hangs" if code is None else f"ended with code {code}"
            raise EquipmentError(f"the watchdog process {state}: {type(error).__name__}") from None

    def _close(self) -> None:
        self._process.stdin = self._close_pipe(self._in)
        try:
            self._process.wait(KILLED_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._out.close()

    @staticmethod
    def _close_pipe(pipe: IO[bytes]) -> None:
        with contextlib.suppress(OSError):
            pipe.close()


class Listener:
    """The watchdog's end of the pipe: waits until the bench says that it is done, or does not say anything any more."""

    def __init__(self, read_fd: int, silent_s: float) -> None:
        self.armed = self.moved = self.failed = self.hangs = False
        self._fd, self._silent_s = read_fd, silent_s
        self._allowed_s = silent_s
        self._rest = b""

    def task(self) -> dict[str, Any]:
        """The first line."""
        while b"\n" not in self._rest:
            data = os.read(self._fd, 1 << 16)
            if not data:
                raise EOFError
            self._rest += data
        line, self._rest = self._rest.split(b"\n", 1)
        return dict(json.loads(line))

    def wait(self) -> str:
        """Why the bench has to be replaced; empty when it is done. Returns when that is so."""
        while True:
            *lines, self._rest = self._rest.split(b"\n")
            for line in lines:
                if line == b"done":
                    return ""
                self._hear(line)
            readable, _, _ = select.select([self._fd], [], [], self._allowed_s)
            if not readable:
                self.hangs = True
                return f"the bench was silent for {self._allowed_s:g} s"
            data = os.read(self._fd, 1 << 16)
            if not data:
                return "the bench could not reach the safe state" if self.failed else "the bench ended unexpectedly"
            self._rest += data

    def _hear(self, line: bytes) -> None:
        word, _, number = line.partition(b" ")
        self.armed = self.armed or word in {b"armed", b"instruments"}
        self.moved = self.moved or word == b"armed"
        self.failed = self.failed or word == b"failed"
        if word == b"beat":
            self._allowed_s = max(float(number), self._silent_s)


class Log:
    """Events into the run folder and onto stderr; a disk or a terminal that is gone keeps nothing from being safe."""

    def __init__(self, folder: Path, started_monotonic_ns: int) -> None:
        self.run = f"{folder.parent.name}/{folder.name}"
        self._path = folder / EVENTS
        self._start_ns = started_monotonic_ns

    def event(self, kind: str, text: str, **facts: Any) -> None:
        """Record an event at the bench time of the run that was."""
        t_s = round((time.monotonic_ns() - self._start_ns) * 1e-9, 3)
        utc = datetime.now(UTC).isoformat(timespec="milliseconds")
        line = json.dumps({"t_s": t_s, "utc": utc, "kind": kind, "text": text, **facts})
        with contextlib.suppress(OSError):
            print(f"bench watchdog: {text}", file=sys.stderr, flush=True)
        with contextlib.suppress(OSError), self._path.open("a", encoding="utf-8") as file:
            file.write(f"{line}\n")
            file.flush()
            os.fsync(file.fileno())

    def write(self, write: Write) -> None:
        """A register of the chamber that was written."""
        text = f"{write.register}: {write.old} -> {write.read_back}"
        self.event("write", text, register=write.register, value=write.new)


def main() -> int:
    """Run as `python -m bench.acquisition.station.watchdog`; exit code 4 when the safe state could not be verified."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGPIPE):
        signal.signal(number, signal.SIG_IGN)  # whoever ends the bench politely lets it make the equipment safe itself
    bench = _Process(os.getppid())
    listener = Listener(sys.stdin.fileno(), READY_S)
    try:
        task = listener.task()
    except EOFError:
        return 0
    settings = StationSettings.model_validate_json(json.dumps(task["station"]))
    log = Log(Path(task["folder"]), int(task["started_monotonic_ns"]))
    prepare()
    load_map(settings.chamber.map)  # what cannot be loaded now could not be when it is needed
    listener = Listener(sys.stdin.fileno(), settings.watchdog.silent_s)
    notices = _notices(settings, log)
    os.write(sys.stdout.fileno(), b"ready\n")
    why = listener.wait()
    if not why or not listener.armed:
        return 0
    known = None if task["known"] is None else TypeAdapter(Known).validate_python(task["known"])
    code = _replace(bench, listener, _Safe(settings, log, known, notices), why)
    notices.close()
    for text in notices.troubles():
        log.event("notify", text)
    return code


def _notices(settings: StationSettings, log: Log) -> Notifier:
    """Who is told; nobody where their file was spoilt since the bench read it."""
    try:
        return Notifier(settings.notify)
    except BenchError as error:
        log.event("notify", str(error))
        return Notifier(None)


def _replace(bench: _Process, listener: Listener, safe: _Safe, why: str) -> int:
    """The bench is gone or hangs: make the equipment safe in its place."""
    started_s, log = time.monotonic(), safe.log
    log.event("watchdog", f"{why}: making the equipment safe", reason=why)
    safe.tell(f"{why}: the watchdog makes the equipment safe")
    grace_s = 0.0 if listener.hangs else KILLED_S  # a pipe closes a moment before its process is gone
    if not listener.failed and bench.kill(grace_s):  # a bench that gave up closes its link and writes its report
        log.event("watchdog", "killed the bench, which hung")
    try:
        steps = safe.make() if listener.moved else switch_off(safe.settings)
    except DriverError as error:  # a file of the station that was right when the run started
        steps = [SafeStep("chamber", False, str(error))]
    took_s = time.monotonic() - started_s
    trouble = failures(steps)
    text = trouble or f"equipment is safe, verified after {took_s:.1f} s"
    log.event("watchdog", text, ok=not trouble, took_s=round(took_s, 3))
    safe.tell(f"{why}; {text}")
    return UNVERIFIED if trouble else 0


@dataclass(frozen=True)
class _Safe:
    """Makes the equipment of a station safe over a link of its own."""

    settings: StationSettings
    log: Log
    known: Known | None
    notices: Notifier

    def tell(self, text: str) -> None:
        """Tell people who are not beside the bench."""
        title = f"{self.log.run}: the watchdog took over"
        self.notices.tell("trip", title, f"{text}\non station {self.settings.name}", "failure")

    def make(self) -> list[SafeStep]:
        settings, log = self.settings, self.log
        connection, chamber = settings.chamber.connection, settings.chamber
        assert connection is not None  # only real stations are watched
        clock = WallClock()
        with contextlib.closing(
            ModbusLink(connection.url, device_id=connection.device, timeout_s=connection.timeout_s)
        ) as link:
            limits = chamber.lowest_degc, chamber.highest_degc
            return SafeState(
                chamber=Chamber(link, load_map(chamber.map), limits, clock, journal=log.write, known=self.known),
                clock=clock,
                settings=settings.safe_state,
                ambient_degc=settings.ambient_degc,
                retry_s=60.0 * settings.watchdog.retry_min,
                stop_moving=lambda: [*halt(settings), *halt_axes(settings.fixture, settings.buses)],
                switch_off=lambda: switch_off(settings),
                report=log.event,
            ).make()


class _Process:
    """The bench, by a handle that no other process can come to bear where the system has one, else by its id."""

    def __init__(self, pid: int) -> None:
        self._pid = pid
        self._handle = os.pidfd_open(pid) if hasattr(os, "pidfd_open") else None

    def kill(self, grace_s: float) -> bool:
        """Kill it unless it ends by itself within `grace_s` [s]; False when that was not needed."""
        if self._gone(grace_s):
            return False
        with contextlib.suppress(ProcessLookupError):
            if self._handle is None:
                os.kill(self._pid, signal.SIGKILL)
            else:
                signal.pidfd_send_signal(self._handle, signal.SIGKILL)
        self._gone(KILLED_S)
        return True

    def _gone(self, within_s: float) -> bool:
        if self._handle is not None:
            return bool(select.select([self._handle], [], [], within_s)[0])
        until_s = time.monotonic() + within_s
        while os.getppid() == self._pid and time.monotonic() < until_s:
            time.sleep(0.05)
        return os.getppid() != self._pid


if __name__ == "__main__":
    sys.exit(main())
