"""The ledger of an archive: the entries that people made in the registry, one JSON line each, beside the run folders.

`ledger.jsonl` begins with the id of the archive; later lines add instruments, operators and lots, and the last line
about one of them counts. The registry can be made again from the ledger and the run folders alone.
"""

from __future__ import annotations

import json
import os
import secrets
import socket
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.base import InputError

FILE = "ledger.jsonl"

Entry = Mapping[str, Any]


@dataclass(frozen=True)
class Ledger:
    """The archive `id` in the folder `root`."""

    root: Path
    id: str

    @property
    def path(self) -> Path:
        """The file."""
        return self.root / FILE

    @property
    def place(self) -> str:
        """host:folder, the location of the archive."""
        return f"{socket.gethostname()}:{self.root.resolve()}"

    def append(self, entry: Entry) -> None:
        """Add a line; two programs may do so at the same time."""
        line = json.dumps({**entry}, allow_nan=False) + "\n"
        handle = os.open(self.path, os.O_WRONLY | os.O_APPEND)
        try:
            os.write(handle, line.encode())
            os.fsync(handle)
        finally:
            os.close(handle)

    def entries(self) -> list[Entry]:
        """Every line after the first; InputError with the line number where one is broken."""
        lines = self.path.read_text(encoding="utf-8").splitlines()
        return [_entry(line, self.path, number) for number, line in enumerate(lines[1:], 2) if line.strip()]


def is_archive(root: Path) -> bool:
    """Whether a folder is an archive."""
    return (root / FILE).is_file()


def archive(root: Path) -> Ledger:
    """The ledger of the folder `root`, which is made if it is missing; InputError where that fails."""
    path = root / FILE
    try:
        if not path.exists():
            _begin(root)
        with path.open(encoding="utf-8") as file:
            first = _entry(file.readline(), path, 1)
    except OSError as error:
        raise InputError(f"cannot be read or made: {error.strerror}", path) from None
    if first.get("kind") != "archive" or not isinstance(first.get("id"), str):
        raise InputError("does not begin with the id of an archive; restore the file", path, 1)
    return Ledger(root, first["id"])


def _begin(root: Path) -> None:
    root.mkdir(parents=True, exist_ok=True)
    partial = root / f".{FILE}.{secrets.token_hex(4)}"
    partial.write_text(json.dumps({"kind": "archive", "id": secrets.token_hex(6)}) + "\n", encoding="utf-8")
    try:
        (root / FILE).hardlink_to(partial)  # if two programs make it at once, the first one counts
    except FileExistsError:
        pass
    except OSError:  # no hard links here
        if not (root / FILE).exists():
            partial.replace(root / FILE)
    finally:
        partial.unlink(missing_ok=True)


def _entry(line: str, path: Path, number: int) -> Entry:
    try:
        entry = json.loads(line)
    except ValueError as error:
        raise InputError(f"not a line of JSON ({error}); restore it", path, number) from None
    if not isinstance(entry, dict):
        raise InputError("not a JSON object; restore it", path, number)
    return entry
