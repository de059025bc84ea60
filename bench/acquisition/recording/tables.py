"""Decoded samples, readings and segments of a run → `data.parquet`, in row groups, in constant memory."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from bench.acquisition.recording.journals import Readings
from bench.acquisition.recording.validity import sound_air
from bench.base import CHANNELS, OUTPUTS, THERMOMETERS, FloatArray, IntArray
from bench.record import Code, ExecutedSegment, channel_of, samples_writer
from drivers.block import Code as Wire
from drivers.gyro import GyroBlock, SampleClock

ROWS_PER_GROUP = 1 << 19
HOLD_BACK = 2000
"""Newest samples that wait for their slow frames before a row group is written."""

MOST_BITS = 32
"""A channel with longer raw values is kept as numbers."""
Wires = Mapping[str, Wire]
"""Channels on the wire, by name."""

_CHAMBER = {"chamber_temperature": "temperature", "chamber_setpoint": "working_setpoint", "compressor": "compressor"}


USUAL = {"time", "rate", "temperature", "frequency", "drive", "quadrature", "supply", *_CHAMBER}
"""Columns of every unit with one output."""


class Grid:
    """Readings of chamber and rate table, and segments, on the sample grid of the unit."""

    def __init__(
        self,
        readings: Readings,
        table: Readings,
        instruments: Readings,
        segments: Sequence[ExecutedSegment],
        clock: SampleClock,
    ) -> None:
        self.clock, self.readings = clock, readings
        self.turns = len(table) > 0
        self.placed = self.turns and any(segment.attitude is not None for segment in segments)
        """Whether units stood on the table in attitudes of a fixture."""
        self._segments = segments
        chamber = {name: readings[field] for name, field in _CHAMBER.items()}
        self.read_at = self.nearest(readings["t_s"])
        """Tick of each reading of the chamber."""
        self.sound_air = sound_air(readings["t_s"], readings["temperature"])
        """Which of these readings' air can be."""
        if not self.sound_air.all():
            air = chamber["chamber_temperature"]
            chamber["chamber_temperature"] = np.where(self.sound_air | np.isnan(air), air, np.nan)
        self._sources = [(self.read_at, chamber)]
        if self.turns:
            index = self.nearest(table["t_s"])
            new = np.diff(index, prepend=-1) > 0  # two readings at one tick: stamps of a host that was late
            turned = {"applied_rate": table["rate_dps"][new]}
            if self.placed:
                turned["table_angle"] = table["position_deg"][new]
            self._sources.append((index[new], turned))
        self.measured = {name.decode() for name in np.unique(instruments["channel"])}
        """Channels of instruments."""
        for name in sorted(self.measured):
            own = instruments[instruments["channel"] == name.encode()]
            index = self.nearest(own["t_s"])
            new = np.diff(index, prepend=-1) > 0
            self._sources.append((index[new], {name: own["value"][new]}))

    def air_for_unit(self) -> None:
        """The air of the chamber is the temperature of a unit that sends none."""
        chamber = self._sources[0][1]
        chamber["temperature"] = chamber["chamber_temperature"]

    def nearest(self, t_s: FloatArray) -> IntArray:
        """Tick nearest to each bench time (r,); without a time no clock is needed."""
        if not len(t_s):
            return np.zeros(0, dtype=np.int64)
        nominal = np.rint(t_s / self.clock.interval_s).astype(np.int64)
        error = self.clock.time(nominal) - t_s
        return nominal - np.rint(error / self.clock.interval_s).astype(np.int64)

    def air(self) -> tuple[IntArray, FloatArray]:
        """Ticks (r,) and values of the readings of the chamber's air that can be [degC]."""
        return self.read_at[self.sound_air], self.readings["temperature"][self.sound_air]

    def between(self, first: int | None, end: int | None) -> dict[str, tuple[IntArray, FloatArray]]:
        """Ticks and values of the readings in [first, end), by channel; None: no bound."""
        found: dict[str, tuple[IntArray, FloatArray]] = {}
        for index, channels in self._sources:
            start = 0 if first is None else int(np.searchsorted(index, first))
            stop = len(index) if end is None else int(np.searchsorted(index, end))
            found |= {name: (index[start:stop], value[start:stop]) for name, value in channels.items()}
        return found

    def segment(self, time: FloatArray) -> IntArray:
        """Segment in force at each bench time (n,), -1 between segments."""
        starts = np.array([segment.from_s for segment in self._segments])
        ends = np.array([segment.to_s for segment in self._segments])
        if not len(starts):
            return np.full(len(time), -1, dtype=np.int64)
        at = np.searchsorted(starts, time, side="right") - 1
        inside = (at >= 0) & (time < ends[at])
        return np.where(inside, at, -1)


