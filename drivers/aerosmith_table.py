"""An Ideal Aerosmith rate table (1270VS and relatives): ASCII over RS-232, 9600 8N1.

A command ends with CR, an answer with `>`; a `?` in the answer is an error. Source: two independent public programs
that drive such tables (a sinusoid test and a laboratory's README), not the manufacturer's manual. What they do not
define is marked uncertain below and verified on the table. The rate is computed from position over time, so it is
correct for any unit of JOG. This protocol does not stop the axis when the bench stops responding: set the table's own
limit.
"""

from __future__ import annotations

import contextlib
import re
from dataclasses import dataclass
from typing import Literal

import serial

from drivers.clock import Clock
from drivers.errors import IdentityError, LinkError, ReadBackError, RefusedError
from drivers.rate_table import STOPPED_DPS, SafeStep, TableArray, TableLimits, attempt, table_array

JogUnit = Literal["deg/s", "deg/min"]
JOG_PER_DPS: dict[JogUnit, float] = {"deg/s": 1.0, "deg/min": 60.0}
"""Uncertain: one source sends +-360 and comments `1-21600 deg/min`. Verified by position over time in `enable`."""
SERVO_ON, SERVO_OFF = "SRV1", "SRV0"
"""Uncertain: the sources give SRV as the motor command, without its argument."""
ERROR = "?"
PROBE_S = 6.0
_NUMBER = re.compile(r"[-+]?\d+(?:\.\d*)?")


@dataclass(frozen=True)
class Line:
    """The serial line."""

    port: str
    baudrate: int = 9600
    timeout_s: float = 1.0


class AerosmithTable:
    """One axis on a serial line. See `drivers.rate_table.RateTable`."""

    def __init__(self, line: Line, limits: TableLimits, clock: Clock, jog_unit: JogUnit = "deg/s") -> None:
        self.limits = limits
        self.commanded_dps = 0.0
        self.enabled = False
        self._clock, self._unit = clock, jog_unit
        self._last: tuple[float, float] | None = None
        self._turns_deg = 0.0
        self._name = f"rate table on {line.port}"
        try:
            self._port = serial.Serial(line.port, line.baudrate, timeout=line.timeout_s, exclusive=True)
        except (OSError, ValueError) as error:
            raise LinkError(f"{self._name} does not open: {error}") from error

    def identify(self) -> str:
        """Check that position and motion status have the described form; nothing moves."""
        position, moving = self._number("PPO"), self._number("MCO5")
        return f"{self._name}: position {position:g} deg, motion status {moving:g}"

    def prepare(self) -> tuple[str, ...]:
        """Nothing to set up."""
        return ("the table does not stop by itself when the bench stops sending",)

    def enable(self) -> None:
        """Switch the motor on, then verify the unit of JOG by position over time, at JOG1."""
        self.enabled = True
        self._ask(SERVO_ON)
        self._ask(f"ACL{self.limits.accel_dps2:g}")
        self._ask("JOG1")
        measured = self._measure(PROBE_S)
        self.stop()
        expected = 1.0 / JOG_PER_DPS[self._unit]
        if not abs(measured - expected) <= 0.1 * expected:
            near = next((unit for unit, per in JOG_PER_DPS.items() if abs(measured * per - 1.0) <= 0.1), "unknown")
            text = f"JOG1 turns {measured:.4f} deg/s: the unit is {near}, the station file states {self._unit}"
            raise IdentityError(f"{self._name}: {text}; correct jog_unit")

    def set_rate(self, rate_dps: float, accel_dps2: float | None = None) -> None:
        """Set the acceleration, then jog; the protocol cannot read either back, `poll` shows the rate."""
        accel = self.limits.accel_dps2 if accel_dps2 is None else accel_dps2
        self.limits.check(rate_dps, accel)
        self._ask(f"ACL{accel:g}")
        self._ask(f"JOG{rate_dps * JOG_PER_DPS[self._unit]:.6g}")
        self.commanded_dps = rate_dps

    def rate(self) -> float:
        """Position over half a second [deg/s]."""
        return self._measure(0.5)

    def position(self) -> float:
        """Current encoder position, turns included [deg]."""
        return self._read()[1]

    def poll(self) -> TableArray:
        """One reading: the mean rate since the last call, in the middle of that time."""
        before = self._last
        now_s, position = self._read()
        if before is None or now_s <= before[0]:
            return table_array(())
        return table_array([((before[0] + now_s) / 2, (position - before[1]) / (now_s - before[0]), position)])

    def stop(self) -> None:
        """Send STO, then wait until the position is constant."""
        limit_s = abs(self.commanded_dps) / self.limits.accel_dps2 + 5.0
        self._ask("STO")
        self.commanded_dps = 0.0
        until_s = self._clock.now() + limit_s
        while abs(now_dps := self.rate()) > STOPPED_DPS:
            if self._clock.now() >= until_s:
                raise ReadBackError(f"{self._name}: still turns at {now_dps:.2f} deg/s {limit_s:.0f} s after STO")

    def safe(self) -> list[SafeStep]:
        """Stop, verify the standstill, switch the motor off."""
        if not self.enabled:
            return []
        steps = [attempt("rate table stands", self._stand), attempt("rate table off", self._switch_off)]
        self.enabled = not all(step.ok for step in steps)
        return steps

    def close(self) -> None:
        """Close the line."""
        self._port.close()

    def _stand(self) -> str:
        self.stop()
        return f"position is constant, motion status {self._number('MCO5'):g}"

    def _switch_off(self) -> str:
        self._ask(SERVO_OFF)
        return "acknowledged"

    def _measure(self, time_s: float) -> float:
        """Position over time [deg/s], after the table has reached its rate."""
        if time_s > 1.0:
            self._clock.sleep_until(self._clock.now() + 1.0)
        from_s, start = self._read()
        self._clock.sleep_until(from_s + time_s)
        to_s, end = self._read()
        return (end - start) / (to_s - from_s)

    def _read(self) -> tuple[float, float]:
        """Bench time [s] and position [deg]; a position that is counted modulo 360 is unwrapped."""
        sent_s = self._clock.now()
        answer = self._number("PPO")
        t_s = (sent_s + self._clock.now()) / 2
        if self._last is None:
            position = answer
        else:
            expected = self._last[1] + self.commanded_dps * (t_s - self._last[0])
            position = answer + self._turns_deg
            if abs(position - expected) > 180.0:
                self._turns_deg += 360.0 * round((expected - position) / 360.0)
                position = answer + self._turns_deg
        self._last = t_s, position
        return self._last

    def _number(self, command: str) -> float:
        answer = self._ask(command)
        if (match := _NUMBER.search(answer)) is None:
            raise IdentityError(f"{self._name}: {command} answers {answer!r}, which contains no number")
        return float(match.group())

    def _ask(self, command: str) -> str:
        """Send a command and return its answer; unread bytes of earlier answers are discarded first."""
        try:
            self._port.reset_input_buffer()
            self._port.write(f"{command}\r".encode("ascii"))
            raw = bytes(self._port.read_until(b">"))
        except (OSError, serial.SerialException) as error:
            raise LinkError(f"{self._name}: {command}: {error}") from error
        if not raw.endswith(b">"):
            with contextlib.suppress(OSError):
                self._port.reset_input_buffer()
            raise LinkError(f"{self._name}: {command}: no answer within {self._port.timeout:g} s")
        answer = raw[:-1].decode("ascii", errors="replace").strip()
        if ERROR in answer:
            raise RefusedError(f"{self._name}: {command} was refused: {answer!r}", 0)
        return answer.removeprefix(command).strip()
