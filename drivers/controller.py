"""The controller of a chamber, accessed by registers: recognised before it is written, every write read back.

This is the only module that writes a register. Values outside the limits are neither sent nor clipped. A register that
already holds the value is not written again: some controllers store each write in a memory that wears out.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import TypeVar

from drivers.clock import Clock
from drivers.errors import (
    DriverError,
    IdentityError,
    LimitError,
    LinkError,
    ReadBackError,
    RefusedError,
    UnreadableError,
)
from drivers.modbus import ModbusLink
from drivers.registers import Register, RegisterMap, Value

ILLEGAL_ADDRESS = 2
NOT_NOW = frozenset({5, 6, 10, 11})
"""Modbus exceptions of a controller or gateway that cannot answer now; the request itself is not wrong."""
WEAR_WINDOW_S = 600.0
WEAR_WRITES = 30
"""More writes than this within WEAR_WINDOW_S to a memory that wears out mean that the host steps the set point
[Eurotherm HA026230: some 100 000 writes; at this rate it would last three weeks]."""

_T = TypeVar("_T")


@dataclass(frozen=True)
class Identity:
    """Identity that the controller reported."""

    model: str
    answers: tuple[tuple[str, str], ...]
    """Register and value of every rule that it satisfied."""
    limits: tuple[float, float]
    """Set points that station and controller both allow [degC]."""


@dataclass(frozen=True)
class Known:
    """Data from the first recognition of a controller that unverified commands need."""

    decimals: Mapping[str, int]
    """Implied decimals, by the register that holds them."""
    limits: tuple[float, float]
    """Set points that station and controller both allowed [degC]."""
    words: Mapping[str, int] = field(default_factory=dict)
    """Whole words of registers of which the driver writes only some bits."""


NOT_READ = "not read back"


@dataclass(frozen=True)
class Write:
    """One write for the journal."""

    t_s: float
    register: str
    old: Value
    new: Value
    read_back: Value


class Controller:
    """The registers of one controller. Raises DriverError subclasses."""

    def __init__(
        self,
        link: ModbusLink,
        registers: RegisterMap,
        limits: tuple[float, float],
        clock: Clock,
        journal: Callable[[Write], None] | None = None,
        known: Known | None = None,
    ) -> None:
        """`limits` [degC] are the station's; `journal` sees every write; `known` is what was read before."""
        self.map = registers
        """The map; its implied decimals are known after `recognise`."""
        self.identity: Identity | None = None
        self.known = known
        """From the first recognition; what is read later must not contradict it."""
        self.writes = 0
        """Registers written since this object was made: wear of the controller's memory."""
        self._described = registers
        self._link = link
        self._station_limits = limits
        self._clock = clock
        self._journal = journal
        self._identified_at = -1
        self._whole_block = True
        self._recent: deque[float] = deque()
        self._deadline: Callable[[], bool] | None = None

    @property
    def limits(self) -> tuple[float, float]:
        """Set points [degC] that station and controller both allow; the station's before `recognise`."""
        return self.identity.limits if self.identity else self._station_limits

    @contextmanager
    def within(self, limit_s: float) -> Iterator[None]:
        """Requests that begin later than `limit_s` [s] of bench time or wall time from now raise LinkError.

        For the safe state: bounds the time on a failing link, and ignores the limit on writes.
        """
        bench_s, wall_s = self._clock.now() + limit_s, time.monotonic() + limit_s
        self._deadline = lambda: self._clock.now() > bench_s or time.monotonic() > wall_s
        try:
            yield
        finally:
            self._deadline = None

    # ---- reading ----------------------------------------------------------------------------------------------------

    def recognise(self) -> Identity:
        """Check the identity rules, and read implied decimals and limits. Writes nothing; IdentityError."""
        model = self._described.model
        self.identity = None
        answers = []
        for rule in self._described.identify:
            value = self._identifying(rule.register)
            text = value if isinstance(value, str) else f"{value:g}"
            if not rule.accepts(value):
                raise IdentityError(f"{model}: {rule.register} reads {text!r}; {rule.why}")
            answers.append((rule.register, text))
        places = {name: round(float(self._identifying(name))) for name in self._described.decimals}
        if self.known is not None and places != self.known.decimals:
            text = f"implies decimals {places}, but {dict(self.known.decimals)} when it was recognised first"
            raise IdentityError(f"{model}: {text}; its display settings were changed")
        answers += [(name, str(count)) for name, count in places.items()]
        self.map = self._described.with_decimals(places)
        low, high = self._station_limits
        if "setpoint_low" in self.map:
            low = max(low, float(self._identifying("setpoint_low")))
        if "setpoint_high" in self.map:
            high = min(high, float(self._identifying("setpoint_high")))
        if low >= high:
            raise IdentityError(f"{model}: station and controller allow no common set point ({low:g}, {high:g})")
        if self.known is None:
            masked = [register for register in self.map.writable if register.mask is not None]
            words = {register.name: int(float(self.read(register.whole_word))) for register in masked}
            self.known = Known(places, (low, high), words)
        self.identity = Identity(model, tuple(answers), (low, high))
        self._identified_at = self._link.counters.connections
        return self.identity

    def read(self, register: Register) -> Value:
        """Value of one register."""
        return self._ask(lambda: self._link.read(register))

    def read_poll(self) -> dict[str, Value]:
        """Values of the polled registers, always in the same blocks if the firmware reads across gaps."""
        if self._whole_block:
            try:
                blocks = [self._ask(lambda b=block: self._link.read_block(b)) for block in self.map.blocks]  # type: ignore[misc]
                return {name: value for block in blocks for name, value in block.items()}
            except RefusedError as error:
                if error.code != ILLEGAL_ADDRESS:
                    raise
                self._whole_block = False  # this firmware does not read across gaps
        return {name: self.read(self.map[name]) for name in self.map.poll}

    # ---- writing ----------------------------------------------------------------------------------------------------

    def check_target(self, target: float) -> None:
        """LimitError unless `target` [degC] is a set point that map, station and controller allow."""
        for name in ("setpoint", *self.map.setpoint_copies):
            self.map[name].encode(target)
        low, high = self.limits
        if not low <= target <= high:
            raise LimitError(
                f"set point {target:g} degC is outside the limits {low:g} to {high:g} degC; nothing was sent"
            )

    def write_target(self, target: float, *, always: bool = False) -> None:
        """Write the set point and its copies."""
        for name in ("setpoint", *self.map.setpoint_copies):
            self.write(name, target, always=always)

    def write(self, name: str, value: Value, *, always: bool = False) -> None:
        """Write when the value changes, or `always`, and read back."""
        if self.identity is None:
            raise IdentityError(f"{self.map.model}: nothing is written before identify()")
        words = self.map[name].encode(value)
        old, old_words = self._old(self.map[name])
        if self._identified_at != self._link.counters.connections:
            self.recognise()  # after a reconnection the equipment, its limits or its decimals may differ
            words = self.map[name].encode(value)
            if name in ("setpoint", *self.map.setpoint_copies):
                self.check_target(float(value))
        if words == old_words and not always:
            return
        register = self.map[name]
        self._spare_memory()
        self._send(register, value, words)
        read_back = self.read(register)
        if self._journal:
            self._journal(Write(self._clock.now(), name, old, value, read_back))
        if not register.agrees(value, read_back):
            raise ReadBackError(f"{name}: wrote {value} {register.unit}, reads back {read_back} {register.unit}")

    def send_target(self, target: float) -> None:
        """As `send`: the set point and its copies; LimitError outside the limits that were read at the start."""
        known, registers = self._as_known()
        low, high = known.limits
        if not low <= target <= high:
            raise LimitError(f"set point {target:g} degC is outside the limits {low:g} to {high:g} degC")
        self.send({name: target for name in ("setpoint", *registers.setpoint_copies)})

    def send(self, settings: Mapping[str, Value]) -> None:
        """Send writes once, unverified, with the data of the first recognition; nothing is read before or after.

        For the safe state of a controller whose answers cannot be trusted. All are sent, also when others fail; then
        LinkError or RefusedError when one got no valid answer, although the controller may have executed it.
        """
        errors: list[DriverError] = []
        for name, value in settings.items():
            try:
                self._send_unverified(name, value)
            except DriverError as error:
                errors.append(error)
        if errors:
            raise errors[0]

    def _send_unverified(self, name: str, value: Value) -> None:
        known, registers = self._as_known()
        register = registers[name]
        words = register.encode(value)
        sent, content = register, value
        if register.mask is not None:
            others = known.words.get(name, 0) & ~register.mask
            sent, content = register.whole_word, float(others | words[0])
        self.writes += 1
        try:
            self._link.send(sent, content)
        finally:
            if self._journal:
                self._journal(Write(self._clock.now(), name, NOT_READ, value, NOT_READ))

    # ---- inside -----------------------------------------------------------------------------------------------------

    def _as_known(self) -> tuple[Known, RegisterMap]:
        """Data of the first recognition, and the map with its decimals."""
        if self.known is None:
            raise IdentityError(f"{self._described.model}: it was never recognised")
        return self.known, self._described.with_decimals(self.known.decimals)

    def _ask(self, request: Callable[[], _T]) -> _T:
        """One request, unless its time limit has passed; refusals are explained by this controller's map."""
        if self._deadline and self._deadline():
            raise LinkError(f"{self.map.model}: the time limit of this step has passed; nothing was sent")
        try:
            return request()
        except RefusedError as error:
            meaning = self.map.exceptions.get(error.code)
            if meaning is None:
                raise
            raise RefusedError(f"{error} ({self.map.model}: {meaning})", error.code) from None

    def _identifying(self, name: str) -> Value:
        """Value of a register that identification needs; IdentityError when it cannot be read."""
        try:
            return self.read(self.map[name] if name not in self._described.decimals else self._described[name])
        except RefusedError as error:
            if error.code in NOT_NOW:  # this gives no information about its identity
                raise
            raise UnreadableError(f"{self.map.model}: {name} cannot be read: {error}") from error
        except LimitError as error:
            raise IdentityError(f"{self.map.model}: {error}") from error

    def _send(self, register: Register, value: Value, words: Iterable[int]) -> None:
        if register.mask is None:
            self._ask(lambda: self._link.write(register, value))
        else:
            word = register.whole_word
            (bits,) = words
            held = int(float(self.read(word)))
            if self.known is not None:
                self.known = replace(self.known, words={**self.known.words, register.name: held})
            others = held & ~register.mask
            self._ask(lambda: self._link.write(word, float(others | bits)))
        self.writes += 1

    def _spare_memory(self) -> None:
        if self.map.eeprom_writes is None or self._deadline is not None:
            return
        now_s = self._clock.now()
        while self._recent and self._recent[0] <= now_s - WEAR_WINDOW_S:
            self._recent.popleft()
        if len(self._recent) >= WEAR_WRITES:
            raise LimitError(
                f"{self.map.model}: {WEAR_WRITES} writes within {WEAR_WINDOW_S / 60:g} min, and its memory endures"
                f" {self.map.eeprom_writes}: nothing was sent; use its native ramp instead of stepping the set point"
            )
        self._recent.append(now_s)

    def _old(self, register: Register) -> tuple[Value, tuple[int, ...] | None]:
        """Value of the register before a write, with its words; None: a value that the driver would not write."""
        try:
            old = self.read(register)
        except LimitError as error:
            return str(error), None
        try:
            return old, register.encode(old)
        except LimitError:
            return old, None
