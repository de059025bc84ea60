"""Simulated rate table or axis of a fixture: a CiA 402 drive on a CAN bus with an axis behind it, stepped by the
simulated clock.

The axis follows its target velocity with limited acceleration and a small wobble, or goes to its target position by a
trapezoidal profile; an encoder with finite resolution and noise
reads it, and the drive sends its readings on a transmit PDO by its event timer. The thread of the CANopen network
answers requests; apart from this, nothing happens between two steps, so a run is deterministic.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

import can
import canopen
import numpy as np
import numpy.typing as npt

from drivers import cia402
from drivers.sim.truth.base import OrnsteinUhlenbeck

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

NODE_S = 0.02
"""Interval of encoder readings [s]; between two readings the rate is a straight line."""
_MASTER = 0x77F
_SET_POINT = 1 << 4
_WINDOW, _STANDS_DPS = 20, 0.01
"""Position window [counts] and rate [deg/s] within which the target is reached."""
_GAIN_HZ = 8.0
"""Of the position controller."""
_QUICK = {cia402.STOPPING, cia402.FAULT}


@dataclass(frozen=True)
class TableSettings:
    """The axis and its encoder."""

    counts_per_degree: float = 2**22 / 360
    wobble_dps: float = 0.0003
    """Standard deviation of the rate about its target."""
    encoder_noise_counts: float = 0.5
    scale_error_ppm: float = 0.0
    """How much more than the true angle the encoder counts."""
    velocity_unit: float = 1.0
    """Units of velocity in one count per second; not 1 for a drive with another velocity setting."""

    @property
    def true_counts_per_degree(self) -> float:
        """Counts in one true degree of the axis."""
        return self.counts_per_degree * (1.0 + 1e-6 * self.scale_error_ppm)


class SimulatedTable:
    """Node `node_id` on an open python-can bus; `advance` returns the rate applied to the unit on the table."""

    def __init__(self, bus: can.BusABC, node_id: int, settings: TableSettings = TableSettings(), seed: int = 1) -> None:
        self.settings = settings
        self.state = "switch on disabled"
        self.rate_dps = self.angle_deg = 0.0
        self._bus = bus
        self._network = canopen.Network(bus)
        self._network.NOTIFIER_CYCLE = 0.05
        self._network.connect()
        self._node = self._network.create_node(node_id, cia402.dictionary())
        self._node.remove_network()
        self._node._write_callbacks.clear()  # its own heartbeat would run on wall time
        self._node.associate_network(self._network)
        self._node.add_write_callback(self._written)
        self._node.add_read_callback(self._read)
        self._master_beat = False
        self._network.subscribe(_MASTER, self._on_master_beat)
        self._master_s: float | None = None
        self._rng = np.random.default_rng([seed, 402])
        self._wobble = OrnsteinUhlenbeck(np.array([0.5]), np.array([1.0]), NODE_S, np.random.default_rng([seed, 403]))
        self._profile_dps = 0.0
        self._counts = 0
        self._velocity = 0
        self._beat_due_s = self._pdo_due_s = 0.0
        self._error_code = 0
        self._is_cut = False
        self._set_point: int | None = None
        self._taken = False

    def advance(self, t0_s: float, t1_s: float) -> FloatArray:
        """Advance from `t0_s` to `t1_s`; returns the rate [deg/s] at nodes every 20 ms, (n + 1,)."""
        n = max(round((t1_s - t0_s) / NODE_S), 1)
        self._supervise(t0_s)
        step_s = (t1_s - t0_s) / n
        rates = self._rates(n, step_s)
        angles = self.angle_deg + np.concatenate([[0.0], np.cumsum((rates[1:] + rates[:-1]) * (0.5 * step_s))])
        true_counts = angles[1:] * self.settings.true_counts_per_degree
        noise = self.settings.encoder_noise_counts * self._rng.standard_normal(n)
        counts = np.round(true_counts + noise).astype(np.int64)
        velocity = np.round(np.diff(counts, prepend=self._counts) / step_s * self.settings.velocity_unit).astype(
            np.int64
        )
        self._report(t0_s + step_s * np.arange(1, n + 1, dtype=np.float64), counts, velocity)
        self._counts, self._velocity = int(counts[-1]), int(velocity[-1])
        self.rate_dps, self.angle_deg = float(rates[-1]), float(angles[-1])
        return rates

    def fail(self, error_code: int) -> None:
        """Cause a drive fault: the drive brakes by itself and reports the fault until it is reset."""
        self.state, self._error_code = cia402.FAULT, error_code

    def cut(self) -> None:
        """Cut the cable: the drive no longer sends or answers; the axis continues to move."""
        self._is_cut = True
        self.close()

    def reset(self) -> None:
        """Switch power off and on: the axis coasts, all settings return to their defaults, boot-up is announced."""
        self.state, self._error_code, self._master_s = "switch on disabled", 0, None
        self._node.data_store.clear()
        self._send(0x700 + self._node.id, b"\0", 0.0)

    def close(self) -> None:
        """Leave the bus; its owner closes it."""
        if self._network.notifier is not None:
            self._network.notifier.stop()
            self._network.notifier = None

    # ---- axis -------------------------------------------------------------------------------------------------------

    def _rates(self, n: int, step_s: float) -> FloatArray:
        """Rate at the nodes [deg/s]: the profile with its acceleration limit, and the servo's wobble."""
        powered = self.state == cia402.ENABLED or self.state in _QUICK
        per_dps = self.settings.true_counts_per_degree * self.settings.velocity_unit
        target = self._raw(cia402.TARGET_VELOCITY) / per_dps
        if self.state != cia402.ENABLED or self._raw(cia402.MODE) != cia402.PROFILE_VELOCITY:
            target = 0.0
        if self._goes:
            return self._way(n, step_s)
        change = target - self._profile_dps
        which = cia402.ACCELERATION if abs(target) > abs(self._profile_dps) else cia402.DECELERATION
        if self.state in _QUICK:
            which = cia402.QUICK_STOP_DECELERATION
        accel = self._raw(which) / self.settings.counts_per_degree if powered else 5.0  # friction
        reach = np.minimum(accel * step_s * np.arange(n + 1), abs(change))
        profile = self._profile_dps + np.copysign(reach, change)
        self._profile_dps = float(profile[-1])
        wobble = self._wobble(n + 1) * self.settings.wobble_dps
        moving = np.abs(profile) > 0
        rates: FloatArray = profile + np.where(moving, wobble, 0.0)
        rates[0] = self.rate_dps
        return rates

    @property
    def _goes(self) -> bool:
        """Whether it goes to a position, or has gone there and holds it."""
        return self.state == cia402.ENABLED and self._raw(cia402.MODE) == cia402.PROFILE_POSITION

    def _way(self, n: int, step_s: float) -> FloatArray:
        """Rate at the nodes [deg/s] on the way to the set point: no faster than what still stops in time."""
        speed, accel = (self._raw(index) for index in (cia402.PROFILE_SPEED, cia402.ACCELERATION))
        per = self.settings.true_counts_per_degree
        rates, angle = np.zeros(n + 1), self.angle_deg
        rates[0] = rate = self.rate_dps
        for i in range(1, n + 1):
            left = 0.0 if self._set_point is None else self._set_point / per - angle
            brakes = np.sqrt(1.8 * accel / per * abs(left))  # 2 would leave no reserve for a whole step
            wanted = float(np.copysign(min(speed / per, brakes, _GAIN_HZ * abs(left)), left))
            new = min(max(wanted, rate - accel / per * step_s), rate + accel / per * step_s)
            angle += 0.5 * (rate + new) * step_s
            rates[i] = rate = new
        self._profile_dps = rate
        return rates

    @property
    def _reached(self) -> bool:
        per = self.settings.true_counts_per_degree
        near = self._set_point is None or abs(self.angle_deg * per - self._set_point) <= _WINDOW
        return self._goes and near and abs(self.rate_dps) < _STANDS_DPS

    def _supervise(self, t_s: float) -> None:
        """Supervise the heartbeat of the master, if the drive is configured to."""
        if self._master_beat:
            self._master_s, self._master_beat = t_s, False
        limit_s = (self._raw(cia402.CONSUMER_HEARTBEAT, 1) & 0xFFFF) / 1000
        if self._master_s is None or limit_s == 0 or t_s - self._master_s <= limit_s:
            return
        if self.state == cia402.ENABLED and self._raw(cia402.ABORT_OPTION) == cia402.ON_ABORT_QUICK_STOP:
            self.state = cia402.STOPPING

    # ---- wire -------------------------------------------------------------------------------------------------------

    def _report(self, times: FloatArray, counts: IntArray, velocity: IntArray) -> None:
        """Send the heartbeats and encoder readings (n,) that are due."""
        beat_s, pdo_s = self._raw(cia402.PRODUCER_HEARTBEAT) / 1000, self._raw(cia402.TPDO1, 5) / 1000
        mapped = self._raw(cia402.TPDO1_MAP, 0) == 2 and not self._raw(cia402.TPDO1, 1) & 1 << 31
        reports = bool(pdo_s) and mapped and self._node.nmt.state == "OPERATIONAL"
        for t_s, count, speed in zip(times.tolist(), _wrapped(counts).tolist(), velocity.tolist(), strict=True):
            if reports and t_s >= self._pdo_due_s - 1e-9:
                self._send(0x180 + self._node.id, struct.pack("<ii", count, speed), t_s)
                self._pdo_due_s = t_s + pdo_s
            if beat_s and t_s >= self._beat_due_s - 1e-9:
                self._send(0x700 + self._node.id, bytes([self._node.nmt._state]), t_s)
                self._beat_due_s = t_s + beat_s

    def _send(self, cob_id: int, data: bytes, t_s: float) -> None:
        if not self._is_cut:
            self._bus.send(can.Message(arbitration_id=cob_id, is_extended_id=False, data=data, timestamp=t_s))

    def _raw(self, index: int, sub: int = 0) -> int:
        stored = self._node.data_store.get(index, {}).get(sub)
        entry = self._node.object_dictionary[index]
        variable = entry[sub] if index in cia402.RECORDS else entry
        return int(variable.default if stored is None else variable.decode_raw(stored))

    def _on_master_beat(self, cob_id: int, data: bytearray, t_s: float) -> None:
        self._master_beat = True

    def _read(self, index: int, subindex: int, **_: object) -> int | None:
        answers = {
            cia402.STATUS: cia402.STATUS_OF[self.state]
            | 0x0200
            | (cia402.TARGET_REACHED if self._reached else 0)
            | (cia402.SET_POINT_TAKEN if self._taken else 0),
            cia402.MODE_DISPLAY: self._raw(cia402.MODE),
            cia402.POSITION: int(_wrapped(np.array(self._counts))),
            cia402.VELOCITY: self._velocity,
            cia402.ERROR_CODE: self._error_code,
        }
        return answers.get(index)

    def _written(self, index: int, subindex: int, data: bytes, **_: object) -> None:
        if index == cia402.CONTROL and self.state != cia402.FAULT:
            control = int.from_bytes(data, "little")
            self.state = _next_state(self.state, control)
            asked = bool(control & _SET_POINT)
            if asked and not self._taken and self._goes:
                self._set_point = self._raw(cia402.TARGET_POSITION)
            self._taken = asked and self._goes


def _wrapped(counts: IntArray) -> IntArray:
    """Counts wrapped to the drive's 32-bit register."""
    return (counts + 2**31) % 2**32 - 2**31


def _next_state(state: str, control: int) -> str:
    """State after a controlword, by the state machine of CiA 402-2, figure 3."""
    command = control & 0x0F
    if not command & 0x02:
        return "switch on disabled"  # disable voltage
    if not command & 0x04:
        return cia402.STOPPING if state in {cia402.ENABLED, cia402.STOPPING} else "switch on disabled"
    if command & 0x07 == cia402.SHUTDOWN:
        return state if state == cia402.STOPPING else "ready to switch on"
    if command == cia402.SWITCH_ON:
        return state if state in {"switch on disabled", cia402.STOPPING} else "switched on"
    allowed = {"ready to switch on", "switched on", cia402.ENABLED, cia402.STOPPING}
    return cia402.ENABLED if state in allowed else state
