"""The moments of a fleet in one file: a Parquet table with a row per run, read and written in groups of 256 rows.

Memory holds a few groups, whatever the number of units; 100,000 units take some 600 MB on disk.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from bench.analysis import SIZE
from bench.base import FloatArray, InputError

GROUP = 256
"""Rows of a group, which is one task of a refit."""

SCHEMA = pa.schema(
    [
        pa.field("unit", pa.string()),
        pa.field("run", pa.string()),
        pa.field("sha256", pa.string()),
        pa.field("moments", pa.list_(pa.float64(), SIZE)),
    ],
    metadata={"bench.moments": "1"},
)


@dataclass(frozen=True, eq=False)
class Stored:
    """Moments of a run: unit, id, hash of the manifest that they belong to, packed numbers (SIZE,)."""

    unit: str
    run: str
    sha256: str
    values: FloatArray


@dataclass(frozen=True, eq=False)
class Group:
    """Up to 256 units as one table: `values` (n, SIZE)."""

    units: tuple[str, ...]
    runs: tuple[str, ...]
    values: FloatArray

    def __len__(self) -> int:
        """Number of units."""
        return len(self.units)

    def __getitem__(self, part: slice, /) -> Group:
        """The units of a part."""
        return Group(self.units[part], self.runs[part], self.values[part])


def write(path: Path, rows: Iterable[Stored]) -> int:
    """Write a file, replacing an older one in one move at the end; returns the number of rows."""
    partial = path.with_name(f".{path.name}.part")
    count = 0
    try:
        with pq.ParquetWriter(partial, SCHEMA, compression="zstd", write_page_checksum=True) as writer:
            source = iter(rows)
            while group := tuple(islice(source, GROUP)):
                writer.write_table(_table(group), row_group_size=GROUP)
                count += len(group)
        partial.replace(path)
    except OSError as error:
        raise InputError(f"moments cannot be written: {error.strerror or error}", path) from None
    finally:
        partial.unlink(missing_ok=True)
    return count


def _table(group: tuple[Stored, ...]) -> pa.Table:
    flat = pa.array(np.concatenate([row.values for row in group]))
    columns = [pa.array([getattr(row, name) for row in group]) for name in ("unit", "run", "sha256")]
    return pa.Table.from_arrays([*columns, pa.FixedSizeListArray.from_arrays(flat, SIZE)], schema=SCHEMA)


def read(path: Path) -> Iterator[Stored]:
    """The rows, one by one; none without a file."""
    if not path.exists():
        return
    with _open(path) as file:
        for i in range(file.num_row_groups):
            table = file.read_row_group(i)
            values = _values(table)
            names = (table.column(name).to_pylist() for name in ("unit", "run", "sha256"))
            for unit, run, sha256, own in zip(*names, values, strict=True):
                yield Stored(unit, run, sha256, own)


def known(path: Path) -> dict[str, str]:
    """Hash of the manifest by run, for all rows, without reading the numbers."""
    if not path.exists():
        return {}
    with _open(path) as file:
        table = file.read(columns=["run", "sha256"])
    return dict(zip(table.column("run").to_pylist(), table.column("sha256").to_pylist(), strict=True))


def stored_groups(path: Path) -> Iterator[Group]:
    """The rows, group by group."""
    with _open(path) as file:
        for i in range(file.num_row_groups):
            table = file.read_row_group(i)
            units, runs = (tuple(table.column(name).to_pylist()) for name in ("unit", "run"))
            yield Group(units, runs, _values(table))


def stored_count(path: Path) -> int:
    """Number of rows; InputError where there is no such file."""
    with _open(path) as file:
        return int(file.metadata.num_rows)


def _open(path: Path) -> pq.ParquetFile:
    try:
        file = pq.ParquetFile(path, page_checksum_verification=True, pre_buffer=False)
    except (OSError, pa.ArrowException) as error:
        raise InputError(f"moments cannot be read: {error}".partition("\n")[0], path) from None
    if not file.schema_arrow.equals(SCHEMA):
        file.close()
        raise InputError(
            "not moments in the format of this bench; remove the file, it is made again from the runs", path
        )
    return file


def _values(table: pa.Table) -> FloatArray:
    flat: FloatArray = table.column("moments").combine_chunks().flatten().to_numpy()
    return flat.reshape(table.num_rows, SIZE)
