"""Tables as text: exact numbers, and the line of whatever is wrong."""

from __future__ import annotations

import csv
from array import array
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from bench.acquisition.importer.table import MOST_COLUMNS, Table
from bench.base import FloatArray, InputError, IntArray, read_text

_DELIMITERS = (";", "\t", ",", "|", " ")
_GAPS = {"", "nan", "na", "n/a", "null", "none"}
LONGEST_HEADER = 100_000
"""Bytes of a header line that a person or a logger may have written."""
_SHOWN = 60
"""Characters of a value in a message."""


def read_text_table(path: Path) -> Table:
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
