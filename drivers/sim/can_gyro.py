"""The simulated unit on its bus: converts arrays of physical values to the frames of its DBC.

Shares with the driver only the description of the wire.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import can
import numpy as np
import numpy.typing as npt

from drivers.errors import ConfigError
from drivers.frames import to_messages
from drivers.journal import FLAG_EXTENDED, FRAME, FrameArray
from drivers.wire import Message, load_dbc

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
WordArray = npt.NDArray[np.uint64]
"""Payloads of eight bytes, (n,)."""

_WORD = np.dtype("<u8")
_SENT = ("GYRO_RATE", "GYRO_RES", "GYRO_AMP", "GYRO_SUPPLY", "GYRO_HEARTBEAT")
BOOT_UP, OPERATIONAL = 0, 5


class Signals(Protocol):
    """Output of a unit's physics for a piece of time: n rate samples, m = n / 10 slow ones."""

    @property
    def rate_dph(self) -> FloatArray:
        """Rate [deg/h], (n,)."""

    @property
    def temperature(self) -> FloatArray:
        """Temperature sensor of the unit [degC], (m,)."""

    @property
    def frequency(self) -> FloatArray:
        """Resonance frequency [Hz], (m,)."""

    @property
    def drive(self) -> FloatArray:
        """Excitation amplitude [V], (m,)."""

    @property
    def quadrature(self) -> FloatArray:
        """Quadrature amplitude [V], (m,)."""

    @property
    def supply(self) -> float:
        """Supply voltage [V]."""


def is_family(layout: str | Path) -> bool:
    """Whether a layout has the messages and signals that `CanGyro` sends; a heartbeat need not tell the set."""
    mine, theirs = (
        {name: {*message.signals} - {"CoefficientSet"} for name, message in load_dbc(dbc).items()}
        for dbc in ("vibratory", layout)
    )
    return mine == theirs


