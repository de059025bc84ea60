"""How much of a CAN bus the frames of its units take, with as many stuff bits as there can be (ISO 11898-1)."""

from __future__ import annotations

from collections.abc import Iterable

from drivers.wire import Message

_GAP_BITS = 3  # between two frames


def frame_s(message: Message, bitrate: int, data_bitrate: int | None, fd: bool) -> float:
    """Longest time that a frame takes on the bus [s]."""
    data = 8 * message.length
    if not fd and message.length <= 8:
        head = 54 if message.extended else 34
        bits = head + data + (head + data - 1) // 4 + 10 + _GAP_BITS
        return bits / bitrate
    head = 36 if message.extended else 17
    slow = head + (head - 1) // 4 + 9 + _GAP_BITS
    crc, fixed = (21, 7) if message.length > 16 else (17, 6)
    fast = 5 + data + (5 + data) // 4 + 4 + crc + fixed + 1
    return slow / bitrate + fast / (data_bitrate or bitrate)


def load(messages: Iterable[Message], bitrate: int, data_bitrate: int | None = None, fd: bool = False) -> float:
    """Share of the bus that these messages take; those without a cycle time take none."""
    cyclic = [(message, 1e-3 * message.cycle_ms) for message in messages if message.cycle_ms]
    return sum(frame_s(message, bitrate, data_bitrate, fd) / cycle_s for message, cycle_s in cyclic)
