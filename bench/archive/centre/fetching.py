"""Brings runs from a centre into a folder, which is an archive like any other: every command reads it as its own.

A folder keeps its path; where another archive has one of the same name, its id is put behind it. A copy of a run, as on
a cloned disk, comes once. What people entered at the benches comes with the runs. Large files stay at the centre until
somebody asks for them; `elsewhere.json` lists them.
"""

from __future__ import annotations

import json
import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from bench.archive.centre.claim import LEDGERS, last_ledger
from bench.archive.centre.entries import RAW, Name, newest, read
from bench.archive.centre.origin import Origin, chain_hash, origin_of
from bench.archive.centre.store import Centre, DamagedError, Tell
from bench.archive.registry.ledger import Entry, Ledger
from bench.base import InputError
from bench.record import MANIFEST, ElsewhereRecord, sha256, staged

LARGE = re.compile(rf"{RAW.pattern}|report\.html")
"""What stays at the centre."""
_TOLD = {"equipment", "operator", "lot", "withdrawal"}


@dataclass
class Fetched:
    """Result of `fetch`: folders that came or were renewed, and those that stayed because they were changed here."""

    folders: list[Path] = field(default_factory=list)
    there: int = 0
    kept: list[Path] = field(default_factory=list)
    damaged: list[str] = field(default_factory=list)
    """A line for each folder that the centre cannot give."""
    unregistered: list[Path] = field(default_factory=list)
    """Folders that an earlier fetch brought or renewed, and did not live to register."""


def fetch(
    centre: Centre, ledger: Ledger, wanted: Collection[str] = (), *, large: bool = False, replace: bool = False,
    tell: Tell = lambda _: None,
) -> Fetched:  # fmt: skip
    """Bring all runs, or those of the ids `wanted`; with `large` whole.

    A folder in which something was written here stays as it is, unless `replace`. CentreError where the centre is not
    reached, InputError for an id that it does not know.
    """
    names = newest(centre)
    for run in wanted:
        if run not in names:
            raise InputError(f"has no run {run}; `bench sync list` lists them", centre.url)
    here = _Here(ledger.root)
    unregistered = [place for place, origin in here.known.values() if not origin.registered]
    done = Fetched(there=len(names), unregistered=unregistered)
    chosen = [names[run] for run in wanted] if wanted else _once(names, here)
    try:
        for name in sorted(chosen, key=lambda one: (one.folder.partition("/")[2], one)):
            place, origin = here.place(name)
            if origin is not None and origin.entry == name.path and not (large and _lacks(place)):
                continue
            if origin is not None and origin.entry != name.path and origin.changed(place) and not replace:
                done.kept.append(place)
                continue
            try:
                _bring(centre, name, place, large=large)
            except DamagedError as error:
                done.damaged.append(str(error))
                continue
            here.put(name, place)
            done.folders.append(place)
            tell(f"fetched {name.run}")
    finally:
        _note(ledger, here)
    _hear(centre, ledger, {name.archive for name in names.values()})
    return done


def located(ledger: Ledger, run: str) -> Path | None:
    """The folder of a run that was fetched, by its id; None where it was not."""
    unit, _, name = run.partition("/")[2].partition("/")
    for place in (ledger.root / unit / name, ledger.root / unit / f"{name}+{run.partition('/')[0]}"):
        origin = origin_of(place)
        known = Name.parse(origin.entry) if origin else None
        if known is not None and known.run == run:
            return place
    return None


class _Here:
    """Folders of this archive that came from a centre."""

    def __init__(self, root: Path) -> None:
        self._root = root
        self.known: dict[str, tuple[Path, Origin]] = {}
        for file in root.glob("*/*/.origin.json"):
            origin = origin_of(file.parent)
            name = Name.parse(origin.entry) if origin else None
            if origin is not None and name is not None:
                self.known[name.run] = (file.parent, origin)

    def place(self, name: Name) -> tuple[Path, Origin | None]:
        """Where a folder belongs, and what is there of it."""
        if name.run in self.known:
            return self.known[name.run]
        place = self._root / name.folder
        return (place.with_name(f"{place.name}+{name.archive}") if place.exists() else place), None

    def put(self, name: Name, place: Path) -> None:
        origin = origin_of(place)
        if origin is not None:
            self.known[name.run] = (place, origin)


