"""A CiA 402 drive on a separate CAN channel, through `canopen`: what its modes of operation have in common.

The drive reports its encoder on a transmit PDO with each reading's time of arrival; one SDO read of the status word
ends every poll, so that everything the drive sent before has been received. The drive is configured to stop by itself
when our heartbeat is missing (0x1016, 0x6007). `poll` sends our heartbeat, so a hung bench stops the axis, too.
"""

from __future__ import annotations

import contextlib
import struct
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import can
import canopen

from drivers import cia402
from drivers.clock import Clock, SimClock
from drivers.errors import ConfigError, IdentityError, LinkError, ReadBackError, RefusedError
from drivers.rate_table import STOPPED_DPS, SafeStep, TableArray, TableLimits, attempt, table_array

MASTER = 0x7F
"""Our node number, for the heartbeat that the drive supervises."""
ANSWER_S, ANSWERS = 0.5, 3
"""Timeout of an answer [s], and attempts: together less than the drive's heartbeat timeout."""
_PDO, _BEAT = 0x180, 0x700


@dataclass(frozen=True)
class Drive:
    """Settings that cannot be read from the drive."""

    node: int
    counts_per_degree: float
    """Units of position per degree of the axis, gear included; velocity in the same units per second."""
    sample_ms: int = 20
    """Interval of the encoder readings."""
    heartbeat_s: float = 3.0
    """Longest interval without a heartbeat, in either direction, before the axis is stopped."""
    latency_s: float = 0.0
    """Lag of a reading's velocity behind the motion."""


