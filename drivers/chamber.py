"""The thermal chamber: identified before it is commanded, every write read back, every reading checked.

Order of use: `identify()`, then `set_point()` or `ramp_to()`, then `start()`; `poll()` at every tick; `safe()` at the
end. Nothing outside the limits is ever sent, and nothing is clipped to them. This driver is no safety device: the
chamber keeps its own limit controller.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass

from drivers.clock import Clock
from drivers.errors import ConfigError, DriverError, IdentityError, LimitError, ReadBackError, RefusedError
from drivers.modbus import ModbusLink
from drivers.registers import Register, RegisterMap, Value

_ILLEGAL_ADDRESS = 2
_STATE_READINGS = 5


@dataclass(frozen=True)
class ChamberReading:
    """One poll of the chamber; temperatures [degC]."""

    t_s: float
    """Bench time of the answer [s]."""
    temperature: float
    setpoint: float
    """Target."""
    working_setpoint: float | None
    """Set point in force; moves during a native ramp."""
    power: float | None
    """Output [%], heating positive."""
    on: bool
    alarm: tuple[str, ...]
    """Active alarms as `register: value`; empty: none. Refreshed with the slower registers."""
    compressor: bool | None
    """None: the controller does not tell."""


@dataclass(frozen=True)
class Identity:
    """What the controller said about itself."""

    model: str
    answers: tuple[tuple[str, str], ...]
    """Register and value of every rule that it satisfied."""
    limits: tuple[float, float]
    """Set points that station and controller both allow [degC]."""


@dataclass(frozen=True)
class Write:
    """One write for the journal."""

    t_s: float
    register: str
    old: Value
    new: Value
    read_back: Value


@dataclass(frozen=True)
class SafeStep:
    """One step towards the safe state and whether a reading confirmed it."""

    what: str
    ok: bool
    detail: str


class Chamber:
    """One control loop of one chamber. All methods raise DriverError subclasses, except `safe`."""

    def __init__(
        self,
        link: ModbusLink,
        registers: RegisterMap,
        limits: tuple[float, float],
        clock: Clock,
        *,
        journal: Callable[[Write], None] | None = None,
        secondary_s: float = 5.0,
    ) -> None:
        """`limits` [degC] are the station's; `journal` sees every write; alarms are read every `secondary_s` [s]."""
        if not (limits[0] < limits[1] and all(map(math.isfinite, limits))):
            raise ConfigError(f"chamber limits {limits[0]} to {limits[1]} degC are no range")
        self._link = link
        self._map = registers
        self._station_limits = limits
        self._clock = clock
        self._journal = journal
        self._secondary_s = secondary_s
        self._secondary_due_s = -math.inf
        self._slow = [registers[name] for name in registers.secondary]
        self._alarm: tuple[str, ...] = ()
        self._compressor: bool | None = None
        self._whole_block = True
        self._identity: Identity | None = None
        self._identified_at = -1
        self._commanded: float | None = None

    @property
    def native_ramp(self) -> bool:
        """Whether `ramp_to` works; without it the host steps the set point."""
        return self._map.native_ramp

    @property
    def limits(self) -> tuple[float, float]:
        """Set points [degC] that station and controller both allow; the station's before `identify`."""
        return self._identity.limits if self._identity else self._station_limits

    @property
    def commanded(self) -> float | None:
        """Last set point [degC] that this driver wrote and read back; another one in force is an operator's."""
        return self._commanded

    # ---- reading ----------------------------------------------------------------------------------------------------

    def identify(self) -> Identity:
        """Read model, unit, set point limits and a plausible temperature; writes nothing.

        Raises IdentityError when this is not the controller that the map describes, or not in degC.
        """
        identity = self._recognise()
        try:
            self.poll()
        except LimitError as error:
            raise IdentityError(f"{identity.model}: {error}") from error
        return identity

    def poll(self) -> ChamberReading:
        """The polled registers, always in the same blocks, and from time to time the slower ones.

        Raises LimitError when a value cannot be true (NaN, outside the sensor's range), LinkError without an answer.
        """
        values = self._poll_block()
        t_s = self._clock.now()
        if t_s >= self._secondary_due_s:
            self._poll_secondary()
            self._secondary_due_s = t_s + self._secondary_s
        working, power = values.get("working_setpoint"), values.get("power")
        return ChamberReading(
            t_s=t_s,
            temperature=float(values["temperature"]),
            setpoint=float(values["setpoint"]),
            working_setpoint=None if working is None else float(working),
            power=None if power is None else float(power),
            on=values[self._map.run.state] != self._map.run.off,
            alarm=self._alarm,
            compressor=self._compressor,
        )

    # ---- commanding -------------------------------------------------------------------------------------------------

    def set_point(self, target: float) -> None:
        """Go to `target` [degC] as fast as the chamber can."""
        self._check_target(target)
        self._write("setpoint", target)  # before the ramp goes off, or the chamber would jump to the old target
        self._ramp_off()
        self._commanded = target

    def ramp_to(self, target: float, rate: float) -> None:
        """Let the controller move its set point to `target` [degC] at `rate` [degC/min]."""
        ramp = self._map.ramp
        if ramp is None:
            raise ConfigError(f"{self._map.model} has no ramp of its own: step the set point from the host")
        self._check_target(target)
        self._map[ramp.rate].encode(rate)
        self._write(ramp.rate, rate)
        for name, value in ramp.on.items():
            self._write(name, value)
        self._write("setpoint", target)
        self._commanded = target

    def hold(self) -> float:
        """Stop a native ramp where it is; returns the set point [degC] that is held."""
        reading = self.poll()
        here = reading.setpoint if reading.working_setpoint is None else reading.working_setpoint
        self.set_point(here)
        return here

    def start(self) -> None:
        """Switch the chamber on; refused before a set point was written, since the old one may be anybody's."""
        if self._commanded is None:
            raise LimitError(f"{self._map.model}: start refused, no set point was commanded yet")
        self._write(self._map.run.register, self._map.run.on)

    def stop(self) -> None:
        """Switch the chamber off and wait until it says so. Raises ReadBackError when it does not."""
        self._write(self._map.run.register, self._map.run.off)
        state = self._map[self._map.run.state]
        for reading in range(_STATE_READINGS):
            if self._link.read(state) == self._map.run.off:
                return
            if reading < _STATE_READINGS - 1:
                self._clock.sleep_until(self._clock.now() + 1.0)
        raise ReadBackError(f"{state.name} is not {self._map.run.off} {_STATE_READINGS - 1} s after it was commanded")

    def safe(self, ambient: float) -> list[SafeStep]:
        """Set point to `ambient` [degC] first, ramp off, then chamber off; each step read back; never raises.

        A later step is tried even when an earlier one failed.
        """
        steps = [
            (f"set point to {ambient:g} degC", lambda: self._safe_setpoint(ambient)),
            ("ramp off", self._ramp_off),
            ("chamber off", self.stop),
        ]  # ambient first: should off fail, the chamber is driven to where it does no harm
        return [self._attempt(what, action) for what, action in steps]

    # ---- inside -----------------------------------------------------------------------------------------------------

    def _recognise(self) -> Identity:
        """Identity rules and limits; what a write needs. A sensor break does not keep us from switching off."""
        answers = []
        for rule in self._map.identify:
            value = str(self._link.read(self._map[rule.register]))
            if not re.search(rule.pattern, value):
                raise IdentityError(f"{self._map.model}: {rule.register} reads {value!r}; {rule.why}")
            answers.append((rule.register, value))
        low, high = self._station_limits
        if "setpoint_low" in self._map:
            low = max(low, float(self._link.read(self._map["setpoint_low"])))
        if "setpoint_high" in self._map:
            high = min(high, float(self._link.read(self._map["setpoint_high"])))
        if low >= high:
            raise IdentityError(
                f"{self._map.model}: station and controller allow no common set point ({low:g}, {high:g})"
            )
        self._identity = Identity(self._map.model, tuple(answers), (low, high))
        self._identified_at = self._link.counters.connections
        return self._identity

    def _poll_block(self) -> dict[str, Value]:
        if self._whole_block:
            try:
                return {name: v for block in self._map.blocks for name, v in self._link.read_block(block).items()}
            except RefusedError as error:
                if error.code != _ILLEGAL_ADDRESS:
                    raise
                self._whole_block = False  # this firmware does not read across its gaps
        return {name: self._link.read(self._map[name]) for name in self._map.poll}

    def _poll_secondary(self) -> None:
        alarms = []
        for register in list(self._slow):
            try:
                value = self._link.read(register)
            except RefusedError as error:
                if error.code != _ILLEGAL_ADDRESS or not register.optional:
                    raise
                self._slow.remove(register)  # this controller does not have it
                continue
            if register.is_alarm(value):
                alarms.append(f"{register.name}: {value}")
            if register.name == "compressor":
                self._compressor = value == "on"
        self._alarm = tuple(alarms)

    def _check_target(self, target: float) -> None:
        self._map["setpoint"].encode(target)
        low, high = self.limits
        if not low <= target <= high:
            raise LimitError(
                f"set point {target:g} degC is outside the limits {low:g} to {high:g} degC; nothing was sent"
            )

    def _attempt(self, what: str, action: Callable[[], None]) -> SafeStep:
        try:
            if self._identity is None:
                self._recognise()
            action()
        except DriverError as error:
            return SafeStep(what, False, str(error))
        except Exception as error:  # the way to the safe state goes on whatever happens
            return SafeStep(what, False, f"{type(error).__name__}: {error}")
        return SafeStep(what, True, "read back")

    def _safe_setpoint(self, ambient: float) -> None:
        self._check_target(ambient)
        self._write("setpoint", ambient)
        self._commanded = ambient

    def _ramp_off(self) -> None:
        for name, value in self._map.ramp.off.items() if self._map.ramp else ():
            self._write(name, value)

    def _write(self, name: str, value: Value) -> None:
        """Write when it changes something, and read back; the only place that writes."""
        register = self._map[name]
        words = register.encode(value)
        if self._identity is None:
            raise IdentityError(f"{self._map.model}: nothing is written before identify()")
        old, old_words = self._old(register)
        if self._identified_at != self._link.counters.connections:
            self._recognise()  # after a reconnection the equipment, or its limits, may be others
            if name == "setpoint":
                self._check_target(float(value))
        if words == old_words:
            return
        self._link.write(register, value)
        read_back = self._link.read(register)
        if self._journal:
            self._journal(Write(self._clock.now(), name, old, value, read_back))
        if not register.agrees(value, read_back):
            raise ReadBackError(f"{name}: wrote {value} {register.unit}, reads back {read_back} {register.unit}")

    def _old(self, register: Register) -> tuple[Value, tuple[int, ...] | None]:
        """What the register holds before a write, with its words; None: nothing that we would have written."""
        try:
            old = self._link.read(register)
        except LimitError as error:
            return str(error), None
        try:
            return old, register.encode(old)
        except LimitError:
            return old, None