class _Pending:
    """Decoded samples that are not written yet."""

    def __init__(self, output: str) -> None:
        self.count = 0
        self.newest = 0
        self._output = output
        self._parts: dict[str, list[tuple[IntArray, FloatArray]]] = {output: []}

    def add(self, block: GyroBlock) -> None:
        if len(block.index):
            self.newest = int(block.index[-1])
        self.count += len(block.index)
        self._parts[self._output].append((block.index, block.rate_dph))
        for name, series in block.slow.items():
            self._parts.setdefault(name, []).append((series.index, series.value))

    def take(self, end: int | None) -> dict[str, tuple[IntArray, FloatArray]]:
        """Channels before tick `end` (all of them for None), which leave the waiting room."""
        taken: dict[str, tuple[IntArray, FloatArray]] = {}
        for name, pairs in self._parts.items():
            index = np.concatenate([pair[0] for pair in pairs] or [np.zeros(0, np.int64)])
            value = np.concatenate([pair[1] for pair in pairs] or [np.zeros(0)])
            cut = len(index) if end is None else int(np.searchsorted(index, end))
            taken[name] = index[:cut], value[:cut]
            self._parts[name] = [(index[cut:], value[cut:])]
        self.count -= len(taken[self._output][0])
        return taken


def write_data(path: Path, parts: Sequence[tuple[Iterator[GyroBlock], Grid]], wires: Sequence[Wires] = ()) -> int:
    """Write `data.parquet` in row groups, in constant memory; returns the number of rows.

    `wires` are the channels of each part on its wire: where all agree, integers are kept as integers.
    """
    turns = any(grid.turns for _, grid in parts)
    sent = set(wires[0]) if wires else {"rate", "temperature"}
    usual = USUAL if "rate" in sent else {"time", *_CHAMBER}
    turned = {"applied_rate"} if turns else set()
    turned |= {"table_angle"} if any(grid.placed for _, grid in parts) else set()
    measured = {name for _, grid in parts for name in grid.measured}
    names = [name for name in CHANNELS if name in usual | sent | turned | measured]
    if not sent & set(THERMOMETERS):  # the air of the chamber takes its place
        if "temperature" not in names:
            names.insert(2, "temperature")
        for _, grid in parts:
            grid.air_for_unit()
    codes, output = _codes(wires), next((name for name in OUTPUTS if name in sent), "rate")
    fields = [codes[name].field(name) if name in codes else pa.field(name, pa.float64()) for name in names]
    schema = pa.schema([*fields, pa.field("segment", pa.int16())])
    with samples_writer(path, schema) as writer:
        return sum(_write_part(writer, blocks, grid, codes, output) for blocks, grid in parts)


def _codes(wires: Sequence[Wires]) -> dict[str, Code]:
    """Channels that are kept as integers."""
    return {
        name: Code(wire.scale, wire.offset, wire.factor, wide=wire.bits - wire.signed > MOST_BITS - 1)
        for name, wire in (wires[0] if wires else {}).items()
        if 0 < wire.bits <= MOST_BITS and all(other.get(name) == wire for other in wires)
    }


def _write_part(
    writer: pq.ParquetWriter, blocks: Iterator[GyroBlock], grid: Grid, codes: Mapping[str, Code], output: str
) -> int:
    pending = _Pending(output)
    rows, first = 0, None
    for block in blocks:
        pending.add(block)
        if pending.count >= ROWS_PER_GROUP + HOLD_BACK:
            end = pending.newest - HOLD_BACK
            rows += _write_group(writer, {**pending.take(end), **grid.between(first, end)}, grid, codes)
            first = end
    return rows + _write_group(writer, {**pending.take(None), **grid.between(first, None)}, grid, codes)


def _write_group(
    writer: pq.ParquetWriter,
    parts: dict[str, tuple[IntArray, FloatArray]],
    grid: Grid,
    codes: Mapping[str, Code],
) -> int:
    index = _union([part[0] for part in parts.values()])
    if not len(index):
        return 0
    time = grid.clock.time(index)
    columns = []
    for item in writer.schema:
        name = channel_of(item)
        if name == "time":
            columns.append(pa.array(time))
        elif name == "segment":
            columns.append(pa.array(grid.segment(time).astype(np.int16)))
        else:
            column = np.full(len(index), np.nan)
            if name in parts:
                where, value = parts[name]
                column[np.searchsorted(index, where)] = value
            columns.append(codes[name].array(column) if name in codes else pa.array(column, from_pandas=True))
    writer.write_table(pa.Table.from_arrays(columns, schema=writer.schema), row_group_size=len(index))
    return len(index)


def _union(indices: Sequence[IntArray]) -> IntArray:
    """Every tick that one of the ascending `indices` has, ascending, once."""
    merged = np.sort(np.concatenate(indices), kind="stable")  # merges what is sorted in parts, in linear time
    new = np.ones(len(merged), dtype=bool)
    new[1:] = merged[1:] != merged[:-1]
    union: IntArray = merged[new]
    return union
