"""Slow channels of a gyro on CAN: the low bits of the counter assign their samples to the rate samples."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from drivers.errors import ConfigError
from drivers.samples import IntArray
from drivers.states import States
from drivers.wire import NOT_SIMPLE, ByteArray, Message

_CHANNELS = {
    "Temperature": "temperature",
    "ResonanceFrequency": "frequency",
    "DriveAmplitude": "drive",
    "QuadratureAmplitude": "quadrature",
    "SupplyVoltage": "supply",
}
_UNITS: dict[str, dict[str, float]] = {  # channel: unit in the DBC: factor to the unit of the channel
    "rate": {"deg/h": 1.0, "deg/s": 3600.0, "rad/s": 3600.0 * 180.0 / np.pi},
    "temperature": {"degC": 1.0},
    "frequency": {"Hz": 1.0, "kHz": 1e3},
    "drive": {"V": 1.0, "mV": 1e-3},
    "quadrature": {"V": 1.0, "mV": 1e-3},
    "supply": {"V": 1.0, "mV": 1e-3},
}


class Reference(NamedTuple):
    """Intact rate frames (n,) in the order of arrival."""

    sample: IntArray
    counter: IntArray
    t_ns: IntArray


class SlowMessage:
    """One slow message of a gyro family, with the index of its last sample."""

    def __init__(self, message: Message, interval_s: float) -> None:
        check_simple(message)
        self.message = message
        self.states = States(message)
        self.channels = {
            _CHANNELS[name]: (name, factor_of(_CHANNELS[name], message, name))
            for name in message.signals
            if name in _CHANNELS
        }
        self._interval_ns = round(interval_s * 1e9)
        self.every = round((message.cycle_ms or 0.0) * 1e-3 / interval_s)
        self._last: int | None = None

    def power_on(self) -> None:
        """The unit is switched on again on purpose: nothing is missing before its first sample."""
        self._last = None

    def place(
        self, data: ByteArray, at: IntArray, t_ns: IntArray, rate_at: IntArray, rate: Reference
    ) -> tuple[IntArray, IntArray, int, int]:
        """Sample indices and rows of new samples, in order; number of repeated and of missing samples."""
        if not len(at):
            return at, at, 0, 0
        near = np.maximum(np.searchsorted(rate_at, at) - 1, 0)
        elapsed: IntArray | int = 0
        signal = self.message.signals["SlowCounter"]
        half = 1 << signal.length - 1
        if np.abs(t_ns - rate.t_ns[near]).max() > half // 4 * self._interval_ns:
            # Host time bridges an outage. After a stall, the rate frame before may be far and the next one near.
            ahead = np.minimum(near + 1, len(rate_at) - 1)
            near = np.where(np.abs(t_ns - rate.t_ns[ahead]) < np.abs(t_ns - rate.t_ns[near]), ahead, near)
            elapsed = np.rint((t_ns - rate.t_ns[near]) / self._interval_ns).astype(np.int64)
        off = signal.unpack(data).astype(np.int64) - rate.counter[near] - elapsed
        index = rate.sample[near] + elapsed + ((off + half) & (2 * half - 1)) - half
        rows = np.arange(len(at))
        if (index[1:] <= index[:-1]).any():
            index, rows = np.unique(index, return_index=True)
        if self._last is not None and index[0] <= self._last:
            fresh = index > self._last
            index, rows = index[fresh], rows[fresh]
        lost = 0
        if len(index):
            first = self._last if self._last is not None else int(index[0]) - self.every
            lost = (int(index[-1]) - first) // self.every - len(index) if self.every else 0
            self._last = int(index[-1])
        return index, rows, len(at) - len(index), max(lost, 0)


def is_slow(message: Message) -> bool:
    """Whether it carries a channel that is sampled less often than the rate."""
    return "SlowCounter" in message.signals and any(name in _CHANNELS for name in message.signals)


def check_simple(message: Message) -> None:
    """ConfigError unless its signals can be decoded by numpy."""
    if not message.is_simple:
        raise ConfigError(f"{message.name} {NOT_SIMPLE}")


def factor_of(channel: str, message: Message, signal: str) -> float:
    """Factor from the unit in the DBC to that of the channel; ConfigError for an unknown unit."""
    unit, known = message.signals[signal].unit, _UNITS[channel]
    if unit not in known:
        raise ConfigError(f"{message.name}.{signal} has the unit '{unit}'; the DBC must use one of {', '.join(known)}")
    return known[unit]
