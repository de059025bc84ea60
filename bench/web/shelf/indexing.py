"""What is known of every run folder: read once, kept in `.web/runs.json`, brought up to date by the folders' times.

A folder's time changes whenever a file in it is made or replaced, and everything that is told here is in files that are
replaced whole. So a look costs one `stat` a run, and reading only what changed; filters are answered from memory.
"""

from __future__ import annotations

import contextlib
import json
import os
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from datetime import datetime
from hashlib import sha256
from operator import attrgetter
from pathlib import Path
from typing import Any

from fastapi import HTTPException, Request

from bench.acquisition import live_at
from bench.base import InputError, process_alive
from bench.record import ComparisonRecord, LimitsRecord, Manifest, VerificationRecord, write_atomically
from bench.web.ground.problems import NotFoundError
from bench.web.live.finding import inside

FILE, FORMAT = "runs.json", 3
RUNNING, UNFINISHED, DAMAGED = "running", "unfinished", "damaged"
LOOK_S = 1.0
"""A look at the disk is good for so long [s]."""
SAVE_S = 30.0
"""Changes are written at most so often; what was not is read again at the next start [s]."""


@dataclass(frozen=True)
class RunEntry:
    """One run in a list; errors of its best model in RMS [deg/h], None where there is no number."""

    run: str
    unit: str
    profile: str
    start: str
    state: str
    """That of the manifest; `running`, `unfinished` where a bench was killed, `damaged` where a file cannot be read."""
    verdict: str
    """PASS, FAIL … against limits, else the word of the analysis; empty before one."""
    rms_dph: float | None
    held_out_rms_dph: float | None
    floor_dph: float | None
    duration_s: float | None
    imported: bool
    corrected: bool
    """Whether the unit corrected its rate itself: no model is fitted to it or checked by it."""


@dataclass(frozen=True)
class Entry(RunEntry):
    """It, and what the index needs to know of it."""

    content: str = ""
    """Hash of what was recorded; empty before the end."""
    changed: int = 0
    """The folder's time [ns]."""

    @property
    def words(self) -> str:
        """What a search looks through."""
        return f"{self.run} {self.profile} {self.state} {self.verdict} {self.start}".lower()


class Index:
    """All runs below a folder."""

    def __init__(self, root: Path, kept: Path, now: Callable[[], float] = time.monotonic) -> None:
        """`kept` is the folder of the server's own files; nothing is read yet."""
        self._root, self._file, self._now = root, kept / FILE, now
        self._lock = threading.Lock()
        self._entries: dict[str, Entry] | None = None
        self._words: dict[str, str] = {}
        self._others: dict[str, int] = {}
        self._looked = self._saved = -1e9
        self._unsaved = False

    def entries(self) -> dict[str, Entry]:
        """Every run by its id, as of a second ago at most; treat it as constant."""
        with self._lock:
            if self._entries is None:
                self._entries = _saved(self._file)
            if self._now() - self._looked >= LOOK_S:
                self._look(self._entries)
            return self._entries

    def matching(self, text: str, wanted: Mapping[str, str]) -> list[Entry]:
        """Runs that hold every word of `text` somewhere, of `this|that` one, and have exactly the `wanted` fields."""
        entries, tokens = self.entries(), [word.split("|") for word in text.lower().split()]
        words = self._words
        return [
            entry
            for entry in entries.values()
            if all(getattr(entry, name) == value for name, value in wanted.items())
            and all(any(word in words[entry.run] for word in token) for token in tokens)
        ]

    def folder(self, unit: str, run: str) -> Path:
        """The folder of a run; NotFoundError where it is not listed. No path is made from the text of a request."""
        return self._root / self.entry(f"{unit}/{run}").run

    def entry(self, run: str) -> Entry:
        """A run by its id; NotFoundError where it is not listed."""
        found = self.entries().get(run)
        if found is None:
            # A run that began within this second.
            with self._lock:
                self._looked = -1e9
            found = self.entries().get(run)
        if found is None:
            raise NotFoundError(f"no run {run[:120]!r} here")
        return found

    def _look(self, known: Mapping[str, Entry]) -> None:
        entries, changed = {}, False
        for id_, path, stamp in _folders(self._root):
            entry = known.get(id_)
            if self._others.get(id_) == stamp:
                continue
            # A bench that is killed changes nothing in its folder.
            if entry is None or entry.changed != stamp or entry.state == RUNNING:
                entry = _read(id_, path, stamp)
                changed |= entry != known.get(id_)
            if entry is None:
                self._others[id_] = stamp
            else:
                entries[id_] = entry
        changed |= len(entries) != len(known)
        if changed or not self._words:
            self._words = {id_: entry.words for id_, entry in entries.items()}
        self._entries, self._looked = entries, self._now()
        self._unsaved |= changed
        if self._unsaved and self._now() - self._saved >= SAVE_S:
            content = {"format": FORMAT, "runs": [asdict(entry) for entry in entries.values()]}
            with contextlib.suppress(OSError):  # a full disk costs the next start a few seconds, and nobody the list
                write_atomically(self._file, json.dumps(content).encode())
            self._saved, self._unsaved = self._now(), False


