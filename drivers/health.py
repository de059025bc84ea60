"""State of a capture: its counts, its error and since when; readable from another process."""

from __future__ import annotations

import time
from dataclasses import dataclass
from multiprocessing.context import SpawnContext
from typing import Literal


@dataclass(frozen=True)
class CaptureHealth:
    """State of a capture; `error` is None while frames can be received."""

    frames: int
    last_frame_s: float | None
    error: str | None = None
    error_frames: int = 0
    since_s: float | None = None
    """Bench time [s] at which `error` began."""
    recoveries: int = 0
    """Number of recoveries from an error."""
    ended: bool = False
    """The capture will not try again: its process has ended, or its journal cannot be written."""
    unreadable: int = 0
    """Received data that no record can hold: CAN FD frames of more than 8 bytes, garbled lines of an adapter."""
    bus: str = ""
    behind_s: float = 0.0
    """Delay of the last frames from reception by the interface to the capture [s]."""
    most_behind_s: float = 0.0
    """Longest such delay since the start [s]."""

    @property
    def state(self) -> Literal["ok", "degraded", "lost"]:
        """`degraded`: the bus is being opened again; `lost`: the capture will not recover by itself."""
        if self.error is None:
            return "ok"
        return "lost" if self.ended else "degraded"

    def __str__(self) -> str:
        since = f" since {self.since_s:.1f} s" if self.since_s is not None else ""
        return f"{self.bus or 'bus'}: {self.state}{since}{f' ({self.error})' if self.error else ''}"


class Beat:
    """Heartbeat in shared memory that the capture process writes and its parent reads, without a lock."""

    TEXT_BYTES = 400

    def __init__(self, context: SpawnContext, bus: str = "") -> None:
        self.bus = bus
        self._beat = context.RawValue("q", 0)
        self._numbers = context.RawArray("q", [0, -1, -1, 0, 0, 0, 0, 0])  # as in `publish`, [ns]
        self._text = context.RawArray("c", self.TEXT_BYTES)
        self._ended = context.RawValue("b", 0)

    def publish(self, tally: Tally) -> None:
        """Publish the counts with the current time."""
        self._numbers[:] = [
            tally.frames,
            tally.last_ns,
            tally.since_ns,
            tally.error_frames,
            tally.recoveries,
            tally.unreadable,
            tally.behind_ns,
            tally.most_behind_ns,
        ]
        self._beat.value = time.monotonic_ns()

    def fail(self, text: str, *, ended: bool = False) -> None:
        """Publish an error; an empty text clears it."""
        self._text.value = text.encode()[: self.TEXT_BYTES - 1]
        self._ended.value = ended

    def age_s(self) -> float:
        """Time since the last `publish` [s]."""
        return (time.monotonic_ns() - int(self._beat.value)) * 1e-9

    def health(self) -> CaptureHealth:
        """The state published last."""
        frames, last_ns, since_ns, error_frames, recoveries, unreadable, behind_ns, most_behind_ns = self._numbers[:]
        text = self._text.value.decode(errors="replace")
        return CaptureHealth(
            frames,
            last_ns * 1e-9 if last_ns >= 0 else None,
            text or None,
            error_frames,
            since_ns * 1e-9 if since_ns >= 0 and text else None,
            recoveries,
            bool(self._ended.value),
            unreadable,
            self.bus,
            behind_ns * 1e-9,
            most_behind_ns * 1e-9,
        )


@dataclass
class Tally:
    """Counts of a capture since its start; times are bench times [ns], -1 for never."""

    frames: int = 0
    last_ns: int = -1
    since_ns: int = -1
    error_frames: int = 0
    recoveries: int = 0
    unreadable: int = 0
    behind_ns: int = 0
    most_behind_ns: int = 0
    spells: int = 0
    """How often the capture was behind its bus by more than the limit."""
