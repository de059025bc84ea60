"""A table of others as columns of numbers, and how large it may be."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from bench.base import FloatArray, InputError, IntArray

MOST_COLUMNS = 2000
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

    @property
    def rows(self) -> int:
        """Number of rows."""
        return next((int(column.size) for column in self.columns.values()), 0)

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
