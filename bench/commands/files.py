"""Files that a user asked for."""

from __future__ import annotations

import sys
from functools import cache
from pathlib import Path

from bench.base import InputError
from bench.record import CalibrationRecord, ImuRecord, JobRecord, Manifest, put, unproven, write_atomically


def tell_unproven(*folders: Path) -> None:
    """Say once, on stderr, of run folders of an older bench that nothing proves their files."""
    told = [text for folder in folders if (text := unproven(folder))]
    more = f" (and {len(told) - 1} more)" if len(told) > 1 else ""
    if told:
        _say(told[0] + more)


@cache
def _say(text: str) -> None:
    print(f"bench: {text}", file=sys.stderr)


def write(path: Path, content: str | bytes) -> None:
    """Write a file whole, in a folder that is made where there is none; the folder of a run or of a job lists it.

    InputError where that cannot be.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        data = content.encode() if isinstance(content, str) else content
        if any((path.parent / name).is_file() for name in (Manifest.FILE, JobRecord.FILE, ImuRecord.FILE)):
            put(path.parent, {path.name: data}, [Manifest.FILE, CalibrationRecord.FILE, ImuRecord.FILE])
        else:
            write_atomically(path, data)
    except OSError as error:
        raise InputError(f"cannot be written: {error.strerror}; choose another place", path) from None
