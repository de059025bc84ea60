"""Samples of a run folder's `data.parquet`, in constant memory, every channel on every sample.

The rate is sampled 500 times a second, temperature and the like more seldom. Between two readings of a slow channel
lies the straight line from one to the other, where they are close in time; beyond that, and before the first and after
the last, is a gap. Nothing is filled with the last value.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from bench.base import DPH_PER_DPS, FloatArray, InputError, IntArray
from bench.record import EARTH, Manifest, SampleFile, seconds_of, use

BATCH_ROWS = 1 << 17
REACH_S = 2.5
"""Two readings of a slow channel further apart than this have a gap between them; the slowest comes once a second."""
_STEADY_DPS = 0.1
"""Between two readings of a rate table further apart than this it accelerates [deg/s]: no bias is read there."""


@dataclass(frozen=True, eq=False)
class Batch:
    """Samples (n,) in order of time; y is the bias [deg/h], NaN in gaps."""

    time: FloatArray
    columns: Mapping[str, FloatArray]
    y: FloatArray
    segment: IntArray


@dataclass(frozen=True)
class Samples:
    """The samples of one run; InputError where the file is missing or holds no samples."""

    path: Path

    @property
    def rows(self) -> int:
        """Samples of the run."""
        return self._known[0]

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Channels with a value."""
        return tuple(self._known[1])

    def range(self, channel: str) -> tuple[float, float]:
        """Smallest and largest value of a channel, out of the file's statistics: no sample is read."""
        if channel not in self._known[1]:
            have = ", ".join(sorted(self._known[1]))
            raise InputError(f"channel '{channel}' is missing; the run has {have}", self.path)
        return self._known[1][channel]

    @cached_property
    def _earth(self) -> tuple[FloatArray, FloatArray] | None:
        """Times [s] and Earth rate along the axis [deg/h] of the 1 s means; None where it is not removed."""
        manifest = Manifest.find(self.path.parent)
        if manifest is None or manifest.orientation is None:
            return None
        seconds = seconds_of(self.path.parent)
        return seconds.time, seconds.channels[EARTH]

    @cached_property
    def _known(self) -> tuple[int, dict[str, tuple[float, float]]]:
        """Samples, and smallest and largest value by channel, of the file, which is the one that was recorded."""
        use(self.path.parent, self.path.name)
        ends: dict[str, tuple[float, float]] = {}
        with SampleFile(self.path) as source:
            for group in source.groups:
                for name in source.names:
                    if (known := source.ends(name, group)) is not None:
                        old = ends.get(name, known)
                        ends[name] = min(known[0], old[0]), max(known[1], old[1])
            return source.rows, ends

    def read(self, channels: Sequence[str]) -> Iterator[Batch]:
        """All samples with these channels, each once."""
        turns = "applied_rate" in self._known[1]
        names = tuple(dict.fromkeys(("time", "rate", *channels, *(("applied_rate",) if turns else ()))))
        for name in names:
            self.range(name)
        wanted = [*names, *(("segment",) if "segment" in self._known[1] else ())]
        carried: dict[str, FloatArray] = {}
        with SampleFile(self.path) as source:
            for new in source.batches(wanted, BATCH_ROWS):
                table = {name: np.concatenate([carried[name], new[name]]) for name in wanted} if carried else new
                # What follows the last reading of a slow channel waits for the next one; that reading stays with it.
                slow = [name for name in names if name not in {"time", "rate"}]
                ready = min((_ready(table["time"], table[name]) for name in slow), default=table["time"].size)
                known = min((_last(table[name], ready) for name in slow), default=ready)
                yield self._batch(table, names, carried, ready)
                keep = max(min(known, ready), 0)
                carried = {name: column[keep:].copy() for name, column in table.items()}
                carried["_done"] = np.array([ready - keep])
            table = {name: carried[name] for name in wanted} if carried else {}
            if table and table["time"].size:
                yield self._batch(table, names, carried, table["time"].size)

    def _batch(
        self, table: dict[str, FloatArray], names: Sequence[str], carried: Mapping[str, FloatArray], ready: int
    ) -> Batch:
        done = int(carried["_done"][0]) if carried else 0
        new, time = slice(done, ready), table["time"]
        columns = {name: between(time, table[name], new, name) for name in names if name not in {"time", "rate"}}
        columns["time"], columns["rate"] = time[new], table["rate"][new]
        y = columns["rate"] if self._earth is None else columns["rate"] - np.interp(columns["time"], *self._earth)
        if "applied_rate" in columns:
            y = y - DPH_PER_DPS * columns["applied_rate"]
        segment = np.nan_to_num(table["segment"][new], nan=-1.0) if "segment" in table else np.full(y.size, -1.0)
        return Batch(columns["time"], columns, y, segment.astype(np.int64))


def between(time: FloatArray, values: FloatArray, rows: slice, channel: str = "") -> FloatArray:
    """Values on the rows of `rows`, on the straight line between readings not further apart than `REACH_S`."""
    known = np.flatnonzero(np.isfinite(values))
    if known.size == values.size:
        return values[rows]
    at = time[rows]
    if known.size < 2:
        return values[rows]
    t, v = time[known], values[known]
    out = np.interp(at, t, v, left=np.nan, right=np.nan)
    far = np.diff(t) > REACH_S
    if channel == "applied_rate":
        far |= np.abs(np.diff(v)) > _STEADY_DPS
    if far.any():
        i = np.clip(np.searchsorted(t, at, side="right") - 1, 0, far.size - 1)
        out[far[i] & (at > t[i]) & (at < t[i + 1])] = np.nan
    return out


def _last(values: FloatArray, before: int) -> int:
    """Row of the last reading before this row; the row itself where there is none."""
    known = np.flatnonzero(np.isfinite(values[:before]))
    return int(known[-1]) if known.size else before


def _ready(time: FloatArray, values: FloatArray) -> int:
    """Rows of which the value is known for good: to the last reading, or so old that none can reach them."""
    known = np.flatnonzero(np.isfinite(values))
    old = int(np.searchsorted(time, time[-1] - REACH_S)) if time.size else 0
    return max(int(known[-1]) + 1 if known.size else 0, old)