class CanGyro:
    """Unit `number` (0 to 15) of the family `layout` on an open python-can bus.

    The bus must keep the time stamps of its sender (`preserve_timestamps`) for bench time to reach the receiver.
    """

    def __init__(
        self,
        bus: can.BusABC,
        number: int,
        serial: int,
        *,
        layout: str | Path = "vibratory",
        firmware: int = 0x0100,
        coefficient_set: int = 0,
    ) -> None:
        if not 0 <= number <= 15:
            raise ConfigError(f"unit number {number}: must be 0 to 15")
        self.number, self.serial, self.firmware, self.coefficient_set = number, serial, firmware, coefficient_set
        self.bus = bus
        self._messages = load_dbc(layout)
        self._interval_ms = self._messages["GYRO_RATE"].cycle_ms or 2.0
        self.sample_s = 1e-3 * self._interval_ms
        """True time between two samples [s]; more than nominal for a unit whose clock is slow."""
        self._counter = 0
        self._booted = False
        self._plans: dict[tuple[int, int], _Plan] = {}
        self.status = 0
        """Fault code of the rate message."""

    def reboot(self) -> None:
        """Start the sample counter again at 0, with a boot-up heartbeat before the next sample."""
        self._counter, self._booted = 0, False

    def go_on(self, samples: int) -> None:
        """Count on after so many samples, as a unit that has kept its power."""
        self._counter, self._booted = samples, True

    def send(self, t0_s: float, signals: Signals) -> None:
        """Send the frames of `signals`, whose first sample is taken at bench time `t0_s` [s].

        LimitError when a value does not fit its frame (nothing is sent); CanError when the bus refuses.
        """
        count = len(signals.rate_dph)
        plan = self._plan(count)
        words = [self._rate(plan.at[0], signals), *self._slow(plan.at[1:], signals)]
        frames = self._stamped(plan, round(t0_s * 1e9), np.concatenate(words))
        if not self._booted:
            boot = self._planned([(self._messages["GYRO_HEARTBEAT"], np.zeros(1, dtype=np.int64))])
            frames = np.concatenate([self._stamped(boot, round(t0_s * 1e9), self._heartbeat(BOOT_UP, 1)), frames])
        self._transmit(frames)
        self._counter += count
        self._booted = True

    def _rate(self, at: IntArray, signals: Signals) -> WordArray:
        values: dict[str, npt.ArrayLike] = {
            "Rate": np.asarray(signals.rate_dph) / 3600.0,
            "SampleCounter": (at + self._counter) & 0xFFFF,
            "Status": self.status,
            "RateValid": 1,
            "LoopLocked": 1,
            "CompensationActive": int(self.coefficient_set != 0),
            "RateSaturated": 0,
        }
        return self._payloads("GYRO_RATE", len(at), values)

    def _slow(self, at: Sequence[IntArray], signals: Signals) -> Iterator[WordArray]:
        values: list[dict[str, npt.ArrayLike]] = [
            {"ResonanceFrequency": signals.frequency, "Temperature": signals.temperature},
            {"DriveAmplitude": signals.drive, "QuadratureAmplitude": signals.quadrature},
            {"SupplyVoltage": signals.supply},
        ]
        for name, given, due in zip(_SENT[1:], values, at, strict=False):
            yield self._payloads(name, len(due), {**given, "SlowCounter": (due + self._counter) & 0xFF})
        yield self._heartbeat(OPERATIONAL, len(at[-1]))

    def _heartbeat(self, state: int, count: int) -> WordArray:
        values = {"State": state, "Serial": self.serial, "Firmware": self.firmware}
        if "CoefficientSet" in self._messages["GYRO_HEARTBEAT"].signals:
            values["CoefficientSet"] = self.coefficient_set
        return self._payloads("GYRO_HEARTBEAT", count, values)

    def _payloads(self, name: str, count: int, values: Mapping[str, npt.ArrayLike]) -> WordArray:
        """Payloads of a message, (count,), with their CRC."""
        message = self._messages[name]
        data = message.pack(count, values)
        if "Crc8" in message.signals:
            data[:, message.length - 1] = message.crc(data, message.id + self.number)
        return data.view(_WORD)[:, 0]

    def _plan(self, count: int) -> _Plan:
        """The frames of a piece of `count` samples; equal pieces share one plan."""
        messages = [self._messages[name] for name in _SENT]
        every = [round((message.cycle_ms or self._interval_ms) / self._interval_ms) for message in messages]
        key = count, self._counter % math.lcm(*every)
        if key not in self._plans:
            sample = self._counter + np.arange(count)
            due = [np.flatnonzero(sample % period == 0) for period in every]
            self._plans = {key: self._planned(list(zip(messages, due, strict=True)))}
        return self._plans[key]

    def _planned(self, parts: Sequence[tuple[Message, IntArray]]) -> _Plan:
        """Messages with the samples after which each is sent; at one instant the lower identifier wins the bus."""
        frames = np.zeros(sum(len(at) for _, at in parts), dtype=FRAME)
        start = 0
        for message, at in parts:
            block = frames[start : start + len(at)]
            block["t_ns"] = np.rint(at * (self.sample_s * 1e9)).astype(np.int64)
            block["id"] = message.id + self.number
            block["flags"] = FLAG_EXTENDED * message.extended
            block["len"] = message.length
            start += len(at)
        order = np.argsort(frames["t_ns"], kind="stable")
        return _Plan([at for _, at in parts], order, frames[order].view(np.int64).reshape(-1, 3))

    def _stamped(self, plan: _Plan, t0_ns: int, words: WordArray) -> FrameArray:
        """The frames of a plan from bench time `t0_ns` [ns] on, with these payloads."""
        whole = plan.frames.copy()
        whole[:, 0] += t0_ns
        whole[:, 2] = words[plan.order]
        return whole.view(FRAME)[:, 0]

    def _transmit(self, frames: FrameArray) -> None:
        if hasattr(self.bus, "send_block"):
            self.bus.send_block(frames)
            return
        for message in to_messages(frames):
            self.bus.send(message)


@dataclass(frozen=True)
class _Plan:
    """The frames of a piece of time, without the time of its start and the payloads."""

    at: list[IntArray]
    """For each message the samples after which it is sent, counted from the start of the piece."""
    order: IntArray
    """Of its frames on the bus, message by message."""
    frames: IntArray
    """FRAME records as numbers of eight bytes, (n, 3): time from the start of the piece [ns], head, no payload."""
