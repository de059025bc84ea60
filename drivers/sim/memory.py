"""The calibration memory of a simulated gyro behind its protocols, and the correction by its image.

The bank in force is chosen at boot: the one that the switch names, or the other one when the unit does not accept it;
a unit that accepts neither sends its raw rate.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from drivers.flash_objects import BANK_BYTES, BANKS, SIGNATURE, Memory
from drivers.sim.correction import Correction, IntArray, RefusedImageError
from drivers.sim.eeprom import BLANK, Eeprom
from drivers.sim.imu_correction import MAGIC, ImuCorrection
from drivers.sim.resonator import DIVIDER, Signals

OUTSIDE, REFUSED = 1, 2
"""Status of the rate message: outside the validity of the calibration; an image is stored that is not accepted."""
_COUNTS = {"temperature": (1, 1e6), "frequency": (2, 1e5), "drive": (3, 1e8), "quadrature": (4, 1e8)}
_SUPPLY = 5, 1e8


class NotAllowedError(Exception):
    """The unit refuses a write; `why` is one of `READ_ONLY`, `STATE` or `VALUE`."""

    READ_ONLY, STATE, VALUE = range(3)

    def __init__(self, why: int) -> None:
        super().__init__(("read-only", "not in this state", "value not allowed")[why])
        self.why = why


class CalibrationMemory:
    """Memory of the unit with a serial number; `boot` after power-on and reset."""

    def __init__(self, eeprom: Eeprom, serial: int) -> None:
        self.eeprom, self.serial = eeprom, serial
        self.active = 0
        self.compensates = False
        self.status = 0
        self._correction: Correction | ImuCorrection | None = None
        self.boot()

    def boot(self) -> None:
        """Load the image in force; compensation is on if there is one."""
        named = self.eeprom.switch[1]
        self._correction, self.active = None, 0
        for bank in (named, *(b for b in BANKS if b != named)) if named else ():
            try:
                self._correction = self._read(bank)
            except RefusedImageError:
                continue
            self.active = bank
            break
        self.compensates = self.active != 0
        stored = any(self.eeprom.image(bank) != BLANK for bank in BANKS)
        self.status = REFUSED if stored and named and not self.active else 0

    @property
    def coefficient_set(self) -> int:
        """Number of the calibration that corrects the rate now, 0: the rate is raw."""
        return self.number if self.compensates else 0

    @property
    def number(self) -> int:
        """Number of the calibration in force, 1 to 255; 0: no calibration is in force."""
        return 0 if not self.active else 1 + (self.eeprom.switch[0] - 1) % 255

    def get(self, what: Memory) -> bytes:
        """Bytes of a value."""
        if what in {Memory.BANK_1, Memory.BANK_2}:
            return self.eeprom.image(what.value.sub)
        if what in {Memory.CRC_1, Memory.CRC_2}:
            return self.eeprom.crc(what.value.sub).to_bytes(4, "little")
        numbers = {
            Memory.SERIAL: self.serial,
            Memory.ACTIVE: self.active,
            Memory.SET: self.number,
            Memory.COMPENSATION: int(self.compensates),
            Memory.SWITCH: 1,
        }
        return numbers[what].to_bytes(what.value.size, "little")

    def set(self, what: Memory, data: bytes) -> None:
        """Write a value that is not an image; NotAllowedError."""
        value = int.from_bytes(data, "little")
        if what is Memory.COMPENSATION:
            if value > 1 or len(data) != 1:
                raise NotAllowedError(NotAllowedError.VALUE)
            if value and not self.active:
                raise NotAllowedError(NotAllowedError.STATE)
            self.compensates = bool(value)
        elif what is Memory.SWITCH:
            self._turn(value)
        else:
            raise NotAllowedError(NotAllowedError.READ_ONLY)

    def begin(self, bank: int) -> None:
        """Erase a bank before a new image. NotAllowedError for the bank in force."""
        if bank == self.active or (not self.active and bank == self.eeprom.switch[1]):
            raise NotAllowedError(NotAllowedError.STATE)
        self.eeprom.erase(bank)

    def put(self, bank: int, at: int, data: bytes) -> None:
        """Write a part of an image; NotAllowedError for the bank in force, or beyond the end of the bank."""
        if bank == self.active or at + len(data) > BANK_BYTES:
            raise NotAllowedError(NotAllowedError.STATE)
        self.eeprom.put(bank, at, data)

    def _turn(self, signature: int) -> None:
        bank = 3 - (self.active or self.eeprom.switch[1] or 2)
        if signature != SIGNATURE:
            raise NotAllowedError(NotAllowedError.VALUE)
        try:
            self._read(bank)
        except RefusedImageError:
            raise NotAllowedError(NotAllowedError.STATE) from None
        self.eeprom.turn(bank)

    def _read(self, bank: int) -> Correction | ImuCorrection:
        image = self.eeprom.image(bank)
        kind = ImuCorrection if image[:4] == MAGIC.to_bytes(4, "little") else Correction
        return kind.read(image, self.serial, BANK_BYTES // 4)

    def correct(self, signals: Any) -> tuple[Any, int]:
        """Signals of a gyro, or channels of an inertial unit, that are sent for a piece of time; and the status.

        An image of the other kind of unit corrects nothing.
        """
        if not self.compensates or self._correction is None:
            return signals, self.status
        if isinstance(self._correction, ImuCorrection):
            if not isinstance(signals, Mapping):
                return signals, REFUSED
            sent, flags = self._correction.apply(signals)
            return sent, OUTSIDE if flags else 0
        return self._of_gyro(signals, self._correction) if isinstance(signals, Signals) else (signals, REFUSED)

    def _of_gyro(self, signals: Signals, correction: Correction) -> tuple[Signals, int]:
        count = len(signals.rate_dph)
        counts: dict[int, IntArray] = {0: np.rint(signals.rate_dph / 3600e-6).astype(np.int64)}
        for name, (channel, per_unit) in _COUNTS.items():
            slow = np.rint(getattr(signals, name) * per_unit).astype(np.int64)
            counts[channel] = np.repeat(slow, DIVIDER)[:count]
        counts[_SUPPLY[0]] = np.full(count, round(signals.supply * _SUPPLY[1]), dtype=np.int64)
        rate_dps, flags = correction.apply(counts)
        return replace(signals, rate_dph=3600.0 * rate_dps), OUTSIDE if flags else 0
