"""Control charts of individual values and moving ranges, with the runs rules that separate a change from chance.

sigma comes from neighbours, mean moving range / 1.128, so that a drift does not widen its own limits.
Source: W. A. Shewhart (1931); L. S. Nelson, J. Quality Technology 16 (1984) 237 (the eight rules; 1, 5, 6 and 2 with 8
in place of 9 are those of Western Electric (1956)).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from bench.base import BoolArray, FloatArray, IntArray

D2, D4 = 1.128, 3.267
"""Mean of the range of two normal values over sigma; upper limit of a moving range over its mean."""
LEAST = 8
"""Least number of values for a chart."""


@dataclass(frozen=True)
class Signal:
    """A rule, in words too, that the values up to `index` break."""

    rule: int
    index: int
    text: str


@dataclass(frozen=True, eq=False)
class Chart:
    """Centre, sigma of neighbours, limit of the moving range, and the signals in order of time."""

    values: FloatArray
    centre: float
    sigma: float
    range_limit: float
    signals: tuple[Signal, ...]

    @property
    def limits(self) -> tuple[float, float]:
        """Three sigma about the centre."""
        return self.centre - 3 * self.sigma, self.centre + 3 * self.sigma

    def newest(self, most: int) -> Chart:
        """The same chart of the newest values only: centre and limits are those of all."""
        gone = max(self.values.size - most, 0)
        kept = tuple(replace(one, index=one.index - gone) for one in self.signals if one.index >= gone)
        return replace(self, values=self.values[gone:], signals=kept) if gone else self

    @property
    def ranges(self) -> FloatArray:
        """Moving ranges (n - 1,)."""
        return np.abs(np.diff(self.values))


def chart(values: FloatArray) -> Chart | None:
    """Chart of finite values (n,) in order of time; None below eight of them, or where they are all equal."""
    if values.size < LEAST or np.ptp(values) == 0.0:
        return None
    mean_range = float(np.mean(np.abs(np.diff(values))))
    if mean_range == 0.0:
        return None
    sigma, centre = mean_range / D2, float(np.mean(values))
    return Chart(values, centre, sigma, D4 * mean_range, signals((values - centre) / sigma))


def _count(flags: BoolArray, window: int) -> IntArray:
    """True flags in the window that ends at each."""
    total: IntArray = np.cumsum(flags, dtype=np.int64)
    total[window:] -= total[:-window].copy()
    return total


def _within(z: FloatArray, window: int, count: int, sigmas: float) -> BoolArray:
    """At each end of a window: at least `count` beyond `sigmas` on one side, the last value among them."""
    out = np.zeros(z.size, dtype=bool)
    for side in (1.0, -1.0):
        beyond = side * z > sigmas
        total = _count(beyond, window)
        out |= (total >= count) & beyond & (np.arange(z.size) >= window - 1)
    return out


def _all(flags: BoolArray, length: int) -> BoolArray:
    """At each end of `length` true flags in a row."""
    whole: BoolArray = _count(flags, length) == length
    return whole


def _trend(z: FloatArray) -> BoolArray:
    steps = np.sign(np.diff(z, prepend=np.nan))
    return _all(steps > 0, 5) | _all(steps < 0, 5)


def _alternating(z: FloatArray) -> BoolArray:
    turns = np.diff(z, prepend=np.nan) * np.concatenate([[np.nan], np.diff(z, prepend=np.nan)[:-1]])
    return _all(turns < 0, 12)


RULES: tuple[tuple[int, str, Callable[[FloatArray], BoolArray]], ...] = (
    (1, "beyond three sigma", lambda z: np.abs(z) > 3),
    (2, "nine in a row on one side", lambda z: _all(z > 0, 9) | _all(z < 0, 9)),
    (3, "six in a row rising or falling", _trend),
    (4, "fourteen in a row alternating", _alternating),
    (5, "two of three beyond two sigma on one side", lambda z: _within(z, 3, 2, 2.0)),
    (6, "four of five beyond one sigma on one side", lambda z: _within(z, 5, 4, 1.0)),
    (7, "fifteen in a row within one sigma", lambda z: _all(np.abs(z) < 1, 15)),
    (8, "eight in a row beyond one sigma", lambda z: _all(np.abs(z) > 1, 8)),
)
"""Number of each rule, its words, and a function that marks where values break it."""


def signals(z: FloatArray) -> tuple[Signal, ...]:
    """Breaks of the rules by values (n,) in sigmas; a break that continues is reported once, at its start."""
    found = []
    for rule, text, broken in RULES:
        at = broken(z)
        begins = at if rule == 1 else at & ~np.concatenate([[False], at[:-1]])
        found += [Signal(rule, int(index), text) for index in np.flatnonzero(begins)]
    return tuple(sorted(found, key=lambda signal: (signal.index, signal.rule)))
