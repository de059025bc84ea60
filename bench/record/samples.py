"""`data.parquet`: every sample of a run, a row for each tick of the unit's counter; missing values are null.

A channel whose values are integers on the wire is kept as these integers, in a column `<channel>_code` whose metadata
say what they mean: value = (code * scale + offset) * factor, in the unit of the channel. They need a quarter of the
bytes of the numbers that they stand for, and give them bit for bit. Other channels, and those of older benches and of
imports, are columns of numbers under their own name. `SampleFile` reads both.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from bench.base import CHANNELS, FloatArray, InputError, IntArray

CODE = "_code"


@dataclass(frozen=True)
class Code:
    """What the integers of a channel mean; `wide`: they need more than 31 bits and a sign."""

    scale: float
    offset: float = 0.0
    factor: float = 1.0
    wide: bool = False

    def values(self, codes: Any) -> FloatArray:
        """Values (n,) in the unit of the channel: the operations of the decoder in their order, so that bits agree."""
        numbers: FloatArray = np.asarray(codes).astype(np.float64)
        if self.scale != 1.0:
            numbers *= self.scale
        if self.offset != 0.0:
            numbers += self.offset
        numbers *= self.factor
        return numbers

    def codes(self, values: FloatArray) -> IntArray:
        """Codes (n,) of values; 0 for NaN."""
        found: IntArray = np.rint((np.nan_to_num(values) / self.factor - self.offset) / self.scale).astype(np.int64)
        return found

    def field(self, channel: str) -> pa.Field:
        """The column of a channel."""
        facts = {
            "channel": channel,
            "unit": CHANNELS[channel].unit,
            "scale": repr(self.scale),
            "offset": repr(self.offset),
            "factor": repr(self.factor),
        }
        return pa.field(channel + CODE, pa.int64() if self.wide else pa.int32(), metadata=facts)

    def array(self, values: FloatArray) -> pa.Array:
        """The column for values (n,); NaN is null."""
        kind = np.int64 if self.wide else np.int32
        return pa.array(self.codes(values).astype(kind), mask=np.isnan(values))

    @classmethod
    def of(cls, field: pa.Field) -> Code | None:
        """What the metadata of a column say; None: it holds numbers."""
        said: Mapping[bytes, bytes] = field.metadata or {}
        if b"channel" not in said:
            return None
        scale, offset, factor = (float(said[name]) for name in (b"scale", b"offset", b"factor"))
        return cls(scale, offset, factor, field.type == pa.int64())


def channel_of(field: pa.Field) -> str:
    """The channel of a column."""
    said: Mapping[bytes, bytes] = field.metadata or {}
    name: bytes = said.get(b"channel", field.name.encode())
    return name.decode()


class SampleFile:
    """Reads `data.parquet` as numbers by channel; a context manager. InputError where it cannot be read."""

    def __init__(self, path: Path | str) -> None:
        self.path = path
        try:
            self._file = pq.ParquetFile(path, pre_buffer=False, page_checksum_verification=True)
        except (OSError, pa.ArrowException) as error:
            raise InputError(f"not a readable Parquet file ({error})", path) from error
        schema = self._file.schema_arrow
        self._codes = {channel_of(field): code for field in schema if (code := Code.of(field)) is not None}
        self.names = tuple(map(channel_of, schema))
        """Its columns: channels and `segment`."""
        self._stored = dict(zip(self.names, schema.names, strict=True))

    def __enter__(self) -> SampleFile:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._file.close()

    @property
    def rows(self) -> int:
        """Samples."""
        return int(self._file.metadata.num_rows)

    @property
    def groups(self) -> range:
        """Its row groups."""
        return range(self._file.num_row_groups)

    def batches(self, names: Sequence[str], rows: int) -> Iterator[dict[str, FloatArray]]:
        """Columns (n,) of these names in order of time, n at most `rows`; NaN is a gap."""
        stored = [self._stored[name] for name in names]
        try:
            for batch in self._file.iter_batches(batch_size=rows, columns=stored):
                yield self._numbers(batch, names)
        except (OSError, pa.ArrowException) as error:
            raise InputError(f"is damaged ({error}); restore it from a backup", self.path) from None

    def read(self, names: Sequence[str], groups: Sequence[int] | None = None) -> dict[str, FloatArray]:
        """The same of some row groups, or of all, at once."""
        stored = [self._stored[name] for name in names]
        try:
            table = self._file.read_row_groups(list(self.groups if groups is None else groups), columns=stored)
        except (OSError, pa.ArrowException) as error:
            raise InputError(f"is damaged ({error}); restore it from a backup", self.path) from None
        return self._numbers(table, names)

    def ends(self, name: str, group: int) -> tuple[float, float] | None:
        """Smallest and largest value of a channel in a row group, out of the file's statistics; None: not known."""
        known = self._file.metadata.row_group(group).column(self._place[name]).statistics
        if known is None or not known.has_min_max:
            return None
        code = self._codes.get(name)
        ends = [float(known.min), float(known.max)] if code is None else code.values([known.min, known.max]).tolist()
        return min(ends), max(ends)

    @cached_property
    def _place(self) -> dict[str, int]:
        return {name: place for place, name in enumerate(self.names)}

    def _numbers(self, table: Any, names: Sequence[str]) -> dict[str, FloatArray]:
        found = {}
        for name in names:
            values, code = floats(table.column(self._stored[name])), self._codes.get(name)
            found[name] = values if code is None else code.values(values)
        return found


def samples_writer(path: Path, schema: pa.Schema) -> pq.ParquetWriter:
    """A writer of `data.parquet`, a context manager that takes tables of this schema, each a row group."""
    encodings = {
        field.name: "BYTE_STREAM_SPLIT" if field.type == pa.float64() else "DELTA_BINARY_PACKED" for field in schema
    }
    encodings.pop("segment", None)
    options = {"compression": "zstd", "write_page_checksum": True, "use_dictionary": ["segment"]}
    return pq.ParquetWriter(path, schema, column_encoding=encodings, **options)


def write_samples(path: Path, columns: Mapping[str, np.ndarray[Any, Any]]) -> None:
    """Write `data.parquet` of columns (n,) by channel and `segment`; NaN is a gap."""
    table = pa.table({name: pa.array(values, from_pandas=True) for name, values in columns.items()})
    with samples_writer(path, table.schema) as writer:
        writer.write_table(table)


def read_samples(path: Path | str, *names: str) -> dict[str, FloatArray]:
    """All samples of `data.parquet`, columns (n,) by channel; without names, all channels."""
    with SampleFile(path) as file:
        return file.read(names or file.names)


def floats(column: pa.Array) -> FloatArray:
    """Values of a column (n,) as numbers, NaN where there is none."""
    if pa.types.is_boolean(column.type):
        column = column.cast(pa.uint8())
    column = column.cast(pa.float64())
    pieces = column.chunks if isinstance(column, pa.ChunkedArray) else [column]
    return np.concatenate([_floats(piece) for piece in pieces]) if pieces else np.empty(0)


def _floats(column: pa.Array) -> FloatArray:
    """The same of one piece of doubles. `to_numpy` would import pandas, a tenth of the time of a short command."""
    present, values = column.buffers()
    rows = slice(column.offset, column.offset + len(column))
    numbers: FloatArray = np.frombuffer(values, dtype=np.float64)[rows]
    if not column.null_count:
        return numbers
    bits = np.unpackbits(np.frombuffer(present, dtype=np.uint8), bitorder="little")[rows]
    return np.where(bits == 1, numbers, np.nan)
