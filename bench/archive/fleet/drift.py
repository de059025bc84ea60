"""Separates drift of stations from differences of lots: value = lot + station + slope of the station x time.

A station that drifts moves the units of one lot against each other; a lot that differs moves all its units at once.
Slopes are therefore taken within lots. Units far from their lot are left out first, so that one bad unit does not
appear as a drift. p values come from the t distribution, with Holm's correction for the number of tests.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from bench.archive.fleet.charts import D2
from bench.base import BoolArray, FloatArray, IntArray

SIGNIFICANT = 0.01
DAY_S = 86400.0
LEAST = 8
_FAR = 5.0
"""Robust sigmas from the lot's median beyond which a unit is left out."""
_WEIGHT, _WIDTH = 0.2, 2.962
"""EWMA: weight of the newest value, limits in its sigmas (in control: one false alarm in 500 units on average)."""


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
    """Weighted mean of a station's latest units, in units of its limit; beyond +-1 the station has left its level."""

    @property
    def significant(self) -> bool:
        """Whether chance is an unlikely cause, given the number of tests."""
        return self.p < SIGNIFICANT


def drifts(
    values: FloatArray, time_s: FloatArray, stations: Sequence[str], lots: Sequence[str], quantity: str
) -> list[Drift]:
    """Slope of every station and offset of every lot for one quantity (n,); none where the data do not determine them.

    `corrected` corrects `p` afterwards.
    """
    lot = np.unique(np.asarray(lots, dtype=str), return_inverse=True)[1]
    keep = _near(values, lot)
    lot_names, lot = np.unique(np.asarray(lots, dtype=str)[keep], return_inverse=True)
    names, station = np.unique(np.asarray(stations, dtype=str)[keep], return_inverse=True)
    y, t = values[keep], time_s[keep] / DAY_S
    freedom = y.size - len(lot_names) - 2 * len(names) + 1
    if freedom < LEAST // 2:
        return []
    slopes = [_centred(t, station == i) for i in range(len(names))]
    offsets = [(station == i).astype(float) for i in range(1, len(names))]
    solved = _solve(np.column_stack([*offsets, *slopes]), y, lot, freedom)
    return [
        *_of_stations(solved, names.tolist(), station, t, quantity),
        *_of_lots(solved, lot_names.tolist(), lot, quantity),
    ]


@dataclass(frozen=True, eq=False)
class _Solved:
    """Least squares of y on columns (n, k) within lots: the remainder for lots and noise, and the covariance."""

    columns: FloatArray
    left: FloatArray
    beta: FloatArray
    covariance: FloatArray
    projector: FloatArray
    variance: float
    freedom: int

    def tested(self, value: float, along: FloatArray, extra: float = 0.0) -> tuple[float, float, float] | None:
        """Value, standard error and p of `along` @ beta (plus means of `extra` variance); None where not determined."""
        if np.linalg.norm(along - self.projector @ along) > 1e-6 * max(float(np.linalg.norm(along)), 1e-300):
            return None
        error = float(np.sqrt(max(float(along @ self.covariance @ along) + extra * self.variance, 0.0)))
        if error == 0.0:
            return None
        return value, error, float(2 * scipy.special.stdtr(self.freedom, -abs(value) / error))


def _solve(columns: FloatArray, y: FloatArray, lot: IntArray, freedom: int) -> _Solved:
    """Subtracts the means of the lots, possibly hundreds: the coefficients stay the same (Frisch, Waugh, Lovell)."""
    inside = columns - _means(columns, lot)[lot]
    scale = np.linalg.norm(inside, axis=0)
    known = scale > 1e-9 * np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    scale = np.where(known, scale, 1.0)
    unit = np.where(known, inside / scale, 0.0)
    inverse = scipy.linalg.pinv(unit, rtol=1e-10)
    beta = inverse @ (y - _means(y[:, None], lot)[lot, 0]) / scale
    left = y - columns @ beta
    variance = float(np.sum((left - _means(left[:, None], lot)[lot, 0]) ** 2)) / freedom
    projector = (inverse @ unit) * np.outer(1 / scale, scale)
    covariance = variance * (inverse @ inverse.T) / np.outer(scale, scale)
    return _Solved(columns, left, beta, covariance, projector.T, variance, freedom)


