"""Data of a unit on the bus that faults need: its identifiers, its counters and its CRC."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from drivers.errors import ConfigError
from drivers.journal import FrameArray
from drivers.wire import Message, Signal, load_dbc

TWIN_COUNTER = 30_011
"""Lead of the second unit's counter: about half its range, and not a multiple of a slow message's cycle."""
TWIN_DELAY_NS = 700_000
BOOT_UP = 0


class Layout:
    """Reads and forges frames of unit `number` of a gyro family; ConfigError where its DBC lacks what that needs."""

    def __init__(self, dbc: str | Path, number: int) -> None:
        messages = load_dbc(dbc).values()
        self._messages = {message.id + number: message for message in messages}
        carriers = {name: id_ for id_, message in self._messages.items() for name in message.signals}
        for name in ("SampleCounter", "Serial"):
            if name not in carriers:
                raise ConfigError(
                    f"DBC {dbc}: no message has '{name}', which rehearsed faults of a unit need; leave these faults out"
                )
        self._rate_id, self._heartbeat_id = carriers["SampleCounter"], carriers["Serial"]
        heartbeat = self._messages[self._heartbeat_id]
        self._heartbeat = heartbeat.pack(1, dict.fromkeys(heartbeat.signals, 0))

    def listen(self, frames: FrameArray) -> None:
        """Store the payload of the unit's last heartbeat."""
        rows = np.flatnonzero(frames["id"] == self._heartbeat_id)
        if len(rows):
            self._heartbeat = np.ascontiguousarray(frames["data"][rows[-1:]])

    def is_unit(self, frames: FrameArray) -> npt.NDArray[np.bool_]:
        """Mask of the frames (n,) of this unit."""
        mask: npt.NDArray[np.bool_] = np.isin(frames["id"], list(self._messages))
        return mask

    def first_rate(self, frames: FrameArray, from_ns: int) -> int | None:
        """Row of the first rate frame from this time [ns] on."""
        rows = np.flatnonzero((frames["id"] == self._rate_id) & (frames["t_ns"] >= from_ns))
        return int(rows[0]) if len(rows) else None

    def counter(self, frame: FrameArray) -> int:
        """Sample counter of one rate frame (1,)."""
        signal = self._messages[self._rate_id].signals["SampleCounter"]
        return int(signal.unpack(np.ascontiguousarray(frame["data"]))[0])

    def counted_from(self, frames: FrameArray, shift: int) -> FrameArray:
        """The same frames with every counter shifted by `shift` samples, and correct CRCs."""
        frames = frames.copy()
        for identifier, message in self._messages.items():
            rows = np.flatnonzero(frames["id"] == identifier)
            for name in ("SampleCounter", "SlowCounter"):
                if name in message.signals and len(rows):
                    signal = message.signals[name]
                    data = np.ascontiguousarray(frames["data"][rows])
                    raw = (signal.unpack(data).astype(np.int64) + shift) & (1 << signal.length) - 1
                    frames["data"][rows] = _signed(message, identifier, _put(signal, data, raw))
        return frames

    def boot(self, like: Any) -> FrameArray:
        """A boot-up heartbeat (1,) at the time of the frame `like`."""
        message = self._messages[self._heartbeat_id]
        frame: FrameArray = np.array([like], dtype=like.dtype)
        state = _put(message.signals["State"], self._heartbeat, np.array([BOOT_UP]))
        frame["id"], frame["len"], frame["data"] = self._heartbeat_id, message.length, state
        return frame

    def twin(self, frames: FrameArray) -> FrameArray:
        """Frames of a second unit beside these: another counter, serial number and rate, the same identifiers."""
        other = self.counted_from(frames[self.is_unit(frames)], TWIN_COUNTER)
        other["t_ns"] += TWIN_DELAY_NS
        rows = np.flatnonzero(other["id"] == self._heartbeat_id)
        signal = self._messages[self._heartbeat_id].signals["Serial"]
        data = np.ascontiguousarray(other["data"][rows])
        other["data"][rows] = _put(signal, data, signal.unpack(data).astype(np.int64) + 1)
        return other


def _put(signal: Signal, data: npt.NDArray[np.uint8], raw: npt.NDArray[np.int64]) -> npt.NDArray[np.uint8]:
    """Payloads (n, 8) with the raw values (n,) of one signal replaced."""
    order = ">u8" if signal.big_endian else "<u8"
    unused = np.uint64(64 - signal.length)
    mask = np.uint64((1 << signal.length) - 1) << unused >> np.uint64(signal.shift_up)
    words = data.view(order)[:, 0].astype(np.uint64)
    words = words & ~mask | raw.astype(np.uint64) << unused >> np.uint64(signal.shift_up)
    return words.astype(order)[:, None].view(np.uint8)


def _signed(message: Message, identifier: int, data: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    if "Crc8" in message.signals:
        data[:, message.length - 1] = message.crc(data, identifier)
    return data
