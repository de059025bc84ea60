"""Tables that somebody else recorded, as columns of numbers: CSV, Parquet, MF4, and CAN logs with their DBC.

A gap stays NaN. What cannot be read exactly is refused with file and line; nothing is guessed, dropped or filled.
"""

from __future__ import annotations

import csv
from array import array
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from bench.acquisition.importer.confines import memory_for
from bench.base import FloatArray, InputError, IntArray, read_text
from drivers.errors import ConfigError
from drivers.wire import Message, read_layouts

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa

CAN_LOGS = (".blf", ".asc", ".log", ".trc")
_DELIMITERS = (";", "\t", ",", "|", " ")
_GAPS = {"", "nan", "na", "n/a", "null", "none"}
TIME = "time"
LONGEST_HEADER = 100_000
"""Bytes of a header line that a person or a logger may have written."""
MOST_COLUMNS = 2000
_COPIES = 3
"""A table in memory, what is made of it, and what reading takes."""
_SHOWN = 60
"""Characters of a value in a message."""


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


def read_table(path: Path | str, dbc: Path | str | None = None, most_bytes: int | None = None) -> Table:
    """Read a table by its file's ending; `dbc` describes the frames of a CAN log. InputError when it cannot be read.

    What announces that it needs more than `most_bytes` of memory is refused; None: more than is free for it.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError("no such file" if not path.exists() else "is a folder, not a file", path)
    size = path.stat().st_size
    if size == 0:
        raise InputError("is empty", path)
    most_bytes = memory_for(size) if most_bytes is None else most_bytes
    ending = path.suffix.lower()
    if ending in CAN_LOGS:
        return _read_can_log(path, dbc, most_bytes)
    if ending == ".parquet":
        table = _read_parquet(path, most_bytes)
    else:
        table = _read_mf4(path, most_bytes) if ending in {".mf4", ".mdf"} else _read_csv(path)
    if table.rows == 0:
        raise InputError("holds zero rows: there is a header, and no data", path)
    return table


def _refuse_large(rows: int, columns: int, most_bytes: int, path: Path) -> None:
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


def _read_csv(path: Path) -> Table:
    """Tidy files go to the parser whole; comments, blank lines and everything wrong take the slow way, line by line."""
    data = path.read_bytes().removeprefix(b"\xef\xbb\xbf")
    start = 0
    line = 1
    while start < len(data):
        end = data.find(b"\n", start) + 1 or len(data)
        if data[start:end].strip() and not data[start:end].lstrip().startswith(b"#"):
            break
        start, line = end, line + 1
    else:
        raise InputError("holds no table: every line is empty or a comment", path)
    if end - start > LONGEST_HEADER:
        raise InputError(f"the header has {end - start:,} bytes, allowed are {LONGEST_HEADER:,}: no table", path, line)
    header = data[start:end].decode("utf-8", errors="replace").strip("\r\n")
    delimiter = _delimiter(header, path, line)
    names = [name.strip() for name in _split(header, delimiter)]
    _check_header(names, path, line)
    body = data[end:].rstrip(b"\r\n")
    if not body.strip():
        raise InputError("holds zero rows: there is a header, and no data", path)
    notes = () if data.endswith((b"\n", b"\r")) else ("the last line has no line end: its last number may be cut off",)
    tidy = delimiter != " " and not any(mark in body for mark in (b"#", b"\n\n", b"\n\r"))
    columns = _parse(body, delimiter, names) if tidy else None
    where: range | IntArray = range(line + 1, line + 2 + body.count(b"\n"))
    del body
    if columns is None or any(len(column) != len(where) for column in columns.values()):
        where, columns = _read_lines(path, line, delimiter, names)
    for name, column in columns.items():
        bad = np.flatnonzero(np.isinf(column))
        if bad.size:
            text = f"'{name}' is infinite; leave the field empty where there is no value"
            raise InputError(text, path, int(where[int(bad[0])]))
    return Table(path, columns, lines=where, notes=notes)


def _read_lines(
    path: Path, header_line: int, delimiter: str, names: list[str]
) -> tuple[IntArray, dict[str, FloatArray]]:
    """Lines and columns of a file with comments or blank lines in it; InputError that names the first wrong line.

    One line at a time: a list of the lines of a large file takes forty times its size.
    """
    read_text(path)  # is it text?
    where, tidy = array("q"), bytearray()
    separator = "\t" if delimiter == " " else delimiter
    rows = _rows(path, header_line)
    for number, row in rows:
        fields = row.split() if delimiter == " " else None
        found = row.count(delimiter) + 1 if fields is None else len(fields)
        if found != len(names) or '"' in row:
            split = _split(row, delimiter)
            if row.count('"') % 2:
                raise InputError('a quoted field has no end: the second " is missing', path, number)
            if len(split) != len(names):
                raise _wrong_width(found, len(names), delimiter, next(rows, None) is None, InputError("", path, number))
            if bad := _bad_value(split, names, path, number):
                raise bad
        tidy += (row if fields is None else "\t".join(fields)).encode() + b"\n"
        where.append(number)
    if not where:
        raise InputError("holds zero rows: there is a header, and no data", path)
    columns = _parse(bytes(tidy).rstrip(b"\n"), separator, names)
    if columns is None:
        for number, row in _rows(path, header_line):
            if bad := _bad_value(_split(row, delimiter), names, path, number):
                raise bad
        raise InputError("holds something that is not a number", path)
    return np.array(where, dtype=np.int64), columns


def _rows(path: Path, header_line: int) -> Iterator[tuple[int, str]]:
    """Lines with content after the header, with their numbers."""
    with path.open("rb") as file:
        for number, raw in enumerate(file, 1):
            line = raw.removesuffix(b"\n").removesuffix(b"\r").decode("utf-8-sig")
            if number > header_line and line.strip() and not line.lstrip().startswith("#"):
                yield number, line


def _parse(body: bytes, delimiter: str, names: list[str]) -> dict[str, FloatArray] | None:
    """Columns of numbers, exact to the last digit; None when anything is not a number or a row is ragged."""
    import pyarrow as pa
    from pyarrow import csv as arrow_csv

    gaps = sorted({spelled for gap in _GAPS for spelled in (gap, gap.upper(), gap.title(), "NaN")})
    try:
        found = arrow_csv.read_csv(
            pa.BufferReader(body),
            arrow_csv.ReadOptions(column_names=names),
            arrow_csv.ParseOptions(delimiter=delimiter, ignore_empty_lines=False),
            arrow_csv.ConvertOptions(column_types=dict.fromkeys(names, pa.float64()), null_values=gaps),
        )
    except (pa.ArrowException, ValueError):
        return None
    return {name: found.column(name).to_numpy() for name in names}


def _delimiter(header: str, path: Path, line: int) -> str:
    counts = {delimiter: header.strip().count(delimiter) for delimiter in _DELIMITERS}
    found = next((delimiter for delimiter, count in counts.items() if count), None)
    if found is None:
        raise InputError("has one column; a table needs columns separated by comma, semicolon or tab", path, line)
    return found


def _split(line: str, delimiter: str) -> list[str]:
    if delimiter == " ":
        return line.split()
    try:
        return next(csv.reader([line], delimiter=delimiter, skipinitialspace=True))
    except csv.Error as error:  # a NUL byte, or a quoted field without end
        raise InputError(f"a line is no text table: {error}") from None


def _check_header(names: list[str], path: Path, line: int) -> None:
    if all(_number(name) is not None for name in names):
        raise InputError("the first line holds numbers, not names; add a header line", path, line)
    if len(names) > MOST_COLUMNS:
        raise InputError(f"has {len(names):,} columns, allowed are {MOST_COLUMNS:,}", path, line)
    for name in names:
        if any(ord(sign) < 32 for sign in name):
            raise InputError(f"column name {name!r} holds control characters; rename it", path, line)
        if not name:
            raise InputError(f"column {names.index(name) + 1} has no name in the header", path, line)
        if names.count(name) > 1:
            raise InputError(f"the header names '{name}' twice; rename one of them", path, line)


def _wrong_width(found: int, width: int, delimiter: str, last: bool, place: InputError) -> InputError:
    """What to say of a line that has not as many fields as the header."""
    text = f"has {found} fields, the header {width}"
    if last and found < width:
        text += ": the file is truncated; delete that line or export it again"
    elif delimiter == "," and found == 2 * width:
        text += ": decimal commas? export with decimal points"
    return InputError(text, place.file, place.line)


def _bad_value(fields: Sequence[str], names: list[str], path: Path, line: int) -> InputError | None:
    """What is not a number in a line."""
    for name, value in zip(names, fields, strict=False):
        if value.strip().lower() in _GAPS or _number(value) is not None:
            continue
        shown = value.strip()
        text = f"'{name}' is '{shown if len(shown) <= _SHOWN else shown[:_SHOWN] + '…'}', not a number"
        if _number(value.replace(",", ".")) is not None:
            text += ": decimal commas are not read; export with decimal points"
        return InputError(text, path, line)
    return None


def _number(text: str) -> float | None:
    try:
        return float(text) if "_" not in text else None
    except ValueError:
        return None


def _read_parquet(path: Path, most_bytes: int) -> Table:
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        with pq.ParquetFile(path, page_checksum_verification=True) as file:
            known = file.metadata
            _refuse_large(known.num_rows, known.num_columns, most_bytes, path)
            names = file.schema_arrow.names
            parts = [_of_arrow(file.read(columns=[name]), path) for name in dict.fromkeys(names)]
    except (OSError, ValueError, pa.ArrowException) as error:
        raise InputError(f"not a readable Parquet file ({' '.join(str(error).split())})", path) from None
    columns = {name: column for part in parts for name, column in part.columns.items()}
    units = {name: unit for part in parts for name, unit in part.units.items()}
    return Table(path, columns, units, notes=tuple(note for part in parts for note in part.notes))


def table_of(frame: pd.DataFrame, name: str = "DataFrame") -> Table:
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
        table = _of_arrow(pa.Table.from_pandas(named, preserve_index=False), Path(name))
    except (pa.ArrowException, TypeError, ValueError) as error:
        raise InputError(f"not a table of numbers ({' '.join(str(error).split())})", name) from None
    if table.rows == 0:
        raise InputError("holds zero rows", name)
    return table


def _of_arrow(table: pa.Table, path: Path) -> Table:
    """Columns of numbers; times in seconds; columns of anything else are left out with a note."""
    import pyarrow as pa
    import pyarrow.compute as pc

    columns, units, notes = {}, {}, []
    for item in table.schema:
        values = table.column(item.name)
        if pa.types.is_timestamp(item.type):
            values = pc.divide(values.cast(pa.timestamp("ns")).cast(pa.int64()).cast(pa.float64(), safe=False), 1e9)
            units[item.name] = "s"
        elif pa.types.is_boolean(item.type):
            values = values.cast(pa.uint8())
        elif not (pa.types.is_integer(item.type) or pa.types.is_floating(item.type)):
            notes.append(f"column '{item.name}' ({item.type}) holds no numbers and is left out")
            continue
        columns[item.name] = values.cast(pa.float64(), safe=False).to_numpy()
        if item.metadata and b"unit" in item.metadata:
            units[item.name] = item.metadata[b"unit"].decode()
    return Table(path, columns, units, notes=tuple(notes))


Series = tuple[FloatArray, FloatArray]
"""Times [s] and values of one signal."""


def on_one_time_base(
    path: Path, signals: Mapping[str, Series], units: Mapping[str, str], most_bytes: int | None = None
) -> Table:
    """Signals with times of their own on the union of all times; NaN where a signal has no sample."""
    if not any(times.size for times, _ in signals.values()):
        raise InputError("holds no samples", path)
    time = last = np.array([])
    for times, _ in signals.values():
        if not np.array_equal(times, last):  # those of a group have the same
            time, last = np.union1d(time, times), times
    if most_bytes is not None:
        _refuse_large(time.size, len(signals) + 1, most_bytes, path)
    columns: dict[str, FloatArray] = {TIME: time}
    for name, (times, values) in signals.items():
        columns[name] = np.full(time.size, np.nan)
        columns[name][np.searchsorted(time, times)] = values
    return Table(path, columns, {TIME: "s", **units})


def _read_mf4(path: Path, most_bytes: int) -> Table:
    try:
        from asammdf import MDF
    except ImportError:
        raise InputError("MF4 needs asammdf: pip install 'gyro-thermal-bench[mf4]'", path) from None
    signals: dict[str, Series] = {}
    units: dict[str, str] = {}
    try:
        with MDF(path) as file:
            values, rows = 0, 0
            for group in file.groups:
                values += int(group.channel_group.cycles_nr) * len(group.channels)
                rows = max(rows, int(group.channel_group.cycles_nr))
            _refuse_large(rows, -(-values // max(rows, 1)), most_bytes, path)
            for signal in file.iter_channels(skip_master=True):
                if signal.samples.ndim == 1 and signal.samples.dtype.kind in "iufb":
                    name = _free_name(signal.name, signals)
                    times = signal.timestamps.astype(np.float64, copy=False)
                    signals[name] = (times, signal.samples.astype(np.float64))
                    units[name] = str(signal.unit or "")
    except InputError:
        raise
    except Exception as error:  # asammdf raises whatever its parser trips over
        raise InputError(f"not a readable MF4 file ({type(error).__name__}: {error})", path) from None
    return on_one_time_base(path, signals, {name: unit for name, unit in units.items() if unit}, most_bytes)


def _free_name(name: str, taken: Mapping[str, Series]) -> str:
    suffixes = ("", *(f"_{n}" for n in range(2, 1000)))
    return next(f"{name}{suffix}" for suffix in suffixes if f"{name}{suffix}" not in taken)


def _read_can_log(path: Path, dbc: Path | str | None, most_bytes: int) -> Table:
    if dbc is None:
        raise InputError("a CAN log needs the description of its frames; name it with --dbc", path)
    messages = _messages(dbc)
    payloads: dict[tuple[int, bool], list[bytes]] = {}
    times: dict[tuple[int, bool], list[float]] = {}
    unread = 0
    import can

    try:
        with can.LogReader(str(path)) as log:
            for frame in log:
                head = frame.arbitration_id, frame.is_extended_id
                message = messages.get(head)
                if message is None or frame.is_error_frame or len(frame.data) < message.length:
                    unread += 1
                    continue
                times.setdefault(head, []).append(frame.timestamp)
                payloads.setdefault(head, []).append(bytes(frame.data))
    except Exception as error:  # python-can's readers raise whatever their parsers trip over
        raise InputError(f"not a readable CAN log ({type(error).__name__}: {error})", path) from None
    if not times:
        raise InputError(f"none of its {unread} frames is described by {dbc}", path)
    signals: dict[str, Series] = {}
    units: dict[str, str] = {}
    for head, stamps in times.items():
        message = messages[head]
        width = message.width
        whole = b"".join(payload[:width].ljust(width, b"\0") for payload in payloads[head])
        columns = message.decode(np.frombuffer(whole, dtype=np.uint8).reshape(-1, width))
        for signal, (column, rows) in columns.items():
            name = _free_name(signal, signals)
            at = np.array(stamps) if rows is None else np.array(stamps)[rows]
            if len(at):  # a multiplexed signal is not in every frame, and may be in none
                signals[name] = at, column
                units[name] = message.signals[signal].unit
    table = on_one_time_base(path, signals, {name: unit for name, unit in units.items() if unit}, most_bytes)
    notes = (f"{unread} frames are not described by the DBC and are left out",) if unread else ()
    return Table(path, table.columns, table.units, notes=notes)


def _messages(dbc: Path | str) -> dict[tuple[int, bool], Message]:
    try:
        return {(message.id, message.extended): message for message in read_layouts(Path(dbc)).values()}
    except ConfigError as error:
        raise InputError(f"not a readable DBC ({error})", dbc) from None
