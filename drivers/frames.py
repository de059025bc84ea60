"""Conversion between python-can messages and FRAME records."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator, Sequence
from functools import lru_cache

import can
import numpy as np

from drivers.can_record import CLASSICAL_BYTES
from drivers.can_record import records as packed_records
from drivers.journal import FLAG_ERROR, FLAG_EXTENDED, FLAG_FAST, FLAG_FD, FLAG_REMOTE, FRAME, FrameArray

NO_FRAMES: FrameArray = np.zeros(0, dtype=FRAME)
NO_FRAMES.flags.writeable = False


@lru_cache(maxsize=8)
def _record(room: int) -> struct.Struct:
    return struct.Struct(f"<qIBBBB{room}s")


def to_record(message: can.Message, t_ns: int, channel: int = 0, room: int = CLASSICAL_BYTES) -> bytes:
    """One record with `room` bytes for data, received at `t_ns` [ns]; ValueError for one that has more or was cut."""
    if message.dlc > room:
        text = f"{message.dlc} bytes, classical CAN has {room}; state `fd: true` for its bus"
        raise ValueError(f"CAN FD frame 0x{message.arbitration_id:X}: {text}")
    data = bytes(message.data)
    if len(data) < message.dlc and not (message.is_remote_frame or message.is_error_frame):
        raise ValueError(f"frame 0x{message.arbitration_id:X} has {len(data)} of {message.dlc} bytes")
    flags = (
        FLAG_EXTENDED * message.is_extended_id
        | FLAG_REMOTE * message.is_remote_frame
        | FLAG_ERROR * message.is_error_frame
        | FLAG_FD * message.is_fd
        | FLAG_FAST * message.bitrate_switch
    )
    return _record(room).pack(t_ns, message.arbitration_id, flags, message.dlc, channel, 0, data)


def to_frames(records: Iterable[bytes]) -> FrameArray:
    """Records (n,) made by `to_record`, all with the same room; read-only."""
    whole = list(records)
    return packed_records(b"".join(whole), len(whole))


def joined(blocks: Sequence[FrameArray]) -> FrameArray:
    """All records of several blocks (n,), in order; joined as bytes, ten times faster than named fields.

    They have room for the data of the longest.
    """
    blocks = [block for block in blocks if len(block)] or blocks[:1]
    if len(blocks) == 1:
        return blocks[0]
    kind = max((block.dtype for block in blocks), key=lambda kind: kind.itemsize)
    alike = [block if block.dtype.itemsize == kind.itemsize else _wider(block, kind) for block in blocks]
    whole: FrameArray = np.concatenate([np.ascontiguousarray(block).view(np.uint8) for block in alike]).view(kind)
    return whole


def _wider(frames: FrameArray, kind: np.dtype[np.void]) -> FrameArray:
    """The same records with more room."""
    wide: FrameArray = np.zeros(len(frames), dtype=kind)
    rows = wide.view(np.uint8).reshape(len(frames), kind.itemsize)
    rows[:, : frames.dtype.itemsize] = np.ascontiguousarray(frames).view(np.uint8).reshape(len(frames), -1)
    return wide


def to_messages(frames: FrameArray, channel: str | None = None) -> Iterator[can.Message]:
    """python-can messages of FRAME records; `Message.timestamp` is `t_ns` in seconds."""
    payloads, room = frames["data"].tobytes(), frames.dtype["data"].itemsize
    heads = zip(*(frames[name].tolist() for name in ("t_ns", "id", "flags", "len")), strict=True)
    for row, (t_ns, identifier, flags, length) in enumerate(heads):
        yield can.Message(
            timestamp=t_ns * 1e-9,
            arbitration_id=identifier,
            is_extended_id=bool(flags & FLAG_EXTENDED),
            is_remote_frame=bool(flags & FLAG_REMOTE),
            is_error_frame=bool(flags & FLAG_ERROR),
            channel=channel,
            is_fd=bool(flags & FLAG_FD),
            bitrate_switch=bool(flags & FLAG_FAST),
            dlc=length,
            data=None if flags & FLAG_REMOTE else payloads[room * row : room * row + length],
        )
