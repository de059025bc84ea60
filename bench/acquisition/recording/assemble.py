"""Journals → tables of the run folder: `data.parquet`, `means.parquet`, `events.jsonl`, `manifest.json`.

The same code finishes a run and recovers a killed one: it needs nothing but the journals. Rows of `data.parquet` are
ticks of the unit's sample counter; a chamber reading stands on the tick nearest to it; what was not sampled is null.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from bench.acquisition.recording import parts as parted
from bench.acquisition.recording.journals import BenchJournal, Readings, bus_blocks, fetch, read_bench
from bench.acquisition.recording.parts import Counted
from bench.base import CHANNELS, FloatArray, IntArray
from bench.record import EVENTS, ExecutedSegment, GyroKind, Manifest, RunFolder, write_events, write_means
from drivers.frames import joined
from drivers.gyro import GyroBlock, GyroDecoder, SampleClock
from drivers.journal import Damage, FrameArray

ROWS_PER_GROUP = 1 << 19
FRAMES_AT_ONCE = 1 << 15
HOLD_BACK = 2000
"""Newest samples that wait for their slow frames before a row group is written."""

_CHAMBER = {"chamber_temperature": "temperature", "chamber_setpoint": "working_setpoint", "compressor": "compressor"}


@dataclass(frozen=True)
class Decoded:
    """A decoder that has seen all frames of a run, and the clock it found; live, or from the journal."""

    decoder: GyroDecoder
    clock: SampleClock


@dataclass
class _Part:
    """One part of a run, ready to be written; `decoder` counts what it hands out."""

    journal: BenchJournal
    seen: Decoded
    decoder: GyroDecoder
    blocks: Iterator[GyroBlock]

    def grid(self, segments: Sequence[ExecutedSegment]) -> _Grid:
        """Where readings of chamber and table can be placed: no sample, no clock to place them on."""
        kept = None if self.seen.decoder.samples else 0
        return _Grid(self.journal.readings[:kept], self.journal.table[:kept], segments, self.seen.clock)

    def counted(self) -> Counted:
        """What it tells of the unit's counter."""
        decoder = self.seen.decoder
        return Counted(decoder.samples, decoder.losses.resets, self.seen.clock, decoder.counter_bits)


def assemble(run: RunFolder, live: Decoded | None = None) -> Manifest:
    """Make the tables and the manifest of a run from the journals of all its parts; returns the manifest.

    `live` saves a pass over the frames of the last part when they were decoded already. InputError when there is
    nothing to make a run from, OSError when the disk does not take the tables.
    """
    damage = Damage()
    bus_events: list[dict[str, Any]] = []
    folders = parted.recorded(run)
    parts = [_part(part, live if part == folders[-1] else None, damage, bus_events) for part in folders]
    journals = parted.apart([part.journal for part in parts])
    first, last = journals[0], journals[-1]
    segments = parted.segments(journals)
    grids = [part.grid(segments) for part in parts]
    rows = _write_data(run.data, [(part.blocks, grid) for part, grid in zip(parts, grids, strict=True)])
    write_means(run.data, run.means)
    events = [event for journal in journals for event in (*journal.events, *journal.watchdog)]
    capture, news = _capture(bus_events)
    events = sorted((*events, *news), key=lambda event: float(event["t_s"]))
    write_events(run.path / EVENTS, events)
    seen = max((part.seen for part in parts), key=lambda seen: seen.decoder.samples)
    losses = [part.decoder.losses.as_dict() for part in parts]
    identities = [identity for part in parts if (identity := part.decoder.identity) is not None]
    readings = np.concatenate([journal.readings for journal in journals])
    content = {
        **first.meta.content(),
        **last.outcome(),
        "sample_rate_hz": round(1 / seen.decoder.interval_s),
        "rate_step_dph": seen.decoder.rate_step_dph,
        "unit_clock": asdict(seen.clock.estimate()) if seen.decoder.samples else None,
        "capture": capture,
        "unit_identity": asdict(identities[-1]) if identities else None,
        "rows": rows,
        "duration_s": float(readings["t_s"][-1]) if len(readings) else 0.0,
        "segments": segments,
        "losses": {
            **{name: sum(loss[name] for loss in losses) for name in losses[0]},
            "journal_damaged_bytes": damage.skipped_bytes + damage.torn_bytes,
        },
        **({"parts": parted.describe(journals, [part.counted() for part in parts])} if len(parts) > 1 else {}),
        "files": run.hashes(),
    }
    manifest = Manifest.model_validate(content)
    manifest.write(run.path)
    return manifest


def _capture(said: Sequence[dict[str, Any]]) -> tuple[dict[str, Any] | None, list[dict[str, Any]]]:
    """How captures kept up with the bus, None where nobody says so; and what they said that is news."""
    behind_ms = [event["most_behind_ms"] for event in said if "most_behind_ms" in event]
    ends = [event for event in said if "behind_spells" in event]
    kept_up = {
        "most_behind_s": max(behind_ms, default=0) * 1e-3,
        "behind_spells": sum(event["behind_spells"] for event in ends),
        **{name: sum(event[name] for event in ends) for name in ("error_frames", "unreadable", "recoveries")},
    }
    return kept_up if behind_ms else None, [event for event in said if "no_news" not in event]


