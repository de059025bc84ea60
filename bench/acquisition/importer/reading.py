"""A table of others, read in a confined process: `python -m bench.acquisition.importer.reading REQUEST ANSWER`."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from bench.acquisition.importer.confines import Confines, answering, memory_for, processor_s_for, run_confined
from bench.acquisition.importer.table import Table
from bench.acquisition.importer.tables import read_table
from bench.base import InputError

_TABLE, _LINES = "table.arrow", "lines.npy"


def read_confined(
    path: Path, dbc: Path | None = None, confines: Confines | None = None, encoding: str | None = None
) -> Table:
    """The table of a file that may be anything; InputError, one line, where it cannot be read within the limits.

    Its columns stay in a file that is already removed, so that they take memory only where they are looked at.
    """
    import numpy as np
    import pyarrow as pa

    if os.name != "posix" or not path.is_file():  # what is missing needs no process to say so
        return read_table(path, dbc, encoding=encoding)
    confines = confines or Confines()
    if confines.memory_bytes is None:
        confines = replace(confines, memory_bytes=memory_for(path.stat().st_size))
    confines = replace(confines, cpu_s=min(confines.cpu_s, processor_s_for(path.stat().st_size)))
    with tempfile.TemporaryDirectory(prefix="bench-import-") as scratch:
        folder = Path(scratch)
        described = {"dbc": None if dbc is None else str(dbc), "encoding": encoding}
        wanted = {"file": str(path), "folder": scratch, **described}
        told = run_confined(__name__, wanted, folder, confines)
        with pa.memory_map(str(folder / _TABLE)) as source:
            found = pa.ipc.open_file(source).read_all()
        columns = {name: found.column(i).to_numpy() for i, name in enumerate(told["names"])}
        lines = np.load(folder / _LINES) if told["lines"] == "file" else told["lines"] and range(*told["lines"])
    unread = {name: (reason, line) for name, (reason, line) in told["unread"].items()}
    return Table(path, columns, told["units"], lines, tuple(told["notes"]), unread, told["encoding"])


def _read(wanted: Mapping[str, Any]) -> dict[str, Any]:
    """Read, and leave the columns in a file."""
    import numpy as np
    import pyarrow as pa

    pa.set_cpu_count(1)
    pa.set_io_thread_count(1)
    most_bytes = int(wanted["confines"]["memory_bytes"])
    table = read_table(wanted["file"], wanted["dbc"], most_bytes, wanted["encoding"])
    folder = Path(wanted["folder"])
    arrays = [pa.array(column) for column in table.columns.values()]
    numbered = pa.Table.from_arrays(arrays, names=[str(i) for i in range(len(arrays))])
    try:
        with pa.OSFile(str(folder / _TABLE), "wb") as sink, pa.ipc.new_file(sink, numbered.schema) as writer:
            writer.write_table(numbered)
    except OSError as error:
        raise InputError(
            f"its {numbered.nbytes / 1e9:.2g} GB cannot be kept in {folder.parent}: {error}", table.path
        ) from error
    lines: Any = table.lines
    if isinstance(lines, range):
        lines = [lines.start, lines.stop]
    elif lines is not None:
        np.save(folder / _LINES, lines)
        lines = "file"
    names = list(table.columns)
    return {
        "names": names, "units": dict(table.units), "lines": lines, "notes": list(table.notes),
        "unread": dict(table.unread), "encoding": table.encoding,
    }  # fmt: skip


if __name__ == "__main__":
    answering(_read, Path(sys.argv[1]), Path(sys.argv[2]))