def _once(names: Mapping[str, Name], here: _Here) -> Iterator[Name]:
    """Every run once: of copies the one that is here already, or else that of the first id."""
    chosen: dict[tuple[str, str], Name] = {}
    for run, name in sorted(names.items(), key=lambda item: (item[0] not in here.known, item[0])):
        key = (name.folder, name.manifest if name.manifest != "none" else run)
        if chosen.setdefault(key, name) is name:
            yield name


def _bring(centre: Centre, name: Name, place: Path, *, large: bool) -> None:
    """A folder, whole: made beside its place and moved there."""
    entry = read(centre, name)
    left = {} if large else {path: file for path, file in entry.files.items() if LARGE.fullmatch(path)}
    with staged(place.parent.parent) as stage:
        folder = stage / "folder"
        for path, file in entry.files.items():
            if path not in left:
                target = _within(folder, path, centre)
                target.parent.mkdir(parents=True, exist_ok=True)
                centre.get(file.sha256, target)
        if left:
            ElsewhereRecord(centre=centre.url, run=name.run, files=left).write(folder)
        Origin(centre.url, name.path, chain_hash(folder), registered=False).write(folder)
        place.parent.mkdir(exist_ok=True)
        if place.exists():
            place.replace(stage / "before")
        folder.replace(place)


def _within(folder: Path, path: str, centre: Centre) -> Path:
    target = folder / path
    if ".." in Path(path).parts or Path(path).is_absolute() or folder not in target.parents:
        raise DamagedError(f"{centre.url}: an entry names the file {path!r}, which is outside its folder")
    return target


def _lacks(place: Path) -> bool:
    away = ElsewhereRecord.find(place)
    return away is not None and any(not (place / path).is_file() for path in away.files)


def _note(ledger: Ledger, here: _Here) -> None:
    """Write the fetched runs into the ledger, also those of a fetch that was killed before it could."""
    runs, origins = [], {}
    for run, (place, _) in here.known.items():
        if (place / MANIFEST).is_file():
            path = place.relative_to(ledger.root).as_posix()
            runs.append((path, sha256(place / MANIFEST)))
            origins[path] = run
    ledger.saw_all(runs, origins)


def _hear(centre: Centre, ledger: Ledger, archives: Collection[str]) -> None:
    """Take over what people entered at the benches, once: by the archive, and the line of its ledger."""
    known = {str(entry["origin"]) for entry in ledger.entries() if entry.get("kind") in _TOLD and "origin" in entry}
    news: list[Entry] = []
    for archive in sorted(archives):
        for number, line in enumerate(last_ledger(centre, archive).decode(errors="replace").splitlines(), 1):
            origin, entry = f"{archive}:{number}", _entry(line, centre.url, archive, number)
            # What was entered elsewhere and fetched there comes from where it was entered.
            if entry.get("kind") in _TOLD and "origin" not in entry and origin not in known:
                news.append({key: value for key, value in entry.items() if key != "previous"} | {"origin": origin})
    if news:
        ledger.append(*news)


def _entry(line: str, url: str, archive: str, number: int) -> Entry:
    try:
        entry = json.loads(line)
    except ValueError:
        entry = None
    if not isinstance(entry, dict):
        raise DamagedError(f"{url}/{LEDGERS}/{archive}: line {number} is no JSON object; send the archive again")
    return entry


def bring_back(centre: Centre, folder: Path) -> int:
    """Bring the files of a folder that are at a centre; how many came. CentreError where one is missing or damaged."""
    away = ElsewhereRecord.find(folder)
    count = 0
    for path, file in ({} if away is None else away.files).items():
        target = _within(folder, path, centre)
        if target.is_file():
            continue
        target.parent.mkdir(parents=True, exist_ok=True)
        partial = target.with_name(f".{target.name}.part")
        partial.unlink(missing_ok=True)
        centre.get(file.sha256, partial)
        partial.replace(target)
        count += 1
    return count
