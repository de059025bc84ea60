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
import pyarrow as pa
import pyarrow.parquet as pq

from bench.base import DPH_PER_DPS, FloatArray, InputError, IntArray
from bench.record import EARTH, Manifest, floats, seconds_of, use

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

    @cached_property
    def metadata(self) -> pq.FileMetaData:
        """Metadata of the file, which is the one that was recorded."""
        use(self.path.parent, self.path.name)
        try:
            return pq.read_metadata(self.path)
        except (OSError, pa.ArrowException) as error:
            raise InputError(f"not a readable Parquet file ({error})", self.path) from error

    @property
    def rows(self) -> int:
        """Samples of the run."""
        return int(self.metadata.num_rows)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Channels with a value."""
        return tuple(self._ends)

    def range(self, channel: str) -> tuple[float, float]:
        """Smallest and largest value of a channel, out of the file's statistics: no sample is read."""
        if channel not in self._ends:
            have = ", ".join(sorted(self._ends))
            raise InputError(f"channel '{channel}' is missing; the run has {have}", self.path)
        return self._ends[channel]

    @cached_property
    def _earth(self) -> tuple[FloatArray, FloatArray] | None:
        """Times [s] and Earth rate along the axis [deg/h] of the 1 s means; None where it is not removed."""
        manifest = Manifest.find(self.path.parent)
        if manifest is None or manifest.orientation is None:
            return None
        seconds = seconds_of(self.path.parent)
        return seconds.time, seconds.channels[EARTH]

    @cached_property
    def _ends(self) -> dict[str, tuple[float, float]]:
        ends: dict[str, tuple[float, float]] = {}
        for g in range(self.metadata.num_row_groups):
            group = self.metadata.row_group(g)
            for c in range(group.num_columns):
                column, known = group.column(c), group.column(c).statistics
                if known is None or not known.has_min_max:
                    continue
                low, high = float(known.min), float(known.max)
                old = ends.get(column.path_in_schema, (low, high))
                ends[column.path_in_schema] = min(low, old[0]), max(high, old[1])
        return ends

    def read(self, channels: Sequence[str]) -> Iterator[Batch]:
        """All samples with these channels, each once."""
        turns = "applied_rate" in self._ends
        names = tuple(dict.fromkeys(("time", "rate", *channels, *(("applied_rate",) if turns else ()))))
        for name in names:
            self.range(name)
        wanted = [*names, *(("segment",) if "segment" in self._ends else ())]
        carried: dict[str, FloatArray] = {}
        with pq.ParquetFile(self.path, pre_buffer=False, page_checksum_verification=True) as source:
            for batch in _sound(source.iter_batches(batch_size=BATCH_ROWS, columns=wanted), self.path):
                table = {name: floats(batch.column(name)) for name in wanted}
                if carried:
                    table = {name: np.concatenate([carried[name], table[name]]) for name in wanted}
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


def _sound(batches: Iterator[pa.RecordBatch], path: Path) -> Iterator[pa.RecordBatch]:
    """The same; InputError where a page is damaged."""
    try:
        yield from batches
    except (OSError, pa.ArrowException) as error:
        raise InputError(f"is damaged ({error}); restore it from a backup", path) from None


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
