"""The bare receive loop of a capture process: every frame of a bus into a journal, and a heartbeat that can be read.

No Notifier, no decoding, no printing: nothing here may take longer than the kernel buffers frames.
"""

from __future__ import annotations

import json
import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.context import SpawnContext
from typing import Any

import can

from drivers.errors import DriverError
from drivers.frames import to_record
from drivers.journal import JournalWriter, Kind

BATCH_FRAMES = 1024
BATCH_NS = 100_000_000
SYNC_S = 1.0
RETRY_S = 0.5


@dataclass(frozen=True)
class CaptureHealth:
    """State of a capture; `error` is None while frames can arrive."""

    frames: int
    last_frame_s: float | None
    error: str | None = None
    error_frames: int = 0


class Beat:
    """Heartbeat in memory that the capture process writes and its parent reads; carries no lock that could be lost."""

    TEXT_BYTES = 400

    def __init__(self, context: SpawnContext) -> None:
        self._numbers = context.RawArray("q", [0, -1, 0, 0])  # frames, last frame [ns], beat [ns], error frames
        self._text = context.RawArray("c", self.TEXT_BYTES)

    def publish(self, frames: int, last_ns: int, error_frames: int) -> None:
        """Say that the loop is alive."""
        self._numbers[:] = [frames, last_ns, time.monotonic_ns(), error_frames]

    def fail(self, text: str) -> None:
        """Say what is wrong; an empty text says that it is right again."""
        self._text.value = text.encode()[: self.TEXT_BYTES - 1]

    def age_s(self) -> float:
        """Time since the last sign of life [s]."""
        return (time.monotonic_ns() - int(self._numbers[2])) * 1e-9

    def health(self) -> CaptureHealth:
        """What was published last."""
        frames, last_ns, _, error_frames = self._numbers[:]
        text = self._text.value.decode(errors="replace")
        return CaptureHealth(frames, last_ns * 1e-9 if last_ns >= 0 else None, text or None, error_frames)


class Recorder:
    """Receives from a bus into a journal until told to stop; opens the bus again when it fails."""

    def __init__(self, open_bus: Callable[[], can.BusABC], writer: JournalWriter, beat: Beat, start_ns: int) -> None:
        self._open_bus = open_bus
        self._writer = writer
        self._beat = beat
        self._start_ns = start_ns
        self._frames = self._error_frames = 0
        self._last_ns = -1

    def run(self, ready: Callable[[], None], stopped: Callable[[], bool]) -> None:
        """Record until `stopped()`; calls `ready()` once the bus is open.

        DriverError when the bus does not open at first; OSError when the journal cannot be written (a full disk).
        """
        bus = self._open_bus()
        self._beat.publish(0, -1, 0)  # whoever asks right after `ready` must not find us silent
        ready()
        with self._synced():
            while True:
                try:
                    self._receive(bus, stopped)
                    return
                except can.CanError as error:
                    self._report(f"bus failed: {_one_line(error)}")
                finally:
                    bus.shutdown()
                reopened = self._reopen(stopped)
                if reopened is None:
                    return
                bus = reopened
                self._report("")

    def _receive(self, bus: can.BusABC, stopped: Callable[[], bool]) -> None:
        while not stopped():
            self._batch(bus, BATCH_NS)
        while self._batch(bus, 0) == BATCH_FRAMES:  # what the bus still holds
            pass

    def _batch(self, bus: can.BusABC, within_ns: int) -> int:
        """Journal the frames that arrive within a time [ns], or those that wait already; how many there were."""
        deadline_ns = time.monotonic_ns() + within_ns
        records: list[bytes] = []
        try:
            while len(records) < BATCH_FRAMES:
                left_ns = deadline_ns - time.monotonic_ns()
                if left_ns <= 0 < within_ns:
                    break
                message = bus.recv(max(left_ns, 0) * 1e-9)
                if message is None:
                    break
                self._last_ns = self._stamp_ns(message)
                self._error_frames += message.is_error_frame
                records.append(to_record(message, self._last_ns))
        except OSError as error:  # some interfaces let the error of the operating system through
            raise can.CanOperationError(_one_line(error)) from error
        finally:
            self._flush(records)
        return len(records)

    def _stamp_ns(self, message: can.Message) -> int:
        """Bench time of a message [ns]: now, less its age where the interface stamps with calendar time.

        A difference of calendar times over milliseconds does not mind that calendar time may jump.
        """
        t_ns = time.monotonic_ns() - self._start_ns
        age_ns = time.time_ns() - round(message.timestamp * 1e9)
        return t_ns - age_ns if 0 < age_ns < 1_000_000_000 else t_ns

    def _flush(self, records: list[bytes]) -> None:
        if records:
            self._frames += len(records)
            self._writer.append(Kind.FRAMES, b"".join(records), len(records), self._last_ns * 1e-9, time.time_ns())
        self._beat.publish(self._frames, self._last_ns, self._error_frames)

    def _reopen(self, stopped: Callable[[], bool]) -> can.BusABC | None:
        while not stopped():
            try:
                return self._open_bus()
            except DriverError as error:
                self._beat.fail(str(error))
                self._beat.publish(self._frames, self._last_ns, self._error_frames)
                time.sleep(RETRY_S)
        return None

    def _report(self, text: str) -> None:
        event = {"kind": "capture", "text": text or "bus open again"}
        now_s = (time.monotonic_ns() - self._start_ns) * 1e-9
        self._writer.append(Kind.EVENT, json.dumps(event).encode(), 1, now_s, time.time_ns())
        self._beat.fail(text)

    @contextmanager
    def _synced(self) -> Iterator[None]:
        """Force the journal to the disk once a second from a thread, which does not hold up the loop."""
        done = threading.Event()

        def sync() -> None:
            while not done.wait(SYNC_S):
                try:
                    self._writer.sync()
                except OSError as error:
                    self._beat.fail(f"journal not on disk: {_one_line(error)}")

        thread = threading.Thread(target=sync, name="journal sync", daemon=True)
        thread.start()
        try:
            yield
        finally:
            done.set()
            thread.join()


def raise_priority() -> None:
    """Ask the system to run this process before others; where it refuses, nothing changes."""
    try:
        os.nice(-10)
    except OSError:
        return


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__


def stop_when(control: Any, parent_pid: int) -> Callable[[], bool]:
    """True from the moment that the parent says so, closes its end of the pipe `control`, or has died."""
    return lambda: control.poll() or os.getppid() != parent_pid
