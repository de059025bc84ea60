"""Units unlike their lot, by a robust distance over all quantities, which are correlated.

Each lot is centred by its medians; a robust estimate of the scatter within lots keeps a few odd units visible.
Source: R. A. Maronna, R. H. Zamar, Technometrics 44 (2002) 307 (orthogonalised Gnanadesikan-Kettenring estimate).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from bench.archive.fleet.groups import Coded, coded, median, medians
from bench.base import FloatArray

UNLIKELY = 0.01
"""Probability that any unit of a fleet without odd units is called odd."""
LEAST = 12


@dataclass(frozen=True)
class Odd:
    """A unit (by its row), its robust distance, the chance of such a one in the fleet, and the leading quantity."""

    row: int
    distance: float
    p: float
    quantity: str
    sigmas: float


def unlike(table: FloatArray, names: Sequence[str], lots: Sequence[str] | Coded) -> tuple[FloatArray, list[Odd]]:
    """Robust distances (n,) of the rows of a table (n, p), NaN for rows with gaps, and the odd units by distance."""
    distances = np.full(len(table), np.nan)
    whole = np.flatnonzero(np.all(np.isfinite(table), axis=1)) if table.size else np.zeros(0, dtype=np.int64)
    if whole.size < LEAST:
        return distances, []
    straight = np.column_stack([_straightened(column) for column in table[whole].T])
    lot = coded(lots).at(whole).code
    centre = np.column_stack([medians(column, lot) for column in straight.T])[lot]
    spread = 1.4826 * np.array([median(np.abs(column)) for column in (straight - centre).T])
    used = np.flatnonzero(spread > 0)
    if used.size == 0:
        return distances, []
    z = (straight - centre)[:, used] / spread[used]
    squared, freedom = _distances(z)
    squared *= scipy.special.chdtri(freedom, 0.5) / np.median(squared)
    distances[whole] = np.sqrt(squared)
    p = -np.expm1(whole.size * np.log1p(-np.minimum(scipy.special.chdtrc(freedom, squared), 1 - 1e-16)))
    odd = [
        Odd(int(whole[i]), float(np.sqrt(squared[i])), float(p[i]), names[used[lead]], float(z[i, lead]))
        for i in np.flatnonzero(p < UNLIKELY)
        for lead in [int(np.argmax(np.abs(z[i])))]
    ]
    return distances, sorted(odd, key=lambda one: -one.distance)


def _straightened(column: FloatArray) -> FloatArray:
    """The values, or their logarithms where these are less skewed (RMS values and noise densities are)."""
    if np.any(column <= 0) or np.ptp(column) == 0:
        return column
    logarithms: FloatArray = np.log(column)
    skew, logarithmic_skew = (abs(_skewness(values)) for values in (column, logarithms))
    return logarithms if logarithmic_skew < skew else column


def _skewness(values: FloatArray) -> float:
    centred = values - values.mean()
    return float(np.mean(centred * centred * centred) / np.mean(centred * centred) ** 1.5)


def _distances(z: FloatArray) -> tuple[FloatArray, int]:
    """Squared robust distances (n,) of centred, scaled rows (n, p), and in how many directions these scatter."""
    p = z.shape[1]
    correlation = np.eye(p)
    for i in range(p):
        for j in range(i):
            plus, minus = _spread(z[:, i] + z[:, j]) ** 2, _spread(z[:, i] - z[:, j]) ** 2
            correlation[i, j] = correlation[j, i] = (plus - minus) / 4
    _, axes = np.linalg.eigh(correlation)
    along = z @ axes
    spread = np.array([_spread(column) for column in along.T])
    usable = spread > 1e-9 * spread.max()
    squared: FloatArray = np.sum((along[:, usable] / spread[usable]) ** 2, axis=1)
    return squared, int(usable.sum())


def _spread(values: FloatArray) -> float:
    return float(1.4826 * median(np.abs(values - median(values))))
