"""Finds live runs among many run folders without looking into all of them every time."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from bench.acquisition import LIVE, LiveRun, live_among

YOUNG_S = 10.0
"""A unit's folder that changed so recently may get a run that goes live a moment later [s]."""
_SHARE = 0.02
"""Of the time may go into looking everywhere."""
_LEAST_S = 5.0


class Finder:
    """A run is found in a second when its folder is new, and in some more when an old one is gone on with."""

    def __init__(self, root: Path, now: Callable[[], float] = time.monotonic) -> None:
        self._root, self._now = root, now
        self._changed: dict[str, int] = {}
        self._live: set[Path] = set()
        self._everywhere_s = now()

    def look(self) -> list[LiveRun]:
        """All runs with a `live.json`, oldest first, whatever their condition."""
        began_s = self._now()
        whole = began_s >= self._everywhere_s
        self._live = {folder for folder in {*self._live, *self._candidates(whole)} if _is_live(folder)}
        if whole:
            self._everywhere_s = began_s + max(_LEAST_S, (self._now() - began_s) / _SHARE)
        return live_among(self._live)

    def _candidates(self, whole: bool) -> Iterator[Path]:
        """Run folders with a `live.json` in the units that changed, or in all."""
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
    """Whether it has a `live.json`; a folder that is somebody else's alone has none for us."""
    return os.path.exists(os.path.join(folder, LIVE))  # noqa: PTH110, PTH118 - Path.exists raises where it may not look


def inside(path: Path | str) -> list[os.DirEntry[str]]:
    """Folders in a folder, those with a dot in front left out; a link could lead out of the store."""
    try:
        with os.scandir(path) as entries:
            return [entry for entry in entries if entry.name[0] != "." and entry.is_dir(follow_symlinks=False)]
    except OSError:
        return []


def folder_of(root: Path, unit: str, run: str) -> Path | None:
    """The run folder of this id, looked up in the listings of folders; None when there is none."""
    for parent in inside(root):
        if parent.name == unit:
            return next((Path(found.path) for found in inside(parent.path) if found.name == run), None)
    return None
