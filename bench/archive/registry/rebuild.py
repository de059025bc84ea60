"""Makes the registry again from run folders and ledger, and proves that both agree."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass

from sqlalchemy import Connection, select

from bench.archive.registry.ledger import Ledger
from bench.archive.registry.opening import Registry
from bench.archive.registry.rows import OF_RUNS, Key, Row, Rows, empty, of_archive, of_run, update
from bench.archive.registry.summaries import summarise
from bench.archive.registry.writing import SHARED, TABLES, TOLD, drop, refuse_copy, remove, stored, upsert, write_runs
from bench.base import InputError
from bench.record import MANIFEST, RunFolder


@dataclass(frozen=True)
class Rebuilt:
    """Result of a rebuild: `differences` between database and folders, and the `digest` of the rows afterwards."""

    archive: str
    counts: dict[str, int]
    differences: tuple[str, ...]
    unreadable: tuple[str, ...]
    digest: str


def rebuild(registry: Registry, ledger: Ledger, *, only_compare: bool = False, moved: bool = False) -> Rebuilt:
    """Make the rows of this archive equal to its folders, or only list the differences.

    Runs that another program registers meanwhile are kept. InputError where rows still differ afterwards, or where the
    registry knows the archive at another place and nobody says that it was `moved`.
    """
    wanted, unreadable = of_archive(ledger)
    if not only_compare:
        runs = sorted(wanted["runs"].values(), key=lambda row: (str(row["created"]), str(row["path"])))
        known = ledger.seen()
        news = [(str(row["path"]), str(row["manifest_sha256"])) for row in runs if row["path"] not in known]
        if news:
            ledger.saw_all(news)
            wanted, unreadable = of_archive(ledger)
    with registry.reading() if only_compare else registry.writing() as connection:
        if not only_compare and not moved:
            refuse_copy(connection, registry, ledger)
        before = stored(connection, ledger.id)
        _read_again(wanted, before, ledger)
        _lend(connection, wanted, before, ledger)
        found = tuple(differences(before, wanted))
        after = before
        if not only_compare:
            _write(connection, wanted, before)
            after = stored(connection, ledger.id)
            if left := tuple(differences(after, wanted)):
                raise InputError(f"registry: the rebuilt rows differ from the run folders: {left[0]}", registry.url)
    counts = {name: len(rows) for name, rows in after.items()}
    return Rebuilt(ledger.id, counts, found, tuple(unreadable), digest(after))


def differences(have: Rows, want: Rows) -> Iterable[str]:
    """A line for each row that is missing, superfluous or different."""
    for name in TABLES:
        for key in sorted({*have[name], *want[name]}, key=str):
            mine, theirs = have[name].get(key), want[name].get(key)
            label = f"{name} {' '.join(map(str, key))}"
            if mine is None:
                yield f"{label}: missing in the registry"
            elif theirs is None:
                yield f"{label}: in the registry, but not on disk"
            elif mine != theirs:
                yield f"{label}: {', '.join(_changes(mine, theirs))}"


def _changes(mine: Row, theirs: Row) -> Iterable[str]:
    for column in theirs:
        if mine.get(column) != theirs[column]:
            yield f"{column} is {_short(mine.get(column))}, on disk {_short(theirs[column])}"


def _short(value: object) -> str:
    text = json.dumps(value, default=str)
    return text if len(text) <= 40 else f"{text[:37]}..."


def digest(rows: Rows) -> str:
    """SHA-256 over all rows, independent of the kind of database."""
    content = [[name, [row for _, row in sorted(found.items())]] for name, found in rows.items() if name != "archives"]
    return hashlib.sha256(json.dumps(content, sort_keys=True, default=str).encode()).hexdigest()


def _read_again(wanted: Rows, before: Rows, ledger: Ledger) -> None:
    """Read runs again that were registered or analysed after the folders had been read."""
    rows, seen = [(name, key, row) for name in ("runs", *OF_RUNS) for key, row in before[name].items()], ledger.seen()
    for run in sorted({str(key[0]) for name, key, row in rows if wanted[name].get(key) != row}):
        path = ledger.root / run.removeprefix(f"{ledger.id}/")
        if (path / MANIFEST).is_file():
            for name in ("runs", *OF_RUNS):
                wanted[name] = {key: row for key, row in wanted[name].items() if key[0] != run}
            with suppress(InputError):  # it stands among the unreadable ones
                update(wanted, of_run(RunFolder(path), ledger, seen))


def _lend(connection: Connection, wanted: Rows, before: Rows, ledger: Ledger) -> None:
    """Leave out units and operators that another archive owns, and keep those that its runs need."""
    runs = TABLES["runs"]
    for name, column in (("units", runs.c.unit), ("operators", runs.c.operator)):
        table = TABLES[name]
        key = next(iter(table.primary_key.columns))
        others = {row[0] for row in connection.execute(select(key).where(table.c.archive != ledger.id))}
        for one in list(wanted[name]):
            if one[0] in others and wanted[name][one].get("lot") is None:
                del wanted[name][one]
        used = select(column).where(runs.c.archive != ledger.id).distinct()
        for one in {(row[0],) for row in connection.execute(used)} & (set(before[name]) - set(wanted[name])):
            wanted[name][one] = before[name][one]


def _write(connection: Connection, wanted: Rows, before: Rows) -> None:
    gone: list[str] = [key[0] for key in set(before["runs"]) - set(wanted["runs"])]
    drop(connection, (*OF_RUNS, "runs"), gone)
    for name in ("archives", *TOLD, *SHARED):
        upsert(connection, name, list(wanted[name].values()))
    write_runs(connection, {**empty(), **{name: wanted[name] for name in ("runs", *OF_RUNS)}})
    for name in (*TOLD, *SHARED):
        surplus: set[Key] = set(before[name]) - set(wanted[name])
        remove(connection, name, surplus)
    summarise(connection, (serial for (serial,) in {*wanted["units"], *before["units"]}))
