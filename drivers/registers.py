"""Register maps: what the registers of one controller model mean, as data, and how values become words on the wire.

A map is a YAML file in `drivers/chambers/` (or anywhere, given by path). Nothing here talks to equipment; the driver
and the simulator share this description of the wire and nothing else. Decoding is as strict as encoding: a value that
cannot be right (NaN, infinite, outside the register's limits) raises instead of becoming data.
"""

from __future__ import annotations

import difflib
import math
import struct
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import field, fields
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, Literal

import yaml
from pydantic import ConfigDict, Field, FiniteFloat, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass

from drivers.errors import ConfigError, LimitError

Value = float | str
"""A decoded register: a number in the register's unit, or the name of an enumerated value, or a text."""

MAX_BLOCK_WORDS = 125
_TINY = 1e-30
_FORMATS = {"int16": "h", "uint16": "H", "int32": "i", "uint32": "I", "float32": "f"}
_STRICT = ConfigDict(extra="forbid")
_Text = Annotated[str, Field(min_length=1)]


@dataclass(frozen=True, config=_STRICT)
class Register:
    """One quantity of a controller: where it is, how it is coded, and what may be read from or written to it."""

    name: str
    address: Annotated[int, Field(ge=0, le=0xFFFF)]
    """0-based, as sent on the wire."""
    type: Literal["int16", "uint16", "int32", "uint32", "float32", "ascii"]
    meaning: _Text
    source: _Text
    read: Literal[3, 4] = 3
    write: Literal[6, 16] | None = None
    """Function code that writes it; None: the driver never writes it."""
    words: Annotated[int, Field(ge=0, le=MAX_BLOCK_WORDS)] = 0
    """Length of a text (one character a register); numbers know their own."""
    word_order: Literal["high_first", "low_first"] = "high_first"
    scale: FiniteFloat = 1.0
    """Value = raw number x scale."""
    unit: str = ""
    values: Mapping[str, int] = field(default_factory=dict)
    """Names of an enumeration."""
    low: FiniteFloat | None = None
    """Limits of what is ever written; for a register that is only read, of what can be true."""
    high: FiniteFloat | None = None
    tolerance: Annotated[FiniteFloat, Field(ge=0)] | None = None
    """Largest difference between written and read back; default half a count, or a float32 rounding."""
    normal: tuple[str, ...] = ()
    """Names that mean nothing is wrong; when given, any other value is an alarm."""
    alarming: tuple[str, ...] = ()
    """Names that are an alarm; any other value is not."""
    optional: bool = False
    """Not every controller of this model has it."""
    uncertain: bool = False
    """The source is weak: confirm on the first real controller."""

    def __post_init__(self) -> None:
        if (self.type == "ascii") != (self.words > 0):
            raise ValueError("words is the length of an ascii register and of no other")
        if self.scale == 0 or (self.type in ("ascii", "float32") and self.scale != 1):
            raise ValueError("scale belongs to integers and is not 0")
        if self.values and self.type != "uint16":
            raise ValueError("an enumeration is a uint16")
        if self.write == 6 and self.count != 1:
            raise ValueError("function code 6 writes one word; use 16")
        if unknown := {*self.normal, *self.alarming} - set(self.values):
            raise ValueError(f"{', '.join(sorted(unknown))} not among the values")

    @property
    def count(self) -> int:
        """Length [words]."""
        return self.words or struct.calcsize(_FORMATS[self.type]) // 2

    @property
    def end(self) -> int:
        """First address behind the register."""
        return self.address + self.count

    def decode(self, words: Sequence[int]) -> Value:
        """Value of `words` as read from the wire.

        Raises LimitError when no healthy controller could have meant it: NaN, infinite, outside low..high.
        """
        if len(words) != self.count:
            raise LimitError(f"{self.name}: {len(words)} words, {self.count} needed")
        if self.type == "ascii":
            text = "".join(chr(word & 0xFF) for word in words).rstrip("\0 ")
            if not text.isprintable():
                raise LimitError(f"{self.name} reads {text!r}, which is no text")
            return text
        ordered = words if self.word_order == "high_first" else tuple(reversed(words))
        (raw,) = struct.unpack(">" + _FORMATS[self.type], struct.pack(f">{self.count}H", *ordered))
        if self.values:
            return next((name for name, code in self.values.items() if code == raw), f"code {raw}")
        value = float(raw * self.scale)
        # A target that somebody left outside what we would write is legal; a measurement outside its range is not.
        if not (self._within(value) if self.write is None else _possible(value)):
            raise self._refusal(value, "reads", "; a sensor break, or wrong word order, scale or unit")
        return value

    def encode(self, value: Value) -> tuple[int, ...]:
        """Words on the wire for `value`; raises LimitError when it is outside the limits or cannot be coded."""
        if self.type == "ascii":
            if not isinstance(value, str) or len(value) > self.words or not value.isascii():
                raise LimitError(f"{self.name}: {value!r} is no ASCII text of at most {self.words} characters")
            return tuple(ord(char) for char in value.ljust(self.words, "\0"))
        number = self._number(value)
        if self.type != "float32":
            number = round(number / self.scale)
        try:
            packed = struct.pack(">" + _FORMATS[self.type], number)
        except (struct.error, OverflowError):
            raise LimitError(f"{self.name}: {value} {self.unit} does not fit {self.type} x {self.scale:g}") from None
        words = struct.unpack(f">{self.count}H", packed)
        return words if self.word_order == "high_first" else tuple(reversed(words))

    def agrees(self, written: Value, read: Value) -> bool:
        """Whether `read` is what a healthy controller gives back for `written`."""
        if isinstance(written, str) or isinstance(read, str):
            return written == read
        tolerance = self.tolerance
        if tolerance is None:
            tolerance = abs(written) * 2**-23 if self.type == "float32" else abs(self.scale) / 2
        return abs(written - read) <= tolerance * (1 + 1e-9)

    def is_alarm(self, value: Value) -> bool:
        """Whether `value` of this register is an alarm by the map."""
        return value in self.alarming or (bool(self.normal) and value not in self.normal)

    def _number(self, value: Value) -> float:
        if self.values:
            if value not in self.values:
                raise LimitError(f"{self.name}: {value!r} is none of {', '.join(self.values)}")
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


