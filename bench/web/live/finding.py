"""Finds live runs among many run folders without a search of all of them each time."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from bench.acquisition import LiveRun, live_among
from bench.record import LIVE

YOUNG_S = 10.0
"""A unit's folder that changed this recently is searched, as a run may go live a moment later [s]."""
_SHARE = 0.02
"""Share of the time for complete searches."""
_LEAST_S = 5.0


class Finder:
    """Finds a run with a new folder within a second, and a resumed older one within a few seconds."""

    def __init__(self, root: Path, now: Callable[[], float] = time.monotonic) -> None:
        self._root, self._now = root, now
        self._changed: dict[str, int] = {}
        self._live: set[Path] = set()
        self._everywhere_s = now()

    def look(self) -> list[LiveRun]:
        """All runs with a `live.json`, oldest first."""
        began_s = self._now()
        whole = began_s >= self._everywhere_s
        self._live = {folder for folder in {*self._live, *self._candidates(whole)} if _is_live(folder)}
        if whole:
            self._everywhere_s = began_s + max(_LEAST_S, (self._now() - began_s) / _SHARE)
        return live_among(self._live)

    def _candidates(self, whole: bool) -> Iterator[Path]:
        """Run folders with a `live.json` in the changed units, or in all."""
        for unit in inside(self._root):
            try:
                changed = unit.stat().st_mtime_ns
            except OSError:  # removed meanwhile
                continue
            young = time.time_ns() - changed < YOUNG_S * 1e9
            if whole or young or self._changed.get(unit.name) != changed:
                self._changed[unit.name] = changed
                yield from (Path(run.path) for run in inside(unit.path) if _is_live(run.path))


def ids(folders: Sequence[Path]) -> list[str]:
    """Run ids of run folders: `<unit>/<run>`."""
    return [f"{folder.parent.name}/{folder.name}" for folder in folders]


def _is_live(folder: Path | str) -> bool:
    """Whether a folder has a readable `live.json`."""
    return os.path.exists(os.path.join(folder, LIVE))  # noqa: PTH110, PTH118 - Path.exists raises where it may not look


def inside(path: Path | str) -> list[os.DirEntry[str]]:
    """Folders in a folder, without links, which could lead elsewhere, and without names that begin with a dot."""
    try:
        with os.scandir(path) as entries:
            return [entry for entry in entries if entry.name[0] != "." and entry.is_dir(follow_symlinks=False)]
    except OSError:
        return []


def folder_of(root: Path, unit: str, run: str) -> Path | None:
    """The run folder of this id, found in the listings of folders; None without one."""
    for parent in inside(root):
        if parent.name == unit:
            return next((Path(found.path) for found in inside(parent.path) if found.name == run), None)
    return None
