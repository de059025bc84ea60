"""Channels beside the first output of a unit: a counter, or their time of arrival, assigns them to its samples."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from drivers.layout import Source
from drivers.samples import IntArray
from drivers.wire import ByteArray


class Reference(NamedTuple):
    """Intact rate frames (n,) in the order of arrival."""

    sample: IntArray
    counter: IntArray
    t_ns: IntArray


class Beside:
    """One source of channels beside the first output, with the index of its last sample."""

    def __init__(self, source: Source, interval_s: float) -> None:
        self.source = source
        self.message, self.states, self.channels = source.message, source.states, source.channels
        self._interval_ns = round(interval_s * 1e9)
        self.every = round((source.message.cycle_ms or 0.0) * 1e-3 / interval_s)
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
        counter = self.source.counter
        half = 1 << (64 if counter is None else counter.length) - 1
        elapsed: IntArray | int = 0
        if counter is None or np.abs(t_ns - rate.t_ns[near]).max() > half // 4 * self._interval_ns:
            # Host time bridges an outage. After a stall, the rate frame before may be far and the next one near.
            ahead = np.minimum(near + 1, len(rate_at) - 1)
            near = np.where(np.abs(t_ns - rate.t_ns[ahead]) < np.abs(t_ns - rate.t_ns[near]), ahead, near)
            elapsed = np.rint((t_ns - rate.t_ns[near]) / self._interval_ns).astype(np.int64)
        index = rate.sample[near] + elapsed
        if counter is not None:
            off = counter.unpack(data).astype(np.int64) - rate.counter[near] - elapsed
            index += ((off + half) & (2 * half - 1)) - half
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
