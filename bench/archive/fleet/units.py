"""The fleet in the registry: for every unit its first and its newest calibrated run with their quantities."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any

import numpy as np
from sqlalchemy import func, select

from bench.analysis import Limits, Quantity, Verdict, judge_limits
from bench.archive.fleet.selection import Selection, profile_of
from bench.archive.registry.asking import once
from bench.archive.registry.opening import Registry
from bench.archive.registry.writing import TABLES
from bench.base import FloatArray, InputError

NO_LOT = re.compile(r"^(.*?)[-_. ]?\d+$")
"""The lot of a unit without a recorded lot is its serial without the number at the end."""


class NoUnitError(InputError):
    """No unit has a calibration, or none of those whose serial matches."""


@dataclass(frozen=True)
class Calibrated:
    """A run with a calibration: unit, lot, station, time, verdict, and its quantities by name."""

    run: str
    unit: str
    lot: str
    station: str
    created: str
    path: str
    """Folder of the run in its archive: `UNIT/RUN`."""
    time_s: float
    judged: str | None
    """Verdict of its certificate, or else of its report."""
    limits: str | None
    values: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Fleet:
    """Newest run of every unit in order of time, and the first; `units` of the quantities."""

    newest: tuple[Calibrated, ...]
    first: tuple[Calibrated, ...]
    units: Mapping[str, str]
    left_out: tuple[str, ...] = ()
    """Runs that do not stand beside these, in words."""

    def column(self, quantity: str) -> FloatArray:
        """Values (n,) of the newest runs, NaN for a missing one."""
        return np.array([one.values.get(quantity, np.nan) for one in self.newest])

    @property
    def time_s(self) -> FloatArray:
        """Time of the newest runs (n,) [s]."""
        return np.array([one.time_s for one in self.newest])


def selected(
    registry: Registry, pattern: str | None = None, selection: Selection | None = None
) -> tuple[list[Calibrated], Mapping[str, str], tuple[str, ...]]:
    """Selected runs of all units whose whole serial matches, in order of time, units of quantities, what was left out.

    NoUnitError where there is none, InputError for a wrong pattern.
    """
    try:
        wanted = re.compile(pattern or ".*")
    except re.error as error:
        raise InputError(f"--unit-filter is '{pattern}', not a regular expression: {error}") from None
    runs, values, units = _rows(registry)
    found, left_out = (selection or Selection()).of([one for one in runs if wanted.fullmatch(one["unit"])])
    if not found:
        why = f" ({'; '.join(left_out)} left out)" if left_out else ""
        raise NoUnitError(
            f"no calibrated unit{f' matches {pattern}' if pattern else ''}{why}; `bench registry list`", registry.url
        )
    return [_calibrated(row, values.get(row["id"], {})) for row in found], units, left_out


def fleet_of(registry: Registry, pattern: str | None = None, selection: Selection | None = None) -> Fleet:
    """All units whose whole serial matches, by their selected runs; errors are those of `selected`."""
    found, units, left_out = selected(registry, pattern, selection)
    first: dict[str, Calibrated] = {}
    newest: dict[str, Calibrated] = {}
    for one in found:
        first.setdefault(one.unit, one)
        newest[one.unit] = one
    ordered = sorted(newest.values(), key=lambda one: (one.time_s, one.run))
    return Fleet(tuple(ordered), tuple(first[one.unit] for one in ordered), units, left_out)


def _rows(registry: Registry) -> tuple[list[dict[str, Any]], dict[str, dict[str, float]], dict[str, str]]:
    run, calibration, unit, quantity = (TABLES[name] for name in ("runs", "calibrations", "units", "quantities"))
    certificate = TABLES["certificates"]
    judged = func.coalesce(certificate.c.verdict, calibration.c.judged).label("judged")
    of_run = ("id", "path", "unit", "station", "created", "profile", "state", "cause", "simulated", "corrected")
    columns = (*(run.c[name] for name in of_run), unit.c.lot)
    chosen = (
        select(*columns, judged, calibration.c.limits)
        .join_from(run, calibration)
        .join(certificate, certificate.c.run == run.c.id, isouter=True)
        .join(unit, unit.c.serial == run.c.unit)
        .where(run.c.created.is_not(None), once())
        .order_by(run.c.seen.asc().nulls_first(), run.c.created, run.c.id)
    )
    values: dict[str, dict[str, float]] = {}
    units: dict[str, str] = {}
    with registry.reading() as connection:
        runs = [_placed(row) for row in connection.execute(chosen).mappings()]
        for row in connection.execute(select(quantity).order_by(quantity.c.run, quantity.c.name)):
            values.setdefault(row.run, {})[row.name] = row.value
            units[row.name] = row.unit or ""
    return runs, values, units


def _placed(row: Mapping[Any, Any]) -> dict[str, Any]:
    """A run of the registry with its lot and its station."""
    return {**row, "lot": lot_of(row["unit"], row["lot"]), "station": row["station"] or "unknown"}


def lot_of(unit: str, recorded: str | None) -> str:
    """The lot of a unit: the recorded one, else its serial number without the digits at the end."""
    match = NO_LOT.match(unit)
    return recorded or (match[1] if match else "") or "one"


def choices(registry: Registry) -> dict[str, list[str]]:
    """Stations, lots and plans of all calibrated runs, by which a fleet can be chosen."""
    runs = _rows(registry)[0]
    of: dict[str, Callable[[dict[str, Any]], str]] = {
        "stations": lambda run: str(run["station"]),
        "lots": lambda run: str(run["lot"]),
        "plans": lambda run: str(profile_of(run)),
    }
    return {name: sorted({value(run) for run in runs}) for name, value in of.items()}


def _calibrated(row: Mapping[str, Any], values: Mapping[str, float]) -> Calibrated:
    return Calibrated(
        run=row["id"],
        unit=row["unit"],
        lot=row["lot"],
        station=row["station"],
        created=row["created"],
        path=row["path"],
        time_s=datetime.fromisoformat(row["created"]).timestamp(),
        judged=row["judged"],
        limits=row["limits"],
        values=values,
    )


def words(runs: Sequence[Calibrated], limits: Limits | None) -> Iterator[str | None]:
    """Verdict of each run: from its report if that used the same limits, else from its numbers; None without limits.

    The registry keeps numbers without their intervals, so a verdict from the numbers ignores their uncertainty.
    """
    for run in runs:
        if limits is None or run.limits == limits.name:
            yield run.judged
        else:
            yield judge_limits(
                limits, [Quantity.exact(name, value) for name, value in run.values.items()]
            ).verdict.value


def good(word: str | None) -> bool:
    """Whether a unit with this verdict passed."""
    return word is not None and Verdict(word).within


def decided(word: str | None) -> bool:
    """Whether a unit with this verdict passed or failed."""
    return word is not None and Verdict(word).judged
