"""Moments of the runs that the registry knows: the newest selected run of every unit, each read once."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from bench.analysis import Moments
from bench.archive.fleet import moments_file
from bench.archive.fleet.moments_file import Stored
from bench.archive.fleet.selection import Selection
from bench.archive.registry.asking import runs
from bench.archive.registry.ledger import Ledger
from bench.archive.registry.opening import Registry
from bench.base import InputError
from bench.record import load


@dataclass
class Collected:
    """Result of `collect`: rows in the file, runs read, a line for each run without moments, and runs left out."""

    rows: int = 0
    fresh: int = 0
    refused: list[str] = field(default_factory=list)
    left_out: tuple[str, ...] = ()


def collect(registry: Registry, ledger: Ledger, path: Path, selection: Selection | None = None) -> Collected:
    """Bring the file up to date: rows of unchanged runs stay, rows of new or changed runs are computed."""
    own = runs(registry, archive=ledger.id)
    chosen, left_out = (selection or Selection()).of(own)
    wanted: dict[str, tuple[str, str, str]] = {}
    for run in chosen:
        wanted.setdefault(run["unit"], (run["id"], run["manifest_sha256"], run["path"]))
    known, done = moments_file.known(path), Collected(left_out=left_out)
    keep = {run for run, sha256, _ in wanted.values() if known.get(run) == sha256}
    missing = [(unit, *found) for unit, found in sorted(wanted.items()) if found[0] not in keep]
    if missing or keep != set(known):
        done.rows = moments_file.write(path, _rows(path, keep, missing, ledger, done))
    else:
        done.rows = len(known)
    return done


def _rows(
    path: Path, keep: set[str], missing: list[tuple[str, str, str, str]], ledger: Ledger, done: Collected
) -> Iterator[Stored]:
    yield from (row for row in moments_file.read(path) if row.run in keep)
    for unit, run, sha256, place in missing:
        try:
            values = Moments.of([load(ledger.root / place)]).pack()
        except (InputError, OSError) as error:
            done.refused.append(str(error))
            continue
        done.fresh += 1
        yield Stored(unit, run, sha256, values)
