"""What a sensor cannot do: stand still bit for bit among noise, jump, or leave all that the air around it was."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from bench.base import BoolArray, FloatArray, IntArray

FEW = 2000
"""Samples before which nothing is known of the noise."""
LONG = 50
"""Samples; shorter repetitions of a value are never suspected."""
MOST_REPEATED, LEAST_REVERSED = 0.5, 0.2
"""A signal whose neighbours are equal more often, or whose changes reverse less often, is not noisy enough to tell."""
BY_CHANCE = 1e-15
LONGEST_S = 60.0
"""A longer time without a reading counts as this long."""


class Frozen:
    """Stretches in which a signal repeats one value bit for bit for longer than its own noise allows.

    Of a signal that is coarser than its noise nothing can be said.
    """

    def __init__(self) -> None:
        self._run: tuple[float, int, int, int] | None = None  # value, first and last index, length of the last run
        self._pairs = self._equal = self._turns = self._reversed = 0
        self._tail = np.zeros(0)  # values of the last two runs that are complete
        self._suspects: list[tuple[int, int, int]] = []  # first index, last index, length

    def take(self, index: IntArray, value: FloatArray) -> None:
        """Take in samples (n,), in order; how they are cut into blocks does not matter."""
        if not len(index):
            return
        starts = np.flatnonzero(np.concatenate(([True], value[1:] != value[:-1])))
        lengths = np.diff(np.append(starts, len(value)))
        firsts, lasts, values = index[starts], index[starts + lengths - 1], value[starts]
        if self._run is not None:
            before, first, last, length = self._run
            if values[0] == before:
                firsts[0], lengths[0] = first, lengths[0] + length
            else:
                firsts, lasts = np.append(first, firsts), np.append(last, lasts)
                lengths, values = np.append(length, lengths), np.append(before, values)
        self._run = float(values[-1]), int(firsts[-1]), int(lasts[-1]), int(lengths[-1])
        self._complete(firsts[:-1], lasts[:-1], lengths[:-1], values[:-1])

    def _complete(self, first: IntArray, last: IntArray, length: IntArray, value: FloatArray) -> None:
        if not len(length):
            return
        long = length > LONG
        self._pairs += int(length[~long].sum())
        self._equal += int((length[~long] - 1).sum())
        changes = np.diff(np.concatenate((self._tail, value)))
        self._tail = np.concatenate((self._tail, value))[-2:]
        self._turns += max(len(changes) - 1, 0)
        self._reversed += int(np.count_nonzero(changes[1:] * changes[:-1] < 0))
        if long.any():
            rows = np.flatnonzero(long)
            self._suspects += zip(first[rows].tolist(), last[rows].tolist(), length[rows].tolist(), strict=True)
            if self._pairs > FEW and self._allowed() is None:
                self._suspects.clear()

    def _allowed(self) -> float | None:
        """Longest repetition that chance explains; None: this signal repeats itself anyway."""
        if self._pairs < FEW or self._turns == 0:
            return None
        repeats = self._equal / self._pairs
        if repeats > MOST_REPEATED or self._reversed < LEAST_REVERSED * self._turns:
            return None
        return max(math.log(BY_CHANCE) / math.log(min(repeats + 0.2, 0.9)), LONG)

    def spans(self) -> list[tuple[int, int]]:
        """First and last index of each stretch."""
        allowed = self._allowed()
        if allowed is None:
            return []
        last = [] if self._run is None else [self._run[1:]]
        return [(first, end) for first, end, length in (*self._suspects, *last) if length > allowed]


class Pace:
    """Which values of a temperature moved faster than its physics allows.

    It is followed at `slope` [K/s] at most; what is further away than `jump` [K] is not believed. After a jump it is
    believed again when it comes back to where it was, or jumps to where it may be by now; not because time passes.
    """

    def __init__(self, jump: float, slope: float) -> None:
        self._jump, self._slope = jump, slope
        self._good: tuple[float, float] | None = None  # time [s] and value that were believed last
        self._before = math.nan  # the last level, believed or not
        self.bad = False
        self.span = math.nan, math.nan
        """Lowest and highest of the values that were taken last."""

    def take(self, t_s: float, values: FloatArray) -> BoolArray | None:
        """One second or reading (k,); which of its values are wrong, None: none is."""
        if self._good is None:
            self._good = t_s, float(np.median(values))
        good_s, good = self._good
        passed_s = max(t_s - good_s, 0.0)
        room = self._jump + self._slope * (passed_s if not self.bad else 0.0)
        low, high = self.span = float(np.minimum.reduce(values)), float(np.maximum.reduce(values))
        if low >= good - room and high <= good + room:
            level = float(np.add.reduce(values)) / len(values)
            self._follow(t_s, level, math.inf if self.bad else passed_s)
            return None
        level = float(np.median(values))
        jumped = not abs(level - self._before) <= self._jump + self._slope
        self._before = level
        wrong: BoolArray = np.abs(values - good) > room
        if self.bad and jumped and abs(level - good) <= self._jump + self._slope * passed_s:
            wrong = np.abs(values - level) > self._jump
            self._good, self.bad = (t_s, level), False
            return wrong
        if wrong.all() or self.bad:
            self.bad = bool(wrong.all())
        if not self.bad:
            self._follow(t_s, float(values[~wrong].mean()), passed_s)
        return wrong

    def _follow(self, t_s: float, level: float, passed_s: float) -> None:
        assert self._good is not None
        most = self._slope * passed_s
        good = self._good[1]
        self._good = t_s, level if abs(level - good) <= max(most, 0.1) else good + math.copysign(most, level - good)
        self._before, self.bad = level, False


class UnitExcess:
    """How far a unit's sensor is outside everything that the air was, as long as its lag remembers it."""

    def __init__(self, lag_min: float) -> None:
        self._lag_s = 60.0 * lag_min
        self._range: tuple[float, float] | None = None
        self._at_s: float | None = None

    def take(self, t_s: float, air_degc: float, units_degc: Sequence[float]) -> float:
        """Excess of the unit that is furthest outside [K]; what units are at first is not doubted."""
        low, high = self._range or (min(air_degc, *units_degc), max(air_degc, *units_degc))
        passed_s = 0.0 if self._at_s is None else min(max(t_s - self._at_s, 0.0), LONGEST_S)
        forgets = 1.0 - math.exp(-passed_s / self._lag_s)
        low += (air_degc - low) * (1.0 if air_degc < low else forgets)
        high += (air_degc - high) * (1.0 if air_degc > high else forgets)
        self._range, self._at_s = (low, high), t_s
        return max(max(low - degc, degc - high, 0.0) for degc in units_degc)
