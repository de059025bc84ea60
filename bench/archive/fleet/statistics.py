"""All statistics of a fleet, for the terminal, CSV, JSON and the page."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from bench.analysis import one_blas_thread
from bench.archive.fleet.capability import Capability, capability, proportion
from bench.archive.fleet.charts import Chart, chart
from bench.archive.fleet.drift import SIGNIFICANT, Drift, Levelled, corrected, drifts
from bench.archive.fleet.groups import Coded, ObjectArray
from bench.archive.fleet.shifts import ControlChart, Shift, charts_for, latest, shifts
from bench.archive.fleet.units import Fleet
from bench.archive.fleet.unlike import Odd, unlike
from bench.archive.registry.summaries import decided, good
from bench.base import BoolArray, FloatArray, IntArray, finite, shared, usual_workers

SHARE = 0.9
"""Share of the units that must have a quantity for it to be part of the distance."""
_MANY = 50_000
"""Units for which one processor would take seconds."""


@dataclass(frozen=True)
class Yield:
    """Number of judged units, and of those that passed at the first attempt and with their newest judged run.

    A unit whose runs are all INVALID is not judged: `unjudged` counts such units. Its values count nowhere.
    """

    judged: int
    first: int
    final: int
    interval: tuple[float, float]
    """95 % of the first-pass yield."""
    unjudged: int = 0

    @property
    def outside(self) -> int:
        """Number of judged units outside their limits."""
        return self.judged - self.final


@dataclass(frozen=True, eq=False)
class Measured:
    """One quantity over the fleet: the rows whose value counts, limits, capability, chart."""

    name: str
    unit: str
    rows: IntArray
    values: FloatArray
    lower: float | None
    upper: float | None
    capability: Capability | None
    chart: Chart | None


@dataclass(frozen=True, eq=False)
class Statistics:
    """All statistics; `distances` (n,) are those of the units from their lots."""

    fleet: Fleet
    limits: str | None
    passes: Yield
    measured: tuple[Measured, ...]
    drifts: tuple[Drift, ...]
    distances: FloatArray
    odd: tuple[Odd, ...]
    missing: tuple[str, ...] = ()
    """Quantities that the limits require and no unit has."""
    shifts: tuple[Shift, ...] = ()
    charts: tuple[ControlChart, ...] = ()
    """Those that `shifts` come from."""
    attempts: tuple[FloatArray, BoolArray] = field(default_factory=lambda: (np.empty(0), np.empty(0, bool)))
    """Time [s] of each judged unit's first attempt that was judged (n,), and whether it passed."""

    def to_json(self) -> dict[str, Any]:
        """The answer of `bench fleet --json`; null where a number does not exist."""
        share = self.passes.first / self.passes.judged if self.passes.judged else None
        serials = self.fleet.newest.column("unit")
        return {
            "units": len(self.fleet.newest),
            "left_out": list(self.fleet.left_out),
            "limits": self.limits,
            "missing": list(self.missing),
            "yield": {**_plain(asdict(self.passes)), "first_pass": share},
            "quantities": [_quantity(one, serials[one.rows]) for one in self.measured],
            "drifts": [{**_plain(asdict(one)), "significant": one.significant} for one in self.drifts],
            "shifts": [_shift(one, self.fleet) for one in self.shifts],
            "station_charts": {"false_alarm": SIGNIFICANT, "charts": [asdict(one) for one in self.charts]},
            "later": [{"unit": one.unit, "run": one.path, "created": one.created} for one in self.fleet.later],
            "unlike": [{"unit": self.fleet.newest[one.row].unit, "lot": self.fleet.newest[one.row].lot,
                        **_plain(asdict(one))} for one in self.odd],
        }  # fmt: skip

    @property
    def beyond(self) -> list[str]:
        """Quantities of which a unit is beyond three sigma."""
        return [one.name for one in self.measured if one.chart and any(s.rule == 1 for s in one.chart.signals)]

    def drifted(self, kind: str) -> list[str]:
        """Lots that differ from the others, or stations that drift."""
        return list(dict.fromkeys(place for place, _ in self._drifting(kind)))

    def shifted(self) -> list[Shift]:
        """The first shift of each station, but of one that drifts: that has left its level, too, and is told once."""
        drifting, found = self._drifting("station"), dict[str, Shift]()
        for one in self.shifts:
            if (one.place, one.quantity) not in drifting:
                found.setdefault(one.place, one)
        return list(found.values())

    @property
    def moved(self) -> list[Drift]:
        """The significant drifts; a sudden shift of a station, which has a slope, too, is none."""
        sudden = [("station", one.place, one.quantity) for one in self.shifts if one.sudden]
        return [one for one in self.drifts if one.significant and (one.kind, one.place, one.quantity) not in sudden]

    def _drifting(self, kind: str) -> list[tuple[str, str]]:
        return [(one.place, one.quantity) for one in self.moved if one.kind == kind]

    @property
    def quiet(self) -> bool:
        """Whether nothing needs attention: all units judged and within, no drift, shift, odd unit or signal."""
        refused = self.passes.outside + self.passes.unjudged + len(self.fleet.later) > 0
        return not (self.beyond or self.moved or self.shifts or self.odd or refused)

    @property
    def charted(self) -> bool:
        """Whether a quantity has enough units for a chart, without which nothing can be odd, beyond or drifting."""
        return any(one.chart for one in self.measured)

    @property
    def silent(self) -> bool:
        """Whether nothing could be found: no unit was judged, and there are too few for a chart."""
        return not (self.passes.judged or self.charted)


