"""What a centre knows of a folder, and what a folder knows of its files at a centre."""

from __future__ import annotations

import hashlib
import json
from typing import ClassVar

from bench.record.records.stored import Record, Stored


class FileAt(Stored):
    """A file by its content."""

    sha256: str
    bytes: int


class EntryRecord(Record):
    """A run folder, job folder or flash folder at a centre, as it was when it was sent; the last number counts."""

    FILE: ClassVar[str] = "entry.json"
    TITLE: ClassVar[str] = "entry"
    ADVICE: ClassVar[str] = "set it aside with `bench sync scrub --repair`, and send the folder again"
    CHAINED: ClassVar[bool] = False

    archive: str
    """Id of the archive that it was sent from; with `folder` it is the run's id everywhere."""
    folder: str
    """Its path there."""
    number: int
    """How often it was sent."""
    utc: str
    bench: str
    """Version of the bench that sent it."""
    files: dict[str, FileAt]
    """By path inside the folder."""

    @property
    def manifest(self) -> str:
        """SHA-256 of the manifest; empty where there is none."""
        known = self.files.get("manifest.json")
        return known.sha256 if known else ""

    @property
    def digest(self) -> str:
        """SHA-256 of the names and contents of all files."""
        return digest_of({name: file.sha256 for name, file in self.files.items()})


class ElsewhereRecord(Record):
    """Files of a folder that are at a centre and not here."""

    FILE: ClassVar[str] = "elsewhere.json"
    TITLE: ClassVar[str] = "elsewhere"
    ADVICE: ClassVar[str] = "bring the files back with `bench sync restore RUN`"

    centre: str
    run: str
    """Id of the folder at the centre: archive/unit/folder."""
    files: dict[str, FileAt]
    """By path inside the folder."""


def digest_of(files: dict[str, str]) -> str:
    """SHA-256 of names and hashes of files."""
    return hashlib.sha256(json.dumps(files, sort_keys=True).encode()).hexdigest()
