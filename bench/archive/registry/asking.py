"""Queries of the registry: lists of runs and instruments, and everything about one unit or run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import date
from typing import Any

from sqlalchemy import ColumnElement, func, select

from bench.archive.registry.opening import Registry
from bench.archive.registry.rows import OF_RUNS
from bench.archive.registry.summaries import JUDGED
from bench.archive.registry.writing import TABLES
from bench.base import InputError

Found = list[dict[str, Any]]


def runs(
    registry: Registry, unit: str | None = None, most: int | None = None, archive: str | None = None,
    among: Sequence[ColumnElement[bool]] = (),
) -> Found:  # fmt: skip
    """Runs with their lots, the verdicts of their calibrations and what a model of them `lacks` (of `diagnosed_model`).

    The one that was seen last comes first, each comes once.

    Of one `archive` all that it holds, others may hold them, too. `among`: further conditions on runs and units.
    """
    run, units, calibration, diagnosis = (TABLES[name] for name in ("runs", "units", "calibrations", "diagnoses"))
    certificate = TABLES["certificates"]
    own = (calibration.c.verdict, calibration.c.model, JUDGED)
    lacking = (diagnosis.c.model.label("diagnosed_model"), diagnosis.c.verdict.label("diagnosis"), diagnosis.c.lacks)
    chosen = (
        select(run, units.c.lot, *own, *lacking)
        .join_from(run, units, units.c.serial == run.c.unit)
        .join(calibration, calibration.c.run == run.c.id, isouter=True)
        .join(certificate, certificate.c.run == run.c.id, isouter=True)
        .join(diagnosis, diagnosis.c.run == run.c.id, isouter=True)
        .where(once(unit) if archive is None else run.c.archive == archive, *among)
        .order_by(run.c.seen.desc().nulls_last(), run.c.created.desc(), run.c.id)
        .limit(most)
    )
    return _found(registry, chosen if unit is None else chosen.where(run.c.unit == unit))


def once(unit: str | None = None) -> ColumnElement[bool]:
    """Of a run whose folder was copied to another archive, one row counts; with `unit`, among its runs."""
    other = TABLES["runs"].alias()
    first = select(func.min(other.c.id)).group_by(other.c.unit, other.c.manifest_sha256)  # no run is compared with each
    return TABLES["runs"].c.id.in_(first if unit is None else first.where(other.c.unit == unit))


def known_runs(registry: Registry, archive: str) -> tuple[bool, frozenset[str]]:
    """Whether the registry knows an archive, and the paths of its runs."""
    table, run = TABLES["archives"], TABLES["runs"]
    here = bool(_found(registry, select(table.c.id).where(table.c.id == archive)))
    paths = _found(registry, select(run.c.path).where(run.c.archive == archive))
    return here, frozenset(row["path"] for row in paths)


def known_unit(registry: Registry, serial: str) -> dict[str, Any] | None:
    """A unit of the registry; None where it has no such one."""
    unit = TABLES["units"]
    return next(iter(_found(registry, select(unit).where(unit.c.serial == serial))), None)


def equipment(registry: Registry) -> Found:
    """All instruments, by the day on which their calibration is due."""
    table = TABLES["equipment"]
    return _found(registry, select(table).order_by(table.c.due_on, table.c.name, table.c.serial))


def certificates(registry: Registry, unit: str | None = None) -> Found:
    """Every certificate with its unit and run, and its `state`: in force, replaced by another one, or withdrawn."""
    issue, run = TABLES["issues"], TABLES["runs"]
    columns = (run.c.unit, issue.c.number, issue.c.issued, issue.c.verdict, issue.c.amends, issue.c.reason, run.c.path)
    chosen = select(*columns).join_from(issue, run).order_by(run.c.unit, issue.c.issued, issue.c.number)
    found = _found(registry, chosen if unit is None else chosen.where(run.c.unit == unit))
    every = _found(registry, select(issue.c.number, issue.c.amends).where(issue.c.amends.is_not(None)))
    replaced = {row["amends"]: row["number"] for row in every}
    withdrawn = {row["number"]: row for row in _found(registry, select(TABLES["withdrawals"]))}
    for row in found:
        by, gone = replaced.get(row["number"]), withdrawn.get(row["number"])
        row["state"] = f"replaced by {by}" if by else f"withdrawn: {gone['reason']}" if gone else "in force"
    return found


def show(registry: Registry, name: str) -> dict[str, Any]:
    """A unit with its runs, or a run with its rows in all tables; InputError where the registry has neither."""
    run = TABLES["runs"]
    if unit := known_unit(registry, name):
        return {"unit": unit, "runs": runs(registry, name)}
    path = name.strip("/")
    of_archives = TABLES["archives"].c.id + "/"
    anywhere = "/".join(path.split("/")[-2:])  # a folder, named from anywhere
    ids = (run.c.id.in_(select(of_archives + one)) for one in (path, anywhere))
    # Only the last one looks at every run.
    ways = (run.c.id == path, *ids, run.c.path.endswith(f"/{path}"))
    found = next((rows for way in ways if (rows := _found(registry, select(run).where(way)))), [])
    if len(found) != 1:
        several = ", ".join(one["id"] for one in found[:5])
        said = f"several runs are called '{name}': {several}" if found else f"no unit or run '{name}'"
        raise InputError(f"registry: {said}; `bench registry list` lists the runs", registry.url)
    return {"run": found[0], **{table: rows_of(registry, table, [found[0]["id"]]) for table in OF_RUNS}}


def rows_of(registry: Registry, table: str, runs: Sequence[str]) -> Found:
    """Rows of a table that belong to these runs, by their ids."""
    run = TABLES[table].c.run
    parts = (runs[start : start + 500] for start in range(0, len(runs), 500))
    return [row for part in parts for row in _found(registry, select(TABLES[table]).where(run.in_(part)))]


def _found(registry: Registry, chosen: Any) -> Found:
    with registry.reading() as connection:
        return [dict(row) for row in connection.execute(chosen).mappings()]


def plain(found: Mapping[str, Any]) -> dict[str, Any]:
    """A row for JSON, with days as text."""
    return {key: value.isoformat() if isinstance(value, date) else value for key, value in found.items()}
