"""What differs between a record and the same made again: JSON trees and tables, compared exactly."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

BATCH_ROWS = 1 << 18
_ABSENT = "(absent)"


@dataclass(frozen=True)
class Change:
    """One difference: `where` is a key, or a column; of a column the first row that differs stands for all `count`."""

    file: str
    where: str
    then: Any
    now: Any
    row: int | None = None
    count: int = 1
    largest: float | None = None
    """Greatest absolute difference of a column's numbers."""

    def to_json(self) -> dict[str, Any]:
        """An entry of `differences`."""
        return {
            "file": self.file, "where": self.where, "row": self.row, "then": self.then, "now": self.now,
            "count": self.count, "largest": self.largest,
        }  # fmt: skip

    def __str__(self) -> str:
        at = f" row {self.row}" if self.row is not None else ""
        more = f" ({self.count} rows differ, by {self.largest:.3g} at most)" if self.largest is not None else ""
        return f"{self.file}: {self.where}{at}: then {_short(self.then)}, now {_short(self.now)}{more}"


def trees(file: str, then: Any, now: Any, where: str = "", skip: Collection[str] = ()) -> Iterator[Change]:
    """Differences of two JSON values; keys in `skip` are not looked at, at any depth."""
    if isinstance(then, dict) and isinstance(now, dict):
        for key in [*then, *(key for key in now if key not in then)]:
            if key not in skip:
                path = f"{where}.{key}" if where else str(key)
                yield from trees(file, then.get(key, _ABSENT), now.get(key, _ABSENT), path, skip)
    elif isinstance(then, list) and isinstance(now, list):
        for i, (old, new) in enumerate(zip_longest(then, now, fillvalue=_ABSENT)):
            yield from trees(file, old, new, f"{where}[{i}]", skip)
    elif then != now or isinstance(then, bool) != isinstance(now, bool):
        yield Change(file, where, then, now)


def texts(file: str, then: str, now: str) -> Iterator[Change]:
    """The first line that differs."""
    pairs = list(zip_longest(then.splitlines(), now.splitlines(), fillvalue=_ABSENT))
    wrong = [i for i, (old, new) in enumerate(pairs) if old != new]
    if wrong:
        yield Change(file, "line", *pairs[wrong[0]], row=wrong[0] + 1, count=len(wrong))


def tables(then: Path, now: Path) -> Iterator[Change]:
    """Differences of two Parquet tables, streamed: missing columns, number of rows, then every value's bits."""
    name = then.name
    try:
        with pq.ParquetFile(then) as old, pq.ParquetFile(now) as new:
            here, there = old.schema_arrow.names, new.schema_arrow.names
            yield from (Change(name, f"column {column}", "present", _ABSENT) for column in here if column not in there)
            yield from (Change(name, f"column {column}", _ABSENT, "present") for column in there if column not in here)
            if old.metadata.num_rows != new.metadata.num_rows:
                yield Change(name, "rows", old.metadata.num_rows, new.metadata.num_rows)
                return
            for column in here:
                if column in there and (change := _column(name, column, old, new)) is not None:
                    yield change
    except (OSError, pa.ArrowException) as error:
        yield Change(name, "file", f"not readable ({error})", "readable")


def _column(file: str, column: str, old: pq.ParquetFile, new: pq.ParquetFile) -> Change | None:
    """The first value of a column that differs; null is not NaN, and -0 is not 0."""
    first: tuple[int, Any, Any] | None = None
    row, count, largest = 0, 0, 0.0
    batches = (table.iter_batches(batch_size=BATCH_ROWS, columns=[column]) for table in (old, new))
    for then, now in zip(*batches, strict=True):
        a, b = then.column(0), now.column(0)
        wrong = np.flatnonzero(_bits(a) != _bits(b))
        if wrong.size:
            at = int(wrong[0])
            first = first or (row + at, _plain(a[at].as_py()), _plain(b[at].as_py()))
            count += int(wrong.size)
            off = np.abs(_floats(a)[wrong] - _floats(b)[wrong])
            largest = max(largest, float(np.nanmax(off, initial=0.0)))
        row += len(a)
    return None if first is None else Change(file, f"column {column}", *first[1:], first[0], count, largest)


def _bits(column: pa.Array) -> Any:
    """Values (n,) so that equal means the same bits and the same null."""
    values = column.fill_null(0).to_numpy(zero_copy_only=False)
    raw = np.ascontiguousarray(values).view(f"u{values.dtype.itemsize}").astype(np.uint64)
    null = column.is_null().to_numpy(zero_copy_only=False)
    return np.rec.fromarrays([raw, null])


def _floats(column: pa.Array) -> Any:
    return column.cast(pa.float64()).to_numpy(zero_copy_only=False)


def _plain(value: Any) -> Any:
    return repr(value) if isinstance(value, float) and not np.isfinite(value) else value


def _short(value: Any) -> str:
    text = repr(value) if isinstance(value, float) else str(value)
    return text if len(text) <= 100 else f"{text[:97]}..."
