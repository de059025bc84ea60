"""Tables as text: exact numbers, and the line of whatever is wrong."""

from __future__ import annotations

import codecs
import gzip
import io
import re
import zipfile
import zlib
from array import array
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import IO, TYPE_CHECKING

import numpy as np

from bench.acquisition.importer.columns import FOREIGN_WORDS
from bench.acquisition.importer.confines import memory_for
from bench.acquisition.importer.header import ADVICE, COMMENTS, find_header, split
from bench.acquisition.importer.table import Table
from bench.acquisition.importer.values import GAPS, joined_dates, numbers
from bench.base import InputError, IntArray

if TYPE_CHECKING:
    import pyarrow as pa

_LOOKED_AT = 100_000
"""Bytes of the beginning in which it shows that a file is not text."""
_NO_TEXT = re.compile(rb"[\x00-\x08\x0b\x0e-\x1f]")
_NO_WORD = re.compile(r"[^\x00-\x7f]{3,}")
"""What text in another encoding looks like in Windows-1252: three signs in a row that are not ASCII."""
_ENCODINGS = ("cp1251", "cp1252", "gb18030")
_SIGNS = {"gb18030": ("℃", "°/", "[°"), "cp1251": ("°/с", "°с")}
"""Units that show an encoding, as the names of columns do."""
_FOREIGN = re.compile(r"[^\x00-\x7f]+")
_MARKLESS = 2000
"""Bytes in which UTF-16 without a byte order mark shows."""
_NOT_UTF16 = "is not whole UTF-16; copy or export it again"
KNOWN = "text tables (also .gz or .zip), .parquet, .mf4, .blf, .asc, .log, .trc, .xlsx, .tdms, .ulg and .h5"


def read_text_table(path: Path, most_bytes: int | None = None, encoding: str | None = None) -> Table:
    """Table of a file of text; `encoding` where it is stated."""
    data, notes, encoding = decoded(path, most_bytes, encoding)
    return replace(table_of_text(data, path, notes), encoding=encoding)


def table_of_text(data: bytes, path: Path, notes: Sequence[str] = ()) -> Table:
    """Tidy texts go to the parser whole; comments, blank lines and everything wrong take the slow way, line by line.

    A column that holds neither numbers nor times is unread: an error only where it is wanted. `path` is for messages.
    """
    notes = list(notes)
    header = find_header(data, path)
    delimiter, names, line = header.delimiter, [*header.names], header.line
    read_names = [*names, *[""] * header.trailing]
    notes += header.notes
    body = data[header.end :].rstrip(b"\r\n")
    if not body.strip():
        raise InputError("holds zero rows: there is a header, and no data", path)
    if not data.endswith((b"\n", b"\r")):
        notes.append("the last line has no line end: its last number may be cut off")
    marks = (*(mark.encode() for mark in COMMENTS), b"\n\n", b"\n\r")
    tidy = delimiter != " " and not any(mark in body for mark in marks) and body[:1] not in b"\r\n"
    columns = _parse(body, delimiter, read_names) if tidy else None
    where: range | IntArray = range(line + 1, line + 2 + body.count(b"\n"))
    del body
    if columns is None or any(len(column) != len(where) for column in columns):
        where, columns = _read_lines(path, data, line, delimiter, read_names)
    if header.trailing and not _is_empty(columns.pop()):
        raise InputError(f"column {len(names) + 1} has no name in the header", path, line)
    names, columns = joined_dates(names, columns)
    read = {name: numbers(name, column) for name, column in zip(names, columns, strict=True)}
    notes += dict.fromkeys(note for column in read.values() for note in column.notes)
    unread = {n: (c.reason, int(where[c.row])) for n, c in read.items() if c.values is None}
    known = {name: column.values for name, column in read.items() if column.values is not None}
    for name, values in known.items():
        bad = np.flatnonzero(np.isinf(values))
        if bad.size:
            text = f"'{name}' is infinite; leave the field empty where there is no value"
            raise InputError(text, path, int(where[int(bad[0])]))
    if not known:
        reason, at = next(iter(unread.values()))
        raise InputError(f"holds no column of numbers: {reason}", path, at)
    units = header.units | {name: column.unit for name, column in read.items() if column.unit}
    return Table(path, known, units, lines=where, notes=tuple(notes), unread=unread)


