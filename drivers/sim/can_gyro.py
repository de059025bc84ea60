"""The simulated unit on its bus: arrays of physical truth become the real frames of its DBC.

Shares with the driver the description of the wire and nothing else.
"""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

import can
import numpy as np
import numpy.typing as npt

from drivers.errors import ConfigError
from drivers.frames import to_messages
from drivers.journal import FLAG_EXTENDED, FRAME, FrameArray
from drivers.wire import ByteArray, Message, load_dbc

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

BOOT_UP, OPERATIONAL = 0, 5


class Signals(Protocol):
    """What the physics of a unit delivers for a piece of time: n rate samples, m = n / 10 slow ones."""

    @property
    def rate_dph(self) -> FloatArray:
        """Rate [deg/h], (n,)."""

    @property
    def temperature(self) -> FloatArray:
        """Sensor of the unit [degC], (m,)."""

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
        self._counter = 0
        self._booted = False
        self.status = 0
        """Fault code of the rate message."""

    def reboot(self) -> None:
        """Start the sample counter again at 0, with a boot-up heartbeat before the next sample."""
        self._counter, self._booted = 0, False

    def send(self, t0_s: float, signals: Signals) -> None:
        """Send the frames of `signals`, whose first sample is taken at bench time `t0_s` [s].

        LimitError when a value does not fit its frame (nothing is sent); CanError when the bus refuses.
        """
        count = len(signals.rate_dph)
        sample = self._counter + np.arange(count)
        parts = [self._rate(sample, signals), *self._slow(sample, signals)]
        t0_ns = round(t0_s * 1e9)
        frames = np.concatenate([self._frames(message, t0_ns, at, data) for message, at, data in parts])
        frames = frames[np.argsort(frames["t_ns"], kind="stable")]  # at one instant the lower identifier wins the bus
        if not self._booted:
            boot = self._heartbeat(BOOT_UP, np.zeros(1, dtype=np.int64))
            frames = np.concatenate([self._frames(boot[0], t0_ns, boot[1], boot[2]), frames])
        self._transmit(frames)
        self._counter += count
        self._booted = True

    def _rate(self, sample: IntArray, signals: Signals) -> _Part:
        values: dict[str, npt.ArrayLike] = {
            "Rate": np.asarray(signals.rate_dph) / 3600.0,
            "SampleCounter": sample & 0xFFFF,
            "Status": self.status,
            "RateValid": 1,
            "LoopLocked": 1,
            "CompensationActive": int(self.coefficient_set != 0),
            "RateSaturated": 0,
        }
        message = self._messages["GYRO_RATE"]
        return message, sample - self._counter, message.pack(len(sample), values)

    def _slow(self, sample: IntArray, signals: Signals) -> list[_Part]:
        def due(name: str) -> IntArray:
            every = round((self._messages[name].cycle_ms or self._interval_ms) / self._interval_ms)
            at: IntArray = sample[sample % every == 0]
            return at

        def part(name: str, values: dict[str, npt.ArrayLike]) -> _Part:
            at, message = due(name), self._messages[name]
            return message, at - self._counter, message.pack(len(at), {**values, "SlowCounter": at & 0xFF})

        return [
            part("GYRO_RES", {"ResonanceFrequency": signals.frequency, "Temperature": signals.temperature}),
            part("GYRO_AMP", {"DriveAmplitude": signals.drive, "QuadratureAmplitude": signals.quadrature}),
            part("GYRO_SUPPLY", {"SupplyVoltage": signals.supply}),
            self._heartbeat(OPERATIONAL, due("GYRO_HEARTBEAT") - self._counter),
        ]

    def _heartbeat(self, state: int, at: IntArray) -> _Part:
        message = self._messages["GYRO_HEARTBEAT"]
        values = {
            "State": state,
            "Serial": self.serial,
            "Firmware": self.firmware,
            "CoefficientSet": self.coefficient_set,
        }
        return message, at, message.pack(len(at), values)

    def _frames(self, message: Message, t0_ns: int, at: IntArray, data: ByteArray) -> FrameArray:
        frames = np.zeros(len(at), dtype=FRAME)
        frames["t_ns"] = t0_ns + at * round(self._interval_ms * 1e6)
        frames["id"] = message.id + self.number
        frames["flags"] = FLAG_EXTENDED * message.extended
        frames["len"] = message.length
        if "Crc8" in message.signals:
            data[:, message.length - 1] = message.crc(data, message.id + self.number)
        frames["data"] = data
        return frames

    def _transmit(self, frames: FrameArray) -> None:
        if hasattr(self.bus, "send_block"):
            self.bus.send_block(frames)
            return
        for message in to_messages(frames):
            self.bus.send(message)


_Part = tuple[Message, IntArray, ByteArray]
"""A message of the DBC, the samples after which it is sent, counted from the start of the piece, and its payloads."""
