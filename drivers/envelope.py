"""Uncertainty of the line along the fastest frame of each stretch of a record, in constant memory.

The length of a stretch is a power of two of samples; when there are too many stretches, pairs of them are merged. The
result therefore does not depend on how the frames were divided into blocks.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

IntArray = npt.NDArray[np.int64]
FloatArray = npt.NDArray[np.float64]

MOST = 128
FIRST_SHIFT = 10
FEWEST = 8
"""Fewer stretches than this are not enough to estimate the uncertainty of a line."""
FINE_NS = 1000
_NORMAL = 1.4826
"""Standard deviation of a normal distribution in units of its median absolute deviation."""


@dataclass(frozen=True)
class Known:
    """Standard uncertainties of a line along the envelope: of its slope [ns per sample] and its start [ns].

    The fastest frames of 95 % of all stretches lie within `spread_ns` of the line.
    """

    slope: float
    start_ns: float
    spread_ns: float


class Envelope:
    """Least delay [ns] of each stretch of samples, and its sample index."""

    def __init__(self) -> None:
        self._shift = FIRST_SHIFT
        self._at: list[int] = []
        self._least: list[int] = []
        self._first = 0
        self._step = 0
        """Resolution of the stamps [ns]; `FINE_NS` or less is negligible; 0: unknown, all delays are equal."""

    def add(self, index: IntArray, delay: IntArray) -> None:
        """Add samples (n,) and their delays [ns]; indices must increase, also from call to call."""
        if not len(index):
            return
        self._see_steps(delay)
        stretch = index >> self._shift
        starts = [0] if stretch[0] == stretch[-1] else [0, *(np.flatnonzero(np.diff(stretch)) + 1).tolist()]
        for start, end in zip(starts, [*starts[1:], len(index)], strict=True):
            row = start + int(delay[start:end].argmin())
            self._take(int(index[row]), int(delay[row]))
        while (self._at[-1] >> self._shift) - (self._at[0] >> self._shift) >= MOST:
            self._widen()

    def known(self, offset_ns: float, slope: float) -> Known | None:
        """Uncertainty of the line with this slope [ns per sample] and `offset_ns` at index 0; None: record too short.

        The line touches the fastest frames of the whole record; a robust line through the fastest frame of each
        stretch is a second estimate. Three contributions are added in quadrature: the difference of both estimates, the
        scatter about the second one, and a drift error over the record as large as the spread or the stamp resolution.
        """
        if len(self._at) < FEWEST:
            return None
        x, y = np.array(self._at, dtype=np.float64), np.array(self._least, dtype=np.float64)
        above = y - (offset_ns + slope * x)
        i, k = np.triu_indices(len(x), 1)
        other = float(np.median((above[k] - above[i]) / (x[k] - x[i])))
        rest = above - other * (x - x.mean())
        rest -= np.median(rest)
        scatter = _NORMAL * float(np.median(np.abs(rest)))
        spread_ns = float(np.quantile(above, 0.95))
        creeping = max(spread_ns, self._step if self._step > FINE_NS else 0) / math.sqrt(12.0) / (x[-1] - x[0])
        slope_u = math.hypot(scatter / math.sqrt(np.sum((x - x.mean()) ** 2)), other, creeping)
        start_u = math.hypot(scatter / math.sqrt(len(x)), slope_u * x.mean())
        return Known(slope_u, start_u, spread_ns)

    def _see_steps(self, delay: IntArray) -> None:
        if not self._at:
            self._first = int(delay[0])
        fine = 0 < self._step <= FINE_NS
        if not fine and (delay != self._first).any():
            self._step = int(np.gcd.reduce(delay - self._first, initial=self._step))

    def _take(self, at: int, least: int) -> None:
        if not self._at or at >> self._shift != self._at[-1] >> self._shift:
            self._at.append(at)
            self._least.append(least)
        elif least < self._least[-1]:
            self._at[-1], self._least[-1] = at, least

    def _widen(self) -> None:
        self._shift += 1
        before = list(zip(self._at, self._least, strict=True))
        self._at, self._least = [], []
        for at, least in before:
            self._take(at, least)
