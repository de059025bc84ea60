"""The seal of a file that lines are added to: it costs what is added, however long the file is.

The seal of the first `head` bytes is their SHA-256. Each further line has the SHA-256 of the seal before it (hex) and
the line, so that the last seal stands for all of the file, and each one for all before it.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator


def whole_lines(data: bytes) -> bytes:
    """Without a last line that a power cut or a full disk cut off: nobody was told that it was written."""
    return data[: data.rfind(b"\n") + 1]


def sealed(data: bytes, head: int | None) -> str:
    """The seal of a file; without `head` it is the SHA-256 of all of it."""
    seal = hashlib.sha256(data if head is None else data[:head]).hexdigest()
    return seal if head is None else extended(seal, data[head:])


def extended(seal: str, lines: bytes) -> str:
    """The seal after further lines."""
    for line in lines.splitlines(keepends=True):
        seal = hashlib.sha256(seal.encode() + line).hexdigest()
    return seal


def seals(data: bytes, head: int | None) -> Iterator[tuple[int, bytes, str]]:
    """Each line, where it begins, and the seal of all before it; at last no line, and the seal of the file."""
    before, at = hashlib.sha256(), 0
    seal = before.hexdigest()
    for line in data.splitlines(keepends=True):
        yield at, line, seal
        at += len(line)
        if head is None or at <= head:
            before.update(line)
            seal = before.hexdigest()
        else:
            seal = extended(seal, line)
    yield at, b"", seal
