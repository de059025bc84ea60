"""chain.seal: every file that the bench wrote into a folder, with its hash and what it was made from, signed."""

from __future__ import annotations

import json
from typing import ClassVar

from pydantic import Field

from bench.record.records.stored import Record, Stored


class Link(Stored):
    """One file. Two hashes stand here only while it is being replaced, or where a bench was killed in between."""

    sha256: tuple[str | None, ...]
    """What the file may be; null: absent. Of a file to which lines are added, the seal of its lines."""
    head: int | None = None
    """Bytes at the beginning of such a file that are hashed at once; each further line has its own seal."""
    lines: int = 0
    """Of such a file."""
    made_from: dict[str, str] = Field(default_factory=dict)
    """SHA-256 of the files that it was made from, by path."""
    utc: str = ""
    bench: str = ""


class ChainRecord(Record):
    """The files of a folder. The manifest in it stands for the recorded files, which it lists itself."""

    FILE: ClassVar[str] = "chain.seal"
    TITLE: ClassVar[str] = "chain"
    ADVICE: ClassVar[str] = "restore it from a backup"
    CHAINED: ClassVar[bool] = False

    unit: str = ""
    run: str = ""
    adopted: str | None = None
    """When this bench took over a folder that an older one had left without this file."""
    files: dict[str, Link] = Field(default_factory=dict)
    """In the order in which they were first written."""
    stamps: dict[str, tuple[int, int, int]] = Field(default_factory=dict)
    """Size, time [ns] and inode of large files when they were hashed: as long as they are the same, so is the hash."""
    keys: tuple[str, ...] = ()
    """Public keys of all benches that wrote here; the last one signed."""
    signature: str = ""

    def signable(self) -> bytes:
        """What is signed: everything but the signature."""
        return json.dumps({**self.content(), "signature": ""}, sort_keys=True, separators=(",", ":")).encode()
