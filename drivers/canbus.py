"""The only module that opens CAN buses, and the captures that put every frame of a bus into a journal.

`InProcessCapture` serves a simulated bus in lock-step. `ProcessCapture` serves a real bus: an OS process of its own
with a bare receive loop, because analysis in the same process holds the interpreter longer than a kernel buffers.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import socket
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Protocol

import can
import numpy as np

from drivers.capture import Beat, CaptureHealth, Recorder, raise_priority, stop_when
from drivers.errors import ConfigError, DriverError, LinkError
from drivers.frames import NO_FRAMES, to_frames, to_record
from drivers.journal import FLAG_ERROR, MAX_PAYLOAD, FrameArray, JournalTail, JournalWriter, Kind

__all__ = ["BusSettings", "Capture", "CaptureHealth", "InProcessCapture", "ProcessCapture", "open_bus"]

_RECEIVE_BUFFER = 8 << 20
_SO_RCVBUFFORCE = 33


@dataclass(frozen=True)
class BusSettings:
    """Which python-can interface to open; `options` are passed to it as they are."""

    interface: str
    channel: str
    bitrate: int | None = None
    options: Mapping[str, Any] = field(default_factory=dict)

    def __str__(self) -> str:
        return f"CAN bus {self.interface}:{self.channel}"


def open_bus(settings: BusSettings) -> can.BusABC:
    """Open a bus; ConfigError when the settings cannot work anywhere, LinkError when the bus is not there now."""
    options = dict(settings.options)
    if settings.bitrate is not None:
        options["bitrate"] = settings.bitrate
    try:
        bus = can.Bus(interface=settings.interface, channel=settings.channel, ignore_config=True, **options)
    except (NotImplementedError, ImportError, TypeError, ValueError) as error:
        raise ConfigError(f"{settings}: {_one_line(error)}") from error
    except (can.CanError, OSError) as error:
        raise LinkError(f"{settings} does not open: {_one_line(error)}") from error
    _enlarge_buffer(bus)
    return bus


def _enlarge_buffer(bus: can.BusABC) -> None:
    """SocketCAN holds some 300 frames unless asked for more; where the system refuses, it stays as it is."""
    link = getattr(bus, "socket", None)
    if isinstance(link, socket.socket) and link.family == getattr(socket, "AF_CAN", None):
        with contextlib.suppress(OSError):
            link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER)
        with contextlib.suppress(OSError):
            link.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, _RECEIVE_BUFFER)


class Capture(Protocol):
    """Puts every frame of a bus into a journal and hands it on."""

    def poll(self) -> FrameArray:
        """Frames since the last call, (n,); what could not be received is in `health().error`."""

    def health(self) -> CaptureHealth:
        """How the capture is."""

    def close(self) -> None:
        """Stop and close what the capture opened."""


class InProcessCapture:
    """Drains a bus into a journal whenever it is polled. Bus and journal remain the caller's.

    `stamp` turns a `Message.timestamp` [s] into bench time [ns]; without it the bus carries bench time already, as
    a simulated one does. OSError of the journal (a full disk) reaches the caller.
    """

    def __init__(self, bus: can.BusABC, writer: JournalWriter, stamp: Callable[[float], int] | None = None) -> None:
        self._bus = bus
        self._writer = writer
        self._stamp = stamp
        self._frames = self._error_frames = 0
        self._last_frame_s: float | None = None
        self._error: str | None = None

    def poll(self) -> FrameArray:
        """Frames that have arrived since the last call, (n,)."""
        frames = self._receive()
        if not len(frames):
            return frames
        self._frames += len(frames)
        self._error_frames += int(np.count_nonzero(frames["flags"] & FLAG_ERROR))
        self._last_frame_s = float(frames["t_ns"][-1]) * 1e-9
        most = MAX_PAYLOAD // frames.itemsize
        for start in range(0, len(frames), most):
            block = frames[start : start + most]
            self._writer.append(Kind.FRAMES, block.tobytes(), len(block), self._last_frame_s)
        return frames

    def health(self) -> CaptureHealth:
        """Counts so far and the last error of the bus."""
        return CaptureHealth(self._frames, self._last_frame_s, self._error, self._error_frames)

    def close(self) -> None:
        """Take what is left on the bus."""
        self.poll()

    def _receive(self) -> FrameArray:
        records: list[bytes] = []
        stamp = self._stamp or _bench_ns
        try:
            if self._stamp is None and hasattr(self._bus, "recv_block"):
                block: FrameArray = self._bus.recv_block(0.0)
                return block
            while (message := self._bus.recv(0.0)) is not None:
                records.append(to_record(message, stamp(message.timestamp)))
        except (can.CanError, OSError, ValueError) as error:
            self._error = _one_line(error)
        return to_frames(records) if records else NO_FRAMES


class ProcessCapture:
    """Captures a bus in an OS process of its own; frames reach this process through the journal.

    `start_monotonic_ns` is the monotonic time [ns] at bench time 0. Raises ConfigError or LinkError when the bus does
    not open. Afterwards nothing raises: `health().error` says what is wrong, and the process opens a failed bus again.
    It ends on `close()`, and by itself when this process dies.
    """

    STALE_S = 1.0

    def __init__(
        self, settings: BusSettings, journal_path: Path, start_monotonic_ns: int, timeout_s: float = 30.0
    ) -> None:
        self._tail = JournalTail(journal_path)
        self._tail.poll()  # frames of an earlier capture into the same journal are not news
        context = multiprocessing.get_context("spawn")
        self._beat = Beat(context)
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
        """Frames that were journalled since the last call, (n,); the last ones are there after `close()`."""
        parts = [block.frames() for block in self._tail.poll() if block.kind is Kind.FRAMES]
        return np.concatenate(parts) if parts else NO_FRAMES

    def health(self) -> CaptureHealth:
        """The last heartbeat; a process that has died or is silent for a second is an error."""
        health = self._beat.health()
        if not self._process.is_alive():
            code = self._process.exitcode
            return replace(health, error=health.error or f"capture process ended (exit code {code})")
        if self._beat.age_s() > self.STALE_S and health.error is None:
            return replace(health, error=f"capture process silent for {self._beat.age_s():.1f} s")
        return health

    def close(self) -> None:
        """End the process; what the bus still held is journalled first. A second call does nothing."""
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
    told: list[int] = []
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the parent decides when to stop
    signal.signal(signal.SIGTERM, lambda number, _: told.append(number))
    raise_priority()
    said_to_stop = stop_when(control, parent_pid)
    writer = None
    try:
        writer = JournalWriter(journal_path)
        recorder = Recorder(lambda: open_bus(settings), writer, beat, start_monotonic_ns)
        recorder.run(lambda: control.send(None), lambda: bool(told) or said_to_stop())
    except DriverError as error:  # the bus did not open; the parent raises it
        control.send(error)
    except (OSError, ValueError) as error:  # a full disk, or frames that the journal cannot hold
        beat.fail(f"capture stopped: {_one_line(error)}")
    finally:
        if writer is not None:
            with contextlib.suppress(OSError):
                writer.close()


def _bench_ns(timestamp_s: float) -> int:
    return round(timestamp_s * 1e9)


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__
