"""The captures that put every frame of a CAN bus into a journal.

`InProcessCapture` serves a simulated bus in lock-step. `ProcessCapture` serves a real bus in a separate OS process
that only receives, because analysis in the same process would block the interpreter for longer than the kernel buffers
frames.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
from collections.abc import Callable
from dataclasses import replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Protocol

import can
import numpy as np

from drivers.can_record import CLASSICAL_BYTES
from drivers.capture import Recorder, event, raise_priority, stop_when, summarise
from drivers.errors import DriverError, LinkError, one_line
from drivers.frames import NO_FRAMES, joined, to_frames, to_record
from drivers.health import Beat, CaptureHealth, Tally
from drivers.interfaces import BusSettings, open_bus
from drivers.journal import FLAG_ERROR, MAX_PAYLOAD, FrameArray, JournalTail, JournalWriter, Kind

__all__ = ["BusSettings", "Capture", "CaptureHealth", "InProcessCapture", "ProcessCapture", "open_bus"]


class Capture(Protocol):
    """Writes every frame of a bus to a journal, and returns it."""

    def poll(self) -> FrameArray:
        """Frames since the last call, (n,); what could not be received is in `health().error`."""

    def health(self) -> CaptureHealth:
        """State of the capture."""

    def close(self) -> None:
        """Stop and close what the capture opened."""


class InProcessCapture:
    """Moves all waiting frames of a bus to a journal at each poll. The caller owns bus and journal.

    `stamp` converts a `Message.timestamp` [s] to bench time [ns]; without it the timestamps must be bench time, as on
    a simulated bus. `now` is bench time [s] for errors and events; without it they get the time of the last frame.
    A bus that fails is tried again at the next poll. OSError of the journal (a full disk) reaches the caller.
    """

    def __init__(
        self,
        bus: can.BusABC,
        writer: JournalWriter,
        stamp: Callable[[float], int] | None = None,
        now: Callable[[], float] | None = None,
        room: int = CLASSICAL_BYTES,
    ) -> None:
        self._room = room
        self._bus = bus
        self._writer = writer
        self._stamp = stamp
        self._tally = Tally()
        self._now = now or (lambda: max(self._tally.last_ns, 0) * 1e-9)
        self._error: str | None = None

    def poll(self) -> FrameArray:
        """Frames that have arrived since the last call, (n,)."""
        error: str | None = None
        frames = NO_FRAMES
        try:
            frames = self._receive()
        except (can.CanError, OSError) as problem:
            error = one_line(problem)
        self._report(error)
        if len(frames):
            self._keep(frames)
        return frames

    def health(self) -> CaptureHealth:
        """Counts so far, and the error of the bus."""
        tally = self._tally
        return CaptureHealth(
            tally.frames,
            tally.last_ns * 1e-9 if tally.last_ns >= 0 else None,
            self._error,
            tally.error_frames,
            tally.since_ns * 1e-9 if self._error is not None else None,
            tally.recoveries,
            unreadable=tally.unreadable,
            bus=str(self._bus.channel_info),
        )

    def close(self) -> None:
        """Journal the frames that are still on the bus."""
        self.poll()
        summarise(self._writer, self._tally, self._now())

    def _keep(self, frames: FrameArray) -> None:
        self._tally.frames += len(frames)
        self._tally.error_frames += int(np.count_nonzero(frames["flags"] & FLAG_ERROR))
        self._tally.last_ns = int(frames["t_ns"][-1])
        most = MAX_PAYLOAD // frames.itemsize
        for start in range(0, len(frames), most):
            block = frames[start : start + most]
            self._writer.append(Kind.FRAMES, block.tobytes(), len(block), self._tally.last_ns * 1e-9)

    def _report(self, error: str | None) -> None:
        """Journal an event when the bus begins to fail, and another one when it works again."""
        if (error is None) == (self._error is None):
            self._error = error
            return
        self._error, now_s = error, self._now()
        if error is not None:
            self._tally.since_ns = round(now_s * 1e9)
            event(self._writer, f"bus failed: {error}", now_s)
        else:
            self._tally.recoveries += 1
            event(self._writer, "bus open again", now_s)

    def _receive(self) -> FrameArray:
        stamp = self._stamp or _bench_ns
        if self._stamp is None and hasattr(self._bus, "recv_block"):
            block: FrameArray = self._bus.recv_block(0.0)
            return block
        records: list[bytes] = []
        try:
            while (message := self._bus.recv(0.0)) is not None:
                try:
                    records.append(to_record(message, stamp(message.timestamp), 0, self._room))
                except ValueError:  # CAN FD on a bus that is said to have none
                    self._tally.unreadable += 1
        except (can.CanError, OSError):
            if not records:  # frames from before the failure are kept; the next poll meets the failure again
                raise
        return to_frames(records) if records else NO_FRAMES


class ProcessCapture:
    """Captures a bus in a separate OS process; frames reach this process through the journal.

    `start_monotonic_ns` is the monotonic time [ns] at bench time 0. Raises ConfigError or LinkError when the bus does
    not open. Afterwards nothing raises: `health().error` reports the error, and the process opens a failed bus again.
    It ends on `close()`, and by itself when this process dies.
    """

    STALE_S = 1.0

    def __init__(
        self, settings: BusSettings, journal_path: Path, start_monotonic_ns: int, timeout_s: float = 30.0
    ) -> None:
        self._tail = JournalTail(journal_path)
        self._tail.poll()  # skips frames of an earlier capture into the same journal
        context = multiprocessing.get_context("spawn")
        self._beat = Beat(context, str(settings))
        self._control, child_end = context.Pipe()
        self._process = context.Process(
            target=_capture_process,
            args=(settings, journal_path, start_monotonic_ns, self._beat, child_end),
            name=f"capture {settings.channel}",
            daemon=True,
        )
        self._process.start()
        child_end.close()
        try:
            self._await_ready(settings, timeout_s)
        except DriverError:
            self.close()
            raise

    @property
    def pid(self) -> int | None:
        """Process id of the capture."""
        return self._process.pid

    def poll(self) -> FrameArray:
        """Frames that were journalled since the last call, (n,); the last ones are available after `close()`."""
        parts = [block.frames() for block in self._tail.poll() if block.kind is Kind.FRAMES]
        return joined(parts) if parts else NO_FRAMES

    def health(self) -> CaptureHealth:
        """The last heartbeat; a process that has died, or has sent none for a second, is an error."""
        health = self._beat.health()
        if not self._process.is_alive():
            code = self._process.exitcode
            return replace(health, error=health.error or f"capture process ended (exit code {code})", ended=True)
        if self._beat.age_s() > self.STALE_S and health.error is None:
            return replace(health, error=f"capture process silent for {self._beat.age_s():.1f} s")
        return health

    def close(self) -> None:
        """End the process; frames that wait on the bus are journalled first. A second call does nothing."""
        self._control.close()
        self._process.join(5.0)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()

    def _await_ready(self, settings: BusSettings, timeout_s: float) -> None:
        if not self._control.poll(timeout_s):
            raise LinkError(f"{settings}: the capture process did not start within {timeout_s:g} s")
        try:
            error = self._control.recv()
        except (EOFError, ConnectionError):
            reason = self._beat.health().error or "the capture process ended while starting"
            raise LinkError(f"{settings}: {reason}") from None
        if error is not None:
            raise error


def _capture_process(
    settings: BusSettings, journal_path: Path, start_monotonic_ns: int, beat: Beat, control: Connection
) -> None:
    """Main function of the capture process."""
    parent_pid = os.getppid()
    received: list[int] = []
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the parent decides when to stop
    signal.signal(signal.SIGTERM, lambda number, _: received.append(number))
    raise_priority()
    stop_requested = stop_when(control, parent_pid)
    writer = None
    try:
        writer = JournalWriter(journal_path)
        recorder = Recorder(lambda: open_bus(settings), writer, beat, start_monotonic_ns, settings.room)
        recorder.run(lambda: control.send(None), lambda: bool(received) or stop_requested())
    except DriverError as error:  # the bus did not open; the parent raises it
        control.send(error)
    except (OSError, ValueError) as error:  # a full disk, or frames that the journal cannot hold
        beat.fail(f"capture stopped: {one_line(error)}", ended=True)
    finally:
        if writer is not None:
            with contextlib.suppress(OSError):
                writer.close()


def _bench_ns(timestamp_s: float) -> int:
    return round(timestamp_s * 1e9)