def _part(run: RunFolder, live: Decoded | None, damage: Damage, bus_events: list[dict[str, Any]]) -> _Part:
    bench = read_bench(run, damage)
    gyro = bench.gyro
    source = run.journal / f"{gyro.bus}.gtbj"
    fetch(run, bench.meta, source.relative_to(run.path))
    until_ns = bench.sound_until_ns()
    decoder = GyroDecoder(gyro.layout, gyro.number)
    blocks = (decoder.decode(frames) for frames in _joined(bus_blocks(source, damage, bus_events, until_ns)))
    return _Part(bench, live or _decode_all(source, gyro, until_ns), decoder, blocks)


def _decode_all(source: Path, gyro: GyroKind, until_ns: int | None) -> Decoded:
    """A first pass over the frames: their losses and the unit's clock."""
    decoder = GyroDecoder(gyro.layout, gyro.number)
    clock = SampleClock(decoder.interval_s)
    for frames in _joined(bus_blocks(source, Damage(), [], until_ns)):
        decoded = decoder.decode(frames)
        clock.add(decoded.index, decoded.t_ns)
    return Decoded(decoder, clock)


def _joined(blocks: Iterable[FrameArray]) -> Iterator[FrameArray]:
    """The same frames in fewer, larger blocks: they decode several times faster."""
    waiting: list[FrameArray] = []
    count = 0
    for block in blocks:
        waiting.append(block)
        count += len(block)
        if count >= FRAMES_AT_ONCE:
            yield joined(waiting)
            waiting, count = [], 0
    if waiting:
        yield joined(waiting)


class _Grid:
    """Readings of chamber and rate table, and segments, on the sample grid of the unit."""

    def __init__(
        self, readings: Readings, table: Readings, segments: Sequence[ExecutedSegment], clock: SampleClock
    ) -> None:
        self.clock = clock
        self.turns = len(table) > 0
        self._segments = segments
        chamber = {name: readings[field] for name, field in _CHAMBER.items()}
        self._sources = [(self._nearest(readings["t_s"]), chamber)]
        if self.turns:
            index = self._nearest(table["t_s"])
            new = np.diff(index, prepend=-1) > 0  # two readings at one tick: stamps of a host that was late
            self._sources.append((index[new], {"applied_rate": table["rate_dps"][new]}))

    def _nearest(self, t_s: FloatArray) -> IntArray:
        """Tick nearest to each bench time (r,); without a time no clock is needed."""
        if not len(t_s):
            return np.zeros(0, dtype=np.int64)
        nominal = np.rint(t_s / self.clock.interval_s).astype(np.int64)
        error = self.clock.time(nominal) - t_s
        return nominal - np.rint(error / self.clock.interval_s).astype(np.int64)

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

    def __init__(self) -> None:
        self.count = 0
        self.newest = 0
        self._parts: dict[str, list[tuple[IntArray, FloatArray]]] = {"rate": []}

    def add(self, block: GyroBlock) -> None:
        if len(block.index):
            self.newest = int(block.index[-1])
        self.count += len(block.index)
        self._parts["rate"].append((block.index, block.rate_dph))
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
        self.count -= len(taken["rate"][0])
        return taken


def _write_data(path: Path, parts: Sequence[tuple[Iterator[GyroBlock], _Grid]]) -> int:
    """Write `data.parquet` in row groups, in constant memory; returns the number of rows."""
    options = {"compression": "zstd", "write_page_checksum": True, "use_dictionary": ["segment"]}
    turns = any(grid.turns for _, grid in parts)
    floats = [name for name in CHANNELS if name != "applied_rate" or turns]
    splits = dict.fromkeys(floats, "BYTE_STREAM_SPLIT")
    schema = pa.schema([*(pa.field(name, pa.float64()) for name in floats), pa.field("segment", pa.int16())])
    with pq.ParquetWriter(path, schema, column_encoding=splits, **options) as writer:
        return sum(_write_part(writer, blocks, grid) for blocks, grid in parts)


def _write_part(writer: pq.ParquetWriter, blocks: Iterator[GyroBlock], grid: _Grid) -> int:
    pending = _Pending()
    rows, first = 0, None
    for block in blocks:
        pending.add(block)
        if pending.count >= ROWS_PER_GROUP + HOLD_BACK:
            end = pending.newest - HOLD_BACK
            rows += _write_group(writer, pending.take(end), grid, first, end)
            first = end
    return rows + _write_group(writer, pending.take(None), grid, first, None)


def _write_group(
    writer: pq.ParquetWriter,
    parts: dict[str, tuple[IntArray, FloatArray]],
    grid: _Grid,
    first: int | None,
    end: int | None,
) -> int:
    parts = {**parts, **grid.between(first, end)}
    index = _union([part[0] for part in parts.values()])
    if not len(index):
        return 0
    time = grid.clock.time(index)
    columns = []
    for item in writer.schema:
        if item.name == "time":
            columns.append(pa.array(time))
        elif item.name == "segment":
            columns.append(pa.array(grid.segment(time).astype(np.int16)))
        else:
            column = np.full(len(index), np.nan)
            if item.name in parts:
                where, value = parts[item.name]
                column[np.searchsorted(index, where)] = value
            columns.append(pa.array(column, from_pandas=True))
    writer.write_table(pa.Table.from_arrays(columns, schema=writer.schema), row_group_size=len(index))
    return len(index)


def _union(indices: Sequence[IntArray]) -> IntArray:
    """Every tick that one of the ascending `indices` has, ascending, once."""
    merged = np.sort(np.concatenate(indices), kind="stable")  # merges what is sorted in parts, in linear time
    new = np.ones(len(merged), dtype=bool)
    new[1:] = merged[1:] != merged[:-1]
    union: IntArray = merged[new]
    return union