def statistics(fleet: Fleet) -> Statistics:
    """Yield, capability, charts, drifts and distances of a fleet."""
    with one_blas_thread():  # the matrices are small: threads of BLAS would wait for each other
        return _statistics(fleet)


def _statistics(fleet: Fleet) -> Statistics:
    limits, verdicts = fleet.limits, fleet.words
    bounds: dict[str, tuple[float | None, float | None]] = {}
    bounds |= {limit.subject: (limit.lower, limit.upper) for limit in limits.limits} if limits else {}
    wanted = [limit.subject for limit in limits.limits if limit.required] if limits else []
    missing = tuple(quantity for quantity in wanted if quantity not in fleet.units)
    counts = _counting(verdicts, missing)
    measured = tuple(_measured(fleet, name, counts, *bounds.get(name, (None, None))) for name in sorted(fleet.units))
    charts = charts_for(sum(one.values.size for one in measured if one.chart is not None))
    place = fleet.newest.time_s, fleet.stations, fleet.lots
    # The quantities are judged apart, by as many processes as there are processors: a million units take half a minute.
    tasks = [partial(_moves, one, charts, *place) for one in measured if one.chart is not None]
    moves = shared(tasks, usual_workers() if len(fleet.newest) > _MANY else 1)
    found = [drift for drifting, _ in moves for drift in drifting]
    moved = [shift for _, shifting in moves for shift in shifting]
    whole = [one for one in measured if one.values.size >= SHARE * int(counts.sum()) and one.chart is not None]
    table = np.full((len(fleet.newest), len(whole)), np.nan)
    for column, one in enumerate(whole):
        table[one.rows, column] = one.values
    distances, odd = unlike(table, [one.name for one in whole], fleet.lots)
    name = limits.name if limits else None
    attempts = _attempts(fleet)
    passes = _yield(attempts[1], verdicts)
    return Statistics(fleet, name, passes, measured, tuple(corrected(found)), distances, tuple(odd), missing,
                      tuple(sorted(moved, key=lambda one: one.since)), charts, attempts)  # fmt: skip


