"""Calibration coefficients in a unit: the operations of its memory over any protocol, and the safe way to change it.

`program` checks the serial number, archives the old image, writes to the bank that is not in force, reads it back word
by word, compares the CRC that the unit computes, turns the switch, resets the unit, waits for a heartbeat with the new
set and reads again. Until the switch is turned, the unit keeps its old calibration, whatever fails; the switch is
turned only to an image that the unit has checked. `restore` goes back to the image in the other bank in the same way,
and writes none.
"""

from __future__ import annotations

import struct
import zlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from drivers import flash_objects
from drivers.errors import DriverError, IdentityError, LimitError, LinkError, ReadBackError, RefusedError
from drivers.flash_objects import BANK_BYTES, SIGNATURE, Memory
from drivers.identity import Identity
from drivers.unit_line import UnitLine

BOOT_S = 10.0
"""Longest time from a reset to the first heartbeat [s]."""
BEAT_S = 3.0
"""Longest time between two heartbeats [s]."""
_SERIAL_AT = 16
_LEAST_BYTES = 100
TRANSFER_S = 60.0

LIMITS_S = {
    "serial number": 10.0,
    "archive": TRANSFER_S,
    "write": TRANSFER_S,
    "read back": TRANSFER_S,
    "CRC": 5.0,
    "switch": 10.0,
    "reset": 5.0,
    "heartbeat": BOOT_S + BEAT_S,
    "read again": TRANSFER_S,
}
"""The steps of `program` (`restore` writes and reads back none), and how long each may take [s]."""


class CoefficientStore(ABC):
    """The calibration memory of one unit. All methods raise DriverError subclasses."""

    def __init__(self, line: UnitLine) -> None:
        self.line = line

    @abstractmethod
    def get(self, what: Memory) -> bytes:
        """Read a value."""

    @abstractmethod
    def set(self, what: Memory, data: bytes) -> None:
        """Write a value that is not an image."""

    @abstractmethod
    def put_image(self, bank: int, image: bytes) -> None:
        """Write an image to a bank."""

    @abstractmethod
    def reset(self) -> None:
        """Restart the unit; does not wait for it."""

    def number(self, what: Memory) -> int:
        """A value as a number; ReadBackError when its length differs from the described one."""
        data = self.get(what)
        if len(data) != what.value.size:
            raise ReadBackError(f"{self.line}: {what.name} has {len(data)} bytes, expected {what.value.size}")
        return int.from_bytes(data, "little")

    def active(self) -> int:
        """Bank in force, 0: none."""
        bank = self.number(Memory.ACTIVE)
        if bank not in {0, *flash_objects.BANKS}:
            raise ReadBackError(f"{self.line}: bank in force is {bank}, allowed are {flash_objects.BANKS}")
        return bank

    def read(self, bank: int) -> bytes:
        """Image in a bank; empty for an empty bank."""
        image = self.get(flash_objects.bank(bank))
        return image if len(image) >= _LEAST_BYTES else b""

    def crc(self, bank: int) -> int:
        """CRC-32 that the unit computes over the image in a bank."""
        return self.number(flash_objects.crc(bank))

    def switch(self) -> None:
        """Put the other bank in force from the next reset on; RefusedError when the unit does not accept its image."""
        self.set(Memory.SWITCH, SIGNATURE.to_bytes(4, "little"))

    def compensate(self, on: bool) -> None:
        """Correct the rate, or send it raw until the next reset; read back."""
        self.set(Memory.COMPENSATION, bytes([on]))
        if self.number(Memory.COMPENSATION) != on:
            raise ReadBackError(f"{self.line}: compensation does not switch {'on' if on else 'off'}")

    def heartbeat(self) -> Identity:
        """Identity in the next heartbeat."""
        self.line.identity = None
        self.line.wait(lambda: self.line.identity is not None, BEAT_S, "heartbeat")
        assert self.line.identity is not None
        return self.line.identity


@dataclass
class Programmed:
    """Result of `program`."""

    serial: int
    bank: int = 0
    old_bank: int = 0
    old: bytes = b""
    old_set: int = 0
    new_set: int = 0
    crc: int = 0
    took_s: dict[str, float] = field(default_factory=dict)


def program(
    store: CoefficientStore,
    image: bytes,
    archive: Callable[[bytes], None] = lambda old: None,
    onlooker: Callable[[str], None] = lambda step: None,
) -> Programmed:
    """Write an image to its unit, and put it in force.

    `archive` gets the old image (empty bytes when there is none) before anything is written; an exception from it ends
    the procedure. DriverError, one line, names the step that failed and the resulting state of the unit.
    """
    if len(image) % 4 or not _LEAST_BYTES <= len(image) <= BANK_BYTES:
        raise LimitError(f"image of {len(image)} bytes, a bank takes whole words, {_LEAST_BYTES} to {BANK_BYTES} bytes")
    done = Programmed(struct.unpack_from("<I", image, _SERIAL_AT)[0])
    steps = _Steps(store.line, done, onlooker)
    with steps("serial number"):
        in_memory = store.number(Memory.SERIAL)
        heartbeat = store.heartbeat()
        for origin, serial in (("its memory", in_memory), ("its heartbeat", heartbeat.serial)):
            if serial != done.serial:
                raise IdentityError(f"serial number in {origin} is {serial}, the image is for {done.serial}")
    with steps("archive"):
        done.old_bank, done.old_set = store.active(), heartbeat.coefficient_set
        done.old = store.read(done.old_bank) if done.old_bank else b""
        steps.left = f"the unit is unchanged ({_calibration(done)})"
        archive(done.old)
    done.bank = 2 if done.old_bank == 1 else 1
    with steps("write"):
        store.put_image(done.bank, image)
    with steps("read back"):
        _compare(image, store.read(done.bank))
    _put_in_force(store, done, image, steps)
    return done


