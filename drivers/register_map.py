"""Register maps: the complete description of one controller model, as data.

A map is a YAML file in `drivers/chambers/`, or anywhere (`drivers/registers.py` reads it). This module does not access
equipment; the driver and the simulator share only this description of the wire.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import field, replace
from functools import cached_property
from itertools import combinations
from typing import Annotated, Literal

from pydantic import Field, FiniteFloat
from pydantic.dataclasses import dataclass

from drivers.errors import ConfigError, LimitError
from drivers.register import MAX_BLOCK_WORDS, ORDER_ASSUMED, STRICT, Register, Text, Value
from drivers.yaml12 import PlacedError

Seconds = Annotated[FiniteFloat, Field(ge=0, le=3600)]

_NEEDED = ("temperature", "setpoint")
_DEGC = ("working_setpoint", "setpoint_low", "setpoint_high")
_STATES = {"door": {"open", "closed"}, "sensor_break": {"ok", "broken"}, "compressor": {"off", "on"}}
"""Registers that the driver uses by name, and the values that they must have."""


@dataclass(frozen=True, config=STRICT)
class Rule:
    """Value that a register must read before anything is written: a pattern for texts, a range for numbers."""

    register: str
    """Name of the register."""
    why: Text
    """Why another value is refused, for the message."""
    pattern: Text | None = None
    """Regular expression that a text, or the name of a value, must match."""
    low: FiniteFloat | None = None
    """Lowest number, with `high`."""
    high: FiniteFloat | None = None
    """Highest number, with `low`."""
    example: str | None = None
    """A text that satisfies the pattern, for the simulated controller."""

    def __post_init__(self) -> None:
        ranged = self.low is not None and self.high is not None and self.low <= self.high
        if ranged == (self.pattern is not None):
            raise ValueError("a rule needs either a pattern, or low and high")
        if self.example is not None and not self.accepts(self.example):
            raise ValueError(f"the example {self.example!r} does not satisfy the rule")

    def accepts(self, value: Value) -> bool:
        """Whether `value` satisfies the rule."""
        if self.pattern is not None:
            return isinstance(value, str) and re.search(self.pattern, value) is not None
        if isinstance(value, str) or self.low is None or self.high is None:
            return False
        return self.low <= value <= self.high

    def example_of(self, register: Register) -> Value:
        """A value of its register that satisfies it; ConfigError when the map does not give one."""
        if self.low is not None:
            return self.low
        for candidate in (self.example, *register.values):
            if candidate is not None and self.accepts(candidate):
                return candidate
        raise ConfigError(f"identify: {self.register}: give the rule an `example` that satisfies {self.pattern}")


@dataclass(frozen=True, config=STRICT)
class Run:
    """How the controller is started and stopped, and the register that reports its state."""

    register: str
    """Register, or coil, that is written."""
    on: str
    """Name of its value for on."""
    off: str
    """Name of its value for off."""
    state: str
    """Register that reports the state with the same names; it may be the same one."""
    least_on_s: Seconds = 0.0
    """Shortest time on [s] before we switch it off; the safe state does not wait."""
    least_off_s: Seconds = 0.0
    """Shortest time off [s] before we switch it on again; protects the compressor."""


@dataclass(frozen=True, config=STRICT)
class Ramp:
    """Native ramp: register of the rate [degC/min], settings that switch it on and off, in this order."""

    rate: str
    """Register of the rate."""
    on: Mapping[str, str | FiniteFloat]
    """Values that switch the ramp on, by register."""
    off: Mapping[str, str | FiniteFloat]
    """Values that switch it off."""


@dataclass(frozen=True, config=STRICT)
class RegisterMap:
    """Description of one controller model.

    The driver uses registers by name: `temperature` and `setpoint` always; `working_setpoint`, `power`,
    `setpoint_low`, `setpoint_high`, `compressor` (off, on), `door` (open, closed) and `sensor_break` (ok, broken) if
    the controller has them.
    """

    model: Text
    """What the controller is called."""
    registers: Mapping[str, Register]
    """Registers, coils and discrete inputs by name."""
    poll: tuple[str, ...]
    """Read at every poll, in as few requests as `block_words` allows."""
    run: Run
    """How it is switched on and off."""
    identify: tuple[Rule, ...]
    """What must be read before anything is written; [] where no register tells."""
    connection: str = ""
    """How the controller is connected, as text for the user."""
    sources: Mapping[str, Text] = field(default_factory=dict)
    """Abbreviations in the registers' `source`, and what they stand for; if given, every source must contain one."""
    notes: tuple[str, ...] = ()
    """Notes on the controller for the user."""
    unit_register: str | None = None
    """Register of an identify rule that refuses degF; None: the controller does not report its unit."""
    setpoint_copies: tuple[str, ...] = ()
    """Further set points that are always written together with `setpoint`."""
    secondary: tuple[str, ...] = ()
    """Read one by one, less often: alarms, limit controller, compressor."""
    ramp: Ramp | None = None
    """None: the host steps the set point."""
    word_order: Literal["high_first", "low_first"] | None = None
    """Default of the registers."""
    block_words: Annotated[int, Field(ge=2, le=MAX_BLOCK_WORDS)] = MAX_BLOCK_WORDS
    """Longest block [words] that the controller reads."""
    unreadable: tuple[tuple[int, int], ...] = ()
    """First and last address of gaps that a block must not contain."""
    eeprom_writes: Annotated[int, Field(gt=0)] | None = None
    """Writes that the controller's memory endures; if given, the host never steps its set point. None: unlimited."""
    exceptions: Mapping[int, str] = field(default_factory=dict)
    """Meaning of exception codes, where this controller departs from the Modbus specification."""

    def __post_init__(self) -> None:
        self._check_names()
        self._check_addresses()
        self._check_writable()
        self._check_states()
        if self.eeprom_writes is not None and self.ramp is None:
            raise ValueError("eeprom_writes needs a native ramp: stepping the set point would wear the memory out")
        if unknown := {name for name in self.decimals if self[name].decimals or "int" not in self[name].type}:
            raise ValueError(f"decimals must be in plain integers, not in {', '.join(sorted(unknown))}")
        try:
            for name in (self.run.register, self.run.state):
                self[name].encode(self.run.on)
                self[name].encode(self.run.off)
            if self.ramp:
                for name, setting in [*self.ramp.on.items(), *self.ramp.off.items()]:
                    if not self[name].decimals:
                        self[name].encode(setting)
        except LimitError as error:
            raise ValueError(str(error)) from None

    def _check_names(self) -> None:
        rules = tuple(rule.register for rule in self.identify)
        named = {"registers": _NEEDED, "poll": self.poll, "secondary": self.secondary, "identify": rules}
        named |= {"run": (self.run.register, self.run.state), "ramp": self._ramp_settings()}
        named |= {"setpoint_copies": self.setpoint_copies}
        for place, names in named.items():
            if missing := [name for name in names if name not in self.registers]:
                known = ", ".join(self.registers)
                raise PlacedError(f"no register {', '.join(missing)}; described are {known}", (place,))
        for name, register in self.registers.items():
            if register.decimals and register.decimals not in self.registers:
                raise PlacedError(f"no register {register.decimals}", ("registers", name, "decimals"))
        if self.unit_register is not None and self.unit_register not in rules:
            raise PlacedError(f"unit_register {self.unit_register} has no identify rule", ("unit_register",))
        needed = {*_NEEDED, self.run.state}
        if not needed <= set(self.poll):
            raise PlacedError(f"poll must contain {', '.join(sorted(needed))}", ("poll",))
        for register in self.registers.values():
            if self.sources and not any(re.search(rf"\b{re.escape(c)}\b", register.source) for c in self.sources):
                raise ValueError(
                    f"{register.name}: source {register.source!r} does not contain any of {', '.join(self.sources)}"
                )

    def _check_addresses(self) -> None:
        for one, other in combinations(self.registers, 2):
            if self[one].collides(self[other]):
                first, last = self[other].address, self[other].end - 1
                text = f"takes address {first}" if first == last else f"takes addresses {first} to {last}"
                text += f", as {one} does; correct one of them, or give both a `mask`"
                raise PlacedError(text, ("registers", other, "address"))
        for name in {*_NEEDED, *_DEGC, *self.setpoint_copies} & set(self.registers):
            if self[name].unit not in ("", "degC"):
                text = f"is {self[name].unit!r}: the bench reads degC; set the controller to degC, or convert its "
                text += "number by `scale` and `offset` (kelvin: offset: -273.15) and state degC"
                raise PlacedError(text, ("registers", name, "unit"))
            if self[name].scale < 0:
                text = f"is {self[name].scale:g}: a temperature would fall as its number rises; must be above 0"
                raise PlacedError(text, ("registers", name, "scale"))

    def _check_writable(self) -> None:
        for name in ("setpoint", *self.setpoint_copies, self.run.register, *self._ramp_settings()):
            if self[name].write is None:
                text = f"register {name} must be writable: add `write`, the function code that writes it"
                raise PlacedError(text, ("registers", name))

    def _check_states(self) -> None:
        for name, values in _STATES.items():
            if name in self and set(self[name].values) != values:
                raise ValueError(f"register {name} needs the values {' and '.join(sorted(values))}")

    def __getitem__(self, name: str) -> Register:
        return self.registers[name]

    def __contains__(self, name: str) -> bool:
        return name in self.registers

    @cached_property
    def blocks(self) -> tuple[tuple[Register, ...], ...]:
        """The polled registers, grouped into one request each."""
        groups: list[list[Register]] = []
        for register in sorted((self[name] for name in self.poll), key=lambda r: (r.read, r.address)):
            last = groups[-1] if groups else None
            if last and self._one_block(last[0], register):
                last.append(register)
            else:
                groups.append([register])
        return tuple(map(tuple, groups))

    def _one_block(self, first: Register, last: Register) -> bool:
        if first.read != last.read or last.end - first.address > self.block_words:
            return False
        return not any(low < last.end and first.address <= high for low, high in self.unreadable)

    @cached_property
    def decimals(self) -> tuple[str, ...]:
        """Registers that hold the implied decimals of others."""
        return tuple(sorted({r.decimals for r in self.registers.values() if r.decimals}))

    def doubts(self) -> Iterator[str]:
        """What the map leaves open, and what is assumed for it."""
        for name, register in self.registers.items():
            if register.order_assumed:
                yield f"register {name} {ORDER_ASSUMED}"

    def with_decimals(self, places: Mapping[str, int]) -> RegisterMap:
        """The map with the implied decimals that the controller reported, by the register that holds them."""
        known = {n: r.with_decimals(places[r.decimals]) if r.decimals else r for n, r in self.registers.items()}
        return replace(self, registers=known)

    @property
    def native_ramp(self) -> bool:
        """Whether the controller itself ramps its set point."""
        return self.ramp is not None

    @property
    def writable(self) -> tuple[Register, ...]:
        """The only registers that the driver writes."""
        return tuple(register for register in self.registers.values() if register.write)

    def _ramp_settings(self) -> tuple[str, ...]:
        return (self.ramp.rate, *self.ramp.on, *self.ramp.off) if self.ramp else ()
