"""Where a text table begins: lines before its header, the header itself, and a row of units below it."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from bench.acquisition.importer.columns import split_header
from bench.acquisition.importer.table import MOST_COLUMNS
from bench.acquisition.importer.values import GAPS, number
from bench.base import InputError
from drivers.units import is_unit

COMMENTS = ("#", "//", "%")
"""What begins a line that is no row."""
ADVICE = "delete lines that do not belong to the table, or begin them with #"
LONGEST_HEADER = 100_000
"""Bytes of a header line that a person or a logger may have written."""
_DELIMITERS = (";", "\t", ",", "|", " ")
_BEFORE = 200
"""Lines in which the header is looked for."""
_ROWS = 3
"""Rows below a header that must be like it."""
_SEPARATOR = re.compile(r'"?sep=(.)"?')
"""First line of a file for spreadsheets that says what is between the columns."""
_NUMBERED = re.compile(r"\"?[+-]?[.,]?\d")


@dataclass(frozen=True)
class Header:
    """The header of a text table."""

    names: tuple[str, ...]
    delimiter: str
    line: int
    """Its own line, or that of the units below it."""
    end: int
    """Where the rows begin [bytes]."""
    units: dict[str, str]
    notes: tuple[str, ...] = ()
    trailing: bool = False
    """Each line ends with one more delimiter than there are columns."""


@dataclass(frozen=True)
class _Line:
    number: int
    text: str
    end: int


def find_header(data: bytes, path: Path) -> Header:
    """The header of a table; InputError where there is none, or where its names cannot be used.

    It is the first line with content. Where the rows below do not fit that one, it is the first line of names above
    rows that do.
    """
    lines = list(_first_lines(data, path))
    if not lines:
        raise InputError("has no table: every line is empty or a comment", path)
    told = _SEPARATOR.fullmatch(lines[0].text)
    if told is not None and len(lines) > 1:
        lines = lines[1:]
    delimiters = tuple(told[1]) if told is not None else _DELIMITERS
    fitting = (at for at in range(len(lines)) if _fits(lines[at:], delimiters, path))
    at = next(fitting, 0)
    first = lines[at]
    delimiter = _delimiter(first.text, delimiters)
    if delimiter is None:
        text = "has one column; a table needs columns separated by comma, semicolon or tab"
        raise InputError(text, path, first.number)
    names = [name.strip() for name in split(first.text, delimiter, path, first.number)]
    trailing = len(names) > 2 and not names[-1]
    names = names[:-1] if trailing else names
    _check(names, path, first.number)
    found = Header(tuple(names), delimiter, first.number, first.end, {}, (), trailing)
    if at:
        found = replace(found, notes=(f"what stands before line {first.number}, the header, was left out",))
    return _with_units(found, lines[at + 1 : at + 2], path)


def split(line: str, delimiter: str, path: Path, number: int) -> list[str]:
    """The fields of a line."""
    if delimiter == " ":
        return line.split()
    try:
        return next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])
    except csv.Error as error:  # a NUL byte, or a quoted field without end
        raise InputError(f"is not a text table: {error}", path, number) from None


def _first_lines(data: bytes, path: Path) -> Iterator[_Line]:
    """Lines with content at the beginning."""
    file, found = io.BytesIO(data), 0
    for line, raw in enumerate(iter(lambda: file.readline(LONGEST_HEADER + 1), b""), 1):
        content = raw.strip()
        if content.startswith(tuple(mark.encode() for mark in COMMENTS)) or not content:
            continue
        if len(raw) > LONGEST_HEADER:
            if found:
                return
            size = len(raw) + len(file.readline())
            raise InputError(
                f"the header has {size:,} bytes, allowed are {LONGEST_HEADER:,}: this is not a table", path, line
            )
        found += 1
        yield _Line(line, raw.decode().strip("\r\n"), file.tell())
        if found == _BEFORE:
            return


def _fits(lines: Sequence[_Line], delimiters: Sequence[str], path: Path) -> bool:
    """Whether the first line is one of names, and the ones below are rows of as many fields, with numbers in them."""
    delimiter = _delimiter(lines[0].text, delimiters)
    if delimiter is None:
        return False
    try:
        rows = [split(line.text, delimiter, path, line.number) for line in lines[: _ROWS + 2]]
    except InputError:
        return False
    names = rows[0][:-1] if len(rows[0]) > 2 and not rows[0][-1].strip() else rows[0]
    between = len(rows) > 2 and not _numbered(rows[1])  # units, or names that are the header themselves
    below = rows[2:] if between and (_are_units(rows[1]) or not any(split_header(n)[1] for n in rows[1])) else rows[1:]
    like = all(len(row) == len(rows[0]) for row in rows[1:])
    named = len(names) > 1 and all(name.strip() and not _NUMBERED.match(name.strip()) for name in names)
    return named and like and bool(below) and all(_numbered(row) or _empty(row) for row in below)


def _with_units(header: Header, below: Sequence[_Line], path: Path) -> Header:
    """The same with the row of units below it, where there is one."""
    if not below:
        return header
    row = below[0]
    fields = split(row.text, header.delimiter, path, row.number)
    if len(fields) != len(header.names) + header.trailing or not _are_units(fields):
        return header
    named = zip(header.names, map(_unit, fields[: len(header.names)]), strict=True)
    units = {name: field for name, field in named if field and split_header(name)[1] is None}
    note = f"line {row.number} was read as the units of the columns"
    return replace(header, line=row.number, end=row.end, units=units, notes=(*header.notes, note))


def _numbered(row: Sequence[str]) -> bool:
    return any(_NUMBERED.match(field.strip()) for field in row)


def _are_units(row: Sequence[str]) -> bool:
    return not _numbered(row) and any(is_unit(_unit(field)) for field in row)


def _unit(field: str) -> str:
    return field.strip().strip("[]()")


def _empty(row: Sequence[str]) -> bool:
    return all(field.strip().lower() in GAPS for field in row)


def _delimiter(line: str, delimiters: Sequence[str]) -> str | None:
    counts = {delimiter: line.strip().count(delimiter) for delimiter in delimiters}
    return next((delimiter for delimiter, count in counts.items() if count), None)


def _check(names: list[str], path: Path, line: int) -> None:
    if all(number(name) is not None for name in names):
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
