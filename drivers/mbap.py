"""Modbus TCP on an open socket: one request, one answer, and every byte of it accounted for.

The frames of "MODBUS Messaging on TCP/IP Implementation Guide V1.0b": transaction, protocol 0, length, device, then the
PDU. A chamber is polled all day; this costs a third of what a general client does.
"""

from __future__ import annotations

import socket
import struct
import time
from collections.abc import Sequence
from dataclasses import dataclass

from drivers.errors import LinkError

_HEAD, _REQUEST, _PAIR = struct.Struct(">HHHB"), struct.Struct(">BHH"), struct.Struct(">HH")
_MOST_BYTES = 260


@dataclass(frozen=True, slots=True)
class Answer:
    """What a device answered; only what its function code carries is set."""

    function_code: int
    exception_code: int = 0
    address: int = 0
    count: int = 0
    registers: Sequence[int] = ()


def request(code: int, address: int, count: int, words: Sequence[int]) -> bytes:
    """PDU of a request with function code 3, 4, 6 or 16."""
    if code == 16:
        return struct.pack(f">BHHB{count}H", code, address, count, 2 * count, *words)
    return _REQUEST.pack(code, address, words[0] if code == 6 else count)


def ask(line: socket.socket, number: int, device: int, pdu: bytes, timeout_s: float) -> Answer:
    """Send request `number` (0 to 65535) and return its answer; LinkError or OSError when none came that is sound."""
    line.settimeout(timeout_s)
    line.sendall(_HEAD.pack(number, 0, len(pdu) + 1, device) + pdu)
    until_s = time.monotonic() + timeout_s
    data = line.recv(_MOST_BYTES)
    while len(data) < 6 or len(data) < 6 + int.from_bytes(data[4:6], "big"):
        left_s = until_s - time.monotonic()
        if not data or left_s <= 0:
            raise LinkError(f"no valid answer: {len(data)} bytes")
        line.settimeout(left_s)
        if not (more := line.recv(_MOST_BYTES)):
            raise LinkError(f"no valid answer: connection closed after {len(data)} bytes")
        data += more
    head = _HEAD.unpack_from(data) if len(data) > _HEAD.size else ()
    if head != (number, 0, len(data) - 6, device):
        raise LinkError(f"no valid answer: head {data[: _HEAD.size].hex(' ')} to request {number} of device {device}")
    return _read(data[_HEAD.size :])


def _read(pdu: bytes) -> Answer:
    code, rest = pdu[0], pdu[1:]
    if code & 0x80 and len(rest) == 1:
        return Answer(code, exception_code=rest[0])
    if code in (3, 4) and rest and len(rest) == 1 + rest[0] and rest[0] % 2 == 0:
        return Answer(code, registers=struct.unpack(f">{rest[0] // 2}H", rest[1:]))
    if code == 6 and len(rest) == 4:
        address, value = _PAIR.unpack(rest)
        return Answer(code, address=address, registers=(value,))
    if code == 16 and len(rest) == 4:
        address, count = _PAIR.unpack(rest)
        return Answer(code, address=address, count=count)
    raise LinkError(f"no valid answer: {pdu.hex(' ')}")
