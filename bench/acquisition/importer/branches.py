"""Heating, cooling and constant branches of a record that came without segments, from its temperature alone."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np

from bench.base import FloatArray, IntArray
from bench.record import ExecutedSegment

Direction = Literal["heating", "cooling", "constant"]

STILL_SHARE = 0.1
"""Slower than this share of the record's fast slopes, the temperature stands."""
STILL_DEGC_PER_MIN = 0.02
"""Slower than this it stands in any record [degC/min]."""
SHORTEST_STILL_S = 180.0
SMALLEST_SHARE = 0.03
"""A branch shorter than this share of the whole span is noise, or the overshoot of a controller."""
SMALLEST_DEGC = 0.5

_GRID_POINTS = 5000
_SIGN: dict[int, Direction] = {1: "heating", -1: "cooling", 0: "constant"}


@dataclass(frozen=True)
class Branch:
    """One piece of a record in which the temperature goes one way, or stands."""

    direction: Direction
    from_s: float
    to_s: float
    from_degc: float
    to_degc: float

    @property
    def rate_degc_per_min(self) -> float:
        """Mean slope, positive in both directions [degC/min]."""
        return 60.0 * abs(self.to_degc - self.from_degc) / (self.to_s - self.from_s) if self.to_s > self.from_s else 0.0

    def as_segment(self, index: int) -> ExecutedSegment:
        """The manifest's entry."""
        still = self.direction == "constant"
        text = f"constant at {self.to_degc:.0f}" if still else f"{self.from_degc:.0f} to {self.to_degc:.0f}"
        return ExecutedSegment(
            index=index,
            name=f"{index + 1}: {text}" if still else f"{index + 1}: {self.direction} {text}",
            kind="soak" if still else "ramp",
            from_s=self.from_s,
            to_s=self.to_s,
            target_degc=round(self.to_degc, 3),
            rate_degc_per_min=0.0 if still else round(self.rate_degc_per_min, 4),
            direction=self.direction,
            settled=still,
            outcome="detected",
        )


def find_branches(time_s: FloatArray, temperature_degc: FloatArray) -> tuple[Branch, ...]:
    """Branches in order of time, without gaps between them; inputs (n,), NaN where not sampled, time increasing.

    Turning points come first (a reversal counts when the temperature goes back by more than `SMALLEST_SHARE` of its
    span), then the standing part at the ends of each branch is cut off. Noise below that size makes no branch.
    """
    known = np.isfinite(temperature_degc)
    if np.count_nonzero(known) < 2:
        return ()
    time, degc = _grid(time_s[known], temperature_degc[known])
    span = float(np.ptp(degc))
    if span < SMALLEST_DEGC:
        return (Branch("constant", float(time_s[0]), float(time_s[-1]), float(degc.mean()), float(degc.mean())),)
    smallest = max(SMALLEST_SHARE * span, SMALLEST_DEGC)
    signs = np.zeros(time.size, dtype=np.int64)
    turns = _turning_points(degc, smallest)
    for first, last in pairwise(turns):
        signs[first : last + 1] = np.sign(degc[last] - degc[first])
    signs[_still(time, degc)] = 0
    starts = _merge(signs, time, degc, smallest)
    edges = [*(float(time[i]) for i in starts), float(time_s[-1])]
    edges[0] = float(time_s[0])
    ends = [*starts[1:], time.size - 1]
    return tuple(
        Branch(_SIGN[int(signs[a])], edges[i], edges[i + 1], float(degc[a]), float(degc[b]))
        for i, (a, b) in enumerate(zip(starts, ends, strict=True))
    )


def segment_of(branches: tuple[Branch, ...], time_s: FloatArray) -> IntArray:
    """Number of the branch of each time (n,), -1 where there is none."""
    if not branches:
        return np.full(time_s.shape, -1, dtype=np.int64)
    return np.searchsorted([branch.from_s for branch in branches[1:]], time_s, side="right").astype(np.int64)


def _grid(time: FloatArray, degc: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Means on at most `_GRID_POINTS` bins: quick for 500 Hz records, and quieter than a sample."""
    points = min(_GRID_POINTS, time.size)
    edges = np.linspace(time[0], time[-1], points + 1)
    group = np.clip(np.searchsorted(edges, time, side="right") - 1, 0, points - 1)
    count = np.bincount(group, minlength=points)
    filled = count > 0
    return tuple(np.bincount(group, column, points)[filled] / count[filled] for column in (time, degc))  # type: ignore[return-value]


def _turning_points(degc: FloatArray, smallest: float) -> list[int]:
    """First and last index and every extreme after which the temperature goes back by more than `smallest`."""
    turns, low, high, going = [0], 0, 0, 0
    for i, value in enumerate(degc):
        low = i if value < degc[low] else low
        high = i if value > degc[high] else high
        if going >= 0 and degc[high] - value > smallest:
            if going > 0 or high > 0:
                turns.append(high)
            going, low = -1, i
            high = i
        elif going <= 0 and value - degc[low] > smallest:
            if going < 0 or low > 0:
                turns.append(low)
            going, high = 1, i
            low = i
    return sorted({*turns, degc.size - 1})


def _still(time: FloatArray, degc: FloatArray) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Where the slope over the shortest standing time is small (n,)."""
    half = SHORTEST_STILL_S / 2
    before = np.interp(np.maximum(time - half, time[0]), time, degc)
    after = np.interp(np.minimum(time + half, time[-1]), time, degc)
    width = np.minimum(time + half, time[-1]) - np.maximum(time - half, time[0])
    slope = 60.0 * np.abs(after - before) / np.maximum(width, 1e-9)
    limit = max(STILL_SHARE * float(np.quantile(slope, 0.9)), STILL_DEGC_PER_MIN)
    return np.asarray(slope < limit)


def _merge(signs: IntArray, time: FloatArray, degc: FloatArray, smallest: float) -> list[int]:
    """Starts of the runs of one sign, after the runs that are too short have joined a neighbour; mends `signs`."""
    while True:
        starts = [0, *(np.flatnonzero(np.diff(signs)) + 1).tolist()]
        ends = [*starts[1:], signs.size]
        short = [
            (float(time[b - 1] - time[a]), a, b)
            for a, b in zip(starts, ends, strict=True)
            if (time[b - 1] - time[a] < SHORTEST_STILL_S if signs[a] == 0 else abs(degc[b - 1] - degc[a]) < smallest)
        ]
        if not short or len(starts) == 1:
            return starts
        _, a, b = min(short)
        # A still moment inside a ramp belongs to the ramp; between two directions it goes to the earlier one.
        signs[a:b] = signs[a - 1] if a else signs[b]
