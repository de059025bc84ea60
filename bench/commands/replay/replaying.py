"""`bench replay`: hashes, tables, results of one run, and the versions then and now."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from bench.base import InputError, package_versions
from bench.commands.analysis import refuse_lot
from bench.commands.replay.changes import Change
from bench.commands.replay.numbers import Circumstances, numbers
from bench.commands.replay.remake import compared, remake, tampered
from bench.record import CalibrationRecord, RunFolder, open_run


@dataclass(frozen=True)
class Replay:
    """What became of a replay."""

    run: RunFolder
    tampered: tuple[Change, ...]
    differences: tuple[Change, ...]
    analysed: bool
    """The run holds results of an analysis, and they were made again."""
    from_frames: bool
    then: dict[str, str]
    now: dict[str, str]
    failed: str = ""
    """Why the numbers could not be made again."""

    @property
    def identical(self) -> bool:
        """Every number is the same, and every file is the one recorded."""
        return not (self.tampered or self.differences or self.failed)

    def to_json(self) -> dict[str, Any]:
        """An entry of `runs` in `bench replay --json`."""
        return {
            "run": str(self.run.path),
            "identical": self.identical,
            "from_frames": self.from_frames,
            "analysed": self.analysed,
            "tampered": [change.to_json() for change in self.tampered],
            "differences": [change.to_json() for change in self.differences],
            "failed": self.failed or None,
            "versions": {"then": self.then, "now": self.now},
        }


def replay(path: Path, models: Sequence[str] = (), others: Sequence[Path] = ()) -> Replay:
    """Make a run again and compare; `others` are further runs of its analysis that are not beside it.

    InputError: no run folder, or a run or model of its analysis is not found. What was altered is no error but the
    answer, also where nothing can be made from it any more.
    """
    run = open_run(path)
    refuse_lot(run)
    manifest = run.manifest()
    altered = tampered(run, manifest)
    analysed = CalibrationRecord.find(run.path) is not None  # one that is listed and lost is refused
    how = Circumstances.of(run, models, others) if analysed else None
    changes: list[Change] = []
    failed = ""
    with TemporaryDirectory(prefix="bench-replay-") as scratch:
        try:
            made = remake(run, manifest, Path(scratch))
            changes += compared(run, made)
            if how is not None:
                changes += numbers(run, made, how, others)
        except InputError as error:
            if not altered:
                raise
            failed = str(error)
    then = manifest.versions
    from_frames = any(run.journal.glob("*.gtbj"))
    return Replay(run, altered, tuple(changes), analysed, from_frames, then, _now(then), failed)


def _now(then: dict[str, str]) -> dict[str, str]:
    now = package_versions()
    return {name: now.get(name, "unknown") for name in then} if then else now
