"""Finds stations whose level has shifted, by a CUSUM and an EWMA of each.

A value is what its lot leaves of it, as a normal score among all units, so that neither shape nor one bad unit matters.
Each is compared with all earlier ones of its station, which gives independent standard normal values where nothing
changes (D. M. Hawkins, The Statistician 36 (1987) 299): no level has to be known. The CUSUM (E. S. Page, Biometrika 41
(1954) 100) sees shifts of one sigma and more first, the EWMA (S. W. Roberts, Technometrics 1 (1959) 239) smaller ones.
Their limits follow from the number of values in the fleet: one fleet in a hundred without a change has an alarm. Run
lengths by Markov chain: D. Brook, D. A. Evans, Biometrika 59 (1972) 539; J. M. Lucas, M. S. Saccucci, Technometrics 32
(1990) 1.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
import scipy

from bench.archive.fleet.drift import SIGNIFICANT, Levelled
from bench.base import FloatArray

Kind = Literal["cusum", "ewma"]
REFERENCE, WEIGHT = 0.5, 0.05
"""Of the CUSUM [sigma], half the shift that it finds fastest; of the newest value in the EWMA."""
_SETTLED = float(np.sqrt(WEIGHT / (2.0 - WEIGHT)))
"""Standard deviation of an EWMA of standard normal values."""
_STATES = 121
_LEAST = 3
"""Earlier values of a station with which a further one is compared."""


@dataclass(frozen=True)
class ControlChart:
    """A chart with its limit [sigma], and the values between two false alarms of one station, on average."""

    kind: Kind
    limit: float
    run_length: float

    @classmethod
    def of(cls, kind: Kind, run_length: float) -> ControlChart:
        """The chart with this run length where nothing changes."""
        limit = scipy.optimize.brentq(
            lambda one: np.log(average_run_length(kind, one) / run_length), *_SEARCHED[kind], xtol=1e-3
        )
        return cls(kind, float(limit), run_length)


_SEARCHED: Mapping[Kind, tuple[float, float]] = {"cusum": (0.5, 28.0), "ewma": (1.0, 7.0)}


@dataclass(frozen=True)
class Shift:
    """First alarm of a station: row of its unit, row of the first one after the most likely change, median after less
    median before [unit of the quantity].
    """

    place: str
    quantity: str
    chart: Kind
    row: int
    since: int
    change: float
    count: int
    """Units of the station from the change on …"""
    before: int
    """… and before."""
    sudden: bool
    """Whether a step follows the units of the station better than a line over time."""


@lru_cache(maxsize=256)
def average_run_length(kind: Kind, limit: float, shift: float = 0.0) -> float:
    """Values of sigma 1, off by `shift` from the start, until a chart with two sides has an alarm, on average."""
    if kind == "cusum":
        sides = [_one_sided(limit, side * shift) for side in (1.0, -1.0)]
        return float(1.0 / sum(1.0 / one for one in sides))
    half = limit * _SETTLED
    edges = np.linspace(-half, half, _STATES + 1)
    middle = 0.5 * (edges[1:] + edges[:-1])
    reached = scipy.special.ndtr((edges - (1.0 - WEIGHT) * middle[:, None]) / WEIGHT - shift)
    return float(_lengths(np.diff(reached, axis=1))[_STATES // 2])


def _one_sided(limit: float, shift: float) -> float:
    """Of a CUSUM that looks upwards and starts at zero."""
    width = 2.0 * limit / (2 * _STATES - 1)
    states = width * np.arange(_STATES)
    edges = np.append(-np.inf, states + 0.5 * width)
    reached = scipy.special.ndtr(edges - states[:, None] + REFERENCE - shift)
    return float(_lengths(np.diff(reached, axis=1))[0])


def _lengths(kept: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.solve(np.eye(len(kept)) - kept, np.ones(len(kept))), dtype=np.float64)


def charts_for(values: int) -> tuple[ControlChart, ...]:
    """A CUSUM and an EWMA of which one fleet in a hundred with so many values has an alarm where nothing changes."""
    kinds: tuple[Kind, ...] = ("cusum", "ewma")
    return tuple(ControlChart.of(kind, len(kinds) * max(values, 1) / SIGNIFICANT) for kind in kinds)


def shifts(levelled: Levelled, quantity: str, charts: Sequence[ControlChart]) -> Iterator[Shift]:
    """The first alarm of each station, the station furthest off first; the others are not compared with it."""
    odd: list[int] = []
    while len(odd) < len(levelled.names):
        scores, standard = _standard(levelled, tuple(odd))
        worst: tuple[float, int, tuple[int, Kind]] | None = None
        for place in sorted(set(range(len(levelled.names))) - set(odd)):
            z = standard[place]
            alarms = [(found, one.kind) for one in charts if (found := alarm(z, one)) is not None]
            if alarms:
                off = max(highest(z, one) / one.limit for one in charts)
                worst = max(worst or (0.0, 0, alarms[0]), (off, place, min(alarms)))
        if worst is None:
            return
        _, place, (at, kind) = worst
        odd.append(place)
        own = levelled.in_order(place)
        since = _changed(scores[own[: at + 1]])
        bare = _bare(levelled, levelled.values, odd)
        after, before = bare[own[since:]], bare[own[:since]]
        change = float(np.median(after) - np.median(before)) if before.size else np.nan
        row, begin = (int(levelled.rows[own[i]]) for i in (at, since))
        sudden = _is_step(scores[own], levelled.time_s[own], since)
        yield Shift(levelled.names[place], quantity, kind, row, begin, change, own.size - since, since, sudden)


def latest(levelled: Levelled, charts: Sequence[ControlChart]) -> dict[str, float]:
    """The EWMA of each station after its newest unit, in units of its limit; none where a station has too few units."""
    (chart,) = [one for one in charts if one.kind == "ewma"]
    known = zip(levelled.names, _standard(levelled, ())[1], strict=True)
    return {name: float(_ewma(z)[-1]) / (chart.limit * _SETTLED) for name, z in known if z.size > _LEAST}


@lru_cache(maxsize=1)
def _standard(levelled: Levelled, odd: tuple[int, ...]) -> tuple[FloatArray, list[FloatArray]]:
    """Scores of all units, and for each station those of its units in order of time as standard normal values."""
    scores = _scores(levelled, odd)
    return scores, [standardised(scores[levelled.in_order(place)]) for place in range(len(levelled.names))]


def _changed(z: FloatArray) -> int:
    """Index of the first value (n,) after the most likely change of their mean."""
    before = np.arange(1.0, z.size)
    apart = np.cumsum(z - z.mean())[:-1] ** 2 * (1.0 / before + 1.0 / (z.size - before))
    return int(np.argmax(apart)) + 1


def _is_step(z: FloatArray, time_s: FloatArray, since: int) -> bool:
    """Whether a step at this index follows values (n,) better, in least squares, than a line over time."""
    line = np.polynomial.Polynomial.fit(time_s, z, 1)(time_s)
    step = np.where(np.arange(z.size) < since, z[:since].mean(), z[since:].mean())
    return bool(np.sum((z - step) ** 2) < np.sum((z - line) ** 2))


def _bare(levelled: Levelled, values: FloatArray, odd: Sequence[int]) -> FloatArray:
    """Values less the levels of their lots, which other stations than the odd ones tell: value = lot + station.

    In least squares; a lot that only one station saw has the level of its units there.
    """
    lots, count = len(levelled.lots), len(levelled.names)
    whole = np.bincount(levelled.lot[levelled.near & ~np.isin(levelled.station, odd)], minlength=lots) > 0
    used = levelled.near & ~(np.isin(levelled.station, odd) & whole[levelled.lot])
    lot, station, y = levelled.lot[used], levelled.station[used], values[used]
    centre = float(np.median(y))
    together = np.bincount(lot * count + station, minlength=lots * count).reshape(lots, count)
    met = scipy.sparse.csr_array(together.astype(np.float64))
    many = np.maximum(np.bincount(lot, minlength=lots), 1)
    total = np.bincount(lot, y - centre, lots)
    shared = (met.T / many) @ met
    normal = np.diag(np.bincount(station, minlength=count)) - np.asarray(shared.todense())
    right = np.bincount(station, y - centre, count) - met.T @ (total / many)
    of_station = np.linalg.pinv(normal, rcond=1e-9, hermitian=True) @ right
    level = (total - met @ of_station) / many
    bare: FloatArray = values - centre - level[levelled.lot]
    return bare


def _scores(levelled: Levelled, odd: Sequence[int]) -> FloatArray:
    """Normal scores of all units without their lots, whose levels are taken from the scores once more.

    The mean of a lot is uncertain by more than the scores show where few values are far out.
    """
    bare = _bare(levelled, levelled.values, odd)
    for place in range(len(levelled.names)):
        own = levelled.station == place
        bare[own] -= np.median(bare[own])
    return _bare(levelled, scipy.special.ndtri((scipy.stats.rankdata(bare) - 0.375) / (bare.size + 0.25)), odd)


def standardised(values: FloatArray) -> FloatArray:
    """Each value (n,) beside mean and spread of all earlier ones, as a standard normal one; the first few are 0."""
    count = np.arange(values.size, dtype=np.float64)
    mean = np.concatenate([[0.0], np.cumsum(values)[:-1]]) / np.maximum(count, 1.0)
    square = np.concatenate([[0.0], np.cumsum((values - values.mean()) ** 2)[:-1]])
    spread = np.maximum(square - count * (mean - values.mean()) ** 2, 0.0)
    out = np.zeros(values.size)
    known = (count >= _LEAST) & (spread > 0.0)
    n = count[known]
    t = (values[known] - mean[known]) * np.sqrt(n / (n + 1.0) * (n - 1.0) / spread[known])
    p = scipy.special.stdtr(n - 1.0, -np.abs(t))
    out[known] = -np.sign(t) * scipy.special.ndtri(np.maximum(p, 1e-300))
    return out


def highest(z: FloatArray, chart: ControlChart) -> float:
    """The furthest that a chart of values (n,) in sigmas gets, in sigmas as its limit."""
    if chart.kind == "cusum":
        return max(float(_heights(side * z).max()) for side in (1.0, -1.0))
    return float(np.abs(_ewma(z)).max()) / _SETTLED


def alarm(z: FloatArray, chart: ControlChart) -> int | None:
    """Index of the first value (n,) in sigmas that is an alarm; None without."""
    if chart.kind == "cusum":
        beyond = (_heights(z) > chart.limit) | (_heights(-z) > chart.limit)
        return int(np.argmax(beyond)) - 1 if beyond.any() else None
    beyond = np.abs(_ewma(z)) > chart.limit * _SETTLED
    return int(np.argmax(beyond)) if beyond.any() else None


def _heights(z: FloatArray) -> FloatArray:
    """Of a CUSUM (n + 1,), from zero."""
    walk = np.concatenate([[0.0], np.cumsum(z - REFERENCE)])
    heights: FloatArray = walk - np.minimum.accumulate(walk)
    return heights


def _ewma(z: FloatArray) -> FloatArray:
    level: FloatArray = scipy.signal.lfilter([WEIGHT], [1.0, WEIGHT - 1.0], z)
    return level
