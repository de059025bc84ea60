"""Whether a unit is like its lot: its bias over temperature, heating and cooling, beside that of all units of the lot.

No model is needed: a unit is the vector of its mean biases in cells of temperature, for each direction. Two statistics
of multivariate process control (J. E. Jackson, G. S. Mudholkar, Technometrics 21 (1979) 341): Hotelling's T^2 of the
principal components, for a unit that varies as its lot does, but too far; and Q, the sum of squares of what the
components leave, for a unit that varies otherwise. For a new unit beside n, T^2 n (n - q) / (q (n^2 - 1)) is
F(q, n - q). Q is compared with that of the lot's own units, each left out of the components it is compared with: its
logarithm is Student's t beside theirs. There are as many components as lower that Q of the units left out by much (S.
Wold, Technometrics 20 (1978) 397): a share of the variance would not do, since it is mostly that of the constants.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from bench.base import BoolArray, FloatArray, InputError, IntArray
from bench.record import Dataset

CELLS = 12
"""Cells of temperature, for each direction."""
LEAST_UNITS = 10
LEAST_CELLS = 4
REFUSED = 0.01
"""Share of the units of a lot that are refused by chance, half of them by each statistic."""
_PAYS = 0.7
"""Another component leaves less than this of the sum of Q."""
_UNITS_PER_COMPONENT = 8
_LEAST_REST = 1e-12  # (deg/h)^2: units that are all the same leave nothing
_LEAST_MOST = 2  # components that are tried at least


@dataclass(frozen=True, eq=False)
class Cells:
    """Borders of the cells of temperature (m + 1,) [degC]."""

    borders: FloatArray

    @classmethod
    def over(cls, low_degc: float, high_degc: float) -> Cells:
        """Equal cells over a range."""
        return cls(np.linspace(low_degc, high_degc, CELLS + 1))

    @property
    def middles(self) -> FloatArray:
        """Temperature of each cell, cooling before heating (2 m,) [degC]."""
        return np.tile(0.5 * (self.borders[1:] + self.borders[:-1]), 2)

    def means(self, records: Sequence[Dataset]) -> FloatArray:
        """Mean bias of a unit in each cell, cooling before heating (2 m,) [deg/h]; NaN where it was not."""
        temperature = np.concatenate([record.channel("temperature") for record in records])
        bias = np.concatenate([record.bias for record in records])
        direction = np.concatenate([record.direction for record in records])
        cell = np.searchsorted(self.borders, temperature, side="right").astype(np.int64) - 1
        cell[temperature == self.borders[-1]] = self.borders.size - 2
        known = np.isfinite(bias) & (cell >= 0) & (cell < self.borders.size - 1)
        return np.concatenate([self._means(cell, bias, known & (direction == sign)) for sign in (-1, 1)])

    def _means(self, cell: IntArray, bias: FloatArray, rows: BoolArray) -> FloatArray:
        size = self.borders.size - 1
        count = np.bincount(cell[rows], minlength=size)
        total = np.bincount(cell[rows], bias[rows], size)
        return np.where(count > 0, total / np.maximum(count, 1), np.nan)


@dataclass(frozen=True)
class Likeness:
    """Both statistics of a unit as shares of their limits: above 1 it is unlike its lot."""

    level: float
    shape: float
    cells: int
    """Cells that the unit and its lot have in common."""
    worst_degc: float
    """Middle of the cell in which it is farthest from its lot."""
    sigmas: float
    """Distance there in standard deviations of the lot."""

    @property
    def like(self) -> bool:
        """Whether the lot's calibration may be used for it."""
        return self.level <= 1.0 and self.shape <= 1.0


def likeness(table: FloatArray, cells: Cells, units: Sequence[FloatArray]) -> list[Likeness]:
    """Compare the cells of units (2 m,) with those of the lot's units (n, 2 m).

    InputError: a lot of fewer than ten units, or a unit with less than four cells in common with it.
    """
    n = len(table)
    if n < LEAST_UNITS:
        raise InputError(f"a lot of {n} units does not tell what is unlike it; at least {LEAST_UNITS} are needed")
    lots: dict[bytes, _Components] = {}
    found = []
    for unit in units:
        common = np.isfinite(unit) & np.all(np.isfinite(table), axis=0)
        if common.sum() < LEAST_CELLS:
            low, high = cells.borders[[0, -1]]
            raise InputError(
                f"the run has {common.sum()} cells of temperature in common with the lot ({low:.0f} to {high:.0f} "
                f"degC), at least {LEAST_CELLS} are needed: heat or cool the unit through the lot's range"
            )
        if (key := common.tobytes()) not in lots:
            lots[key] = _Components.paying(table[:, common])
        found.append(_compared(lots[key], unit[common], cells.middles[common]))
    return found


@dataclass(frozen=True, eq=False)
class _Components:
    """Centre of units in some cells, standard deviations in these and along the components, largest first."""

    units: int
    centre: FloatArray
    spread: FloatArray
    deviations: FloatArray
    directions: FloatArray
    limit: float = np.nan
    """Of Q [(deg/h)^2]."""

    @classmethod
    def of(cls, known: FloatArray, most: int) -> _Components:
        """The first components of units (n, cells)."""
        n, centre = len(known), known.mean(axis=0)
        _, sizes, directions = np.linalg.svd(known - centre, full_matrices=False)
        return cls(n, centre, known.std(axis=0, ddof=1), sizes[:most] / np.sqrt(n - 1), directions[:most])

    @classmethod
    def paying(cls, known: FloatArray) -> _Components:
        """Those that pay on units left out, and the limit of Q beside them."""
        n = len(known)
        most = min(max(_LEAST_MOST, n // _UNITS_PER_COMPONENT), known.shape[1] - 1)
        rests = np.array([cls.of(np.delete(known, i, axis=0), most).rests(known[i]) for i in range(n)])
        left = rests.sum(axis=0)
        q = 1 + int(np.argmin(np.append(left[1:] < _PAYS * left[:-1], False)))
        logarithm = np.log(rests[:, q - 1])
        reach = scipy.stats.t.ppf(1.0 - REFUSED / 2, n - 1) * logarithm.std(ddof=1) * np.sqrt(1.0 + 1.0 / n)
        return replace(cls.of(known, q), limit=float(np.exp(logarithm.mean() + reach)))

    def level(self, own: FloatArray) -> float:
        """T^2 of a unit as a share of its limit."""
        n, q = self.units, len(self.deviations)
        scores = self.directions @ (own - self.centre) / self.deviations
        limit = q * (n * n - 1) / (n * (n - q)) * scipy.stats.f.ppf(1.0 - REFUSED / 2, q, n - q)
        return float(scores @ scores / limit)

    def rests(self, own: FloatArray) -> FloatArray:
        """Q of a unit [(deg/h)^2] beside one component, two and so on."""
        apart = own - self.centre
        return np.maximum(apart @ apart - np.cumsum((self.directions @ apart) ** 2), _LEAST_REST)


def _compared(lot: _Components, own: FloatArray, middles: FloatArray) -> Likeness:
    apart = np.abs(own - lot.centre) / lot.spread
    worst = int(apart.argmax())
    shape = float(lot.rests(own)[-1]) / lot.limit
    return Likeness(lot.level(own), shape, own.size, float(middles[worst]), float(apart[worst]))
