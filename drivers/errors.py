"""The errors of the drivers: one class for each decision that a caller can make.

DriverError                 the equipment or its link refuses or fails
├── ConfigError             a register map, DBC or station entry is wrong: fix the file
├── LimitError              a value outside the limits of the equipment; nothing was sent
├── IdentityError           the equipment that answered is not the one described; nothing was written
│   └── UnreadableError     its identity could not be read, so it may still be the right one
├── LinkError               no answer, a damaged answer or one to another request: retry, reconnect or go safe
│   └── NoConnectionError   nothing was sent
├── RefusedError            the equipment answered with an exception code: do not retry blindly
└── ReadBackError           the value read back differs from the value written: go safe
"""

from __future__ import annotations


class DriverError(Exception):
    """Base of all errors that equipment drivers raise."""

    exit_code = 4
    """Exit code of a program that ends with it: 2 when a file or value must be corrected, 4 when equipment failed."""


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
    """A register that identifies the equipment could not be read: the identity is unknown."""


class LinkError(DriverError):
    """No answer in time, a damaged answer, or one that belongs to another request."""


class NoConnectionError(LinkError):
    """There was no connection to send a request over."""


class RefusedError(DriverError):
    """The equipment understood and refused; `code` is its Modbus exception code or CAN abort code."""

    def __init__(self, text: str, code: int) -> None:
        super().__init__(text)
        self.code = code


class ReadBackError(DriverError):
    """The value read back differs from the value written."""


def one_line(error: BaseException) -> str:
    """Text of an error without line breaks; its type when the text is empty."""
    return " ".join(str(error).split()) or type(error).__name__
