"""Sample counters of units that send none: from their time stamp, or from when their frames arrive."""

from __future__ import annotations

import numpy as np

from drivers.samples import IntArray
from drivers.wire import ByteArray, Signal

BITS = 32
"""Of the counters made here."""
_MASK = (1 << BITS) - 1
_AHEAD = 32
"""Frames within which one that came late is followed by one in time."""


class StampCount:
    """Counts by the unit's own time of each sample."""

    def __init__(self, signal: Signal, step_s: float, interval_ns: int) -> None:
        self._signal, self._mask = signal, (1 << signal.length) - 1
        self._step_ns, self._interval_ns = step_s * 1e9, interval_ns
        self._last: tuple[int, int] | None = None  # raw value, and steps since the first one

    def count(self, data: ByteArray, t_ns: IntArray) -> IntArray:
        """Counter (n,) of frames in the order of arrival."""
        raw = self._signal.unpack(data).astype(np.int64)
        if not len(raw):
            return raw
        before, start = self._last or (int(raw[0]), 0)
        step = np.diff(raw, prepend=before) & self._mask
        step = np.where(step > self._mask // 2, step - self._mask - 1, step)  # out of order
        steps = start + np.cumsum(step)
        self._last = int(raw[-1]), int(steps[-1])
        counter: IntArray = np.rint(steps * (self._step_ns / self._interval_ns)).astype(np.int64) & _MASK
        return counter


class CycleCount:
    """Counts frames, and what is missing between them by their cycle time.

    A frame that is late by half a cycle or more, and that no frame in time follows soon, has one missing before it.
    """

    def __init__(self, interval_ns: int) -> None:
        self._interval_ns = interval_ns
        self._frames = 0
        self._phase_ns: int | None = None  # arrival of frame 0 as the fastest frames have it

    def count(self, data: ByteArray, t_ns: IntArray) -> IntArray:
        """Counter (n,) of frames in the order of arrival."""
        number = self._frames + np.arange(len(t_ns))
        if not len(t_ns):
            return number
        self._frames += len(t_ns)
        phase = t_ns - number * self._interval_ns
        padded = np.concatenate((phase, np.full(_AHEAD - 1, phase[-1])))
        fastest = np.lib.stride_tricks.sliding_window_view(padded, _AHEAD).min(axis=1)
        if self._phase_ns is None:
            self._phase_ns = int(fastest[0])
        missing = np.maximum.accumulate((fastest - self._phase_ns + self._interval_ns // 2) // self._interval_ns)
        left = int((fastest - missing * self._interval_ns).min()) - self._phase_ns
        self._phase_ns += min(max(left, -self._interval_ns // 4), self._interval_ns // 4)  # its clock drifts
        counter: IntArray = (number + missing) & _MASK
        return counter
