"""One register of a controller: its address, its meaning, and the coding of its values as words on the wire.

Decoding is as strict as encoding: an impossible value (NaN, infinite, outside the register's limits) raises instead of
becoming data.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import field, replace
from functools import cache, cached_property
from typing import Annotated, Literal

from pydantic import ConfigDict, Field, FiniteFloat
from pydantic.dataclasses import dataclass

from drivers.errors import ConfigError, LimitError

Value = float | str
"""A decoded register: a number in the register's unit, or the name of an enumerated value, or a text."""

MAX_BLOCK_WORDS = 125
ORDER_ASSUMED = "has two words and no `word_order`: high_first is assumed; state high_first or low_first"
_TINY = 1e-30
_FORMATS = {"int16": "h", "uint16": "H", "int32": "i", "uint32": "I", "float32": "f", "bit": "H"}
STRICT = ConfigDict(extra="forbid", use_attribute_docstrings=True)
Text = Annotated[str, Field(min_length=1)]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Register:
    """One quantity of a controller: its address, its coding, and what may be read from or written to it."""

    name: str = ""
    """Its key in the map."""
    address: Annotated[int, Field(ge=0, le=0xFFFF)]
    """0-based, as sent on the wire."""
    type: Literal["int16", "uint16", "int32", "uint32", "float32", "ascii", "bit"]
    """`bit`: a coil or a discrete input, with `values` for its codes 0 and 1."""
    meaning: Text
    """What it is, for messages and people."""
    source: Text
    """Where this is written: document and page."""
    read: Literal[1, 2, 3, 4] = 3
    """Function code that reads it: 1 a coil, 2 a discrete input, 3 a holding register, 4 an input register."""
    write: Literal[5, 6, 16] | None = None
    """Function code that writes it, 5 for a coil; None: the driver never writes it."""
    words: Annotated[int, Field(ge=0, le=MAX_BLOCK_WORDS)] = 0
    """Length of a text (one character per register); for numbers, their type defines it."""
    word_order: Literal["high_first", "low_first"] | None = None
    """Of numbers of two words; left out: that of the map, else high_first, which `bench check` tells."""
    byte_order: Literal["high_first", "low_first"] = "high_first"
    """Of the two bytes in each word."""
    scale: FiniteFloat = 1.0
    """Value = raw number x scale + offset."""
    offset: FiniteFloat = 0.0
    """Such as -273.15 of a controller that works in kelvin."""
    decimals: str = ""
    """Register that holds how many decimals the controller implies; read by `identify`. Empty: no implied decimals."""
    mask: Annotated[int, Field(ge=1, le=0xFFFF)] | None = None
    """The bits of the word that belong to this register; a write does not change the other bits."""
    unit: str = ""
    """Unit of the value; temperatures are in degC."""
    values: Mapping[str, int] = field(default_factory=dict)
    """Names of an enumeration."""
    low: FiniteFloat | None = None
    """Limits of written values; for a register that is only read, limits of plausible values."""
    high: FiniteFloat | None = None
    """Highest of them."""
    tolerance: Annotated[FiniteFloat, Field(ge=0)] | None = None
    """Largest difference between written and read back; default half a count, or a float32 rounding."""
    normal: tuple[str, ...] = ()
    """Names of normal states; when given, any other value is an alarm."""
    alarming: tuple[str, ...] = ()
    """Names of alarms; any other value is not an alarm."""
    optional: bool = False
    """Not every controller of this model has it."""
    uncertain: bool = False
    """The source is weak: confirm on the first real controller."""

    def __post_init__(self) -> None:
        if (self.type == "ascii") != (self.words > 0):
            raise ValueError("words must be given for an ascii register, and only for it")
        self._check_numbers()
        if self.values and self.type not in ("uint16", "bit"):
            raise ValueError("a register with values must be a uint16 or a bit")
        if (self.type == "bit") != (self.read in (1, 2)) or (self.write == 5) != (self.is_bit and bool(self.write)):
            raise ValueError("a coil has type: bit, read: 1, and write: 5 if it is written; a discrete input read: 2")
        if self.is_bit and (sorted(self.values.values()) != [0, 1] or (self.read == 2 and self.write)):
            raise ValueError("a bit needs two values, with the codes 0 and 1; a discrete input cannot be written")
        if self.write == 6 and self.count != 1:
            raise ValueError("function code 6 writes one word; use 16")
        if self.decimals and "int" not in self.type:
            raise ValueError("decimals are only allowed for integers")
        if self.mask is not None:
            self._check_mask(self.mask)
        if unknown := {*self.normal, *self.alarming} - set(self.values):
            known = ", ".join(self.values) or "none"
            raise ValueError(f"{', '.join(sorted(unknown))} not among the values; known: {known}")

    def _check_numbers(self) -> None:
        if self.scale == 0:
            raise ValueError("scale must not be 0")
        if (self.scale, self.offset) != (1, 0) and (self.type in ("ascii", "bit") or self.values):
            raise ValueError("scale and offset are only allowed for numbers")
        if self.low is not None and self.high is not None and self.low > self.high:
            raise ValueError(f"low is {self.low:g}, above high, {self.high:g}: exchange them")

    def _check_mask(self, mask: int) -> None:
        if self.type != "uint16" or not self.values:
            raise ValueError("a mask needs values and the type uint16")
        if outside := [name for name, code in self.values.items() if code & ~mask]:
            raise ValueError(f"bits of {', '.join(outside)} are outside the mask {mask:#x}")

    def collides(self, other: Register) -> bool:
        """Whether both take the same address; two that tell bits of one word apart do not."""
        if self.read != other.read or self.end <= other.address or other.end <= self.address:
            return False
        if self.mask is not None and other.mask is not None:
            return bool(self.mask & other.mask)
        return (self.mask, other.mask) == (None, None) or bool(self.write or other.write)

    @property
    def order_assumed(self) -> bool:
        """Whether it is a number of two words whose order nobody has stated."""
        return self.count == 2 and not self.words and self.word_order is None

    @property
    def is_bit(self) -> bool:
        """A coil or a discrete input, in an address space of its own."""
        return self.type == "bit"

    @cached_property
    def count(self) -> int:
        """Length [words, or bits]."""
        return self.words or struct.calcsize(_FORMATS[self.type]) // 2

    @cached_property
    def end(self) -> int:
        """First address after the register."""
        return self.address + self.count

    @property
    def impossible(self) -> tuple[int, ...]:
        """Words that a working sensor never gives: NaN, or the end of the integer range."""
        first = {"float32": 0x7FC0, "int16": 0x7FFF, "int32": 0x7FFF}.get(self.type, 0xFFFF)
        return self.ordered([first, *[0 if self.type == "float32" else 0xFFFF] * (self.count - 1)])

    def with_decimals(self, places: int) -> Register:
        """The same register with the implied decimals that the controller reported."""
        return replace(self, scale=self.scale * 10.0**-places, decimals="")

    @property
    def whole_word(self) -> Register:
        """The word that contains a masked register."""
        return replace(self, mask=None, values={}, normal=(), alarming=())

    def decode(self, words: Sequence[int]) -> Value:
        """Value of `words` as read from the wire.

        Raises LimitError for a value that a healthy controller cannot report: NaN, infinite, outside low..high.
        """
        self._check_scale()
        if len(words) != self.count:
            raise LimitError(f"{self.name}: {len(words)} words, {self.count} needed")
        if self.type == "ascii":
            text = "".join(chr(word & 0xFF) for word in self.ordered(words)).rstrip("\0 ")
            if not text.isprintable():
                raise LimitError(f"{self.name} reads {text!r}, which is not printable text")
            return text
        as_words, as_number = _coding(self.count, self.type)
        (raw,) = as_number.unpack(as_words.pack(*self.ordered(words)))
        if self.values:
            raw &= 0xFFFF if self.mask is None else self.mask
            return next((name for name, code in self.values.items() if code == raw), f"code {raw}")
        value = float(raw * self.scale)
        if self.offset:
            value = round(value + self.offset, 9)  # 233.65 - 273.15 is not -39.5
        # A set point outside the limits that we would write is legal; a measurement outside its range is not.
        if not (self._within(value) if self.write is None else _possible(value)):
            raise self._refusal(value, "reads", "; a sensor break, or wrong word order, scale or unit")
        return value

    def encode(self, value: Value) -> tuple[int, ...]:
        """Words on the wire for `value`; raises LimitError when it is outside the limits or cannot be coded."""
        self._check_scale()
        if self.type == "ascii":
            if not isinstance(value, str) or len(value) > self.words or not value.isascii():
                raise LimitError(f"{self.name}: {value!r} is not ASCII text of at most {self.words} characters")
            return self.ordered([ord(char) for char in value.ljust(self.words, "\0")])
        number = (self._number(value) - self.offset) / self.scale
        if self.type != "float32":
            number = round(number)
        as_words, as_number = _coding(self.count, self.type)
        try:
            packed = as_number.pack(number)
        except (struct.error, OverflowError):
            coding = f"{self.type} x {self.scale:g}" + (f" + {self.offset:g}" if self.offset else "")
            raise LimitError(f"{self.name}: {value} {self.unit} does not fit {coding}") from None
        return self.ordered(as_words.unpack(packed))

    def ordered(self, words: Sequence[int]) -> tuple[int, ...]:
        """Words as they are on the wire, from words with the highest first, or the other way round."""
        if self.word_order == "low_first" and not self.words:
            words = words[::-1]
        if self.byte_order == "low_first":
            words = [word >> 8 | (word & 0xFF) << 8 for word in words]
        return tuple(words)

    def agrees(self, written: Value, read: Value) -> bool:
        """Whether `read` equals `written` within the tolerance."""
        if isinstance(written, str) or isinstance(read, str):
            return written == read
        tolerance = self.tolerance
        if tolerance is None:
            counts = abs(written - self.offset) * 2**-23
            tolerance = counts if self.type == "float32" else abs(self.scale) / 2
        return abs(written - read) <= tolerance * (1 + 1e-9)

    def is_alarm(self, value: Value) -> bool:
        """Whether the map defines `value` of this register as an alarm."""
        return value in self.alarming or (bool(self.normal) and value not in self.normal)

    def _check_scale(self) -> None:
        if self.decimals:
            raise ConfigError(
                f"{self.name}: its decimals are in {self.decimals}, which was not read yet: call identify() first"
            )

    def _number(self, value: Value) -> float:
        if self.values:
            if value not in self.values:
                raise LimitError(f"{self.name}: {value!r} is not one of {', '.join(self.values)}")
            return self.values[str(value)]
        if isinstance(value, str | bool):
            raise LimitError(f"{self.name}: {value!r} is not a number")
        if not self._within(value):
            raise self._refusal(value, "cannot be set to", "")
        return value

    def _within(self, value: float) -> bool:
        low = -math.inf if self.low is None else self.low
        high = math.inf if self.high is None else self.high
        return _possible(value) and low <= value <= high

    def _refusal(self, value: float, what: str, hint: str) -> LimitError:
        low, high = ("none" if limit is None else f"{limit:g}" for limit in (self.low, self.high))
        return LimitError(f"{self.name} {what} {value:g} {self.unit}; limits {low} to {high}{hint}")


@cache
def _coding(count: int, kind: str) -> tuple[struct.Struct, struct.Struct]:
    """Formats that read the same bytes as words and as a number."""
    return struct.Struct(f">{count}H"), struct.Struct(">" + _FORMATS[kind])


def _possible(value: float) -> bool:
    """Finite, and not so small as a round float32 whose two words are swapped."""
    return math.isfinite(value) and not 0 < abs(value) < _TINY


def block_of(registers: Iterable[Register]) -> tuple[int, int, int]:
    """Function code, address and length [words] of the one request that reads all `registers`.

    Raises ValueError when one request cannot read them.
    """
    members = tuple(registers)
    if len(members) == 1:
        return members[0].read, members[0].address, members[0].count
    codes = {register.read for register in members}
    if len(codes) != 1:
        raise ValueError(f"a block must have one function code, not {sorted(codes)}")
    start = min(register.address for register in members)
    count = max(register.end for register in members) - start
    if count > MAX_BLOCK_WORDS:
        raise ValueError(f"a block has {count} words; Modbus reads at most {MAX_BLOCK_WORDS}")
    return codes.pop(), start, count
