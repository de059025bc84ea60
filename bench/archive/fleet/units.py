"""The fleet in the registry: for every unit its first and its newest calibrated run with their quantities."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import cache, cached_property
from sys import intern
from typing import Any

import numpy as np
import numpy.typing as npt
from sqlalchemy import ColumnElement, case, func, select

from bench.analysis import Limits, Quantity, judge_limits
from bench.archive.fleet.selection import ONE, UNKNOWN, Selection, profile_of
from bench.archive.registry.asking import once
from bench.archive.registry.opening import Registry
from bench.archive.registry.writing import TABLES
from bench.base import FloatArray, InputError
from bench.record import Verdict

NO_LOT = re.compile(r"^(.*?)[-_. ]?\d+$")
"""The lot of a unit without a recorded lot is its serial without the number at the end."""


ObjectArray = npt.NDArray[np.object_]

_AT_ONCE = 10_000
"""Runs whose quantities are read together."""


class NoUnitError(InputError):
    """No unit has a calibration, or none of those whose serial matches."""


@dataclass(frozen=True, slots=True)
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
    values: Values


class Values(Mapping[str, float]):
    """Quantities of one run by name: a row of a table of all runs."""

    __slots__ = ("_names", "row")

    def __init__(self, names: Mapping[str, int], row: FloatArray) -> None:
        """`names` say which place of `row` (names,) holds what; NaN is nothing."""
        self._names, self.row = names, row

    def __getitem__(self, name: str) -> float:
        """The value; KeyError where there is none."""
        value = float(self.row[self._names[name]])
        if np.isnan(value):
            raise KeyError(name)
        return value

    def __iter__(self) -> Iterator[str]:
        """Names of the quantities that there are, sorted."""
        return (name for name, place in self._names.items() if not np.isnan(self.row[place]))

    def __len__(self) -> int:
        """Number of quantities."""
        return int((~np.isnan(self.row)).sum())


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
        column: FloatArray = self._table[list(self.units).index(quantity)]
        return column

    @cached_property
    def _table(self) -> FloatArray:
        """Values of the newest runs (quantities, n), in the order of `units`."""
        return np.array([one.values.row for one in self.newest]).T.copy()

    @cached_property
    def time_s(self) -> FloatArray:
        """Time of the newest runs (n,) [s]."""
        return np.array([one.time_s for one in self.newest])

    @cached_property
    def stations(self) -> ObjectArray:
        """Stations of the newest runs (n,)."""
        return np.array([one.station for one in self.newest], dtype=object)

    @cached_property
    def lots(self) -> ObjectArray:
        """Lots of the newest runs (n,)."""
        return np.array([one.lot for one in self.newest], dtype=object)


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
    selection = selection or Selection()
    runs, values, units = _rows(registry, selection.among())
    found, left_out = selection.of([one for one in runs if wanted.fullmatch(one["unit"])])
    if not found:
        why = f" ({'; '.join(left_out)} left out)" if left_out else ""
        raise NoUnitError(
            f"no calibrated unit{f' matches {pattern}' if pattern else ''}{why}; `bench registry list`", registry.url
        )
    return [_calibrated(row, values(row["id"])) for row in found], units, left_out


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


def _rows(
    registry: Registry, among: Sequence[ColumnElement[bool]]
) -> tuple[list[dict[str, Any]], Callable[[str], Values], dict[str, str]]:
    """Runs with a calibration, in order, the quantities by the id of a run, and their units."""
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
        .where(run.c.created.is_not(None), once(), *among)
        .order_by(run.c.seen.asc().nulls_first(), run.c.created, run.c.id)
    )
    chosen_runs = select(run.c.id).join_from(run, unit, unit.c.serial == run.c.unit).where(*among)
    chosen_ones = (quantity.c.run.in_(chosen_runs),) if among else ()
    of_names = select(quantity.c.name, func.max(quantity.c.unit)).where(*chosen_ones).group_by(quantity.c.name)
    with registry.reading() as connection:
        runs = [_placed(row) for row in connection.execute(chosen).mappings()]
        units = {name: word or "" for name, word in sorted(tuple(row) for row in connection.execute(of_names))}
        places = {name: place for place, name in enumerate(units)}
        rows = {one["id"]: row for row, one in enumerate(runs)}
        table = np.full((len(runs) + 1, len(places)), np.nan)  # the last row takes the quantities of all other runs
        wide = (func.max(case((quantity.c.name == name, quantity.c.value))) for name in units)
        of_runs = select(quantity.c.run, *wide).where(*chosen_ones).group_by(quantity.c.run)
        for some in connection.execute(of_runs).partitions(_AT_ONCE):
            where = [rows.get(one[0], -1) for one in some]
            table[where] = np.array([one[1:] for one in some], dtype=np.float64)
    return runs, lambda one: Values(places, table[rows[one]]), units


def _placed(row: Mapping[Any, Any]) -> dict[str, Any]:
    """A run of the registry with its lot and its station."""
    few = {name: intern(row[name]) for name in ("profile", "state", "cause") if row[name]}
    lot, station = lot_of(row["unit"], row["lot"]), row["station"] or UNKNOWN
    return {**row, **few, "lot": intern(lot), "station": intern(station)}


def lot_of(unit: str, recorded: str | None) -> str:
    """The lot of a unit: the recorded one, else its serial number without the digits at the end."""
    match = NO_LOT.match(unit)
    return recorded or (match[1] if match else "") or ONE


def choices(registry: Registry) -> dict[str, list[str]]:
    """Stations, lots and plans of all calibrated runs, by which a fleet can be chosen."""
    run, calibration, unit = (TABLES[name] for name in ("runs", "calibrations", "units"))
    of_station = select(run.c.station, run.c.profile, run.c.cause).join_from(run, calibration).distinct()
    own = select(calibration.c.run).join_from(calibration, run).where(run.c.unit == unit.c.serial).exists()
    with registry.reading() as connection:
        found = [dict(row) for row in connection.execute(of_station).mappings()]
        lots = set(connection.execute(select(unit.c.lot).where(unit.c.lot.is_not(None), own).distinct()).scalars())
        nameless = connection.execute(select(unit.c.serial).where(unit.c.lot.is_(None), own)).scalars()
        lots |= {lot_of(serial, None) for serial in nameless}
    stations = {str(one["station"] or UNKNOWN) for one in found}
    return {
        "stations": sorted(stations),
        "lots": sorted(lots),
        "plans": sorted({str(profile_of(one)) for one in found}),
    }


def _calibrated(row: Mapping[str, Any], values: Values) -> Calibrated:
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


@cache
def good(word: str | None) -> bool:
    """Whether a unit with this verdict passed."""
    return word is not None and Verdict(word).within


@cache
def decided(word: str | None) -> bool:
    """Whether a unit with this verdict passed or failed."""
    return word is not None and Verdict(word).judged
