"""The fleet in the registry: for every unit its first and its newest judged run with their quantities."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from datetime import datetime
from functools import cached_property, partial
from sys import intern
from typing import overload

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from sqlalchemy import ColumnElement, func, select

from bench.analysis import Limits, Quantity, judge_limits
from bench.archive.fleet.groups import Coded, ObjectArray, coded
from bench.archive.fleet.selection import ONE, UNKNOWN, Row, Selection, lot_of, profile_of
from bench.archive.registry.asking import once
from bench.archive.registry.opening import Registry, open_registry
from bench.archive.registry.summaries import JUDGED, decided
from bench.archive.registry.writing import TABLES
from bench.base import Aside, BoolArray, FloatArray, InputError, IntArray, usual_workers

_AT_ONCE = 10_000
"""Runs that are read together."""
_LARGE = 100 << 20
"""Size of a registry [B] from which a second processor sums up the quantities while the runs are read."""
_UNIQUE = ("id", "unit", "created")
"""Columns in which most runs differ; of the others each word is kept once."""


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


@dataclass(frozen=True, eq=False)
class Runs(Sequence[Calibrated]):
    """Calibrated runs as `rows` of common columns. An object is made where one is asked for: a million take a GB."""

    columns: Mapping[str, ObjectArray]
    names: Mapping[str, int]
    """Column of `table` by quantity."""
    table: FloatArray
    """Quantities of the runs; NaN where there is none."""
    rows: IntArray

    def __len__(self) -> int:
        """Number of runs."""
        return int(self.rows.size)

    @overload
    def __getitem__(self, place: int) -> Calibrated: ...

    @overload
    def __getitem__(self, place: slice) -> Runs: ...

    def __getitem__(self, place: int | slice) -> Calibrated | Runs:
        """A run, or some."""
        if isinstance(place, slice):
            return replace(self, rows=self.rows[place])
        row = self.rows[place]
        own = {name: column[row] for name, column in self.columns.items() if name in _OF_CALIBRATED}
        run = own.pop("id")
        values, time_s = Values(self.names, self.table[row]), _time_s(own["created"])
        return Calibrated(run=run, path=run.partition("/")[2], time_s=time_s, values=values, **own)

    def column(self, name: str) -> ObjectArray:
        """A column of these runs (n,)."""
        return self.columns[name][self.rows]

    def of_units(self, judged: BoolArray) -> tuple[IntArray, IntArray, IntArray]:
        """Places of the newest `judged` run of every unit in order of time, of its first one, and of its newest run."""
        newest, first, last = _of_units(self.column("unit"), judged)
        runs = replace(self, rows=self.rows[newest])
        keys = pa.table({"time": runs.time_s, "run": pa.array(runs.column("id"), pa.string())})
        order = pc.sort_indices(keys, sort_keys=[("time", "ascending"), ("run", "ascending")]).to_numpy()
        return newest[order], first[order], last[order]

    @cached_property
    def time_s(self) -> FloatArray:
        """Time of each (n,) [s]."""
        created = self.column("created")
        try:
            zoned = pa.array(created, pa.string()).cast(pa.timestamp("us", "UTC")).cast(pa.int64())
        except pa.ArrowInvalid:  # a time without a zone is local time
            return np.array([_time_s(one) for one in created])
        return np.asarray(zoned.to_numpy() / 1e6, dtype=np.float64)


def standing(found: Sequence[Row]) -> list[Row]:
    """The run by which each unit stands, the newest first, of runs of which the newest comes first."""
    oldest_first = found[::-1]
    judged = np.array([decided(run["judged"]) for run in oldest_first], dtype=bool)
    newest, _, _ = _of_units([run["unit"] for run in oldest_first], judged)
    return [oldest_first[place] for place in sorted(newest.tolist(), reverse=True)]


def _of_units(units: Sequence[str] | ObjectArray, judged: BoolArray) -> tuple[IntArray, IntArray, IntArray]:
    """Places of the newest `judged` run of every unit, of its first one, and of its newest run; the oldest comes first.

    A unit without a judged run has its newest and its first run.
    """
    unit = pa.array(units, pa.string()).dictionary_encode().indices.to_numpy()
    first, newest = np.empty((2, int(unit.max(initial=-1)) + 1), dtype=np.int64)
    every = np.arange(unit.size)
    newest[unit] = every
    first[unit[::-1]] = every[::-1]
    last, judging = newest.copy(), every[judged]
    newest[unit[judging]] = judging
    first[unit[judging[::-1]]] = judging[::-1]
    return newest, first, last


_OF_CALIBRATED = ("id", "unit", "lot", "station", "created", "judged", "limits")


def _time_s(created: str) -> float:
    return datetime.fromisoformat(created).timestamp()


@dataclass(frozen=True, eq=False)
class Fleet:
    """Newest judged run of every unit in order of time, and the first; `units` of the quantities.

    Of a unit without a judged run it is the newest run.
    """

    newest: Runs
    first: Runs
    later: Runs
    """Newest runs that are newer than the newest judged run of their units."""
    words: tuple[str | None, ...]
    """Verdicts of `newest`."""
    first_words: tuple[str | None, ...]
    units: Mapping[str, str]
    limits: Limits | None = None
    left_out: tuple[str, ...] = ()
    """Runs that do not stand beside these, in words."""

    def column(self, quantity: str) -> FloatArray:
        """Values (n,) of the newest runs, NaN for a missing one."""
        column: FloatArray = self.newest.table[self.newest.rows, self.newest.names[quantity]]
        return column

    @cached_property
    def stations(self) -> Coded:
        """Stations of the newest runs."""
        return coded(self.newest.column("station"))

    @cached_property
    def lots(self) -> Coded:
        """Lots of the newest runs."""
        return coded(self.newest.column("lot"))


def selected(
    registry: Registry, pattern: str | None = None, selection: Selection | None = None
) -> tuple[Runs, Mapping[str, str], tuple[str, ...]]:
    """Selected runs of all units whose whole serial matches, in order of time, units of quantities, what was left out.

    NoUnitError where there is none, InputError for a wrong pattern.
    """
    selection = selection or Selection()
    among, large = selection.among(), registry.bytes > _LARGE
    work = partial(_of_a_copy if large else _quantities, registry, among)
    with closing(Aside(work, usual_workers() if large else 1)) as aside:
        columns = _columns(registry, among, pattern)
        units, ids, values = aside.answer()
    rows, left_out = selection.kept(columns)
    if not rows.size:
        why = f" ({'; '.join(left_out)} left out)" if left_out else ""
        raise NoUnitError(
            f"no calibrated unit{f' matches {pattern}' if pattern else ''}{why}; `bench registry list`", registry.url
        )
    places = {name: place for place, name in enumerate(units)}
    return Runs(columns, places, _placed(ids, values, columns["id"]), rows), units, left_out


def fleet_of(
    registry: Registry, pattern: str | None = None, selection: Selection | None = None, limits: Limits | None = None
) -> Fleet:
    """All units whose whole serial matches, by their selected runs; errors are those of `selected`."""
    found, units, left_out = selected(registry, pattern, selection)
    verdicts = words(found, limits)
    newest, first, last = found.of_units(np.array([decided(word) for word in verdicts], dtype=bool))

    def at(places: IntArray) -> Runs:
        return replace(found, rows=found.rows[places])

    told, first_told = (tuple(verdicts[places].tolist()) for places in (newest, first))
    return Fleet(at(newest), at(first), at(last[last != newest]), told, first_told, units, limits, left_out)


def as_shown(registry: Registry, selection: Selection | None = None, pattern: str | None = None) -> Selection:
    """The selection with the profile, and simulated or not, of the runs that `selected` finds by it.

    Runs without a calibration choose neither, unless no run has one.
    """
    selection = selection or Selection()
    columns = _columns(registry, selection.among(), pattern)
    rows, _ = selection.kept(columns)
    if not rows.size:
        return selection
    cause, profile, simulated = (columns[name][rows[0]] for name in ("cause", "profile", "simulated"))
    return replace(selection, profile=profile_of(cause, profile).item(), simulated=bool(simulated))


def _columns(registry: Registry, among: Sequence[ColumnElement[bool]], pattern: str | None) -> dict[str, ObjectArray]:
    """Runs with a calibration, in order, with their lots and stations, of units whose whole serial matches.

    InputError for a wrong pattern.
    """
    try:
        wanted = re.compile(pattern or ".*")
    except re.error as error:
        raise InputError(f"--unit-filter is '{pattern}', not a regular expression: {error}") from None
    run, calibration, unit = (TABLES[name] for name in ("runs", "calibrations", "units"))
    certificate = TABLES["certificates"]
    of_run = ("id", "unit", "station", "created", "profile", "state", "cause", "simulated", "corrected")
    chosen = (
        select(*(run.c[name] for name in of_run), unit.c.lot, JUDGED, calibration.c.limits)
        .join_from(run, calibration)
        .join(certificate, certificate.c.run == run.c.id, isouter=True)
        .join(unit, unit.c.serial == run.c.unit)
        .where(run.c.created.is_not(None), once(), *among)
        .order_by(run.c.seen.asc().nulls_first(), run.c.created, run.c.id)
    )
    known: dict[object, object] = {}
    with registry.reading() as connection:
        names = chosen.selected_columns.keys()
        read: list[list[object]] = [[] for _ in names]
        for some in connection.execute(chosen).partitions(_AT_ONCE):
            for name, column, more in zip(names, read, zip(*some, strict=True), strict=True):
                column.extend(more if name in _UNIQUE else map(known.setdefault, more, more))
    columns = dict(zip(names, (np.array(column, dtype=object) for column in read), strict=True))
    pairs = zip(columns["unit"], columns["lot"], strict=True)
    columns["lot"] = np.array([lot or intern(lot_of(unit, None)) for unit, lot in pairs], dtype=object)
    columns["station"] = np.array([station or UNKNOWN for station in columns["station"]], dtype=object)
    if pattern:
        matching = np.array([wanted.fullmatch(unit) is not None for unit in columns["unit"]], dtype=bool)
        columns = {name: column[matching] for name, column in columns.items()}
    return columns


def _quantities(
    registry: Registry, among: Sequence[ColumnElement[bool]]
) -> tuple[dict[str, str], list[str], FloatArray]:
    """Units of the quantities; ids of runs (n,), and their values (n, quantities)."""
    run, unit, quantity = (TABLES[name] for name in ("runs", "units", "quantities"))
    chosen_runs = select(run.c.id).join_from(run, unit, unit.c.serial == run.c.unit).where(*among)
    chosen_ones = (quantity.c.run.in_(chosen_runs),) if among else ()
    of_names = select(quantity.c.name, quantity.c.unit).where(*chosen_ones).distinct()
    ids, values = list[str](), list[FloatArray]()
    with registry.reading() as connection:
        pairs = sorted((name, word or "") for name, word in map(tuple, connection.execute(of_names)))
        units = dict(pairs)  # the last of several
        wide = (func.max(quantity.c.value).filter(quantity.c.name == name) for name in units)
        of_runs = select(quantity.c.run, *wide).where(*chosen_ones).group_by(quantity.c.run)
        for some in connection.execute(of_runs).partitions(_AT_ONCE):
            own, *columns = zip(*some, strict=True)
            ids += own
            values.append(np.array(columns, dtype=np.float64).T)
    return units, ids, np.concatenate([np.empty((0, len(units))), *values])


def _of_a_copy(
    registry: Registry, among: Sequence[ColumnElement[bool]]
) -> tuple[dict[str, str], list[str], FloatArray]:
    """The same in a copy of this process, which opens the file anew: connections of SQLite are not shared."""
    with open_registry(registry.url) as own:
        return _quantities(own, among)


def _placed(ids: Sequence[str], values: FloatArray, runs: ObjectArray) -> FloatArray:
    """Values (n, quantities) of runs with these ids in the order of `runs`, NaN where there are none; a row is left."""
    rows = dict(zip(runs.tolist(), range(runs.size), strict=True))
    table = np.full((runs.size + 1, values.shape[1]), np.nan)  # the last row takes the quantities of all other runs
    table[[rows.get(one, -1) for one in ids]] = values
    return table


def choices(registry: Registry) -> dict[str, list[str]]:
    """Stations, lots and plans of all calibrated runs, by which a fleet can be chosen.

    `cut`: lots that no unit has on record, of all units; the serial numbers begin with them.
    """
    run, calibration, unit = (TABLES[name] for name in ("runs", "calibrations", "units"))
    of_station = select(run.c.station, run.c.profile, run.c.cause).join_from(run, calibration).distinct()
    own = select(calibration.c.run).join_from(calibration, run).where(run.c.unit == unit.c.serial).exists()
    with registry.reading() as connection:
        found = [dict(row) for row in connection.execute(of_station).mappings()]
        lots = set(connection.execute(select(unit.c.lot).where(unit.c.lot.is_not(None), own).distinct()).scalars())
        nameless = connection.execute(select(unit.c.serial, own).where(unit.c.lot.is_(None))).all()
    cut = {lot_of(serial, None) for serial, _ in nameless} - lots - {ONE}
    lots |= {lot_of(serial, None) for serial, calibrated in nameless if calibrated}
    stations = {str(one["station"] or UNKNOWN) for one in found}
    return {
        "stations": sorted(stations),
        "lots": sorted(lots),
        "cut": sorted(cut),
        "plans": sorted({str(profile_of(one["cause"], one["profile"])) for one in found}),
    }


def words(runs: Runs, limits: Limits | None) -> ObjectArray:
    """Verdict of each run (n,): from its report if that used the same limits, else from its numbers.

    None without limits. The registry keeps numbers without their intervals, so a verdict from the numbers ignores their
    uncertainty.
    """
    found = runs.column("judged")
    if limits is not None:
        for place in np.flatnonzero(runs.column("limits") != limits.name).tolist():
            values = runs[place].values.items()
            found[place] = judge_limits(limits, [Quantity.exact(name, value) for name, value in values]).verdict.value
    return found