def _moves(
    one: Measured, charts: tuple[ControlChart, ...], time_s: FloatArray, stations: Coded, lots: Coded
) -> tuple[list[Drift], list[Shift]]:
    """Drifts and shifts of one quantity; times (n,), stations and lots are those of the whole fleet."""
    rows = one.rows
    levelled = Levelled.of(one.values, time_s[rows], stations.at(rows), lots.at(rows), rows)
    if levelled is None:
        return [], []
    now = latest(levelled, charts)
    found = [replace(drift, ewma=now.get(drift.place, np.nan)) if drift.kind == "station" else drift
             for drift in drifts(levelled, one.name)]  # fmt: skip
    return found, list(shifts(levelled, one.name, charts))


def _attempts(fleet: Fleet) -> tuple[FloatArray, BoolArray]:
    """First judged run of each unit that has one; an attempt that was not judged is no attempt."""
    judged = np.array([decided(word) for word in fleet.first_words], dtype=bool)
    return fleet.first.time_s[judged], np.array([good(word) for word in fleet.first_words], dtype=bool)[judged]


def _yield(passed: BoolArray, newest: tuple[str | None, ...]) -> Yield:
    first, final = int(passed.sum()), sum(map(good, newest))
    unjudged = sum(word is not None and not decided(word) for word in newest)
    return Yield(passed.size, first, final, proportion(first, passed.size), unjudged)


def _counting(verdicts: Sequence[str | None], missing: Sequence[str]) -> BoolArray:
    """Whether the values of each unit (n,) count: not those of a run that must not be judged.

    Where the limits require what is `missing` in every run, no unit is judged, and the runs are as good as they were.
    """
    return np.array([bool(missing) or word is None or decided(word) for word in verdicts], dtype=bool)


def _measured(fleet: Fleet, name: str, counts: BoolArray, lower: float | None, upper: float | None) -> Measured:
    column = fleet.column(name)
    rows = np.flatnonzero(np.isfinite(column) & counts)
    values = column[rows]
    able = capability(values, lower, upper)
    return Measured(name, fleet.units[name], rows, values, lower, upper, able, chart(values))


def _quantity(one: Measured, serials: ObjectArray) -> dict[str, Any]:
    drawn = one.chart
    control = drawn and {
        "centre": drawn.centre,
        "limits": list(drawn.limits),
        "range_limit": drawn.range_limit,
        "signals": [{"rule": s.rule, "text": s.text, "unit": serials[s.index]} for s in drawn.signals],
    }
    able = None if one.capability is None else _plain(asdict(one.capability))
    return {"name": one.name, "unit": one.unit, "lower": one.lower, "upper": one.upper, "units": len(one.rows),
            "capability": able, "chart": control}  # fmt: skip


def _shift(one: Shift, fleet: Fleet) -> dict[str, Any]:
    """With the units of the alarm and of the change, and the time of the change."""
    unit, since = fleet.newest[one.row].unit, fleet.newest[one.since]
    return {"place": one.place, "quantity": one.quantity, "chart": one.chart, "change": finite(one.change),
            "since": since.unit, "since_created": since.created, "unit": unit, "before": one.before,
            "count": one.count, "sudden": one.sudden}  # fmt: skip


def _plain(content: dict[str, Any]) -> dict[str, Any]:
    def one(value: Any) -> Any:
        if isinstance(value, tuple):
            return [one(item) for item in value]
        return finite(value) if isinstance(value, float) else value

    return {key: one(value) for key, value in content.items()}


def to_csv(found: Statistics) -> str:
    """One line per unit and quantity."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(("unit", "lot", "station", "created", "run", "verdict", "quantity", "value", "unit_of_value",
                     "lower", "upper", "distance_from_lot"))  # fmt: skip
    writer.writerows(_lines(found))
    return text.getvalue()


def _lines(found: Statistics) -> Iterator[tuple[Any, ...]]:
    by_name = {one.name: one for one in found.measured}
    for row, one in enumerate(found.fleet.newest):
        distance = finite(float(found.distances[row]))
        head = (one.unit, one.lot, one.station, one.created, one.run, found.fleet.words[row] or "")
        for name, value in sorted(one.values.items()):
            limit = by_name[name]
            yield (*head, name, repr(value), limit.unit, limit.lower, limit.upper, distance)
