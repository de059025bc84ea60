"""The list of units as the registry keeps it: runs, last run, newest calibration and how each unit stands by it.

It follows from the other tables. Whoever changes the rows of a unit makes its summary anew in the same transaction, so
that a list of a million units is asked for and not counted.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import cache
from typing import Any, cast

from sqlalchemy import Connection, case, delete, func, insert, select
from sqlalchemy import Table as SqlTable

from bench.archive.registry.tables import Calibration, Certificate, Run, Summary, Unit
from bench.record import Verdict

SUMMARIES = cast(SqlTable, Summary.__table__)
# A verification that failed since says more than a certificate that was issued before it.
JUDGED = case(
    (Calibration.judged == Verdict.FAIL, Verdict.FAIL), else_=func.coalesce(Certificate.verdict, Calibration.judged)
).label("judged")
"""Verdict of a run against limits."""
_AT_ONCE = 500
_TOLD = 50_000
"""Units that take some seconds."""


def summarise(
    connection: Connection, serials: Iterable[str] | None = None, tell: Callable[[int, int], None] | None = None
) -> None:
    """Make the summaries of these units anew, or those of all; `tell` gets how many are made of how many."""
    every = sorted(connection.execute(select(Unit.serial)).scalars() if serials is None else set(serials))
    for start in range(0, len(every), _AT_ONCE):
        some = every[start : start + _AT_ONCE]
        # Another station that registers a run of the same unit waits here, so that neither misses the other's run.
        connection.execute(select(Unit.serial).where(Unit.serial.in_(some)).order_by(Unit.serial).with_for_update())
        connection.execute(delete(SUMMARIES).where(SUMMARIES.c.serial.in_(some)))
        if rows := _rows(connection, some):
            connection.execute(insert(SUMMARIES), rows)
        if tell is not None and start % _TOLD == 0 and len(every) > _TOLD:
            tell(start, len(every))


def _rows(connection: Connection, serials: list[str]) -> list[dict[str, Any]]:
    columns = (Run.unit, Run.created, Run.station, Run.state, Run.path, Run.corrected, Calibration.model, JUDGED)
    chosen = (
        select(*columns, Calibration.run.label("analysed"), Certificate.number)
        .join_from(Run, Calibration, Calibration.run == Run.id, isouter=True)
        .join(Certificate, Certificate.run == Run.id, isouter=True)
        .where(Run.unit.in_(serials))
        .order_by(Run.seen.asc().nulls_first(), Run.created, Run.id)
    )
    known = connection.execute(select(Unit.serial, Unit.lot).where(Unit.serial.in_(serials)))
    units = {row.serial: _empty(row.serial, row.lot) for row in known}
    for row in connection.execute(chosen):
        one = units[row.unit]
        one["runs"] += 1
        one |= {"last": row.created, "last_run": row.path, "state": row.state, "station": row.station}
        if calibrates(row._mapping, row.judged):
            one["calibrations"] += 1
            one |= {"calibrated": row.created, "model": row.model, "certificate": row.number}
        if row.analysed and row.state == "done" and not row.corrected:
            if decided(row.judged):
                one |= {"standing": "pass" if good(row.judged) else "fail", "judged": row.judged, "unjudged": None}
            else:
                one |= {"unjudged": row.path} if decided(one["judged"]) else {"standing": "unjudged"}
    return list(units.values())


def calibrates(run: Mapping[Any, Any], judged: str | None) -> bool:
    """Whether a run, with the model that was fitted to it, is a calibration of its unit.

    One that was aborted or is INVALID is none, and nothing is fitted to a unit that corrected itself.
    """
    return run["model"] is not None and run["state"] == "done" and not run["corrected"] and judged != Verdict.INVALID


def _empty(serial: str, lot: str | None) -> dict[str, Any]:
    return {
        "serial": serial, "lot": lot, "words": f"{serial} {lot or ''}".casefold(), "standing": "uncalibrated",
        "runs": 0, "calibrations": 0, "last": None, "last_run": None, "state": None, "station": None,
        "calibrated": None, "model": None, "judged": None, "certificate": None, "unjudged": None,
    }  # fmt: skip


@cache
def good(word: str | None) -> bool:
    """Whether a unit with this verdict passed."""
    return word is not None and Verdict(word).within


@cache
def decided(word: str | None) -> bool:
    """Whether a unit with this verdict passed or failed."""
    return word is not None and Verdict(word).judged
