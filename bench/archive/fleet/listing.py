"""The list of all units: number of runs, the last run, and the newest calibration."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, Literal

from sqlalchemy import func, select

from bench.analysis import Verdict
from bench.archive.registry.opening import Registry
from bench.archive.registry.writing import TABLES

Standing = Literal["pass", "fail", "unjudged", "uncalibrated"]
Order = Literal["newest", "oldest", "serial"]

Found = dict[str, Any]


def listing(registry: Registry) -> list[Found]:
    """All units by serial number; `standing` comes from the newest calibration."""
    unit, run, calibration, certificate = (
        TABLES[name] for name in ("units", "runs", "calibrations", "certificates")
    )  # fmt: skip
    judged = func.coalesce(certificate.c.verdict, calibration.c.judged).label("judged")
    chosen = (
        select(
            run.c.unit, run.c.created, run.c.station, run.c.state, run.c.path, run.c.corrected, calibration.c.model,
            judged, certificate.c.number,
        )
        .join_from(run, calibration, isouter=True)
        .join(certificate, certificate.c.run == run.c.id, isouter=True)
        .order_by(run.c.seen.asc().nulls_first(), run.c.created, run.c.id)
    )  # fmt: skip
    with registry.reading() as connection:
        units = {row.serial: _empty(row.serial, row.lot) for row in connection.execute(select(unit))}
        for row in connection.execute(chosen):
            one = units[row.unit]
            one["runs"] += 1
            one |= {"last": row.created, "last_run": row.path, "state": row.state, "station": row.station}
            if row.model is not None and not row.corrected:  # nothing is fitted to a unit that corrected itself
                one["calibrations"] += 1
                one |= {"calibrated": row.created, "model": row.model, "judged": row.judged}
                one["certificate"] = row.number
    for one in units.values():
        one["standing"] = _standing(one)
    return sorted(units.values(), key=lambda one: str(one["serial"]))


def _empty(serial: str, lot: str | None) -> Found:
    return {
        "serial": serial, "lot": lot, "runs": 0, "calibrations": 0, "last": None, "last_run": None, "state": None,
        "station": None, "calibrated": None, "model": None, "judged": None, "certificate": None,
    }  # fmt: skip


def _standing(one: Found) -> Standing:
    if one["model"] is None:
        return "uncalibrated"
    if one["judged"] not in set(Verdict) or not Verdict(one["judged"]).judged:
        return "unjudged"
    return "pass" if Verdict(one["judged"]).within else "fail"


def chosen(units: Iterable[Found], text: str, standing: Standing | None, order: Order) -> Sequence[Found]:
    """Units whose serial number or lot holds every word of `text`, with this standing, in this order."""
    words = text.casefold().split()
    found = [
        one
        for one in units
        if (standing is None or one["standing"] == standing)
        and all(word in f"{one['serial']} {one['lot'] or ''}".casefold() for word in words)
    ]
    if order == "serial":
        return found
    return sorted(found, key=lambda one: str(one["last"] or ""), reverse=order == "newest")
