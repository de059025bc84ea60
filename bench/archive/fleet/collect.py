"""Moments of the runs that the registry knows: the newest judged one of those selected of every unit, each read once.

Runs are read by the engines of a refit. What they have read is kept as it comes, in small files beside the file of all,
so that an interrupted collection goes on with the runs that were in work.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from bench.analysis import Moments, one_blas_thread, undisturbed
from bench.archive.fleet import moments_file
from bench.archive.fleet.engines import Engine, Work
from bench.archive.fleet.moments_file import Stored
from bench.archive.fleet.selection import Selection
from bench.archive.fleet.units import as_shown, standing
from bench.archive.registry.asking import runs
from bench.archive.registry.ledger import Ledger
from bench.archive.registry.opening import Registry
from bench.base import BenchError, InputError
from bench.record import load

AT_ONCE, PART = 4, 16
"""Runs that a worker reads at a time, and those of a small file."""


@dataclass(frozen=True)
class Due:
    """A run to be read: its unit, id, hash of the manifest, and folder."""

    unit: str
    run: str
    sha256: str
    folder: str


@dataclass
class Collected:
    """Result of `collect`: rows in the file, runs read, a line for each run without moments, and runs left out."""

    rows: int = 0
    fresh: int = 0
    refused: list[str] = field(default_factory=list)
    left_out: tuple[str, ...] = ()


def collect(
    registry: Registry,
    ledger: Ledger,
    path: Path,
    engine: Callable[[int], Engine],
    selection: Selection | None = None,
) -> Collected:
    """Bring the file up to date: rows of unchanged runs stay, new or changed runs are read by `engine` (of groups)."""
    chosen, left_out = as_shown(registry, selection).of(runs(registry, archive=ledger.id))
    wanted: dict[str, Due] = {}
    for run in standing(chosen):
        folder = str(ledger.root.resolve() / run["path"])
        wanted[run["unit"]] = Due(run["unit"], run["id"], run["manifest_sha256"], folder)
    digests = {one.run: one.sha256 for one in wanted.values()}
    done, parts = Collected(left_out=left_out), path.with_suffix(".parts")
    known = {run for file in _files(path, parts) for run, digest in moments_file.known(file).items()
             if digests.get(run) == digest}  # fmt: skip
    missing = [wanted[unit] for unit in sorted(wanted) if wanted[unit].run not in known]
    if missing:
        _read(parts, missing, engine, ledger.root.resolve(), done)
    if missing or parts.is_dir() or known != set(moments_file.known(path)):
        done.rows = moments_file.write(path, _rows(_files(path, parts), digests))
        shutil.rmtree(parts, ignore_errors=True)
    else:
        done.rows = len(known)
    return done


def _read(parts: Path, missing: list[Due], engine: Callable[[int], Engine], root: Path, done: Collected) -> None:
    """Read runs into small files."""
    groups = [tuple(missing[start : start + AT_ONCE]) for start in range(0, len(missing), AT_ONCE)]
    parts.mkdir(exist_ok=True)
    number, waiting = len(list(parts.iterdir())), list[Stored]()
    try:
        for answers in engine(len(groups))(Work(_moments_of, _lost, root), groups):
            waiting += [one for one in answers if isinstance(one, Stored)]
            done.refused += [one for one in answers if isinstance(one, str)]
            if len(waiting) >= PART:
                done.fresh += moments_file.write(parts / f"{number:06d}.parquet", waiting)
                number, waiting = number + 1, []
    finally:
        if waiting:
            done.fresh += moments_file.write(parts / f"{number:06d}.parquet", waiting)


def _moments_of(group: tuple[Due, ...]) -> list[Stored | str]:
    """Moments of each run, or why there are none."""
    with one_blas_thread():
        return [_moments(one) for one in group]


def _moments(one: Due) -> Stored | str:
    try:
        return Stored(one.unit, one.run, one.sha256, Moments.of([undisturbed(load(Path(one.folder)))]).pack())
    except (BenchError, OSError) as error:
        return str(error)
    except Exception as bug:
        return f"{one.folder}: internal error: {type(bug).__name__}: {bug}"


def _lost(group: tuple[Due, ...], why: str) -> list[Stored | str]:
    return [f"{one.folder}: not read: {why}" for one in group]


def _files(path: Path, parts: Path) -> list[Path]:
    """The file of all, and the small ones in their order; one that a power cut tore goes."""
    found = [path]
    for part in sorted(parts.glob("*.parquet")):
        try:
            moments_file.stored_count(part)
            found.append(part)
        except InputError:
            part.unlink()
    return found


def _rows(files: list[Path], digests: Mapping[str, str]) -> Iterator[Stored]:
    """Rows of the runs with these hashes, each once."""
    waiting = dict(digests)
    for file in files:
        for row in moments_file.read(file):
            if waiting.get(row.run) == row.sha256:
                del waiting[row.run]
                yield row
