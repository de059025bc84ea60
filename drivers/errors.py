"""The errors of the drivers: one class for each decision that a caller can take.

DriverError                 anything the equipment or its link refuses or fails at
├── ConfigError             a register map, DBC or station entry is wrong: fix the file
├── LimitError              a value outside the limits of the equipment; nothing was sent
├── IdentityError           the equipment that answered is not the one described; nothing was written
│   └── UnreadableError     it could not be asked who it is: nothing is known against it
├── LinkError               no answer, a torn or a foreign answer: retry, reconnect or go safe
│   └── NoConnectionError   nothing was sent
├── RefusedError            the equipment answered with an exception code: do not retry blindly
└── ReadBackError           what was written is not what reads back: go safe
"""

from __future__ import annotations


class DriverError(Exception):
    """Base of all errors that equipment drivers raise."""

    exit_code = 4
    """Of a program that ends with it: 2 where a file or value is to be mended, 4 where equipment failed."""


class ConfigError(DriverError):
    """A description of equipment (register map, DBC, station entry) cannot be used."""

    exit_code = 2


class LimitError(DriverError):
    """A value outside the limits; raised before anything is sent, nothing is clipped."""

    exit_code = 2


class IdentityError(DriverError):
    """The equipment that answered is not the one that the station describes."""

    exit_code = 2


class UnreadableError(IdentityError):
    """A register that tells who the equipment is was refused: nothing is known for it or against it."""


class LinkError(DriverError):
    """No answer in time, a torn answer, or one that belongs to another request."""


class NoConnectionError(LinkError):
    """There was no connection to send a request over."""


class RefusedError(DriverError):
    """The equipment understood and refused; `code` is its Modbus exception code or CAN abort code."""

    def __init__(self, text: str, code: int) -> None:
        super().__init__(text)
        self.code = code


class ReadBackError(DriverError):
    """What was written does not read back."""


def one_line(error: BaseException) -> str:
    """Text of an error without line breaks; its type when it has none."""
    return " ".join(str(error).split()) or type(error).__name__