def decoded(path: Path, most_bytes: int | None, encoding: str | None = None) -> tuple[bytes, list[str], str | None]:
    """A text file in UTF-8, unpacked, what is to be said of it, and its encoding; InputError with the line."""
    data = path.read_bytes()
    if path.suffix.lower() == ".gz" or data.startswith(b"PK\x03\x04"):
        data = _unpacked(path, most_bytes)
    data = data.removeprefix(codecs.BOM_UTF8)
    if encoding is not None:
        stated = f"is not text in {encoding}, as stated by `encoding`; correct it or leave it out"
        data = _as_utf8(data, encoding, path, stated)
    elif data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        data = _as_utf8(data, "utf-16", path, _NOT_UTF16)
    elif len(data) % 2 == 0 and data[1:_MARKLESS:2].count(0) > 0.4 * len(data[:_MARKLESS]):
        data = _as_utf8(data, "utf-16-le", path, _NOT_UTF16)
    if b"\n" not in data:  # the line ends of old programs
        data = data.replace(b"\r", b"\n")
    if (found := _NO_TEXT.search(data, 0, _LOOKED_AT)) is not None:
        line = data.count(b"\n", 0, found.start()) + 1
        raise InputError(
            f"is not a text table (byte {data[found.start()]} in it); export it as one of {KNOWN}", path, line
        )
    try:
        data.decode()
    except UnicodeDecodeError as error:
        encoding = _shown(data, data.count(b"\n", 0, error.start), path)
        return data.decode(encoding).encode(), [f"it is not UTF-8, and was read as {encoding}"], encoding
    return data, [], encoding


def _shown(data: bytes, before: int, path: Path) -> str:
    """The encoding of a text that is not UTF-8, by its words; `before` are the lines before the first that is not."""
    texts = {}
    for encoding in _ENCODINGS:
        with suppress(UnicodeDecodeError):
            texts[encoding] = data.decode(encoding)
    if not texts:
        text = f"is not UTF-8 and in none of {', '.join(_ENCODINGS)}; export it as one of {KNOWN}"
        raise InputError(text, path, before + 1)
    looks = {encoding: "".join(text[:_LOOKED_AT].lower().split()) for encoding, text in texts.items()}
    known = [one for one, look in looks.items() if any(word in look for word in _words(one))]
    if len(known) == 1:
        return known[0]
    if not known and "cp1252" in texts and _NO_WORD.search(texts["cp1252"]) is None:
        return "cp1252"
    line = {encoding: text.split("\n")[before] for encoding, text in texts.items()}
    says = [f"'{found[0]}' as {encoding}" for encoding, text in line.items() if (found := _FOREIGN.search(text))]
    text = f"is not UTF-8: {', '.join(says)}; state which one by `encoding` in a column map, or save it as UTF-8"
    raise InputError(text, path, before + 1)


def _words(encoding: str) -> tuple[str, ...]:
    """Words of tables that only this encoding writes so; cp1252 has none."""
    own = [word for word in FOREIGN_WORDS if (ord(word[0]) < 0x0500) == (encoding == "cp1251")]
    return () if encoding == "cp1252" else (*own, *_SIGNS[encoding])


def _as_utf8(data: bytes, encoding: str, path: Path, otherwise: str) -> bytes:
    try:
        return data.decode(encoding).encode()
    except UnicodeDecodeError as error:
        raise InputError(otherwise, path, data.count(b"\n", 0, error.start) + 1) from None


def _unpacked(path: Path, most_bytes: int | None) -> bytes:
    most = (most_bytes or memory_for(path.stat().st_size)) // 3
    kind = "gzip" if path.suffix.lower() == ".gz" else "zip"
    try:
        with gzip.open(path) if kind == "gzip" else _only_member(path) as file:
            data = file.read(most + 1)
    except (OSError, EOFError, zlib.error, zipfile.BadZipFile, RuntimeError) as error:  # RuntimeError: a password
        raise InputError(f"not a readable {kind} file ({error}): is it cut off?", path) from None
    if len(data) > most:
        raise InputError(f"unpacks to more than {most / 1e9:.2g} GB, a third of the memory for reading it: allow more "
                         "with `bench import --memory GB`", path)  # fmt: skip
    return data