def _possible(value: float) -> bool:
    """Finite, and not what a round float32 looks like with its two words swapped."""
    return math.isfinite(value) and not 0 < abs(value) < _TINY


@dataclass(frozen=True, config=_STRICT)
class Rule:
    """What a register must read before anything is written: a pattern for the decoded value."""

    register: str
    pattern: _Text
    why: _Text


@dataclass(frozen=True, config=_STRICT)
class Run:
    """How the controller is started and stopped, and where it says that it is."""

    register: str
    on: str
    off: str
    state: str


@dataclass(frozen=True, config=_STRICT)
class Ramp:
    """Native ramp: register of the rate [degC/min], settings that switch it on and off, in this order."""

    rate: str
    on: Mapping[str, str | FiniteFloat]
    off: Mapping[str, str | FiniteFloat]


@dataclass(frozen=True, config=_STRICT)
class RegisterMap:
    """Everything that the driver knows about one controller model.

    The driver looks for registers by name: `temperature` and `setpoint` always; `working_setpoint`, `power`,
    `setpoint_low`, `setpoint_high` and `compressor` where the controller has them.
    """

    model: _Text
    registers: Mapping[str, Register]
    poll: tuple[str, ...]
    """Read at every poll, in as few requests as `block_words` allows."""
    run: Run
    identify: tuple[Rule, ...]
    secondary: tuple[str, ...] = ()
    """Read one by one, less often: alarms, limit controller, compressor."""
    ramp: Ramp | None = None
    """None: the host steps the set point."""
    word_order: Literal["high_first", "low_first"] = "high_first"
    """Default of the registers."""
    block_words: Annotated[int, Field(ge=2, le=MAX_BLOCK_WORDS)] = MAX_BLOCK_WORDS
    """Longest block [words] that the controller reads."""
    exceptions: Mapping[int, str] = field(default_factory=dict)
    """What this controller means by an exception code, where it departs from the Modbus specification."""

    def __post_init__(self) -> None:
        named = {"temperature", "setpoint", *self.poll, *self.secondary, *(rule.register for rule in self.identify)}
        named |= {self.run.register, self.run.state, *self._ramp_settings()}
        if self.ramp:
            named.add(self.ramp.rate)
        if missing := named - set(self.registers):
            raise ValueError(f"no register {', '.join(sorted(missing))}")
        for name in ("setpoint", self.run.register, *self._ramp_settings(), *([self.ramp.rate] if self.ramp else [])):
            if self.registers[name].write is None:
                raise ValueError(f"register {name} has to be writable")
        needed = {"temperature", "setpoint", self.run.state}
        if not needed <= set(self.poll):
            raise ValueError(f"poll has to hold {', '.join(sorted(needed))}")
        try:
            for name in (self.run.register, self.run.state):
                self[name].encode(self.run.on)
                self[name].encode(self.run.off)
            if self.ramp:
                for name, setting in [*self.ramp.on.items(), *self.ramp.off.items()]:
                    self[name].encode(setting)
        except LimitError as error:
            raise ValueError(str(error)) from None

    def __getitem__(self, name: str) -> Register:
        return self.registers[name]

    def __contains__(self, name: str) -> bool:
        return name in self.registers

    @property
    def blocks(self) -> tuple[tuple[Register, ...], ...]:
        """The polled registers, grouped into one request each."""
        groups: list[list[Register]] = []
        for register in sorted((self[name] for name in self.poll), key=lambda r: (r.read, r.address)):
            last = groups[-1] if groups else None
            if last and last[0].read == register.read and register.end - last[0].address <= self.block_words:
                last.append(register)
            else:
                groups.append([register])
        return tuple(map(tuple, groups))

    @property
    def native_ramp(self) -> bool:
        """Whether the controller moves its own set point at a rate."""
        return self.ramp is not None

    @property
    def writable(self) -> tuple[Register, ...]:
        """The whitelist: the only registers that the driver ever writes."""
        return tuple(register for register in self.registers.values() if register.write)

    def _ramp_settings(self) -> tuple[str, ...]:
        return (*self.ramp.on, *self.ramp.off) if self.ramp else ()


