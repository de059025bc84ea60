"""1 s means of a 500 Hz record, streamed in constant memory: `data.parquet` -> `means.parquet`."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from bench.base import FloatArray, InputError, IntArray
from bench.record.samples import SampleFile

INTERVAL_S = 1.0
_BATCH_ROWS = 1 << 16
_GROUP_ROWS = 1 << 18
"""Rows of a row group: the means of three days are read in one piece."""


def write_means(data_parquet: Path | str, out: Path | str) -> int:
    """Write means, counts and variances of each second of `data_parquet` to `out`; returns the rows written.

    A second is split where the segment changes inside it, so that no mean mixes two segments. `time` is the centre of
    the second (of the samples, where it is split). `<channel>_count` counts the samples that are not gaps;
    `<channel>_var` is their sample variance, null below two. Memory does not grow with the record.
    Raises InputError when the file cannot be read or its time runs backwards.
    """
    source = SampleFile(data_parquet)
    names = [name for name in source.names if name not in {"time", "segment"}]
    if "time" not in source.names:
        raise InputError("has no column 'time'", data_parquet)
    rows, waiting, schema = 0, list[pa.Table](), _schema(names)
    with source, pq.ParquetWriter(out, schema, compression="zstd", write_page_checksum=True) as writer:
        for columns in _whole_seconds(source, names, data_parquet):
            means = _means(columns, names)
            arrays = [pa.array(means[item.name], type=item.type, from_pandas=True) for item in schema]
            waiting.append(pa.Table.from_arrays(arrays, schema=schema))
            rows += len(waiting[-1])
            if sum(map(len, waiting)) >= _GROUP_ROWS:
                writer.write_table(pa.concat_tables(waiting))
                waiting = []
        if waiting:
            writer.write_table(pa.concat_tables(waiting))
    return rows


def _schema(names: list[str]) -> pa.Schema:
    fields = [pa.field("time", pa.float64())]
    for name in names:
        fields += [pa.field(name, pa.float64()), pa.field(f"{name}_count", pa.int32())]
        fields.append(pa.field(f"{name}_var", pa.float64()))
    return pa.schema([*fields, pa.field("segment", pa.int16())])


def _whole_seconds(source: SampleFile, names: list[str], where: Path | str) -> Iterator[dict[str, FloatArray]]:
    """Batches of float columns that end at a second's end; the started second is carried into the next batch."""
    wanted = [name for name in ("time", "segment", *names) if name in source.names]
    carried: dict[str, FloatArray] = {}
    for new in source.batches(wanted, _BATCH_ROWS):
        columns = {name: np.concatenate([carried[name], new[name]]) for name in wanted} if carried else new
        time = columns["time"]
        if time.size == 0:
            continue
        if not np.all(np.isfinite(time)) or np.any(np.diff(time) < 0):
            raise InputError("time has gaps or runs backwards", where)
        split = int(np.searchsorted(time, np.floor(time[-1] / INTERVAL_S) * INTERVAL_S))
        carried = {name: column[split:] for name, column in columns.items()}
        if split:
            yield {name: column[:split] for name, column in columns.items()}
    if carried:
        yield carried


def _means(columns: dict[str, FloatArray], names: list[str]) -> dict[str, FloatArray | IntArray]:
    time = columns["time"]
    second = np.floor(time / INTERVAL_S)
    segment = columns["segment"] if "segment" in columns else np.full(time.shape, -1.0)
    segment = np.where(np.isnan(segment), -1.0, segment)
    new = np.empty(time.size, dtype=bool)
    new[0] = True
    new[1:] = (second[1:] != second[:-1]) | (segment[1:] != segment[:-1])
    starts = np.flatnonzero(new)
    group = np.cumsum(new) - 1
    shared = np.bincount(np.unique(second[starts], return_inverse=True)[1])
    split = np.repeat(shared, shared) > 1
    centre = (second[starts] + 0.5) * INTERVAL_S
    lengths = np.diff(np.append(starts, time.size))
    out: dict[str, FloatArray | IntArray] = {
        "time": np.where(split, np.add.reduceat(time, starts) / lengths, centre),
        "segment": segment[starts].astype(np.int64),
    }
    for name in names:
        out |= _one(name, columns[name], starts, group)
    return out


def _one(name: str, value: FloatArray, starts: IntArray, group: IntArray) -> dict[str, FloatArray | IntArray]:
    present = np.isfinite(value)
    count = np.add.reduceat(present.astype(np.int64), starts)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.add.reduceat(np.where(present, value, 0.0), starts) / count
        # Second pass about the mean: the one-pass formula loses all digits on a 14 kHz frequency.
        square = np.where(present, value - mean[group], 0.0) ** 2
        variance = np.where(count > 1, np.add.reduceat(square, starts) / (count - 1), np.nan)
    return {name: mean, f"{name}_count": count, f"{name}_var": variance}
