"""Separates drift of stations from differences of lots: value = lot + station + slope of the station x time.

Lots are random: each is drawn from the same distribution about a level that may change with time, so that units of
different lots are compared as well as those of one (a mixed model, by restricted likelihood). A station drifts where
its slope differs from that of the others; one or two stations are judged by the units within lots alone, because a
trend of the lots would pass for a drift. A lot differs where it lies further from the others than they lie from each
other. Units far from their lot are left out first, so that one bad unit does not appear as a drift. p values come from
the t distribution with Satterthwaite's degrees of freedom, with Holm's correction for the number of tests. Sources:
D. A. Harville, J. Am. Stat. Assoc. 72 (1977) 320; F. E. Satterthwaite, Biometrics Bull. 2 (1946) 110.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bench.archive.fleet.groups import Coded, coded, median, medians
from bench.archive.fleet.mixed import Columns, Mixed, Tested
from bench.base import BoolArray, FloatArray, IntArray

SIGNIFICANT = 0.01
DAY_S = 86400.0
LEAST = 8
_FAR = 5.0
"""Robust sigmas from the lot's median beyond which a unit is left out."""
_LEAST_LOT, _LEAST_STATIONS = 3, 3


@dataclass(frozen=True)
class Drift:
    """A change of `quantity` at `place` (station or lot): `change` with its standard error, in unit a day or unit."""

    kind: str
    place: str
    quantity: str
    change: float
    error: float
    p: float
    count: int
    ewma: float = np.nan
    """Weighted mean of a station's latest units, in units of its limit (`shifts`)."""

    @property
    def significant(self) -> bool:
        """Whether chance is an unlikely cause, given the number of tests."""
        return self.p < SIGNIFICANT


@dataclass(frozen=True, eq=False)
class Levelled:
    """Values of one quantity (n,) in the order given, their stations and lots, and the mixed model of those near.

    `rows` are the places of the values in a longer table, 0 to n - 1 without one.
    """

    solved: Mixed
    values: FloatArray
    station: IntArray
    lot: IntArray
    names: tuple[str, ...]
    """Of the stations …"""
    lots: tuple[str, ...]
    """… and the lots."""
    time_s: FloatArray
    near: BoolArray
    """Values that the model was fitted to."""
    rows: IntArray

    @classmethod
    def of(
        cls,
        values: FloatArray,
        time_s: FloatArray,
        stations: Sequence[str] | Coded,
        lots: Sequence[str] | Coded,
        rows: IntArray | None = None,
    ) -> Levelled | None:
        """None where there are too few values."""
        lot_names, lot = coded(lots)
        names, station = coded(stations)
        near, t = _near(values, lot), time_s / DAY_S
        many = np.bincount(station[near], minlength=len(names))
        if near.sum() - 2 * np.count_nonzero(many) - 1 < LEAST // 2:
            return None
        sizes = np.maximum(np.bincount(lot[near], minlength=len(lot_names)), 1)
        when = (np.bincount(lot[near], t[near], len(lot_names)) / sizes)[lot]
        when -= when[near].mean()
        own = np.bincount(station[near], t[near], len(names)) / np.maximum(many, 1)
        count = len(names)
        place = np.column_stack([station, count + station, np.full(values.size, 2 * count)])
        columns = Columns(place, np.column_stack([np.ones(values.size), t - own[station], when]), 2 * count + 1)
        solved = Mixed.of(columns.at(near), values[near], lot[near])
        found = np.arange(values.size) if rows is None else rows
        return cls(solved, values, station, lot, names, lot_names, time_s, near, found)

    def in_order(self, place: int) -> IntArray:
        """Indices of the values of a station in order of time."""
        own = np.flatnonzero(self.station == place)
        return own[np.argsort(self.time_s[own], kind="stable")]


def drifts(levelled: Levelled, quantity: str) -> list[Drift]:
    """Slope of every station and offset of every lot for one quantity; none where the data do not determine them.

    `corrected` corrects `p` afterwards.
    """
    return [*_of_stations(levelled, quantity), *_of_lots(levelled.solved, levelled.lots, quantity)]


def _of_stations(levelled: Levelled, quantity: str) -> Iterator[Drift]:
    solved, names = levelled.solved, levelled.names
    count = len(names)
    slopes = np.eye(solved.beta.size)[count : 2 * count]
    certain = 1.0 / np.maximum(np.diag(slopes @ solved.inverse @ slopes.T), 1e-300)
    many = np.bincount(levelled.station[levelled.near], minlength=count)
    known = [i for i in range(count) if many[i] >= LEAST and certain[i] < 1e300]

    def test(i: int, others: Sequence[int]) -> Tested | None:
        if count < _LEAST_STATIONS:
            return solved.tested(slopes[i])
        return (
            solved.tested(slopes[i] - np.average(slopes[others], axis=0, weights=certain[others])) if others else None
        )

    for i, result in _apart(known, test, count):
        yield Drift("station", names[i], quantity, *result, int(many[i]))


def _of_lots(solved: Mixed, names: Sequence[str], quantity: str) -> Iterator[Drift]:
    """Each lot beside what the others predict, the most different first; later lots are not compared with it."""
    sizes = np.bincount(solved.lot, minlength=len(names))
    waiting = {i for i in range(len(names)) if sizes[i] >= _LEAST_LOT}
    while waiting:
        apart = solved.apart()
        tested = {i: apart[i] for i in sorted(waiting) if i in apart}
        if not tested:
            return
        first = min(tested, key=lambda i: tested[i][2])
        without = solved.without(first)
        found = None if without is None else without.predicted(solved, first)
        odd = found is not None and found[2] < SIGNIFICANT / len(names)
        for i in [first] if odd else sorted(tested):
            result = found if i == first and found is not None else tested[i]
            yield Drift("lot", names[i], quantity, *result, int(sizes[i]))
        if not odd or without is None:
            return
        waiting.discard(first)
        solved = without


def _apart(
    known: Sequence[int], test: Callable[[int, Sequence[int]], Tested | None], tests: int
) -> Iterator[tuple[int, Tested]]:
    """Each of several beside the others, the most different first; later ones are not compared with it."""
    waiting, others = set(known), set(known)
    while waiting:
        found = {i: result for i in sorted(waiting) if (result := test(i, sorted(others - {i}))) is not None}
        if not found:
            return
        first = min(found, key=lambda i: found[i][2])
        odd = found[first][2] < SIGNIFICANT / tests
        yield from ((i, found[i]) for i in ([first] if odd else sorted(found)))
        if not odd:
            return
        waiting.discard(first)
        others.discard(first)


def corrected(found: Sequence[Drift]) -> list[Drift]:
    """The drifts, least p first, after Holm's correction among stations and among lots, half of the alarms each.

    Source: S. Holm, Scand. J. Stat. 6 (1979) 65.
    """
    kinds = {drift.kind for drift in found}
    out = []
    for kind in sorted(kinds):
        ordered = sorted((drift for drift in found if drift.kind == kind), key=lambda drift: drift.p)
        highest = 0.0
        for rank, drift in enumerate(ordered):
            highest = max(highest, min(1.0, drift.p * len(kinds) * (len(ordered) - rank)))
            out.append(replace(drift, p=highest))
    return sorted(out, key=lambda drift: drift.p)


def _near(values: FloatArray, lot: IntArray) -> BoolArray:
    centre = medians(values, lot)[lot]
    spread = 1.4826 * median(np.abs(values - centre))
    near: BoolArray = np.abs(values - centre) <= _FAR * spread if spread > 0 else np.ones(values.size, dtype=bool)
    return near
