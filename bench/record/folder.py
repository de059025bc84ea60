"""Run folders: the truth of what was captured, and the only thing that the two halves of the bench share.

A run folder holds verbatim copies of its inputs, the raw journals, `data.parquet` (one row per unit sample),
`means.parquet` (1 s means), `events.jsonl`, and `manifest.json`, which is written atomically and names every file
with its SHA-256.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any
from unicodedata import normalize

from bench.base import InputError
from bench.record.chain import chain_of, put, use
from bench.record.events import EVENTS, read_events
from bench.record.files import sha256
from bench.record.records.manifest import Manifest

MANIFEST = Manifest.FILE
LIVE = "live.json"
"""Of a run that goes on: how it is reached."""
LAYOUT = "layout.dbc"
"""The DBC by which the frames of the run are read, where its unit has one."""
HASHED_PATTERNS = ("*.parquet", "*.yaml", "*.jsonl", LAYOUT, "journal/*", "journal-*/*")


@dataclass(frozen=True)
class RunFolder:
    """One run on disk; `path` is the folder, `part` counts how often its bench was started for it."""

    path: Path
    part: int = 1

    @property
    def journal(self) -> Path:
        """Folder of the raw journals of this part."""
        return self.path / ("journal" if self.part == 1 else f"journal-{self.part}")

    def parts(self) -> list[RunFolder]:
        """Every part that has journals, in order of time; a run that was never cut off has one."""
        found = [replace(self, part=1)]
        while (following := replace(self, part=len(found) + 1)).journal.is_dir():
            found.append(following)
        return found

    @property
    def data(self) -> Path:
        """One row per unit sample (500 Hz), see `bench.base.channels`."""
        return self.path / "data.parquet"

    @property
    def means(self) -> Path:
        """1 s means of `data`, with counts and variances."""
        return self.path / "means.parquet"

    @property
    def report(self) -> Path:
        """The HTML report."""
        return self.path / "report.html"

    def manifest(self) -> Manifest:
        """The manifest; InputError when there is none or it is not one of ours."""
        return Manifest.read(self.path)

    def hashes(self) -> dict[str, str]:
        """SHA-256 of every file that the numbers of this run rest on, by path inside the folder.

        What the run was started with has the hash that it had then; what was made from the manifest is not in it.
        """
        known = chain_of(self.path)
        links = {} if known is None else known.files
        files = {
            str(path.relative_to(self.path)): path for pattern in HASHED_PATTERNS for path in self.path.glob(pattern)
        }
        return {
            name: links[name].sha256[-1] or "" if name in links else sha256(files[name])
            for name in sorted({*files, *(name for name in links if name.endswith(".yaml"))})
            if name not in links or not links[name].made_from
        }

    def events(self) -> list[dict[str, Any]]:
        """The events of the run in order of time, without damaged lines."""
        use(self.path, EVENTS)
        return read_events(self.path / EVENTS).sound


def create_run(
    root: Path, unit: str, profile: str, created: datetime, files: Mapping[str, str | bytes] | None = None
) -> RunFolder:
    """Make a new run folder `root/<unit>/<time>_<profile>` that holds `files` (name: content).

    InputError when it cannot be written, or the folder is that of another unit.
    """
    stem = f"{created:%Y%m%dT%H%M%SZ}_{slug(profile)}"
    parent = root / slug(unit)
    try:
        parent.mkdir(parents=True, exist_ok=True)
        _refuse_shared(parent, unit)
        run = RunFolder(new_folder(parent, stem))
        run.journal.mkdir()
        contents = {name: one if isinstance(one, bytes) else one.encode() for name, one in (files or {}).items()}
        put(run.path, contents, unit=unit, run=run.path.name)
    except OSError as error:
        raise InputError(f"cannot make a run folder: {error.strerror}; choose another place with --out", root) from None
    return run


def _refuse_shared(parent: Path, unit: str) -> None:
    """Two units in one folder would be taken for one, also by what was written into them."""
    other = ""
    with suppress(InputError):  # a damaged run says nothing of its unit, and keeps nobody from the next
        other = next((RunFolder(path.parent).manifest().unit for path in parent.glob(f"*/{MANIFEST}")), "")
    if other not in {"", unit} and slug(other) == parent.name:
        raise InputError(
            f"unit {unit} would share this folder with unit {other}: a folder's name has letters, digits and . _ + - "
            "only; give it another serial number, or another --out",
            parent,
        )


def new_folder(parent: Path, stem: str) -> Path:
    """A folder that did not exist: `parent`/`stem`, or with _2, _3 … behind it; InputError where all are taken."""
    for suffix in ("", *(f"_{n}" for n in range(2, 1000))):
        path = parent / f"{stem}{suffix}"
        try:
            path.mkdir(parents=True)
        except FileExistsError:
            continue
        return path
    raise InputError(f"a thousand folders named {stem} already exist; clear the folder", parent)


def open_run(path: Path) -> RunFolder:
    """The run folder at `path`; InputError when there is none."""
    run = RunFolder(Path(path))
    if run.path.is_file():
        raise InputError("is a file, not a run folder; `bench import` makes a run folder of a table", run.path)
    if not run.path.is_dir():
        raise InputError("no such run folder; `bench run` prints the folder it made", run.path)
    run.manifest()
    return run


_DEVICE = re.compile(r"(?i)con|prn|aux|nul|(com|lpt)\d")
"""Names that Windows gives to devices, with any ending."""


def slug(text: str) -> str:
    """A name that is safe as one part of a path: letters and digits of any script, and . _ + - inside."""
    name = re.sub(r"[^\w.+-]+", "-", normalize("NFC", text)).strip(".-") or "unnamed"
    return f"_{name}" if _DEVICE.fullmatch(name.partition(".")[0]) else name
