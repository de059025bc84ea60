"""Moments of the runs that the registry knows: the newest finished run of every unit, each read once."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from bench.analysis import Moments
from bench.archive.fleet import moments_file
from bench.archive.fleet.moments_file import Stored
from bench.archive.registry.asking import runs
from bench.archive.registry.ledger import Ledger
from bench.archive.registry.opening import Registry
from bench.base import InputError
from bench.record import load


@dataclass
class Collected:
    """Result of `collect`: rows in the file, runs that were read, and a line for each run without moments."""

    rows: int = 0
    fresh: int = 0
    refused: list[str] = field(default_factory=list)


def collect(registry: Registry, ledger: Ledger, path: Path) -> Collected:
    """Bring the file up to date: rows of unchanged runs stay, rows of new or changed runs are computed."""
    wanted: dict[str, tuple[str, str, str]] = {}
    for run in runs(registry):
        if run["archive"] == ledger.id and run["state"] == "done":
            wanted.setdefault(run["unit"], (run["id"], run["manifest_sha256"], run["path"]))
    known, done = moments_file.known(path), Collected()
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
