"""The only module that opens CAN buses, and the captures that put every frame of a bus into a journal.

`InProcessCapture` serves a simulated bus in lock-step. `ProcessCapture` serves a real bus: an OS process of its own
with a bare receive loop, because analysis in the same process holds the interpreter longer than a kernel buffers.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import can
import numpy as np

from drivers.errors import ConfigError, LinkError
from drivers.frames import NO_FRAMES, to_frames, to_record
from drivers.journal import FLAG_ERROR, MAX_PAYLOAD, FrameArray, JournalWriter, Kind


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
        return can.Bus(interface=settings.interface, channel=settings.channel, ignore_config=True, **options)
    except (can.CanInterfaceNotImplementedError, ImportError, TypeError, ValueError) as error:
        raise ConfigError(f"{settings}: {_one_line(error)}") from error
    except (can.CanError, OSError) as error:
        raise LinkError(f"{settings} does not open: {_one_line(error)}") from error


@dataclass(frozen=True)
class CaptureHealth:
    """State of a capture; `error` is None while frames can arrive."""

    frames: int
    last_frame_s: float | None
    error: str | None = None
    error_frames: int = 0


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
        try:
            frames = self._receive()
        except (can.CanError, OSError) as error:
            self._error = _one_line(error)
            return NO_FRAMES
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
        if self._stamp is None and hasattr(self._bus, "recv_block"):
            block: FrameArray = self._bus.recv_block(0.0)
            return block
        stamp = self._stamp or _bench_ns
        records = []
        while (message := self._bus.recv(0.0)) is not None:
            records.append(to_record(message, stamp(message.timestamp)))
        return to_frames(records) if records else NO_FRAMES


def _bench_ns(timestamp_s: float) -> int:
    return round(timestamp_s * 1e9)


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__
