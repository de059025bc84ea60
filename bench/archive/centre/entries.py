"""Entries of a centre: which folders of which archives are there, and what this place says of one that is here."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from bench.archive.centre.store import Centre, DamagedError
from bench.base import InputError, process_alive
from bench.record import (
    CHAIN,
    LIVE,
    MANIFEST,
    ElsewhereRecord,
    EntryRecord,
    FileAt,
    JobRecord,
    RunFolder,
    listed,
    sha256,
)

ENTRIES = "entries"
_SHORT = 16
"""So many digits of a hash stand in a name."""
FLASH = "flash"
RAW = re.compile(r"data\.parquet|journal(-\d+)?/.*")
"""What was captured, sample by sample."""


@dataclass(frozen=True, order=True)
class Name:
    """The name of an entry: all that is needed to see whether a folder is there as it is here."""

    archive: str
    folder: str
    number: int
    manifest: str
    digest: str

    @classmethod
    def of(cls, entry: EntryRecord) -> Name:
        """That of an entry."""
        return cls(entry.archive, entry.folder, entry.number, entry.manifest[:_SHORT] or "none", entry.digest[:_SHORT])

    @classmethod
    def parse(cls, path: str) -> Name | None:
        """That of a file in the centre; None for another file."""
        parts = path.split("/")
        rest = parts[-1].removesuffix(".json").split("-")
        if len(parts) != 5 or parts[0] != ENTRIES or len(rest) != 3 or not rest[0].isdigit():
            return None
        return cls(parts[1], f"{parts[2]}/{parts[3]}", int(rest[0]), rest[1], rest[2])

    @property
    def path(self) -> str:
        """The file in the centre."""
        return f"{ENTRIES}/{self.archive}/{self.folder}/{self.number:06d}-{self.manifest}-{self.digest}.json"

    @property
    def run(self) -> str:
        """Id of the folder, the same everywhere."""
        return f"{self.archive}/{self.folder}"


def newest(centre: Centre, archive: str = "") -> dict[str, Name]:
    """The last entry of every folder, of one archive or of all, by the folder's id."""
    found: dict[str, Name] = {}
    for path in centre.names(f"{ENTRIES}/{archive}".rstrip("/")):
        name = Name.parse(path)
        if name is not None and (name.run not in found or name.number > found[name.run].number):
            found[name.run] = name
    return found


def read(centre: Centre, name: Name) -> EntryRecord:
    """An entry; CentreError where it is damaged."""
    try:
        entry = EntryRecord.parse(centre.read(name.path), f"{centre.url}/{name.path}")
    except InputError as error:
        raise DamagedError(str(error)) from None
    if Name.of(entry) != name:
        raise DamagedError(f"{centre.url}/{name.path}: does not fit its name; {entry.ADVICE}")
    return entry


def folders(root: Path) -> Iterator[Path]:
    """Folders of an archive that are whole: of runs that have ended, of jobs, of writes into a unit's memory."""
    for folder in sorted(root.glob("*/*/")):
        hidden = folder.name.startswith(".") or folder.parent.name.startswith(".")
        if not hidden and (_marked(folder) or folder.name == FLASH) and not _running(folder):
            yield folder


def unfinished(root: Path) -> list[Path]:
    """Run folders of benches that were killed before they made the manifest."""
    return [
        f for f in sorted(root.glob("*/*/")) if RunFolder(f).journal.is_dir() and not _marked(f) and not _running(f)
    ]


def files_of(folder: Path) -> dict[str, FileAt]:
    """Every file of a folder by its content; those that it gave to a centre are among them. InputError: one is missing.

    Files that a list names have the hash that stands there; whether they still do is seen when they are sent.
    """
    wanted, away = listed(folder), ElsewhereRecord.find(folder)
    elsewhere = {} if away is None else away.files
    found: dict[str, FileAt] = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.is_file() and not path.is_symlink() and not _own(name):
            found[name] = FileAt(sha256=wanted.get(name) or sha256(path), bytes=path.stat().st_size)
    for name, digest in wanted.items():
        if name not in found:
            known = elsewhere.get(name)
            if known is None or known.sha256 != digest:
                raise InputError(f"is missing; {CHAIN} or {MANIFEST} lists it; restore it from a backup", folder / name)
            found[name] = known
    return found


def stamp(folder: Path) -> list[int]:
    """What changes with every file that the bench writes into a folder."""
    found = []
    for name in (CHAIN, MANIFEST):
        with suppress(OSError):
            there = (folder / name).stat()
            found += [there.st_mtime_ns, there.st_size, there.st_ino]
    return [*found, folder.stat().st_mtime_ns]


def _marked(folder: Path) -> bool:
    return any((folder / name).is_file() for name in (MANIFEST, JobRecord.FILE))


def _running(folder: Path) -> bool:
    try:
        return process_alive(int(json.loads((folder / LIVE).read_text())["pid"]))
    except (OSError, ValueError, KeyError, TypeError):
        return False


def _own(name: str) -> bool:
    """Files that are of this place only."""
    return name == LIVE or any(part.startswith(".") for part in name.split("/"))