def index_of(request: Request) -> Index:
    """The index of the server that got this request."""
    index: Index = request.app.state.index
    return index


def ordered(entries: list[Entry], sort: str) -> list[Entry]:
    """Sorted by a field, `-` in front for descending; what has no value comes last."""
    name = sort.removeprefix("-")
    have = [entry for entry in entries if getattr(entry, name) is not None]
    lack = [entry for entry in entries if getattr(entry, name) is None]
    return sorted(have, key=attrgetter(name), reverse=sort.startswith("-")) + lack


def _folders(root: Path) -> Iterator[tuple[str, str, int]]:
    """Id, path and time of every folder that may be a run; folders with a dot in front are not."""
    for unit in inside(root):
        for run in inside(unit.path):
            with contextlib.suppress(OSError):  # removed meanwhile
                yield f"{unit.name}/{run.name}", run.path, run.stat(follow_symlinks=False).st_mtime_ns


def _read(id_: str, path: str, stamp: int) -> Entry | None:
    """What a folder says; None where it is none of a run."""
    unit, _, name = id_.partition("/")
    plan, begun = name.partition("_")[2], _begun(name)
    entry = Entry(id_, unit, plan, begun, UNFINISHED, "", None, None, None, None, False, False, changed=stamp)
    live = live_at(path)
    if live is not None and process_alive(live.file.pid):
        entry = replace(entry, state=RUNNING)
    try:
        manifest = Manifest.find(path)
        if manifest is None:
            # Ten thousand times a Path is a second.
            return entry if live or os.path.isdir(f"{path}/journal") else None  # noqa: PTH112
        recorded = json.dumps([manifest.run, manifest.files], sort_keys=True).encode()
        return replace(
            entry,
            profile=manifest.profile or entry.profile,
            start=manifest.created,
            state=RUNNING if entry.state == RUNNING else manifest.state,
            duration_s=manifest.duration_s,
            imported=manifest.imported,
            corrected=manifest.corrected,
            content=sha256(recorded).hexdigest() if manifest.files else "",
            **_judged(path),
        )
    except InputError:  # one damaged file is one damaged run; the run's own page says which file, and what to do
        return replace(entry, state=DAMAGED)


def _begun(name: str) -> str:
    """When a run without a manifest began, as its folder is named; empty where it is named otherwise."""
    with contextlib.suppress(ValueError):
        return datetime.strptime(name.partition("_")[0], "%Y%m%dT%H%M%S%z").isoformat()
    return ""


def _judged(path: str) -> dict[str, Any]:
    """What the analysis says of the best model, and the limits where there are some."""
    compared = ComparisonRecord.find(path)
    judged = LimitsRecord.find(path) or VerificationRecord.find(path)
    best = compared.best() if compared else None
    return {
        "verdict": (judged and judged.verdict) or (compared and compared.verdict) or "",
        "rms_dph": best.rms_dph if best else None,
        "held_out_rms_dph": best.held_out_rms_dph if best else None,
        "floor_dph": compared.floor_dph if compared else None,
    }


def _saved(file: Path) -> dict[str, Entry]:
    """The entries of last time; none where there are none, or of another format."""
    try:
        content = json.loads(file.read_bytes())
        return {entry["run"]: Entry(**entry) for entry in content["runs"]} if content["format"] == FORMAT else {}
    except (OSError, ValueError, KeyError, TypeError):
        return {}


def resolved(request: Request, ids: Sequence[str]) -> list[dict[str, str]]:
    """Id, folder and hash of the data of each run.

    NotFoundError for a run that does not exist, HTTPException 409 for one that has not ended.
    """
    index, entries = index_of(request), []
    for id_ in dict.fromkeys(ids):
        entry = index.entry(id_)
        if not entry.content:
            again = "; “Resume” on the page of its verdict goes on with it" if entry.state == UNFINISHED else ""
            raise HTTPException(409, f"run {id_} is {entry.state}: only an ended run can be analysed{again}")
        unit, _, run = id_.partition("/")
        entries.append({"run": id_, "path": str(index.folder(unit, run)), "content": entry.content})
    return entries
