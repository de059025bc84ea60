"""A line to one unit for requests and answers, without threads: frames are received while a caller waits.

On a simulated station, waiting advances the simulated clock, so that an exchange is deterministic; on a real one it
waits for frames.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import can
import numpy as np

from drivers.clock import Clock, WallClock
from drivers.errors import ConfigError, LinkError
from drivers.frames import to_messages
from drivers.identity import Identity
from drivers.layout import Layout

STEP_S = 0.02
"""Interval between polls of the bus [s]; waiting times on a simulated station must be whole multiples of it."""
ANSWER_S = 1.0
"""Timeout of an answer [s]."""
BOOT_UP = 0


class UnitLine:
    """Frames to and from unit `number` of a layout; the caller owns the bus, and nothing else may read from it."""

    def __init__(self, bus: can.BusABC, clock: Clock, layout: Layout, number: int) -> None:
        """ConfigError for a layout whose heartbeat lacks serial number, state or coefficient set."""
        self.clock = clock
        self.identity: Identity | None = None
        """Identity in the last heartbeat."""
        self.boots = 0
        """Number of boot-up heartbeats received."""
        self.deadline_s: float | None = None
        """Bench time at which the current operation fails."""
        self._bus, self._number = bus, number
        lacking = {"serial", "state", "coefficient_set"} - (layout.beat.signals.keys() if layout.beat else set())
        if layout.beat is None or lacking:
            raise ConfigError(f"the unit's heartbeat has no {', '.join(sorted(lacking))}: its memory cannot be served")
        self._beat = layout.beat
        identifier = self._beat.message.id + number
        self._listeners: dict[int, Callable[[bytes], None]] = {identifier: self._on_heartbeat}

    def __str__(self) -> str:
        return f"unit number {self._number} on {self._bus.channel_info}"

    def listen(self, identifier: int, callback: Callable[[bytes], None]) -> None:
        """Call `callback` with each payload of an identifier."""
        self._listeners[identifier] = callback

    def send(self, identifier: int, data: bytes) -> None:
        """Send one frame; LinkError when the bus does not take it."""
        message = can.Message(
            arbitration_id=identifier, is_extended_id=identifier > 0x7FF, data=data, timestamp=self.clock.now()
        )
        try:
            self._bus.send(message)
        except (can.CanError, OSError) as error:
            raise LinkError(f"{self}: cannot send: {' '.join(str(error).split())}") from error

    def wait(self, condition: Callable[[], bool], limit_s: float, what: str) -> None:
        """Wait until the condition holds; LinkError after `limit_s` or at the deadline."""
        until_s = self.clock.now() + limit_s
        while not condition():
            if self.clock.now() >= until_s - 1e-9:
                raise LinkError(f"{self}: no {what} within {limit_s:g} s")
            self.pump()

    def pump(self) -> None:
        """Wait for `STEP_S` and receive frames; LinkError at the deadline, or when the bus fails."""
        if self.deadline_s is not None and self.clock.now() >= self.deadline_s:
            raise LinkError(f"{self}: time limit reached")
        try:
            if isinstance(self.clock, WallClock):
                self._take(self._bus.recv(STEP_S))
            else:
                self.clock.sleep_until(self.clock.now() + STEP_S)
            for message in self._arrived():
                self._take(message)
        except (can.CanError, OSError) as error:
            raise LinkError(f"{self}: {' '.join(str(error).split())}") from error

    def _arrived(self) -> Iterator[can.Message]:
        """Waiting frames. With filters of python-can, `recv(0.0)` would return None at the first foreign frame."""
        if hasattr(self._bus, "recv_block"):
            frames = self._bus.recv_block(0.0)
            yield from to_messages(frames[np.isin(frames["id"], list(self._listeners))])
        else:
            while (message := self._bus.recv(0.0)) is not None:
                yield message

    def _take(self, message: can.Message | None) -> None:
        if message is None or message.is_error_frame or message.is_remote_frame:
            return
        if (callback := self._listeners.get(message.arbitration_id)) is not None:
            callback(bytes(message.data))

    def _on_heartbeat(self, data: bytes) -> None:
        """Read a heartbeat; one with the wrong length or CRC is ignored."""
        message = self._beat.message
        width = max(8, message.length)
        frame = np.frombuffer(data.ljust(width, b"\0"), dtype=np.uint8).reshape(1, -1)[:, :width].copy()
        crc_fits = "Crc8" not in message.signals or (
            message.crc(frame, message.id + self._number)[0] == frame[0, message.length - 1]
        )
        if len(data) != message.length or not crc_fits:
            return
        raw = {what: int(signal.unpack(frame)[0]) for what, signal in self._beat.signals.items()}
        self.identity = Identity(raw["serial"], raw.get("firmware", 0), raw["coefficient_set"], raw["state"])
        self.boots += raw["state"] == BOOT_UP