def block_of(registers: Iterable[Register]) -> tuple[int, int, int]:
    """Function code, address and length [words] of the one request that reads all `registers`.

    Raises ValueError when there is none.
    """
    members = tuple(registers)
    codes = {register.read for register in members}
    if len(codes) != 1:
        raise ValueError(f"a block is read with one function code, not {sorted(codes)}")
    start = min(register.address for register in members)
    count = max(register.end for register in members) - start
    if count > MAX_BLOCK_WORDS:
        raise ValueError(f"a block of {count} words; Modbus reads at most {MAX_BLOCK_WORDS}")
    return codes.pop(), start, count


def list_maps() -> list[str]:
    """Names of the maps that come with the package."""
    return sorted(entry.name[:-5] for entry in (files("drivers") / "chambers").iterdir() if entry.name[-5:] == ".yaml")


def load_map(name_or_path: str | Path) -> RegisterMap:
    """The map of a controller model, by its name in the package or by the path of a YAML file.

    Raises ConfigError with file, line and the nearest known key.
    """
    path = Path(name_or_path)
    try:
        if path.suffix in (".yaml", ".yml"):
            text = path.read_text("utf-8")
        elif str(name_or_path) in list_maps():
            text = (files("drivers") / "chambers" / f"{name_or_path}.yaml").read_text("utf-8")
        else:
            raise ConfigError(f"no register map {str(name_or_path)!r}; there are {', '.join(list_maps())}")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"register map {path}: {error}") from error
    return parse_map(text, str(name_or_path))


class _Loader(yaml.SafeLoader):
    """YAML in which `on` and `off` are words, as controllers use them, and a repeated key is an error."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen = set()
        for key, _ in node.value:
            if key.value in seen:
                raise yaml.MarkedYAMLError(problem=f"{key.value} stands twice", problem_mark=key.start_mark)
            seen.add(key.value)
        return super().construct_mapping(node, deep)


_Loader.yaml_implicit_resolvers = {
    first: [(tag, regexp) for tag, regexp in resolvers if tag != "tag:yaml.org,2002:bool" or first in "tTfF"]
    for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}


def parse_map(text: str, where: str) -> RegisterMap:
    """The map written in YAML `text`; `where` names it in errors. Raises ConfigError."""
    try:
        node = yaml.compose(text, _Loader)
        data = yaml.load(text, _Loader)
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else 0
        raise ConfigError(f"{where}:{line}: {error.problem}") from error
    if not isinstance(data, dict):
        raise ConfigError(f"{where}:1: a register map is a mapping")
    registers = data.get("registers")
    for name, entry in registers.items() if isinstance(registers, dict) else ():
        if isinstance(entry, dict):
            entry["name"] = name
            entry.setdefault("word_order", data.get("word_order", "high_first"))
    try:
        return TypeAdapter(RegisterMap).validate_python(data)
    except ValidationError as error:
        raise ConfigError(_explain(error, node, where)) from error


_KEYS: dict[str, type] = {"registers": Register, "identify": Rule, "run": Run, "ramp": Ramp}


def _explain(error: ValidationError, node: yaml.Node | None, where: str) -> str:
    """First error as file, line, key, what is wrong, nearest known key."""
    problems = error.errors()
    first = next((entry for entry in problems if entry["type"] == "unexpected_keyword_argument"), problems[0])
    path = [str(part) for part in first["loc"]]
    text = first["msg"]
    if first["type"] == "unexpected_keyword_argument":
        known = [entry.name for entry in fields(_KEYS[path[0]] if len(path) > 1 else RegisterMap)]
        near = difflib.get_close_matches(path[-1], known, 1)
        text = "unknown key" + (f"; did you mean {near[0]}?" if near else f"; known are {', '.join(known)}")
    return f"{where}:{_line(node, path)}: {'.'.join(path) or 'map'}: {text}"


def _line(node: yaml.Node | None, path: list[str]) -> int:
    line = 1
    for part in path:
        if isinstance(node, yaml.MappingNode):
            found = next(((key, value) for key, value in node.value if key.value == part), None)
            if found is None:
                break
            line, node = found[0].start_mark.line + 1, found[1]
        elif isinstance(node, yaml.SequenceNode) and part.isdigit() and int(part) < len(node.value):
            node = node.value[int(part)]
            line = node.start_mark.line + 1
    return line
