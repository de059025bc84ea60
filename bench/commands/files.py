"""Files that a user asked for."""

from __future__ import annotations

from pathlib import Path

from bench.base import InputError
from bench.record import write_atomically


def write(path: Path, content: str | bytes) -> None:
    """Write a file whole, in a folder that is made where there is none; InputError where that cannot be."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, content.encode() if isinstance(content, str) else content)
    except OSError as error:
        raise InputError(f"cannot be written: {error.strerror}; choose another place", path) from None
