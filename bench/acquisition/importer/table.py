"""A table of others as columns of numbers, and how large it may be."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from bench.base import FloatArray, InputError, IntArray

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa

MOST_COLUMNS = 2000
TIME = "time"
EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_CLOCKS_SET = datetime(1990, 1, 1)
"""A moment before it is of a logger whose clock was never set."""
_COPIES = 3
"""A table in memory, what is made of it, and what reading takes."""


@dataclass(frozen=True, eq=False)
class Table:
    """Columns of one length; `units` where the file states them."""

    path: Path
    columns: Mapping[str, FloatArray]
    units: Mapping[str, str] = field(default_factory=dict)
    lines: IntArray | range | None = None
    """Line of each row in a text file."""
    notes: tuple[str, ...] = ()
    unread: Mapping[str, tuple[str, int | None]] = field(default_factory=dict)
    """Columns that hold no numbers: why, and the line in a text file of the first value that is none."""
    encoding: str | None = None
    """Of a text file that is not UTF-8 or UTF-16."""

    @property
    def rows(self) -> int:
        """Number of rows."""
        return next((int(column.size) for column in self.columns.values()), 0)

    def take(self, rows: IntArray, note: str) -> Table:
        """The same table with these rows, and a note that says so."""
        columns = {name: column[rows] for name, column in self.columns.items()}
        lines = None if self.lines is None else np.asarray(self.lines)[rows]
        return replace(self, columns=columns, lines=lines, notes=(*self.notes, note))

    def line(self, row: int) -> int | None:
        """Line of a row in a text file; None for other files."""
        return None if self.lines is None else int(self.lines[row])


def refuse_large(rows: int, columns: int, most_bytes: int, path: Path) -> None:
    """InputError where a table of this size, and what is made of it, does not fit into the memory for it."""
    if columns > MOST_COLUMNS:
        raise InputError(f"has {columns:,} columns, allowed are {MOST_COLUMNS:,}", path)
    table_bytes = 8 * rows * columns
    if table_bytes > most_bytes // _COPIES:
        raise InputError(
            f"holds {rows:,} rows of {columns} columns, {table_bytes / 1e9:.2g} GB unpacked, and may take "
            f"{most_bytes / _COPIES / 1e9:.2g}, a third of the memory for reading it: export fewer columns or rows, or "
            "allow more: `bench import --memory GB`",
            path,
        )


def table_of(frame: pd.DataFrame, name: str | Path = "DataFrame") -> Table:
    """Columns of a DataFrame; `name` stands for its file in messages.

    An index with a name is a column, too, and one of dates is the time. Raises InputError where there
    are no rows, or something that no table holds.
    """
    import pandas as pd
    import pyarrow as pa

    dated = isinstance(frame.index, pd.DatetimeIndex) and frame.index.name is None
    named = frame.rename_axis(index=TIME) if dated else frame
    named = named.reset_index() if any(named.index.names) else named
    try:
        table = of_arrow(pa.Table.from_pandas(named, preserve_index=False), Path(name))
    except (pa.ArrowException, TypeError, ValueError) as error:
        raise InputError(f"not a table of numbers ({' '.join(str(error).split())})", name) from None
    if table.rows == 0:
        raise InputError("holds zero rows", name)
    return table


def _begin(name: str, moment: datetime) -> tuple[str, ...]:
    """A note of the first moment of a record; none of a clock that was not set."""
    known = moment.replace(tzinfo=None) > _CLOCKS_SET
    return (f"'{name}' begins at {moment.isoformat(' ', 'seconds')}",) if known else ()


def of_arrow(table: pa.Table, path: Path) -> Table:
    """Columns of numbers; times in seconds; columns of anything else are unread."""
    import pyarrow as pa
    import pyarrow.compute as pc

    columns, units = {}, {}
    notes: tuple[str, ...] = ()
    unread: dict[str, tuple[str, int | None]] = {}
    for item in table.schema:
        values = table.column(item.name)
        if pa.types.is_timestamp(item.type):
            first = pc.min(values.cast(pa.timestamp("us", item.type.tz), safe=False)).as_py()
            notes += () if first is None else _begin(item.name, first)
            values = pc.divide(values.cast(pa.timestamp("ns")).cast(pa.int64()).cast(pa.float64(), safe=False), 1e9)
            units[item.name] = "s"
        elif pa.types.is_duration(item.type):
            values = pc.divide(values.cast(pa.duration("ns")).cast(pa.int64()).cast(pa.float64(), safe=False), 1e9)
            units[item.name] = "s"
        elif pa.types.is_boolean(item.type):
            values = values.cast(pa.uint8())
        elif not (pa.types.is_integer(item.type) or pa.types.is_floating(item.type) or pa.types.is_decimal(item.type)):
            unread[item.name] = f"column '{item.name}' holds {item.type}, not numbers; export it as numbers", None
            continue
        columns[item.name] = values.cast(pa.float64(), safe=False).to_numpy()
        if item.metadata and b"unit" in item.metadata:
            units[item.name] = item.metadata[b"unit"].decode()
    return Table(path, columns, units, notes=notes, unread=unread)


Series = tuple[FloatArray, FloatArray]
"""Times [s] and values of one signal."""


def on_one_time_base(
    path: Path,
    signals: Mapping[str, Series],
    units: Mapping[str, str],
    most_bytes: int | None = None,
    zero: datetime | None = None,
) -> Table:
    """Signals with times of their own on the union of all times; NaN where a signal has no sample.

    `zero` is the moment from which the times count, where the file has it.
    """
    if not any(times.size for times, _ in signals.values()):
        raise InputError("holds no samples", path)
    time = last = np.array([])
    for times, _ in signals.values():
        if not np.array_equal(times, last):  # those of a group have the same
            time, last = np.union1d(time, times), times
    if most_bytes is not None:
        refuse_large(time.size, len(signals) + 1, most_bytes, path)
    columns: dict[str, FloatArray] = {TIME: time}
    for name, (times, values) in signals.items():
        columns[name] = np.full(time.size, np.nan)
        columns[name][np.searchsorted(time, times)] = values
    notes = () if zero is None else _begin(TIME, zero + timedelta(seconds=float(time[0])))
    return Table(path, columns, {TIME: "s", **units}, notes=notes)
