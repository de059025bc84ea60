"""Keeps a centre sound and a bench's disk free: every file hashed anew, and raw data that stay at the centre only."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path

from bench.archive.centre.entries import ENTRIES, RAW, Name, folders, newest, read
from bench.archive.centre.store import Centre, DamagedError, content
from bench.archive.registry.ledger import Ledger
from bench.base import InputError
from bench.record import MANIFEST, ElsewhereRecord, EntryRecord, FileAt, Manifest, listed

ASIDE = "damaged"


@dataclass
class Scrubbed:
    """Result of `scrub`: entries and files read, bytes hashed, and a line for each fault."""

    entries: int = 0
    files: int = 0
    bytes: int = 0
    faults: list[str] = field(default_factory=list)
    aside: int = 0
    """Entries that were set aside; their folders are sent again."""


@dataclass
class Released:
    """Result of `release`: folders whose raw data are at the centre only, and why others were left as they are."""

    folders: list[Path] = field(default_factory=list)
    bytes: int = 0
    refused: list[str] = field(default_factory=list)


def scrub(centre: Centre, *, repair: bool = False) -> Scrubbed:
    """Hash every file that an entry lists anew, each once.

    `repair`: files that are damaged are set aside, with the entries that list them, so that the benches send them
    again. CentreError where the centre is not reached.
    """
    done, verdicts = Scrubbed(), dict[str, str]()
    for path in centre.names(ENTRIES):
        done.entries += 1
        name = Name.parse(path)
        try:
            if name is None:
                raise DamagedError(f"{centre.url}/{path}: is no entry: its name is none")
            files = read(centre, name).files
        except DamagedError as error:
            done.faults.append(str(error))
            done.aside += _aside(centre, [path], repair=repair)
            continue
        bad = []
        for file in files.values():
            if file.sha256 not in verdicts:
                verdicts[file.sha256] = _verdict(centre, file)
                done.files, done.bytes = done.files + 1, done.bytes + file.bytes
                done.faults += [verdict] if (verdict := verdicts[file.sha256]) else []
            if verdicts[file.sha256]:
                bad.append(content(file.sha256))
        if bad:
            done.aside += _aside(centre, [path, *bad], repair=repair)
    return done


def release(centre: Centre, ledger: Ledger, older_days: float, now: datetime | None = None) -> Released:
    """Remove the raw data of runs that ended so long ago and are at the centre, where each file is hashed anew first.

    `elsewhere.json` says which they are and where; `bring_back` restores them. CentreError where it is not reached.
    """
    names, done = newest(centre, ledger.id), Released()
    before = (now or datetime.now(UTC)) - timedelta(days=older_days)
    for folder in folders(ledger.root):
        name = names.get(f"{ledger.id}/{folder.relative_to(ledger.root).as_posix()}")
        try:
            raw = _raw(folder, before)
            if raw and name is None:
                raise InputError("is not at the centre yet; `bench sync send` sends it", folder)
            if raw and name is not None:
                done.bytes += _release(centre, folder, read(centre, name), raw)
                done.folders.append(folder)
        except (InputError, DamagedError) as error:
            done.refused.append(str(error))
    return done


def _raw(folder: Path, before: datetime) -> dict[str, str]:
    """Raw files that are here, with their hashes; none where the run is younger."""
    manifest = Manifest.find(folder) if (folder / MANIFEST).is_file() else None
    try:
        old = manifest is not None and datetime.fromisoformat(manifest.created) < before
    except (ValueError, TypeError):  # nobody knows when; it stays
        old = False
    if not old:
        return {}
    return {name: digest for name, digest in listed(folder).items() if RAW.fullmatch(name) and (folder / name).exists()}


def _release(centre: Centre, folder: Path, entry: EntryRecord, raw: dict[str, str]) -> int:
    for name, digest in raw.items():
        there = entry.files.get(name)
        if there is None or there.sha256 != digest:
            raise InputError("is not at the centre as it is here; `bench sync send` sends it", folder / name)
        if verdict := _verdict(centre, there):
            raise DamagedError(verdict)
    known = ElsewhereRecord.find(folder)
    files = {**({} if known is None else known.files), **{name: entry.files[name] for name in raw}}
    ElsewhereRecord(centre=centre.url, run=Name.of(entry).run, files=files).write(folder)
    freed = 0
    for name in raw:  # what a kill leaves here is removed the next time
        freed += (folder / name).stat().st_size
        (folder / name).unlink()
    return freed


def _verdict(centre: Centre, file: FileAt) -> str:
    """What is wrong with a file at the centre; empty where nothing is."""
    found = centre.hashed(file.sha256)
    if found == file.sha256:
        return ""
    what = "is missing" if found is None else f"is damaged: its SHA-256 is {found}"
    return f"{centre.url}/{content(file.sha256)}: {what}"


def _aside(centre: Centre, paths: list[str], *, repair: bool) -> int:
    """Move files out of the way, the entry first, so that nothing lists what is gone."""
    for path in _there(centre, paths) if repair else ():
        centre.move(path, f"{ASIDE}/{path}")
    return int(repair)


def _there(centre: Centre, paths: list[str]) -> Iterator[str]:
    return (path for path in paths if centre.has(path))
