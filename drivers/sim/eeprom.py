"""The EEPROM of a simulated gyro: two banks and a switch, in a file that outlives the process, or in memory.

The switch is a counter with its complement, stored in two words that are written in turn: after a write that a power
cut interrupts, the previous one is still valid. The file is written byte by byte and in place, so that a killed bench
leaves the same content as a real unit.
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

from drivers.flash_objects import BANK_BYTES, BANKS

_FIRST_BANK = 16
SIZE = _FIRST_BANK + len(BANKS) * BANK_BYTES
_WORD = struct.Struct("<I")
_LENGTH_AT, _LEAST_WORDS = 12, 25
BLANK = b"\xff\xff\xff\xff"


class PowerLostError(Exception):
    """The unit lost power during a write."""


class Eeprom:
    """Non-volatile bytes. `writable` is how many more can be written before the power fails; None: any number."""

    def __init__(self, path: Path | None = None) -> None:
        self.writable: int | None = None
        self._path = path
        self._bytes = bytearray(b"\xff" * SIZE)
        if path is not None and path.exists():
            stored = path.read_bytes()[:SIZE]
            self._bytes[: len(stored)] = stored

    def image(self, bank: int) -> bytes:
        """Image in a bank, with the length in its header; one blank word when that length is invalid."""
        start = self._start(bank)
        words = _WORD.unpack_from(self._bytes, start + _LENGTH_AT)[0]
        if not _LEAST_WORDS <= words <= BANK_BYTES // 4:
            return BLANK
        return bytes(self._bytes[start : start + 4 * words])

    def crc(self, bank: int) -> int:
        """CRC-32 over the image in a bank without its last word, 0 for an empty bank."""
        image = self.image(bank)
        return zlib.crc32(image[:-4]) if len(image) > 4 else 0

    def erase(self, bank: int) -> None:
        """Erase a bank, its length first."""
        start = self._start(bank)
        self._write(start + _LENGTH_AT, BLANK)
        self._write(start, b"\xff" * _LENGTH_AT)
        self._write(start + 16, b"\xff" * (BANK_BYTES - 16))

    def put(self, bank: int, at: int, data: bytes) -> None:
        """Write bytes of a bank; ValueError when they do not fit."""
        if at < 0 or at + len(data) > BANK_BYTES:
            raise ValueError(f"bytes {at} to {at + len(data)} of a bank of {BANK_BYTES}")
        self._write(self._start(bank) + at, data)

    @property
    def switch(self) -> tuple[int, int]:
        """(number of turns of the switch, bank that it names); (0, 0) before the first turn."""
        values = [value for slot in (0, 1) if (value := self._slot(slot)) is not None]
        if not values:
            return 0, 0
        newest = values[0]
        if len(values) == 2 and (values[1] - values[0]) & 0xFFFF < 0x8000:
            newest = values[1]
        return newest >> 1, 1 + (newest & 1)

    def turn(self, bank: int) -> None:
        """Make the switch name a bank."""
        turned = (self.switch[0] + 1) & 0x7FFF
        value = turned << 1 | (bank - 1)
        self._write(4 * (turned & 1), _WORD.pack(value | (~value & 0xFFFF) << 16))

    def _slot(self, slot: int) -> int | None:
        word = int(_WORD.unpack_from(self._bytes, 4 * slot)[0])
        return word & 0xFFFF if (word ^ word >> 16) & 0xFFFF == 0xFFFF else None

    def _start(self, bank: int) -> int:
        if bank not in BANKS:
            raise ValueError(f"bank {bank}")
        return _FIRST_BANK + (bank - 1) * BANK_BYTES

    def _write(self, at: int, data: bytes) -> None:
        kept = data if self.writable is None else data[: self.writable]
        self._bytes[at : at + len(kept)] = kept
        if self._path is not None:
            if not self._path.exists():
                self._path.parent.mkdir(parents=True, exist_ok=True)
                self._path.write_bytes(b"\xff" * SIZE)
            with self._path.open("r+b", buffering=0) as file:
                file.seek(at)
                file.write(kept)
        if self.writable is not None:
            self.writable -= len(kept)
            if len(kept) < len(data):
                raise PowerLostError(f"power lost at byte {at + len(kept)}")
