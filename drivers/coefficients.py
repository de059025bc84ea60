"""Calibration coefficients in a unit: the operations of its memory over any protocol, and the safe way to change it.

`program` checks the serial number, archives the old image, writes to the bank that is not in force, reads it back word
by word, compares the CRC that the unit computes, turns the switch, resets the unit, waits for a heartbeat with the new
set and reads again. Until the switch is turned, the unit keeps its old calibration, whatever fails; the switch is
turned only to an image that the unit has checked. `restore` goes back to the image in the other bank in the same way,
and writes none.
"""

from __future__ import annotations

import zlib
from abc import abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from drivers import flash_objects
from drivers.errors import DriverError, IdentityError, LimitError, ReadBackError
from drivers.flash_objects import BANK_BYTES, SIGNATURE, Memory
from drivers.identity import Identity
from drivers.unit_line import UnitLine
from drivers.unit_memory import LEAST_BYTES, Held, Onlooker, Programmed, UnitMemory, compare, named, serial_of

BOOT_S = 10.0
"""Longest time from a reset to the first heartbeat [s]."""
BEAT_S = 3.0
"""Longest time between two heartbeats [s]."""
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


class CoefficientStore(UnitMemory):
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
        return image if len(image) >= LEAST_BYTES else b""

    def crc(self, bank: int) -> int:
        """CRC-32 that the unit computes over the image in a bank."""
        return self.number(flash_objects.crc(bank))

    def switch(self) -> None:
        """Put the other bank in force from the next reset on; RefusedError when the unit does not accept its image."""
        self.set(Memory.SWITCH, SIGNATURE.to_bytes(4, "little"))

    def held(self) -> Held:
        """What is in force."""
        bank = self.active()
        return Held(self.read(bank) if bank else b"", bank, self.number(Memory.SET))

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

    def program(
        self,
        image: bytes,
        archive: Callable[[bytes], None] = lambda old: None,
        onlooker: Onlooker = lambda step: None,
    ) -> Programmed:
        """See UnitMemory."""
        if len(image) % 4 or not LEAST_BYTES <= len(image) <= BANK_BYTES:
            text = f"a bank takes whole words, {LEAST_BYTES} to {BANK_BYTES} bytes"
            raise LimitError(f"image of {len(image)} bytes, {text}")
        done = Programmed(serial_of(image))
        steps = _Steps(self.line, done, onlooker)
        with steps("serial number"):
            in_memory = self.number(Memory.SERIAL)
            heartbeat = self.heartbeat()
            for origin, serial in (("its memory", in_memory), ("its heartbeat", heartbeat.serial)):
                if serial != done.serial:
                    raise IdentityError(f"serial number in {origin} is {serial}, the image is for {done.serial}")
        with steps("archive"):
            self._look(done, heartbeat)
            steps.left = f"the unit is unchanged ({_calibration(done)})"
            archive(done.old)
        with steps("write"):
            self.put_image(done.bank, image)
        with steps("read back"):
            compare(image, self.read(done.bank))
        _put_in_force(self, done, image, steps)
        return done

    def restore(
        self,
        archive: Callable[[Programmed, bytes], None],
        onlooker: Onlooker = lambda step: None,
    ) -> Programmed:
        """Put the image in the bank that is not in force back in force.

        `archive` gets what is in force and the image in the other bank (empty bytes where there is none) before the
        switch is turned; an exception from it ends the procedure. Errors are those of `program`.
        """
        done = Programmed(0)
        steps = _Steps(self.line, done, onlooker)
        with steps("serial number"):
            done.serial, heartbeat = self.number(Memory.SERIAL), self.heartbeat()
            if heartbeat.serial != done.serial:
                text = f"serial number in its memory is {done.serial}, in its heartbeat it is {heartbeat.serial}"
                raise IdentityError(text)
        with steps("archive"):
            self._look(done, heartbeat)
            previous = self.read(done.bank) if done.old_bank else b""
            steps.left = f"the unit is unchanged ({_calibration(done)})"
            archive(done, previous)
        _put_in_force(self, done, previous, steps)
        return done

    def _look(self, done: Programmed, heartbeat: Identity) -> None:
        """What is in force, and the bank that is not."""
        done.old_bank, done.old_set = self.active(), heartbeat.coefficient_set or 0
        done.old = self.read(done.old_bank) if done.old_bank else b""
        done.bank = 2 if done.old_bank == 1 else 1


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
        compare(image, store.read(done.bank))


def _started(store: CoefficientStore, done: Programmed, boots: int) -> int:
    """Coefficient set in the heartbeat after the reset."""
    line = store.line
    line.wait(lambda: line.boots > boots, BOOT_S, "boot-up heartbeat after the reset")
    heartbeat = store.heartbeat()
    if heartbeat.serial != done.serial:
        raise IdentityError(f"serial number is {heartbeat.serial} after the reset, before it was {done.serial}")
    number = heartbeat.coefficient_set or 0
    if number in {0, done.old_set}:
        raise ReadBackError(f"coefficient set is {number} after the switch, expected a new one")
    return number


def _calibration(done: Programmed) -> str:
    return f"the calibration in bank {done.old_bank}" if done.old_bank else "no calibration"


class _Steps:
    """Time limits, and errors that name the step and the resulting state of the unit."""

    def __init__(self, line: UnitLine, done: Programmed, onlooker: Onlooker) -> None:
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
            raise named(error, f"step '{name}' failed: {error}; {self.left}") from error
        finally:
            self._line.deadline_s = None
            self._done.took_s[name] = round(self._line.clock.now() - started_s, 3)
