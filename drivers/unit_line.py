"""A line to one unit for requests and answers, without threads: frames are received while a caller waits.

On a simulated station, waiting advances the simulated clock, so that an exchange is deterministic; on a real one it
waits for frames.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import can
import numpy as np

from drivers.clock import Clock, WallClock
from drivers.errors import ConfigError, LinkError
from drivers.frames import to_messages
from drivers.identity import Identity
from drivers.wire import load_dbc

STEP_S = 0.02
"""Interval between polls of the bus [s]; waiting times on a simulated station must be whole multiples of it."""
ANSWER_S = 1.0
"""Timeout of an answer [s]."""
BOOT_UP = 0


class UnitLine:
    """Frames to and from unit `number` of a layout; the caller owns the bus, and nothing else may read from it."""

    def __init__(self, bus: can.BusABC, clock: Clock, layout: str | Path, number: int) -> None:
        self.clock = clock
        self.identity: Identity | None = None
        """Identity in the last heartbeat."""
        self.boots = 0
        """Number of boot-up heartbeats received."""
        self.deadline_s: float | None = None
        """Bench time at which the current operation fails."""
        self._bus, self._number = bus, number
        matches = [m for m in load_dbc(layout).values() if {"Serial", "State", "CoefficientSet"} <= set(m.signals)]
        if len(matches) != 1:
            text = f"{len(matches)} messages with Serial, State and CoefficientSet, must be one"
            raise ConfigError(f"DBC {layout}: {text}")
        self._heartbeat = matches[0]
        self._listeners: dict[int, Callable[[bytes], None]] = {self._heartbeat.id + number: self._on_heartbeat}

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
        message = self._heartbeat
        frame = np.frombuffer(data.ljust(8, b"\0"), dtype=np.uint8).reshape(1, 8).copy()
        crc_fits = "Crc8" not in message.signals or (
            message.crc(frame, message.id + self._number)[0] == frame[0, message.length - 1]
        )
        if len(data) != message.length or not crc_fits:
            return
        raw = {name: int(signal.unpack(frame)[0]) for name, signal in message.signals.items()}
        self.identity = Identity(raw["Serial"], raw.get("Firmware", 0), raw["CoefficientSet"], raw["State"])
        self.boots += raw["State"] == BOOT_UP
