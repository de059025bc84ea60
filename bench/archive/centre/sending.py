"""Sends what a centre lacks of an archive. A kill or a pulled cable costs nothing but the file that was on its way.

What waits is the difference between the folders here and the entries there, so no list can get lost. Receipts of the
last talk tell what waits while the centre is not reached, and which folders need not be looked at.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from bench.archive.centre.claim import claim
from bench.archive.centre.entries import FLASH, Name, files_of, folders, newest, stamp, unfinished
from bench.archive.centre.origin import origin_of
from bench.archive.centre.store import Centre, Tell, content, named
from bench.archive.registry.ledger import Ledger
from bench.base import BenchError, CentreError, InputError, __version__
from bench.record import ElsewhereRecord, EntryRecord, FileAt, write_atomically


@dataclass
class Outbox:
    """What a centre lacks of an archive; `asked` is when it was asked last, empty where it never was."""

    waiting: list[str] = field(default_factory=list)
    there: int = 0
    damaged: list[str] = field(default_factory=list)
    """A line for each folder that cannot be sent."""
    unfinished: list[Path] = field(default_factory=list)
    asked: str = ""


@dataclass
class Sent:
    """Result of `send`: folders, and files and bytes that travelled."""

    sent: list[str] = field(default_factory=list)
    there: int = 0
    files: int = 0
    bytes: int = 0
    damaged: list[str] = field(default_factory=list)
    unfinished: list[Path] = field(default_factory=list)


def send(centre: Centre, ledger: Ledger, *, moved: bool = False, tell: Tell = lambda _: None) -> Sent:
    """Send every folder that the centre has not got as it is here, in the order in which the ledger saw them.

    CentreError where it is not reached; what was sent until then is there. InputError where another computer sends
    under the id of this archive.
    """
    claim(centre, ledger, moved=moved)
    receipts, done = Receipts.read(ledger, centre.url), Sent(unfinished=unfinished(ledger.root))
    copied = _copied(centre, ledger)
    receipts.known = newest(centre, ledger.id)
    try:
        for folder, files, last in _lacking(ledger, receipts, copied, done.damaged):
            try:
                done.files, done.bytes = _transfer(centre, folder, files, done)
            except InputError as error:
                done.damaged.append(str(error))
                continue
            entry = _entry(ledger, folder, files, last)
            centre.write(Name.of(entry).path, entry.text().encode())
            receipts.note(folder, Name.of(entry))
            done.sent.append(entry.folder)
            tell(f"sent {entry.folder}")
    except CentreError as error:
        raise CentreError(f"{error}; {len(done.sent)} folders were sent, nothing is lost") from error
    finally:
        receipts.write()
    done.there = len(receipts.known)
    return done


def outbox(centre: Centre | None, ledger: Ledger, url: str) -> Outbox:
    """What the centre lacks; as far as its last answer tells where it is not reached (None)."""
    receipts = Receipts.read(ledger, url)
    copied = _copied(centre, ledger) if centre else set()
    if centre is not None:
        receipts.known = newest(centre, ledger.id)
    found = Outbox(asked=receipts.utc, unfinished=unfinished(ledger.root))
    found.waiting = [_inside(ledger, folder) for folder, _, _ in _lacking(ledger, receipts, copied, found.damaged)]
    found.there = len(receipts.known)
    if centre is not None:
        receipts.write()
        found.asked = receipts.utc
    return found


def reached(url: str, ledger: Ledger) -> Centre:
    """The centre to which this archive sends, made where it never sent there; CentreError where it is gone since."""
    before = len(Receipts.read(ledger, named(url)).known)
    try:
        return Centre(url, begin=not before)
    except CentreError:
        raise
    except InputError as error:
        if not before:
            raise
        raise CentreError(f"{error}, and {before} folders were sent there before: is it mounted?") from None


class Receipts:
    """What a centre had when it was asked last, and how the folders looked that were sent; a file in the archive."""

    def __init__(self, ledger: Ledger, path: Path) -> None:
        self._ledger, self._path = ledger, path
        self.known: dict[str, Name] = {}
        self.stamps: dict[str, list[Any]] = {}
        self.utc = ""

    @classmethod
    def read(cls, ledger: Ledger, url: str) -> Receipts:
        """Those of a centre; none where the file is missing or damaged: the centre itself knows."""
        path = ledger.root / f".centre-{hashlib.sha256(url.encode()).hexdigest()[:12]}.json"
        receipts = cls(ledger, path)
        try:
            content = json.loads(path.read_bytes())
            if content["archive"] == ledger.id:
                names = [Name.parse(name) for name in content["entries"]]
                receipts.known = {name.run: name for name in names if name is not None}
                receipts.stamps, receipts.utc = dict(content["stamps"]), str(content["utc"])
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            pass
        return receipts

    def note(self, folder: Path, name: Name) -> None:
        """A folder is there now."""
        self.known[name.run] = name
        self.stamps[name.folder] = [name.path, *stamp(folder)]

    def write(self) -> None:
        """Keep them."""
        self.utc = datetime.now(UTC).isoformat(timespec="seconds")
        content = {
            "archive": self._ledger.id,
            "utc": self.utc,
            "entries": [name.path for name in self.known.values()],
            "stamps": self.stamps,
        }
        write_atomically(self._path, json.dumps(content).encode())


def _lacking(
    ledger: Ledger, receipts: Receipts, copied: set[tuple[str, str]], damaged: list[str]
) -> Iterator[tuple[Path, dict[str, FileAt], Name | None]]:
    """Folders that are not there as they are here, with their files and their last entry."""
    seen = ledger.seen()
    ordered = sorted(folders(ledger.root), key=lambda f: (seen.get(_inside(ledger, f), (1 << 60, ""))[0], str(f)))
    for folder in ordered:
        place = _inside(ledger, folder)
        last = receipts.known.get(f"{ledger.id}/{place}")
        now = [last.path if last else "", *stamp(folder)]
        if last is not None and receipts.stamps.get(place) == now:
            continue
        if origin_of(folder) is not None:  # it came from a centre
            continue
        try:
            files = files_of(folder)
        except (BenchError, OSError) as error:
            damaged.append(str(error))
            continue
        name = Name.of(_entry(ledger, folder, files, None))
        if (place, name.manifest) in copied and folder.name != FLASH:
            continue
        if last is not None and last.digest == name.digest:
            receipts.stamps[place] = now
            continue
        yield folder, files, last


def _transfer(centre: Centre, folder: Path, files: dict[str, FileAt], done: Sent) -> tuple[int, int]:
    away = ElsewhereRecord.find(folder)
    for name, file in files.items():
        if not (folder / name).is_file() and away is not None and name in away.files:
            if centre.size(content(file.sha256)) != file.bytes:
                raise InputError(f"is neither here nor at {centre.url}; send to the centre that has it", folder / name)
            continue
        travelled = centre.put(file.sha256, folder / name)
        done.files += travelled > 0
        done.bytes += travelled
    return done.files, done.bytes


def _entry(ledger: Ledger, folder: Path, files: dict[str, FileAt], last: Name | None) -> EntryRecord:
    return EntryRecord(
        archive=ledger.id,
        folder=_inside(ledger, folder),
        number=1 if last is None else last.number + 1,
        utc=datetime.now(UTC).isoformat(timespec="seconds"),
        bench=__version__,
        files=files,
    )


def _copied(centre: Centre, ledger: Ledger) -> set[tuple[str, str]]:
    """Folders and manifests of the archives that this one is a copy of: they are there under their own ids."""
    others = [str(entry["copy_of"]) for entry in ledger.entries() if entry.get("kind") == "archive"]
    return {(name.folder, name.manifest) for other in others for name in newest(centre, other).values()}


def _inside(ledger: Ledger, folder: Path) -> str:
    return folder.relative_to(ledger.root).as_posix()
