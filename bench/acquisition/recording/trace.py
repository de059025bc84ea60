"""What a live run has done so far, small enough to be looked at while it runs: curves of bounded length.

A point spans some ticks: temperatures as they were at its end, the smallest and largest rate of *all* samples in it, so
that a spike of one sample stays visible, and their mean, which shows a bias below the noise. When the trace is full,
pairs of points become one: it ends between half full and full however long the run is, and its points are then twice as
long.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from bench.base import finite

CAPACITY = 4096
"""Points; after a day at a tick a second each spans 32 s."""
_PAGE_BYTES = 40_000
"""Size of one answer, about; a line of the control socket may have 64 KiB."""
_POINT_BYTES = 50
_LEVELS = 64
"""A trace cannot be halved more often than this in the age of anything."""

Span = tuple[float, float, float, int]
"""Smallest and largest rate, sum of the rates [deg/h], number of valid samples; without one NaN, NaN, 0, 0."""
_WIDTH = 4
"""Columns of a span."""


class Envelope:
    """Smallest, largest, sum and number of the samples since it was taken last."""

    __slots__ = ("_count", "_high", "_low", "_sum")

    def __init__(self) -> None:
        self._clear()

    def _clear(self) -> None:
        self._low = self._high = math.nan
        self._sum, self._count = 0.0, 0

    def add(self, values: npt.NDArray[np.float64]) -> None:
        """Take in samples (n,); NaN is none."""
        known = values[np.isfinite(values)]
        if known.size:
            self._low = float(np.fmin(known.min(), self._low))
            self._high = float(np.fmax(known.max(), self._high))
            self._sum += float(known.sum())
            self._count += known.size

    def take(self) -> Span:
        """What was added since the last call."""
        span = self._low, self._high, self._sum, self._count
        self._clear()
        return span


class Trace:
    """Points of a live run; one thread adds, any thread reads."""

    def __init__(self, capacity: int = CAPACITY, tick_s: float = 1.0, origin: int = 0) -> None:
        """`capacity` points (even); a tick lasts `tick_s` [s]; `origin` makes its generations those of no other."""
        self._capacity, self._tick_s = capacity, tick_s
        self._generation = origin * _LEVELS
        self._lock = threading.Lock()
        self._serials: tuple[str, ...] = ()
        self._rows = np.empty((0, 0))
        self._count = 0
        self._every = 1
        self._open: list[float] = []
        self._ticks = 0

    def add(self, t_s: float, chamber: tuple[float, float], units: Sequence[tuple[str, float, Span]]) -> None:
        """One tick: bench time [s], set point and air of the chamber [degC], each unit's serial, sensor and rates.

        Who is in the first tick has a place in all of them.
        """
        if not self._serials:
            self._serials = tuple(serial for serial, _, _ in units)
            self._rows = np.empty((self._capacity, 3 + (1 + _WIDTH) * len(units)))
        told = {serial: (degc, span) for serial, degc, span in units}
        silent = (math.nan, (math.nan, math.nan, 0.0, 0))
        here = [told.get(serial, silent) for serial in self._serials]
        row = [t_s, *chamber, *(degc for degc, _ in here)]
        with self._lock:
            before = iter(self._open[len(row) :] or [math.nan, math.nan, 0.0, 0] * len(here))
            for _, (low, high, total, count) in here:
                row += (
                    _smaller(low, next(before)),
                    _larger(high, next(before)),
                    total + next(before),
                    count + next(before),
                )
            self._open = row
            self._ticks += 1
            if self._ticks == self._every:
                self._close()

    def _close(self) -> None:
        self._rows[self._count] = self._open
        self._count += 1
        self._ticks, self._open = 0, []
        if self._count == self._capacity:
            self._halve()

    def _halve(self) -> None:
        """Two points become one: the later one's temperatures, the rates of both."""
        first, second = self._rows[0::2], self._rows[1::2]
        joined = second.copy()
        rates = 3 + len(self._serials)
        for column, join in enumerate((np.fmin, np.fmax, np.add, np.add)):
            here = slice(rates + column, None, _WIDTH)
            joined[:, here] = join(first[:, here], second[:, here])
        self._count = len(joined)
        self._rows[: self._count] = joined
        self._every *= 2
        self._generation += 1

    def since(self, index: int = 0, generation: int | None = None) -> dict[str, Any]:
        """Points from `index` on as an object for JSON, a page of them; from the first one when that is no more ours.

        `first` is the index of the first point in the answer, `next` what to ask for next, `count` how many there are,
        `open` the point that is not complete yet. What is not known is null.
        """
        most = max(_PAGE_BYTES // (_POINT_BYTES * (1 + len(self._serials))), 1)
        with self._lock:
            ours = generation in (None, self._generation) and 0 <= index <= self._count
            first = index if ours else 0
            end = min(first + most, self._count)
            rows = self._rows[first:end].tolist()
            newest = list(self._open)
            units, count, generation, every = len(self._serials), self._count, self._generation, self._every
        return {
            "generation": generation,
            "first": first,
            "next": end,
            "count": count,
            "every_s": every * self._tick_s,
            "serials": list(self._serials),
            "points": [_point(row, units) for row in rows],
            "open": _point(newest, units) if newest else None,
        }


def _smaller(one: float, other: float) -> float:
    """That of the two which is a number; comparisons with NaN are false."""
    return other if other < one or math.isnan(one) else one


def _larger(one: float, other: float) -> float:
    return other if other > one or math.isnan(one) else one


def _point(row: Sequence[float], units: int) -> list[Any]:
    """`[t_s, set point, chamber, [unit…], [[rate_min, rate_max, rate_mean]…]]`."""
    known = [finite(value, 3) for value in row[: 3 + units]]
    columns = (row[3 + units + column :: _WIDTH] for column in range(_WIDTH))
    spans = [
        [finite(low, 3), finite(high, 3), finite(total / count, 3) if count else None]
        for low, high, total, count in zip(*columns, strict=True)
    ]
    return [*known[:3], known[3:], spans]