def restore(
    store: CoefficientStore,
    archive: Callable[[Programmed, bytes], None],
    onlooker: Callable[[str], None] = lambda step: None,
) -> Programmed:
    """Put the image in the bank that is not in force back in force.

    `archive` gets what is in force and the image in the other bank (empty bytes where there is none) before the switch
    is turned; an exception from it ends the procedure. Errors are those of `program`.
    """
    done = Programmed(0)
    steps = _Steps(store.line, done, onlooker)
    with steps("serial number"):
        done.serial, heartbeat = store.number(Memory.SERIAL), store.heartbeat()
        if heartbeat.serial != done.serial:
            text = f"serial number in its memory is {done.serial}, in its heartbeat it is {heartbeat.serial}"
            raise IdentityError(text)
    with steps("archive"):
        done.old_bank, done.old_set = store.active(), heartbeat.coefficient_set
        done.old = store.read(done.old_bank) if done.old_bank else b""
        done.bank = 2 if done.old_bank == 1 else 1
        previous = store.read(done.bank) if done.old_bank else b""
        steps.left = f"the unit is unchanged ({_calibration(done)})"
        archive(done, previous)
    _put_in_force(store, done, previous, steps)
    return done


def _put_in_force(store: CoefficientStore, done: Programmed, image: bytes, steps: _Steps) -> None:
    """Turn the switch to an image that is in `done.bank`, after the unit's CRC over it, and read it again."""
    with steps("CRC"):
        done.crc = store.crc(done.bank)
        if done.crc != zlib.crc32(image[:-4]):
            raise ReadBackError(f"the unit computes 0x{done.crc:08X}, the image has 0x{zlib.crc32(image[:-4]):08X}")
    steps.left = f"{_calibration(done)} or the new one is in force, both are complete; flash again"
    with steps("switch"):
        store.switch()
    steps.left = "the new calibration is stored and checked; switch the unit off and on, then flash again to verify"
    with steps("reset"):
        boots = store.line.boots
        store.reset()
    with steps("heartbeat"):
        done.new_set = _started(store, done, boots)
    with steps("read again"):
        if (active := store.active()) != done.bank:
            raise ReadBackError(f"bank {active} is in force, the switch was turned to bank {done.bank}")
        _compare(image, store.read(done.bank))


def _started(store: CoefficientStore, done: Programmed, boots: int) -> int:
    """Coefficient set in the heartbeat after the reset."""
    line = store.line
    line.wait(lambda: line.boots > boots, BOOT_S, "boot-up heartbeat after the reset")
    heartbeat = store.heartbeat()
    if heartbeat.serial != done.serial:
        raise IdentityError(f"serial number is {heartbeat.serial} after the reset, before it was {done.serial}")
    if heartbeat.coefficient_set in {0, done.old_set}:
        raise ReadBackError(f"coefficient set is {heartbeat.coefficient_set} after the switch, expected a new one")
    return heartbeat.coefficient_set


def _compare(written: bytes, read: bytes) -> None:
    """Compare word by word; ReadBackError names the first difference."""
    if len(read) != len(written):
        raise ReadBackError(f"{len(read) // 4} words read back, {len(written) // 4} were written")
    pairs = zip(struct.iter_unpack("<I", written), struct.iter_unpack("<I", read), strict=True)
    for number, ((one,), (other,)) in enumerate(pairs):
        if one != other:
            raise ReadBackError(f"word {number} reads back 0x{other:08X}, 0x{one:08X} was written")


def _calibration(done: Programmed) -> str:
    return f"the calibration in bank {done.old_bank}" if done.old_bank else "no calibration"


class _Steps:
    """Time limits, and errors that name the step and the resulting state of the unit."""

    def __init__(self, line: UnitLine, done: Programmed, onlooker: Callable[[str], None]) -> None:
        self.left = "nothing was written"
        self._line, self._done, self._onlooker = line, done, onlooker

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        self._onlooker(name)
        started_s = self._line.clock.now()
        self._line.deadline_s = started_s + LIMITS_S[name]
        try:
            yield
        except DriverError as error:
            raise _named(error, f"step '{name}' failed: {error}; {self.left}") from error
        finally:
            self._line.deadline_s = None
            self._done.took_s[name] = round(self._line.clock.now() - started_s, 3)


def _named(error: DriverError, text: str) -> DriverError:
    if isinstance(error, RefusedError):
        return RefusedError(text, error.code)
    kinds = (IdentityError, ReadBackError, LinkError, LimitError)
    return next((kind(text) for kind in kinds if isinstance(error, kind)), DriverError(text))
