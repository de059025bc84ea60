"""Files that a user asked for."""

from __future__ import annotations

from pathlib import Path

from bench.base import InputError
from bench.record import CalibrationRecord, Manifest, put, write_atomically


def write(path: Path, content: str | bytes) -> None:
    """Write a file whole, in a folder that is made where there is none; InputError where that cannot be."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        data = content.encode() if isinstance(content, str) else content
        if not (path.parent / Manifest.FILE).is_file():
            write_atomically(path, data)
        else:
            put(path.parent, {path.name: data}, [Manifest.FILE, CalibrationRecord.FILE])
    except OSError as error:
        raise InputError(f"cannot be written: {error.strerror}; choose another place", path) from None
