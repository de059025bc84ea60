"""A new controller for one behaviour with the real driver, and helpers of the behaviours."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Protocol

from drivers.chamber import Chamber, Write
from drivers.clock import SimClock
from drivers.errors import DriverError
from drivers.modbus import ModbusLink
from drivers.register import Register, Value
from drivers.register_map import RegisterMap

LIMITS = (-40.0, 85.0)
"""Station limits [degC] of the trial; every map must allow them."""


class Served(Protocol):
    """A controller that serves a map: its address, and its registers from the inside."""

    @property
    def url(self) -> str:
        """Address for a link."""

    def words(self, name: str) -> list[int]:
        """Raw words of a register."""

    def set_words(self, name: str, words: Iterable[int]) -> None:
        """Write raw words to a register; for a masked one, only its bits."""

    def close(self) -> None:
        """Stop serving."""


class NotApplicable(Exception):  # noqa: N818 - an outcome, not an error
    """The behaviour does not apply to the controller."""


class Trial:
    """A new controller for one behaviour, and the driver on it."""

    def __init__(self, registers: RegisterMap, served: Served) -> None:
        self.described = registers
        self.map = registers.with_decimals(dict.fromkeys(registers.decimals, 1))
        self.served = served
        self.link = ModbusLink(served.url, timeout_s=5.0, attempts=1)
        self.writes: list[Write] = []
        self.clock = SimClock()
        self.connect()

    def connect(self) -> None:
        """A driver that has not recognised the controller yet."""
        journal = self.writes.append
        self.chamber = Chamber(self.link, self.described, LIMITS, self.clock, journal=journal, secondary_s=0.0)

    def value(self, name: str) -> Value:
        """Value of a register."""
        return self.map[name].decode(self.served.words(name))

    def put(self, name: str, value: Value) -> None:
        """Change a register from the controller's side."""
        self.served.set_words(name, self.map[name].encode(value))

    def image(self) -> dict[str, list[int]]:
        """All registers."""
        return {name: self.served.words(name) for name in self.map.registers}

    def refused(self, error: type[DriverError], call: Callable[[], object], what: str) -> str:
        """Call `call`, which must raise `error`; returns its text."""
        try:
            call()
        except error as refusal:
            return str(refusal)
        raise AssertionError(f"{what} was not refused")


def check(true: bool, text: str) -> None:
    """AssertionError with `text` unless `true`; unlike assert, also with -O."""
    if not true:
        raise AssertionError(text)


def foreign(register: Register) -> tuple[int, ...]:
    """Words that satisfy no sensible rule about a register."""
    if register.type == "ascii":
        return (ord("?"),) * register.count
    return (0xFFFF if register.mask is None else register.mask,) * register.count


def alarm(register: Register) -> tuple[int, ...]:
    """Words of an alarm register that mean an alarm."""
    for name, code in register.values.items():
        if register.is_alarm(name):
            return (code,)
    bits = 0xFFFF if register.mask is None else register.mask
    return (next(code for code in range(1, 0x10000) if code & bits == code and code not in register.values.values()),)
