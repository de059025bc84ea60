"""What holds the calibration of a unit, over whatever protocol: the operations that the bench needs of it."""

from __future__ import annotations

import struct
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field

from drivers.errors import ConfigError, DriverError, IdentityError, LimitError, LinkError, ReadBackError, RefusedError

SERIAL_AT = 16
"""Place of the serial number in an image [bytes]."""
LEAST_BYTES = 100
"""Of an image."""

Onlooker = Callable[[str], None]
"""Hears of each step as it begins."""


@dataclass(frozen=True)
class Held:
    """What is in force in a unit."""

    image: bytes
    """Empty: no calibration."""
    bank: int | None = None
    """None where the memory has no banks."""
    number: int | None = None
    """Coefficient set; None where the unit does not count."""


@dataclass
class Programmed:
    """What a change to a unit's memory did; banks and sets are 0 where the memory has none."""

    serial: int
    bank: int = 0
    old_bank: int = 0
    old: bytes = b""
    old_set: int = 0
    new_set: int = 0
    crc: int = 0
    took_s: dict[str, float] = field(default_factory=dict)


class UnitMemory(ABC):
    """The calibration memory of one unit. All methods raise DriverError subclasses."""

    @abstractmethod
    def held(self) -> Held:
        """What is in force."""

    @abstractmethod
    def compensate(self, on: bool) -> None:
        """Correct the rate, or send it raw until the next reset."""

    @abstractmethod
    def program(
        self,
        image: bytes,
        archive: Callable[[bytes], None] = lambda old: None,
        onlooker: Onlooker = lambda step: None,
    ) -> Programmed:
        """Write an image to its unit, put it in force and read it back.

        `archive` gets the old image (empty bytes when there is none) before anything is written; an exception from it
        ends the procedure. DriverError, one line, names the step that failed and the resulting state of the unit.
        """


def serial_of(image: bytes) -> int:
    """The serial number that an image is for."""
    return int(struct.unpack_from("<I", image, SERIAL_AT)[0])


def compare(written: bytes, read: bytes) -> None:
    """Compare word by word; ReadBackError names the first difference."""
    if len(read) != len(written):
        raise ReadBackError(f"{len(read)} bytes read back, {len(written)} were written")
    pairs = zip(struct.iter_unpack("<I", written), struct.iter_unpack("<I", read), strict=True)
    for number, ((one,), (other,)) in enumerate(pairs):
        if one != other:
            raise ReadBackError(f"word {number} reads back 0x{other:08X}, 0x{one:08X} was written")


def named(error: DriverError, text: str) -> DriverError:
    """An error of the same kind with another text."""
    if isinstance(error, RefusedError):
        return RefusedError(text, error.code)
    kinds = (ConfigError, IdentityError, ReadBackError, LinkError, LimitError)
    return next((kind(text) for kind in kinds if isinstance(error, kind)), DriverError(text))