@contextmanager
def _only_member(path: Path) -> Iterator[IO[bytes]]:
    """The one file of a zip archive; InputError where it has none, or several."""
    with zipfile.ZipFile(path) as archive:
        names = [one for one in archive.namelist() if not one.endswith("/") and not one.startswith("__MACOSX/")]
        if len(names) != 1:
            shown = f": {', '.join(names[:3])}{', …' * (len(names) > 3)}" if names else ""
            text = f"is a zip archive of {len(names)} files{shown}; one with a single table is imported as it is"
            raise InputError(f"{text}, unpack this one", path)
        with archive.open(names[0]) as file:
            yield file


def _read_lines(
    path: Path, data: bytes, header_line: int, delimiter: str, names: list[str]
) -> tuple[IntArray, list[pa.ChunkedArray]]:
    """Lines and columns of a file with comments or blank lines in it; InputError that names the first ragged line.

    One line at a time: a list of the lines of a large file takes forty times its size.
    """
    where, tidy = array("q"), bytearray()
    separator = "\t" if delimiter == " " else delimiter
    rows = _rows(data, header_line)
    for line, row in rows:
        fields = row.split() if delimiter == " " else None
        found = row.count(delimiter) + 1 if fields is None else len(fields)
        if found != len(names) or '"' in row:
            if row.count('"') % 2:
                raise InputError('a quoted field has no end: the second " is missing', path, line)
            if len(split(row, delimiter, path, line)) != len(names):
                raise _wrong_width(found, len(names), delimiter, next(rows, None) is None, InputError("", path, line))
        tidy += (row if fields is None else "\t".join(fields)).encode() + b"\n"
        where.append(line)
    if not where:
        raise InputError("holds zero rows: there is a header, and no data", path)
    columns = _parse(bytes(tidy).rstrip(b"\n"), separator, names)
    if columns is None or any(len(column) != len(where) for column in columns):
        raise InputError("has fields that hold more than one value", path)
    return np.array(where, dtype=np.int64), columns


def _rows(data: bytes, header_line: int) -> Iterator[tuple[int, str]]:
    """Lines with content after the header, with their numbers."""
    for line, raw in enumerate(io.BytesIO(data), 1):
        row = raw.removesuffix(b"\n").removesuffix(b"\r").decode()
        if line > header_line and row.strip() and not row.lstrip().startswith(COMMENTS):
            yield line, row


def _parse(body: bytes, delimiter: str, names: list[str]) -> list[pa.ChunkedArray] | None:
    """Columns of numbers, exact to the last digit, or all of texts; None where a row is ragged."""
    import pyarrow as pa
    from pyarrow import csv as arrow_csv

    gaps = sorted({spelled for gap in GAPS for spelled in (gap, gap.upper(), gap.title(), "NaN")})
    for kind, empty in ((pa.float64(), gaps), (pa.string(), [])):
        try:
            return list(arrow_csv.read_csv(
                pa.BufferReader(body),
                arrow_csv.ReadOptions(column_names=names, use_threads=False),
                arrow_csv.ParseOptions(delimiter=delimiter, ignore_empty_lines=False),
                arrow_csv.ConvertOptions(column_types=dict.fromkeys(names, kind), null_values=empty),
            ).columns)  # fmt: skip
        except (pa.ArrowException, ValueError):
            continue
    return None


def _is_empty(column: pa.ChunkedArray) -> bool:
    import pyarrow as pa
    import pyarrow.compute as pc

    empty: bool = column.null_count == len(column)
    if empty or pa.types.is_floating(column.type):
        return empty
    return not pc.any(pc.not_equal(pc.utf8_trim_whitespace(column), "")).as_py()


def _wrong_width(found: int, width: int, delimiter: str, last: bool, place: InputError) -> InputError:
    """What to say of a line that has not as many fields as the header."""
    text = f"has {found} field{'' if found == 1 else 's'}, the header {width}"
    if last and found < width:
        text += ": the file is truncated; delete that line or export it again"
    elif delimiter == "," and found == 2 * width:
        text += ": decimal commas? export with decimal points"
    else:
        text += f"; {ADVICE}"
    return InputError(text, place.file, place.line)
