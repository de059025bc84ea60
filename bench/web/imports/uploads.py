"""An upload, written into its folder while it comes in, with limits of parts and bytes."""

from __future__ import annotations

import re
import shutil
from collections.abc import AsyncIterator
from pathlib import Path
from typing import BinaryIO

from python_multipart.exceptions import FormParserError
from python_multipart.multipart import MultipartParser, parse_options_header

from bench.base import InputError

ENDINGS = (".csv", ".txt", ".tsv", ".dat", ".parquet", ".mf4", ".mdf", ".blf", ".asc", ".log", ".trc",
           ".gz", ".zip", ".xlsx", ".tdms", ".ulg", ".h5", ".hdf5")  # fmt: skip
"""File name endings of tables."""
PARTS = {"file": ENDINGS, "dbc": (".dbc",)}
"""Parts of the form, each once, with the allowed endings."""
SPARE_BYTES = 2 << 30
"""Free space on the disk that is reserved for runs."""
_HEADER_BYTES = 4096
_NAME_BYTES = 120


def safe_name(given: str) -> str:
    """Last part of a file name, reduced to letters, digits, dots, dashes and spaces of any script; never empty."""
    last = re.split(r"[/\\]", given)[-1]
    kept = "".join(sign if sign.isalnum() or sign in "._- " else "-" for sign in last).strip(" .-")
    stem, dot, ending = kept.rpartition(".")
    while len(kept.encode()) > _NAME_BYTES and stem:
        stem = stem[:-1]
        kept = f"{stem}{dot}{ending}"
    return kept if len(kept.encode()) <= _NAME_BYTES and stem else "unnamed"


class Upload:
    """Writes the parts of a form as files into `folder`; `files` lists them by part."""

    def __init__(self, folder: Path, boundary: bytes) -> None:
        """`folder` exists and is empty."""
        self.files: dict[str, Path] = {}
        self._folder = folder
        self._open: BinaryIO | None = None
        self._headers: dict[str, bytes] = {}
        self._field, self._value, self._held = b"", b"", 0
        self._parser = MultipartParser(boundary, {
            "on_part_begin": self._begin, "on_header_field": self._on_field, "on_header_value": self._on_value,
            "on_header_end": self._on_header, "on_headers_finished": self._on_headers, "on_part_data": self._on_data,
            "on_part_end": self._on_end,
        })  # fmt: skip

    async def take(self, stream: AsyncIterator[bytes]) -> None:
        """Take the whole body; InputError for a wrong form."""
        try:
            async for chunk in stream:
                if shutil.disk_usage(self._folder).free < SPARE_BYTES:
                    raise InputError("the disk is nearly full, and the rest is reserved for runs; free some disk")
                self._parser.write(chunk)
            self._parser.finalize()
        except FormParserError as error:
            raise InputError(f"the form cannot be read: {error}") from None
        except OSError as error:
            raise InputError(f"the upload cannot be written: {error.strerror}; free some disk") from None
        finally:
            self.close()
        if "file" not in self.files:
            raise InputError("no part 'file' with a file name in the form; send the table as one")

    def close(self) -> None:
        """Close the file that was being written."""
        if self._open is not None:
            self._open.close()
            self._open = None

    def _begin(self) -> None:
        self._headers, self._field, self._value, self._held = {}, b"", b"", 0

    def _on_field(self, data: bytes, start: int, end: int) -> None:
        self._grow(end - start)
        self._field += data[start:end]

    def _on_value(self, data: bytes, start: int, end: int) -> None:
        self._grow(end - start)
        self._value += data[start:end]

    def _grow(self, size: int) -> None:
        self._held += size
        if self._held > _HEADER_BYTES:
            raise InputError(f"the headers of a part of the form have more than {_HEADER_BYTES} bytes")

    def _on_header(self) -> None:
        self._headers[self._field.decode("latin-1").lower()] = self._value
        self._field, self._value = b"", b""

    def _on_headers(self) -> None:
        _, options = parse_options_header(self._headers.get("content-disposition", b""))
        part = options.get(b"name", b"").decode("utf-8", errors="replace")
        if part not in PARTS or part in self.files:
            raise InputError(f"the form has a part '{part[:40]}', allowed are {' and '.join(PARTS)}, each once")
        name = safe_name(options.get(b"filename", b"").decode("utf-8", errors="replace"))
        ending = Path(name).suffix.lower()
        if ending not in PARTS[part]:
            raise InputError(f"'{name}' is not of a kind that can be read: {', '.join(PARTS[part])}")
        path = self._folder / part
        path.mkdir()
        self.files[part] = path / name
        self._open = self.files[part].open("wb")

    def _on_data(self, data: bytes, start: int, end: int) -> None:
        if self._open is not None:
            self._open.write(memoryview(data)[start:end])

    def _on_end(self) -> None:
        self.close()


def boundary_of(content_type: str) -> bytes:
    """The boundary of a multipart body; InputError where there is none."""
    _, options = parse_options_header(content_type.encode("latin-1", errors="replace"))
    boundary = options.get(b"boundary", b"")
    if not boundary or len(boundary) > 200:
        raise InputError("Content-Type names no boundary of the form's parts")
    return boundary
