"""The thermal chamber: identified before it is commanded, every write read back, every reading checked.

Order of use: `identify()`, then `set_point()` or `ramp_to()`, then `start()`; `poll()` at every tick; `safe()` at the
end. Values outside the limits are refused: they are neither sent nor clipped. This driver is not a safety device: the
chamber keeps its own limit controller.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from drivers.clock import Clock
from drivers.controller import ILLEGAL_ADDRESS, Controller, Identity, Known, Write
from drivers.errors import (
    ConfigError,
    DriverError,
    IdentityError,
    LimitError,
    LinkError,
    NoConnectionError,
    ReadBackError,
    RefusedError,
    UnreadableError,
)
from drivers.modbus import ModbusLink
from drivers.registers import Register, RegisterMap, Value

__all__ = ["Chamber", "ChamberReading", "Identity", "Known", "SafeStep", "Write"]

SAFE_STEP_S = 30.0
"""Longest time [s] for one step to the safe state."""
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
    """Active alarms as `register: value`. Refreshed with the slower registers."""
    compressor: bool | None
    """None: the controller does not report it."""
    door: bool | None = None
    """Whether the door is open. None: the controller does not report it."""
    sensor_break: bool | None = None
    """Whether the controller has lost its sensor. None: it does not report it."""


@dataclass(frozen=True)
class SafeStep:
    """One step towards the safe state and whether a reading confirmed it."""

    what: str
    ok: bool
    detail: str
    sent: bool = False
    """The command was sent, but not verified."""


@dataclass(frozen=True)
class _Command:
    """A step to the safe state: as a verified write, and as an unverified one for when nothing can be read."""

    what: str
    verified: Callable[[], None]
    unverified: Callable[[], None]


class Chamber:
    """One control loop of one chamber. All methods raise DriverError subclasses, except `safe`."""

    def __init__(  # noqa: PLR0913 - each option has its default
        self,
        link: ModbusLink,
        registers: RegisterMap,
        limits: tuple[float, float],
        clock: Clock,
        *,
        journal: Callable[[Write], None] | None = None,
        secondary_s: float = 5.0,
        known: Known | None = None,
    ) -> None:
        """`limits` [degC] are the station's; `journal` sees every write; alarms are read every `secondary_s` [s].

        `known` holds what another process read from this controller when the run started; it suffices for `safe`.
        """
        if not (limits[0] < limits[1] and all(map(math.isfinite, limits))):
            raise ConfigError(f"chamber limits {limits[0]} to {limits[1]} degC: the first must be below the second")
        self._controller = Controller(link, registers, limits, clock, journal, known)
        self._clock = clock
        self._secondary_s = secondary_s
        self._secondary_due_s = -math.inf
        self._missing: set[str] = set()
        self._slow: dict[str, Value] = {}
        self._commanded: float | None = None
        self._on: bool | None = None
        self._switched_s = -math.inf

    @property
    def native_ramp(self) -> bool:
        """Whether `ramp_to` works; without it the host steps the set point."""
        return self._map.native_ramp

    @property
    def limits(self) -> tuple[float, float]:
        """Set points [degC] that station and controller both allow; the station's before `identify`."""
        return self._controller.limits

    @property
    def known(self) -> Known | None:
        """What `identify` read first; None before. A process that may have to make the chamber safe needs it."""
        return self._controller.known

    @property
    def commanded(self) -> float | None:
        """Last set point [degC] that this driver wrote and read back; a different one was set by an operator."""
        return self._commanded

    @property
    def writes(self) -> int:
        """Registers written since this object was made; the memory of some controllers endures a limited number."""
        return self._controller.writes

    # ---- reading ----------------------------------------------------------------------------------------------------

    def identify(self) -> Identity:
        """Read model, unit, decimals, set point limits and a plausible temperature; writes nothing.

        Raises IdentityError when this is not the controller that the map describes, or not in degC.
        """
        identity = self._controller.recognise()
        try:
            self.poll()
        except LimitError as error:
            raise IdentityError(f"{identity.model}: {error}") from error
        return identity

    def poll(self) -> ChamberReading:
        """Read the polled registers, always in the same blocks, and every `secondary_s` the slower ones.

        Raises LimitError when a value is impossible (NaN, outside the sensor's range), LinkError without an answer.
        """
        values = self._poll_block()
        t_s = self._clock.now()
        if t_s >= self._secondary_due_s:
            self._slow = self._poll_secondary()
            self._secondary_due_s = t_s + self._secondary_s
        values |= self._slow
        return ChamberReading(
            t_s=t_s,
            temperature=float(values["temperature"]),
            setpoint=float(values["setpoint"]),
            working_setpoint=_number(values.get("working_setpoint")),
            power=_number(values.get("power")),
            on=values[self._map.run.state] != self._map.run.off,
            alarm=tuple(f"{name}: {value}" for name, value in values.items() if self._map[name].is_alarm(value)),
            compressor=_flag(values.get("compressor"), "on"),
            door=_flag(values.get("door"), "open"),
            sensor_break=_flag(values.get("sensor_break"), "broken"),
        )

    def deviations(self) -> list[str]:
        """Every difference between the values in the controller and those that the bench commanded.

        For use after a reconnection: a chamber that lost power may run with another set point, or be off.
        """
        deviations = []
        if self._commanded is not None:
            for name in ("setpoint", *self._map.setpoint_copies):
                held = self._held(name)
                if not self._map[name].agrees(self._commanded, held):
                    text = f"{held:g} degC" if isinstance(held, float) else held
                    deviations.append(f"{name} is {text}, the bench commanded {self._commanded:g} degC")
        if self._on is not None:
            run = self._map.run
            commanded, held = run.on if self._on else run.off, self._held(run.state)
            if held != commanded:
                deviations.append(f"{run.state} is {held}, the bench commanded {commanded}")
        return deviations

    # ---- commanding -------------------------------------------------------------------------------------------------

    def set_point(self, target: float) -> None:
        """Go to `target` [degC] as fast as the chamber can."""
        self._controller.check_target(target)
        self._controller.write_target(target)  # before the ramp goes off, or the chamber would jump to the old target
        self._ramp_off()
        self._commanded = target

    def ramp_to(self, target: float, rate: float) -> None:
        """Let the controller move its set point to `target` [degC] at `rate` [degC/min]."""
        ramp = self._map.ramp
        if ramp is None:
            raise ConfigError(f"{self._map.model} has no native ramp: step the set point from the host")
        self._controller.check_target(target)
        if not rate > 0:
            raise LimitError(f"ramp rate {rate:g} degC/min must be above 0; nothing was sent")
        self._map[ramp.rate].encode(rate)
        self._controller.write(ramp.rate, rate)
        for name, value in ramp.on.items():
            self._controller.write(name, value)
        self._controller.write_target(target)
        self._commanded = target

    def hold(self) -> float:
        """Stop a native ramp at its current set point; returns that set point [degC]."""
        reading = self.poll()
        current = reading.setpoint if reading.working_setpoint is None else reading.working_setpoint
        self.set_point(current)
        return current

    def start(self) -> None:
        """Switch the chamber on; refused before a set point was written, since the old one is unknown.

        Waits until the compressor was off long enough.
        """
        if self._commanded is None:
            raise LimitError(f"{self._map.model}: start refused, no set point was commanded yet")
        if self._on is False:
            self._clock.sleep_until(self._switched_s + self._map.run.least_off_s)
        self._controller.write(self._map.run.register, self._map.run.on)
        self._switched(on=True)

    def stop(self) -> None:
        """Switch the chamber off and wait until it reports off. Raises ReadBackError when it does not.

        Waits until the compressor was on long enough; the safe state does not.
        """
        if self._on:
            self._clock.sleep_until(self._switched_s + self._map.run.least_on_s)
        self._off()

    def safe(self, ambient: float, limit_s: float = SAFE_STEP_S) -> list[SafeStep]:
        """Set point to `ambient` [degC] first, ramp off, then chamber off; each step read back; never raises.

        Every step is tried, also when others fail. Each has `limit_s` [s]; a request that was sent before this limit
        may still wait for its answer. As soon as a step cannot be verified, this step and all later ones are sent at
        once without verification, with the decimals and limits that were read at the start, so that switching off does
        not wait for an answer. The later steps are then tried again, verified.
        """
        steps = [
            _Command(
                f"set point to {ambient:g} degC",
                lambda: self._safe_setpoint(ambient),
                lambda: self._controller.send_target(ambient),
            ),
            _Command("ramp off", lambda: self._ramp_off(always=True), self._send_ramp_off),
            _Command("chamber off", lambda: self._off(always=True), self._send_off),
        ]  # ambient first: if switching off fails, the chamber goes to a harmless temperature
        self._controller.identity = None  # identify again; otherwise nothing counts as verified
        done: list[SafeStep] = []
        sent: dict[str, bool] = {}
        first: Exception | None = None
        for at, step in enumerate(steps):
            trouble = self._verified(step.verified, limit_s)
            if trouble is not None and not sent:
                sent = {later.what: self._sent(later, trouble) for later in steps[at:]}
            first = first or trouble
            done.append(
                SafeStep(step.what, trouble is None, _why(trouble, first), trouble is not None and sent[step.what])
            )
        return done

    # ---- inside -----------------------------------------------------------------------------------------------------

    @property
    def _map(self) -> RegisterMap:
        return self._controller.map

    def _held(self, name: str) -> Value:
        try:
            return self._controller.read(self._map[name])
        except LimitError as error:
            return str(error)

    def _poll_block(self) -> dict[str, Value]:
        try:
            return self._controller.read_poll()
        except LimitError as error:
            if "sensor_break" in self._map and self._held("sensor_break") == "broken":
                raise LimitError(f"{self._map.model} reports a broken sensor: {error}") from error
            raise

    def _poll_secondary(self) -> dict[str, Value]:
        values = {}
        for name in self._map.secondary:
            if name not in self._missing:
                value = self._read_slow(self._map[name])
                if value is not None:
                    values[name] = value
        return values

    def _read_slow(self, register: Register) -> Value | None:
        """Value of a slow register; None: the controller does not have it, or an uncertain register is implausible."""
        try:
            return self._controller.read(register)
        except RefusedError as error:
            if error.code != ILLEGAL_ADDRESS or not register.optional:
                raise
        except LimitError:
            if not register.uncertain:
                raise
        self._missing.add(register.name)
        return None

    def _verified(self, action: Callable[[], None], limit_s: float) -> Exception | None:
        """Perform the action and read it back; returns the error that prevented this, None on success."""
        try:
            with self._controller.within(limit_s):
                if self._controller.identity is None:
                    self._controller.recognise()  # a sensor break must not prevent switching off
                action()
        except Exception as error:  # the other steps to the safe state must still be tried
            return error
        return None

    def _sent(self, step: _Command, trouble: Exception) -> bool:
        """Send a step without verification; returns whether it was sent.

        A controller that identifies as another one, or uses another unit, would interpret our set point as another
        temperature: it is only switched off.
        """
        stranger = isinstance(trouble, IdentityError) and not isinstance(trouble, UnreadableError)
        if stranger and step.what.startswith("set point"):
            return False
        try:
            step.unverified()
        except NoConnectionError:
            return False
        except (LinkError, RefusedError):
            return True  # it was sent; its answer is not trusted
        except Exception:  # nothing was sent; the other steps must still be tried
            return False
        return True

    def _safe_setpoint(self, ambient: float) -> None:
        self._controller.check_target(ambient)
        self._controller.write_target(ambient, always=True)
        self._commanded = ambient

    def _ramp_off(self, *, always: bool = False) -> None:
        for name, value in self._map.ramp.off.items() if self._map.ramp else ():
            self._controller.write(name, value, always=always)

    def _send_ramp_off(self) -> None:
        if self._map.ramp:
            self._controller.send(self._map.ramp.off)

    def _off(self, *, always: bool = False) -> None:
        self._controller.write(self._map.run.register, self._map.run.off, always=always)
        state = self._map[self._map.run.state]
        for reading in range(_STATE_READINGS):
            if self._controller.read(state) == self._map.run.off:
                self._switched(on=False)
                return
            if reading < _STATE_READINGS - 1:
                self._clock.sleep_until(self._clock.now() + 1.0)
        raise ReadBackError(f"{state.name} is not {self._map.run.off} {_STATE_READINGS - 1} s after it was commanded")

    def _send_off(self) -> None:
        self._controller.send({self._map.run.register: self._map.run.off})

    def _switched(self, *, on: bool) -> None:
        if self._on is not on:
            self._on, self._switched_s = on, self._clock.now()


def _why(trouble: Exception | None, first: Exception | None) -> str:
    """Detail of a step; all steps that failed for lack of an answer state the reason of the first."""
    if trouble is None:
        return "read back"
    unanswered = (LinkError, RefusedError, IdentityError)
    shown = first if isinstance(trouble, unanswered) and isinstance(first, unanswered) else trouble
    return str(shown) if isinstance(shown, DriverError) else f"{type(shown).__name__}: {shown}"


def _number(value: Value | None) -> float | None:
    return None if value is None else float(value)


def _flag(value: Value | None, yes: str) -> bool | None:
    return None if value is None else value == yes
