"""Writes rows into the database; every statement may be repeated, and two stations may write at once."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from typing import Any, cast

from sqlalchemy import Connection, Insert, delete, select
from sqlalchemy import Table as SqlTable
from sqlalchemy.dialects import postgresql, sqlite

from bench.archive.registry.ledger import Entry, Ledger
from bench.archive.registry.opening import Registry
from bench.archive.registry.rows import (
    OF_RUNS,
    PRIMARY,
    Key,
    Row,
    Rows,
    empty,
    of_ledger,
    of_run,
    place_of,
    update,
    update_by,
)
from bench.archive.registry.summaries import summarise
from bench.archive.registry.tables import IN_ORDER
from bench.base import InputError
from bench.record import MANIFEST, RunFolder, sha256

TABLES: dict[str, SqlTable] = {table.__tablename__: cast(SqlTable, table.__table__) for table in IN_ORDER}
TOLD = ("equipment", "withdrawals")
"""Tables whose rows people entered, in the ledger of their archive."""
SHARED = ("units", "operators")
"""Tables whose rows archives share: a run only adds missing ones."""


def register(registry: Registry, folder: RunFolder, ledger: Ledger) -> None:
    """Write the rows of a run folder in one transaction, replacing all earlier rows of this run; the ledger saw it."""
    path = place_of(folder, ledger)
    rows = of_run(folder, ledger, ledger.saw(path, sha256(folder.path / MANIFEST)))
    with registry.writing() as connection:
        refuse_copy(connection, registry, ledger)
        write_runs(connection, rows)


def register_all(registry: Registry, folders: Iterable[RunFolder], ledger: Ledger) -> list[str]:
    """Write the rows of run folders that the ledger saw, and what people entered; a line for each that is damaged."""
    told, rows, seen, damaged = of_ledger(ledger), empty(), ledger.seen(), list[str]()
    for folder in folders:
        try:
            update(rows, of_run(folder, ledger, seen))
        except (InputError, OSError) as error:
            damaged.append(str(error))
    with registry.writing() as connection:
        refuse_copy(connection, registry, ledger)
        for name in ("archives", *TOLD, *SHARED):
            upsert(connection, name, list(told[name].values()))
        write_runs(connection, rows)
        summarise(connection, (serial for (serial,) in told["units"]))
    return damaged


def tell(registry: Registry, ledger: Ledger, entry: Entry) -> None:
    """Write a line into the ledger and its rows into the database, or into neither."""
    rows = empty()
    rows["archives"][(ledger.id,)] = {"id": ledger.id, "path": ledger.place}
    update_by(rows, entry, ledger)
    with registry.writing() as connection:
        refuse_copy(connection, registry, ledger)
        for name, found in rows.items():
            upsert(connection, name, list(found.values()))
        summarise(connection, (serial for (serial,) in rows["units"]))
        ledger.append(entry)


def refuse_copy(connection: Connection, registry: Registry, ledger: Ledger) -> None:
    """InputError where a registry elsewhere knows this archive at another place: one of the two may be a copy.

    A copy, such as a cloned disk, must not take the rows of the other one for its own. On one computer it is seen
    whether the other place is empty now.
    """
    if registry.inside(ledger.root):
        return
    table = TABLES["archives"]
    known = connection.execute(select(table.c.path).where(table.c.id == ledger.id)).scalar_one_or_none()
    if known is not None and known != ledger.place and not ledger.moved_from(known):
        raise InputError(
            f"registry: knows archive {ledger.id} at {known}, this is {ledger.place}; if it was moved, "
            "`bench registry rebuild --moved`; if it is a copy, give it an id of its own with --copied",
            registry.url,
        )


def write_runs(connection: Connection, rows: Rows) -> None:
    """Replace runs with all their rows in the database; add shared rows only where they are missing."""
    for name, found in rows.items():
        if name not in OF_RUNS:
            upsert(connection, name, list(found.values()), keep=name in SHARED)
    drop(connection, OF_RUNS, [key[0] for key in rows["runs"]])
    for name in OF_RUNS:
        upsert(connection, name, list(rows[name].values()))
    summarise(connection, (row["unit"] for row in rows["runs"].values()))


def drop(connection: Connection, tables: Sequence[str], runs: Sequence[str]) -> None:
    """Delete the rows of these runs."""
    for name in tables:
        column = TABLES[name].c["id" if name == "runs" else "run"]
        for start in range(0, len(runs), 500):
            connection.execute(delete(TABLES[name]).where(column.in_(runs[start : start + 500])))


def upsert(connection: Connection, name: str, rows: Sequence[Row], *, keep: bool = False) -> None:
    """Insert rows; where the key exists, replace the row, or `keep` the existing one."""
    if not rows:
        return
    statement = _insert(connection, name)
    rest = {column: statement.excluded[column] for column in rows[0] if column not in PRIMARY[name]}
    chosen = (
        statement.on_conflict_do_nothing()
        if keep or not rest
        else statement.on_conflict_do_update(index_elements=list(PRIMARY[name]), set_=rest)
    )
    # The same order of keys everywhere prevents deadlocks between two stations.
    ordered = sorted(rows, key=lambda row: tuple(row[column] for column in PRIMARY[name]))
    connection.execute(chosen, ordered)


def _insert(connection: Connection, name: str) -> Any:
    made: Insert = (
        postgresql.insert(TABLES[name]) if connection.dialect.name == "postgresql" else sqlite.insert(TABLES[name])
    )
    return made


def stored(connection: Connection, archive: str) -> Rows:
    """All rows of one archive in the database."""
    rows = empty()
    runs = TABLES["runs"]
    own = select(runs.c.id).where(runs.c.archive == archive)
    for name, table in TABLES.items():
        if name == "archives":
            chosen = select(table).where(table.c.id == archive)
        elif name in OF_RUNS:
            chosen = select(table).where(table.c.run.in_(own))
        else:
            chosen = select(table).where(table.c.archive == archive)
        for found in connection.execute(chosen).mappings():
            rows[name][tuple(found[column] for column in PRIMARY[name])] = dict(found)
    return rows


def remove(connection: Connection, name: str, keys: Collection[Key]) -> None:
    """Delete rows of a table by their keys."""
    table = TABLES[name]
    for key in keys:
        conditions = [table.c[column] == value for column, value in zip(PRIMARY[name], key, strict=True)]
        connection.execute(delete(table).where(*conditions))