class CanopenDrive:
    """One axis. The caller owns the bus; what else sends on it uses other identifiers."""

    MODE: int
    """Mode of operation, object 0x6060."""
    MODE_NAME: str
    NAME: str
    """What the axis belongs to, for messages."""

    def __init__(
        self,
        bus: can.BusABC,
        drive: Drive,
        limits: TableLimits,
        clock: Clock,
    ) -> None:
        self.limits = limits
        self.commanded_dps = 0.0
        self.enabled = False
        self._drive, self._clock = drive, clock
        self._readings: deque[tuple[float, float, float]] = deque()
        self._turns = 0  # of the 32-bit position register
        self._last_counts = 0
        self._last_sign_s = clock.now()
        self._beats = 0
        self._by_pdo = False
        if limits.rate_dps * drive.counts_per_degree >= 1 << 31:
            text = f"{limits.rate_dps:g} deg/s at {drive.counts_per_degree:g} counts per degree"
            raise ConfigError(f"{self}: {text} does not fit the drive's 32 bits; lower the limit or the resolution")
        self._network = canopen.Network(bus)
        self._network.NOTIFIER_CYCLE = 0.05
        self._network.subscribe(_PDO + drive.node, self._on_reading)
        self._network.subscribe(_BEAT + drive.node, self._on_beat)
        self._network.connect()
        self._node = self._network.add_node(canopen.RemoteNode(drive.node, cia402.dictionary()))
        self._node.sdo.RESPONSE_TIMEOUT, self._node.sdo.MAX_RETRIES = ANSWER_S, ANSWERS

    # ---- before it turns --------------------------------------------------------------------------------------------

    def identify(self) -> str:
        """Check device profile 402 and the mode of operation; IdentityError. Writes nothing."""
        profile = self._get(cia402.DEVICE_TYPE) & 0xFFFF
        if profile != cia402.PROFILE_402:
            raise IdentityError(f"{self}: device profile {profile}, not {cia402.PROFILE_402}: not a CiA 402 drive")
        if not self._get(cia402.SUPPORTED_MODES) >> (self.MODE - 1) & 1:
            raise IdentityError(f"{self}: the drive has no {self.MODE_NAME} mode")
        return f"CiA 402 drive, node {self._drive.node}, {self._state()}"

    def prepare(self) -> tuple[str, ...]:
        """Set up encoder readings by PDO, heartbeats in both directions, quick stop when ours is missing."""
        missing = []
        consumer = MASTER << 16 | round(1000 * self._drive.heartbeat_s)
        for what, action in (
            ("readings by PDO (they are polled)", self._map_readings),
            ("heartbeat", lambda: self._set(cia402.PRODUCER_HEARTBEAT, round(250 * self._drive.heartbeat_s))),
            ("supervision of our heartbeat", lambda: self._set(cia402.CONSUMER_HEARTBEAT, consumer, 1)),
            (
                "quick stop when our heartbeat is missing",
                lambda: self._set(cia402.ABORT_OPTION, cia402.ON_ABORT_QUICK_STOP),
            ),
            ("quick stop that holds", lambda: self._set(cia402.QUICK_STOP_OPTION, cia402.QUICK_STOP_AND_STAY)),
            ("quick stop ramp", lambda: self._set(cia402.QUICK_STOP_DECELERATION, self._counts(self._accel(None)))),
        ):
            try:
                action()
            except RefusedError as error:
                missing.append(f"{what}: {error}")
        self._node.nmt.send_command(0x01)  # operational
        self._last_sign_s = self._clock.now()
        return tuple(missing)

    def _switch_on(self) -> None:
        """Go through the state machine to `operation enabled`; a fault is never cleared. The target is set before."""
        self.enabled = True
        for command in (cia402.SHUTDOWN, cia402.SWITCH_ON, cia402.ENABLE_OPERATION):
            self._command(command)
        self._await(lambda: self._state() == cia402.ENABLED, 5.0, "operation enabled")

    def _set_mode(self) -> None:
        """RefusedError where the drive has a fault."""
        self._refuse_fault()
        self._set(cia402.MODE, self.MODE)
        if (mode := self._get(cia402.MODE_DISPLAY)) != self.MODE:
            raise ReadBackError(f"{self}: mode of operation is {mode}, commanded {self.MODE}")

    # ---- encoder -----------------------------------------------------------------------------------------------------

    def rate(self) -> float:
        """Current rate by the drive's encoder [deg/s]."""
        return self._get(cia402.VELOCITY) / self._drive.counts_per_degree

    def position(self) -> float:
        """Current position by the drive's encoder [deg]."""
        return self._get(cia402.POSITION) / self._drive.counts_per_degree

    def poll(self) -> TableArray:
        """Readings since the last call.

        Raises RefusedError for a fault, ReadBackError for an axis that was switched off, LinkError when the drive does
        not answer.
        """
        self._beat()
        self._refuse_fault()
        if self.enabled and (now := self._state()) != cia402.ENABLED:
            raise ReadBackError(
                f"{self}: the axis is in state '{now}', not '{cia402.ENABLED}': it was switched off externally"
            )
        if not self._by_pdo:
            self._on_reading(0, struct.pack("<ii", self._get(cia402.POSITION), self._get(cia402.VELOCITY)), None)
        beats, self._beats = self._beats, 0
        rows = [self._readings.popleft() for _ in range(len(self._readings))]
        now_s = self._clock.now()
        if beats or rows:
            self._last_sign_s = now_s
        if now_s - self._last_sign_s > self._drive.heartbeat_s:
            raise LinkError(f"{self}: neither readings nor a heartbeat for {now_s - self._last_sign_s:.0f} s")
        return table_array(rows)

    # ---- the end ----------------------------------------------------------------------------------------------------

    def safe(self) -> list[SafeStep]:
        """Quick stop, verify the standstill, switch the voltage off; a drive that was never enabled is not changed."""
        if not self.enabled:
            return []
        steps = [
            attempt(f"{self.NAME} quick stop", self._quick_stop),
            attempt(f"{self.NAME} stands", self._stand),
            attempt(f"{self.NAME} off", self._disable),
        ]
        self.enabled = not all(step.ok for step in steps)
        return steps

    def close(self) -> None:
        """Stop receiving; the drive continues to supervise our heartbeat."""
        if self._network.notifier is not None:
            self._network.notifier.stop()
            self._network.notifier = None

    def __str__(self) -> str:
        return f"{self.NAME} node {self._drive.node}"

    def _quick_stop(self) -> str:
        self.commanded_dps = 0.0
        self._command(cia402.QUICK_STOP)
        self._await(lambda: self._state() != cia402.ENABLED, 2.0, "quick stop")
        return f"state {self._state()}"

    def _stand(self) -> str:
        limit_s = abs(self.rate()) / self.limits.accel_dps2 + 5.0
        self._await(lambda: abs(self.rate()) < STOPPED_DPS, limit_s, "standing")
        return f"encoder reads {self.rate():.3f} deg/s"

    def _disable(self) -> str:
        with contextlib.suppress(RefusedError):
            self._set(cia402.TARGET_VELOCITY, 0)  # so that it stands still when it is enabled next
        self._command(cia402.DISABLE_VOLTAGE)
        self._await(lambda: self._state() in {"switch on disabled", cia402.FAULT}, 2.0, "voltage off")
        return f"state {self._state()}"

    # ---- inside -----------------------------------------------------------------------------------------------------

    def _map_readings(self) -> None:
        """Position and velocity on the first transmit PDO, by its event timer (CiA 301, 7.5.2.35)."""
        cob_id = _PDO + self._drive.node
        self._set(cia402.TPDO1, 1 << 31 | cob_id, 1)
        self._set(cia402.TPDO1_MAP, 0, 0)
        for sub, index in ((1, cia402.POSITION), (2, cia402.VELOCITY)):
            self._set(cia402.TPDO1_MAP, cia402.mapped(index), sub)
        self._set(cia402.TPDO1_MAP, 2, 0)
        self._set(cia402.TPDO1, 255, 2)
        self._set(cia402.TPDO1, self._drive.sample_ms, 5)
        self._set(cia402.TPDO1, cob_id, 1)
        self._by_pdo = True

    def _on_reading(self, cob_id: int, data: bytes | bytearray, timestamp_s: float | None) -> None:
        counts, velocity = struct.unpack_from("<ii", data)
        # A simulated message carries bench time. What stamps a real one has depends on the interface; when it reached
        # us does not.
        t_s = timestamp_s if timestamp_s is not None and isinstance(self._clock, SimClock) else self._clock.now()
        if abs(counts - self._last_counts) > 1 << 31:  # the register overflowed
            self._turns += 1 if counts < self._last_counts else -1
        self._last_counts = counts
        per_degree = self._drive.counts_per_degree
        position = (counts + (self._turns << 32)) / per_degree
        self._readings.append((t_s - self._drive.latency_s, velocity / per_degree, position))

    def _on_beat(self, cob_id: int, data: bytearray, timestamp_s: float) -> None:
        self._beats += 1

    def _beat(self) -> None:
        with self._wire("heartbeat"):
            self._network.send_message(_BEAT + MASTER, b"\5")
            self._network.check()  # the receiving thread does not report its end

    def _refuse_fault(self) -> None:
        if self._state() in {cia402.FAULT, "fault reaction active"}:
            code = self._get(cia402.ERROR_CODE)
            raise RefusedError(f"{self}: drive fault 0x{code:04X}; find the cause and reset it at the drive", code)

    def _await(self, condition: Callable[[], bool], limit_s: float, what: str) -> None:
        until_s = self._clock.now() + limit_s
        while not condition():
            if self._clock.now() >= until_s:
                text = f"not '{what}' within {limit_s:.1f} s: state '{self._state()}', {self.rate():.2f} deg/s"
                raise ReadBackError(f"{self}: {text}")
            self._wait(0.1)

    def _wait(self, time_s: float) -> None:
        """Wait [s], sending heartbeats."""
        until_s = self._clock.now() + time_s
        while self._clock.now() < until_s - 1e-6:
            self._beat()
            self._clock.sleep_until(min(self._clock.now() + 0.1, until_s))

    def _accel(self, given: float | None) -> float:
        return self.limits.accel_dps2 if given is None else given

    def _counts(self, degrees: float) -> int:
        return round(degrees * self._drive.counts_per_degree)

    def _state(self) -> str:
        return cia402.state(self._get(cia402.STATUS))

    def _command(self, control: int) -> None:
        with self._wire("controlword"):
            self._node.sdo[cia402.CONTROL].raw = control

    def _get(self, index: int, sub: int = 0) -> int:
        with self._wire(f"0x{index:04X}:{sub}"):
            return int(self._entry(index, sub).raw)

    def _set(self, index: int, value: int, sub: int = 0) -> None:
        """Write and read back."""
        with self._wire(f"0x{index:04X}:{sub}"):
            self._entry(index, sub).raw = value
        if (read := self._get(index, sub)) != value:
            raise ReadBackError(f"{self}: 0x{index:04X}:{sub}: wrote {value}, reads back {read}")

    def _entry(self, index: int, sub: int) -> Any:
        entry = self._node.sdo[index]
        return entry[sub] if index in cia402.RECORDS else entry

    @contextmanager
    def _wire(self, what: str) -> Iterator[None]:
        try:
            yield
        except canopen.SdoAbortedError as error:
            raise RefusedError(f"{self}: {what}: {error}", error.code) from error
        except (canopen.SdoCommunicationError, can.CanError, OSError) as error:
            raise LinkError(f"{self}: {what}: {' '.join(str(error).split()) or type(error).__name__}") from error
