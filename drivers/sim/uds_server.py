"""UDS server (ISO 14229-1) of a simulated gyro over ISO-TP (ISO 15765-2), normal addressing, one frame at a time.

Services: session control, read and write data by identifier, ECU reset, tester present. An image is written when its
message is complete, page by page.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator

from drivers.flash_objects import BANK_BYTES, Memory
from drivers.sim.memory import CalibrationMemory, NotAllowedError

SESSION, RESET, READ, WRITE, PRESENT = 0x10, 0x11, 0x22, 0x2E, 0x3E
_NOT_SUPPORTED, _LENGTH, _CONDITIONS, _RANGE = 0x11, 0x13, 0x22, 0x31
_REFUSALS = {
    NotAllowedError.READ_ONLY: _RANGE,
    NotAllowedError.STATE: _CONDITIONS,
    NotAllowedError.VALUE: _RANGE,
}
_DIDS = {entry.value.did: entry for entry in Memory}
_BANKS = {Memory.BANK_1: 1, Memory.BANK_2: 2}
_PAGE = 32


class UdsServer:
    """Answers requests to one memory; an ECU reset sets `reset_asked`, the caller performs it."""

    def __init__(self, memory: CalibrationMemory) -> None:
        self.reset_asked = False
        self._memory = memory
        self._got, self._size, self._next = b"", 0, 0
        self._waiting = b""

    def answer(self, frame: bytes) -> Iterator[bytes]:
        """Frames that follow one frame of the tester."""
        kind = frame[0] >> 4 if frame else -1
        if kind == 0:
            yield from self._send(self._serve(frame[1 : 1 + (frame[0] & 15)]))
        elif kind == 1:
            self._size, self._got, self._next = int.from_bytes(frame[:2], "big") & 0xFFF, frame[2:8], 1
            yield b"\x30\0\0"
        elif kind == 2:
            yield from self._consecutive(frame)
        elif kind == 3 and self._waiting:
            waiting, self._waiting = self._waiting, b""
            for number, at in enumerate(range(0, len(waiting), 7), 1):
                yield bytes([0x20 | number & 15]) + waiting[at : at + 7]

    def _consecutive(self, frame: bytes) -> Iterator[bytes]:
        if not self._size or frame[0] & 15 != self._next & 15:
            self._size = 0  # a frame is missing: the whole message is dropped
            return
        self._next += 1
        self._got += frame[1:]
        if len(self._got) >= self._size:
            message, self._size = self._got[: self._size], 0
            yield from self._send(self._serve(message))

    def _send(self, message: bytes) -> Iterator[bytes]:
        if not message:
            return
        if len(message) <= 7:
            yield bytes([len(message)]) + message
            return
        self._waiting = message[6:]
        yield (0x1000 | len(message)).to_bytes(2, "big") + message[:6]

    def _serve(self, request: bytes) -> bytes:
        if not request:
            return b""
        service = request[0]
        try:
            code, positive = self._positive(service, request)
        except NotAllowedError as error:
            code, positive = _REFUSALS[error.why], b""
        return positive if not code else bytes([0x7F, service, code])

    def _positive(self, service: int, request: bytes) -> tuple[int, bytes]:
        """(0, positive answer) or (code of the negative answer, nothing)."""
        if service in {SESSION, PRESENT, RESET} and len(request) == 2:
            self.reset_asked = service == RESET
            times = struct.pack(">HH", 50, 500) if service == SESSION else b""
            return 0, bytes([service | 0x40, request[1]]) + times
        if service not in {READ, WRITE}:
            return _NOT_SUPPORTED, b""
        if len(request) < 3:
            return _LENGTH, b""
        what = _DIDS.get(int.from_bytes(request[1:3], "big"))
        if what is None:
            return _RANGE, b""
        if service == READ:
            return 0, b"\x62" + request[1:3] + self._memory.get(what)
        return self._write(what, request[3:]), b"\x6e" + request[1:3]

    def _write(self, what: Memory, data: bytes) -> int:
        bank = _BANKS.get(what)
        if bank is None:
            if len(data) != what.value.size:
                return _LENGTH
            self._memory.set(what, data)
            return 0
        if len(data) > BANK_BYTES:
            return _LENGTH
        self._memory.begin(bank)
        for at in range(0, len(data), _PAGE):
            self._memory.put(bank, at, data[at : at + _PAGE])
        return 0
