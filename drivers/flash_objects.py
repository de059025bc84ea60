"""CANopen objects and UDS identifiers of a unit's calibration memory, one table for driver and simulator.

The memory has two banks, each for one image of docs/eeprom.md, and a switch that names the bank in force. The bank in
force cannot be written. A write of `SIGNATURE` to the switch makes the unit check the image in the other bank and,
if it accepts it, turn the switch; the change takes effect with the next reset.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Literal

BANKS = (1, 2)
BANK_BYTES = 4000
"""Size of a bank: 1000 words, and with the head of a UDS request less than the 4095 bytes of one ISO-TP message."""
SIGNATURE = 0x65766173
"""`save` as the bytes of a little-endian word, as in CiA 301, object 1010h."""

NODE_BASE = 0x10
"""CANopen node of unit 0; its NMT heartbeat does not collide with the heartbeat of the layout (0x700 + number)."""
SDO_REQUEST, SDO_ANSWER = 0x600, 0x580
UDS_REQUEST, UDS_ANSWER = 0x6C0, 0x6D0
"""CAN identifiers of unit 0."""
NMT_RESET = 0x81
Protocol = Literal["canopen", "uds"]


@dataclass(frozen=True)
class Addresses:
    """Addresses of a unit; `node` is its CANopen node, `request` and `answer` are UDS identifiers."""

    protocol: Protocol
    node: int
    request: int
    answer: int

    @classmethod
    def usual(cls, number: int, protocol: Protocol = "canopen") -> Addresses:
        """Addresses of unit `number` of the shipped family."""
        return cls(protocol, NODE_BASE + number, UDS_REQUEST + number, UDS_ANSWER + number)


PAGE_WORDS = 128
_PAGES = {1: 0x2200, 2: 0x2300}


@dataclass(frozen=True)
class Object:
    """Address of a value: CANopen index and sub-index, UDS data identifier, and its length [bytes], 0: varies."""

    index: int
    sub: int
    did: int
    size: int


class Memory(Enum):
    """Values in a unit."""

    SERIAL = Object(0x1018, 4, 0xFD00, 4)
    """Serial number, as in the heartbeat and in images."""
    ACTIVE = Object(0x2100, 0, 0xFD01, 1)
    """Bank that the switch names, 0: neither bank holds an image that the unit accepts."""
    SET = Object(0x2104, 0, 0xFD02, 1)
    """Number of the calibration in force, as in the heartbeat: counts switches (1 to 255); 0: none in force."""
    COMPENSATION = Object(0x2103, 0, 0xFD03, 1)
    """1: the rate is corrected; 0: it is raw, until the next reset."""
    SWITCH = Object(0x1010, 1, 0xFD04, 4)
    """Write `SIGNATURE` to turn the switch. Reads 1."""
    BANK_1 = Object(0x2101, 1, 0xFD11, 0)
    BANK_2 = Object(0x2101, 2, 0xFD12, 0)
    """Image in a bank; one word of ones for an empty bank."""
    CRC_1 = Object(0x2102, 1, 0xFD21, 4)
    CRC_2 = Object(0x2102, 2, 0xFD22, 4)
    """CRC-32 that the unit computes over the image in a bank without its last word; 0 for an empty bank."""


def bank(number: int) -> Memory:
    """The image in a bank."""
    return Memory.BANK_1 if number == 1 else Memory.BANK_2


def crc(number: int) -> Memory:
    """The CRC of a bank."""
    return Memory.CRC_1 if number == 1 else Memory.CRC_2


def word_object(number: int, word: int) -> tuple[int, int]:
    """Index and sub-index of one 32-bit word of a bank, for units without segmented transfer."""
    return _PAGES[number] + word // PAGE_WORDS, 1 + word % PAGE_WORDS


def word_place(index: int, sub: int) -> tuple[int, int] | None:
    """Bank and word of an object of single words; None for any other object."""
    for number, base in _PAGES.items():
        word = (index - base) * PAGE_WORDS + sub - 1
        if 0 <= word < BANK_BYTES // 4 and 1 <= sub <= PAGE_WORDS:
            return number, word
    return None
