"""SDO server of a simulated gyro (CiA 301, 7.2.4.3): expedited and segmented, no block transfer; one frame at a time.

Segments of an image are written to the EEPROM as they arrive.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from drivers.flash_objects import Memory, word_place
from drivers.sim.memory import CalibrationMemory, NotAllowedError

_TOGGLE, _COMMAND, _NO_OBJECT = 0x05030000, 0x05040001, 0x06020000
_LENGTH = 0x06070010
_REFUSALS = {
    NotAllowedError.READ_ONLY: 0x06010002,
    NotAllowedError.STATE: 0x08000022,
    NotAllowedError.VALUE: 0x06090030,
}
_PLACES = {(entry.value.index, entry.value.sub): entry for entry in Memory}
_BANKS = {Memory.BANK_1: 1, Memory.BANK_2: 2}


class _AbortError(Exception):
    def __init__(self, code: int) -> None:
        super().__init__(hex(code))
        self.code = code


@dataclass
class _Transfer:
    place: tuple[int, int]
    data: bytes = b""
    at: int = 0
    toggle: int = 0
    bank: int = 0


class SdoServer:
    """Answers requests to one memory."""

    def __init__(self, memory: CalibrationMemory) -> None:
        self._memory = memory
        self._download: _Transfer | None = None
        self._upload: _Transfer | None = None

    def answer(self, request: bytes) -> bytes | None:
        """The answer to a request; None for a request without an answer."""
        if len(request) != 8 or request[0] >> 5 == 4:
            self._download = self._upload = None
            return None
        place = struct.unpack_from("<HB", request, 1)
        actions = {0: self._segment, 1: self._initiate, 2: self._begin_upload, 3: self._next_upload}
        try:
            if (action := actions.get(request[0] >> 5)) is None:
                raise _AbortError(_COMMAND)
            return action(request).ljust(8, b"\0")
        except NotAllowedError as error:
            code = _REFUSALS[error.why]
        except _AbortError as error:
            code = error.code
        self._download = self._upload = None
        return struct.pack("<BHBI", 0x80, *place, code)

    def _initiate(self, request: bytes) -> bytes:
        """Start a download: the value itself, or the announcement of segments."""
        place = struct.unpack_from("<HB", request, 1)
        index, sub = place
        if request[0] & 2:
            size = 4 - (request[0] >> 2 & 3) if request[0] & 1 else 4
            self._store(index, sub, request[4 : 4 + size])
        else:
            what = _PLACES.get((index, sub))
            self._download = _Transfer(place, bank=_BANKS.get(what, 0) if what else 0)
            if what is None:
                raise _AbortError(_NO_OBJECT)
            if self._download.bank:
                self._memory.begin(self._download.bank)
        return struct.pack("<BHB", 0x60, index, sub)

    def _segment(self, request: bytes) -> bytes:
        transfer = self._download
        if transfer is None:
            raise _AbortError(_COMMAND)
        if request[0] >> 4 & 1 != transfer.toggle:
            raise _AbortError(_TOGGLE)
        data = request[1 : 8 - (request[0] >> 1 & 7)]
        if transfer.bank:
            self._memory.put(transfer.bank, transfer.at, data)
        else:
            transfer.data += data
        transfer.at += len(data)
        answer = bytes([0x20 | transfer.toggle << 4])
        transfer.toggle ^= 1
        if request[0] & 1:
            self._download = None
            if not transfer.bank:
                self._store(*transfer.place, transfer.data)
        return answer

    def _store(self, index: int, sub: int, data: bytes) -> None:
        if (word := word_place(index, sub)) is not None:
            if len(data) != 4:
                raise _AbortError(_LENGTH)
            if word[1] == 0:
                self._memory.begin(word[0])
            self._memory.put(word[0], 4 * word[1], data)
            return
        what = _PLACES.get((index, sub))
        if what is None:
            raise _AbortError(_NO_OBJECT)
        if what in _BANKS or len(data) != what.value.size:
            raise _AbortError(_LENGTH)
        self._memory.set(what, data)

    def _begin_upload(self, request: bytes) -> bytes:
        place = struct.unpack_from("<HB", request, 1)
        index, sub = place
        data = self._load(index, sub)
        if len(data) <= 4:
            return struct.pack("<BHB", 0x43 | (4 - len(data)) << 2, index, sub) + data
        self._upload = _Transfer(place, data)
        return struct.pack("<BHBI", 0x41, index, sub, len(data))

    def _load(self, index: int, sub: int) -> bytes:
        if (word := word_place(index, sub)) is not None:
            image = self._memory.eeprom.image(word[0])
            return image[4 * word[1] :][:4] or b"\xff\xff\xff\xff"
        what = _PLACES.get((index, sub))
        if what is None:
            raise _AbortError(_NO_OBJECT)
        return self._memory.get(what)

    def _next_upload(self, request: bytes) -> bytes:
        transfer = self._upload
        if transfer is None:
            raise _AbortError(_COMMAND)
        if request[0] >> 4 & 1 != transfer.toggle:
            raise _AbortError(_TOGGLE)
        part = transfer.data[transfer.at : transfer.at + 7]
        transfer.at += len(part)
        last = transfer.at >= len(transfer.data)
        answer = bytes([transfer.toggle << 4 | (7 - len(part)) << 1 | last]) + part
        transfer.toggle ^= 1
        if last:
            self._upload = None
        return answer