def _means(columns: FloatArray, group: IntArray) -> FloatArray:
    """Means (g, k) of the rows of each group."""
    count = np.bincount(group)
    return np.column_stack([np.bincount(group, column) / count for column in columns.T])


def _of_stations(
    solved: _Solved, names: Sequence[str], station: IntArray, t: FloatArray, quantity: str
) -> Iterator[Drift]:
    for i, name in enumerate(names):
        along = np.zeros(solved.beta.size)
        along[len(names) - 1 + i] = 1.0
        result = solved.tested(float(along @ solved.beta), along)
        own = np.flatnonzero(station == i)
        if result is not None and own.size >= LEAST:
            own = own[np.argsort(t[own], kind="stable")]
            late = ewma(solved.left[own] + solved.columns[own] @ solved.beta)
            yield Drift("station", str(name), quantity, *result, own.size, late)


def _of_lots(solved: _Solved, names: Sequence[str], lot: IntArray, quantity: str) -> Iterator[Drift]:
    """Each lot against the others, the most different first; later lots are not compared with it."""
    sizes = np.bincount(lot).astype(np.float64)
    means = _means(np.column_stack([solved.left, solved.columns]), lot)
    waiting = {i for i in range(len(names)) if sizes[i] >= 3}
    others = np.ones(len(names), dtype=bool)
    while waiting:
        found = {i: _against(solved, means, sizes, others & (np.arange(len(names)) != i), i) for i in waiting}
        tested = {i: result for i, result in found.items() if result is not None}
        if not tested:
            return
        first = min(tested, key=lambda i: tested[i][2])
        odd = tested[first][2] < SIGNIFICANT / len(names)
        for i in [first] if odd else sorted(tested):
            yield Drift("lot", str(names[i]), quantity, *tested[i], int(sizes[i]))
        if not odd:
            return
        waiting.discard(first)
        others[first] = False


def _against(
    solved: _Solved, means: FloatArray, sizes: FloatArray, others: BoolArray, i: int
) -> tuple[float, float, float] | None:
    total = float(sizes[others].sum())
    if total == 0.0:
        return None
    apart = means[i] - sizes[others] @ means[others] / total
    return solved.tested(float(apart[0]), apart[1:], 1 / sizes[i] + 1 / total)


def corrected(found: Sequence[Drift]) -> list[Drift]:
    """The drifts, least p first, after Holm's correction. Source: S. Holm, Scand. J. Stat. 6 (1979) 65."""
    ordered = sorted(found, key=lambda drift: drift.p)
    highest, out = 0.0, []
    for rank, drift in enumerate(ordered):
        highest = max(highest, min(1.0, drift.p * (len(ordered) - rank)))
        out.append(replace(drift, p=highest))
    return out


def ewma(values: FloatArray) -> float:
    """Last exponentially weighted mean of values (n,) in order of time, in units of its limit.

    Source: S. W. Roberts, Technometrics 1 (1959) 239.
    """
    sigma = float(np.mean(np.abs(np.diff(values)))) / D2 if values.size > 1 else 0.0
    if sigma == 0.0:
        return np.nan
    level = 0.0
    for value in values - np.median(values):
        level = _WEIGHT * value + (1 - _WEIGHT) * level
    return float(level / (_WIDTH * sigma * np.sqrt(_WEIGHT / (2 - _WEIGHT))))


def _near(values: FloatArray, lot: IntArray) -> BoolArray:
    centre = np.array([np.median(values[lot == i]) for i in range(lot.max() + 1)])[lot]
    spread = 1.4826 * float(np.median(np.abs(values - centre)))
    near: BoolArray = np.abs(values - centre) <= _FAR * spread if spread > 0 else np.ones(values.size, dtype=bool)
    return near


def _centred(t: FloatArray, own: BoolArray) -> FloatArray:
    return np.where(own, t - (t[own].mean() if own.any() else 0.0), 0.0)
