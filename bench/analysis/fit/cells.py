"""Sums of a record in cells of temperature: every cubic spline with knots on borders of cells follows from them.

The range of temperature is cut into equal cells. Each keeps twelve sums of its rows, with u in [-1, 1] inside the cell
and y less a fixed offset: of u^0 .. u^6, of y u^0 .. y u^3, and of y^2. Sums of two records add; cells join into wider
ones without loss. A thermal record stays in one cell for seconds: a stretch that does is summed by a few dot products,
and only a stretch that crosses a border is cut smaller, to no loss. Far cheaper than a matrix product.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from math import comb
from typing import ClassVar

import numpy as np

from bench.base import FloatArray, InputError, IntArray

POWERS, PRODUCTS = 7, 4
SUMS = POWERS + PRODUCTS + 1
"""Numbers of a cell: its powers, its products with y, the square of y."""
STRETCH = 1 << 13
_LEAF = 1 << 9


@dataclass(frozen=True)
class Cells:
    """`cells` equal cells over [low, high] [degC]; `offset` [deg/h] is taken off y before it is summed."""

    low: float
    high: float
    cells: int
    offset: float = 0.0
    needs: ClassVar[tuple[str, ...]] = ("temperature",)

    @property
    def size(self) -> int:
        """Numbers of its sums."""
        return SUMS * self.cells

    def sums(self, columns: Mapping[str, FloatArray], y: FloatArray) -> FloatArray:
        """Sums (12 cells,) of rows; InputError where a temperature lies outside the range."""
        return self.of(columns["temperature"], y)

    def of(self, x: FloatArray, y: FloatArray, weight: FloatArray | None = None) -> FloatArray:
        """Sums (12 cells,) of temperature and y (n,), each row counted `weight` times; NaN where one has a gap.

        InputError where a temperature lies outside the range.
        """
        total = np.zeros((self.cells, SUMS))
        if not x.size:
            return total.ravel()
        starts = np.arange(0, x.size, _LEAF)
        low, high = np.minimum.reduceat(x, starts), np.maximum.reduceat(x, starts)
        if not self._inside(float(low.min()), float(high.max())):
            return np.full(self.size, np.nan)
        if weight is not None:
            self._weighted(x, y, weight, total)
            return total.ravel()
        first, last = self._cell(low), self._cell(high)
        label = np.where(first == last, first, -1)
        cuts = [0, *(np.flatnonzero(np.diff(label)) + 1).tolist(), label.size]
        crossing = [np.zeros(0, dtype=np.int64)]
        work = np.empty((5, min(STRETCH, x.size)))
        work[4] = 1.0
        for begin, end in pairwise(cuts):
            rows = begin * _LEAF, min(end * _LEAF, x.size)
            if label[begin] >= 0:
                self._stretch(x, y, rows, work, total[label[begin]], int(label[begin]))
            else:
                crossing.append(np.arange(*rows))
        several = np.concatenate(crossing)
        if several.size:
            self._sorted(x[several], y[several], work, total)
        return total.ravel()

    def _inside(self, low: float, high: float) -> bool:
        """Whether these are numbers within the range; InputError where they are numbers beyond it."""
        slack = 1e-9 * (self.high - self.low)
        if low < self.low - slack or high > self.high + slack:
            raise InputError(
                f"temperatures {low:.6g} to {high:.6g} degC lie outside the cells from {self.low:.6g} to "
                f"{self.high:.6g} degC"
            )
        return math.isfinite(low) and math.isfinite(high)

    def _cell(self, x: FloatArray) -> IntArray:
        v = (x - self.low) * (self.cells / (self.high - self.low))
        return np.clip(v.astype(np.int64), 0, self.cells - 1)

    def _stretch(
        self, x: FloatArray, y: FloatArray, rows: tuple[int, int], work: FloatArray, own: FloatArray, cell: int
    ) -> None:
        """Add rows that all lie in one cell."""
        unit = self._centre(cell), 2.0 * self.cells / (self.high - self.low)
        z = work[3]
        for start in range(*rows, STRETCH):
            stop = min(start + STRETCH, rows[1])
            np.subtract(y[start:stop], self.offset, out=z[: stop - start])
            _add(x[start:stop], z[: stop - start], unit, work, own)

    def _sorted(self, x: FloatArray, y: FloatArray, work: FloatArray, total: FloatArray) -> None:
        """Add rows that lie in several cells, put in the order of the cells."""
        cell = self._cell(x)
        order = np.argsort(cell.astype(np.uint16), kind="stable")
        x, y, cell = x[order], y[order], cell[order]
        cuts = [0, *(np.flatnonzero(np.diff(cell)) + 1).tolist(), x.size]
        for begin, end in pairwise(cuts):
            self._stretch(x, y, (begin, end), work, total[cell[begin]], int(cell[begin]))

    def _centre(self, cell: int) -> float:
        return self.low + (cell + 0.5) * (self.high - self.low) / self.cells

    def _weighted(self, x: FloatArray, y: FloatArray, weight: FloatArray, total: FloatArray) -> None:
        cell = self._cell(x)
        first = int(cell.min())
        cell -= first
        many = int(cell.max()) + 1
        centre = self.low + (cell + first + 0.5) * (self.high - self.low) / self.cells
        u = (x - centre) * (2.0 * self.cells / (self.high - self.low))
        centred, power = y - self.offset, weight
        own = total[first : first + many]
        own[:, -1] += np.bincount(cell, power * centred**2, many)
        for k in range(POWERS):
            own[:, k] += np.bincount(cell, power, many)
            if k < PRODUCTS:
                own[:, POWERS + k] += np.bincount(cell, power * centred, many)
            power = power * u

    def joined(self, sums: FloatArray, intervals: int) -> FloatArray:
        """Sums (..., 12 cells) in wider cells (..., intervals, 12); InputError where they do not divide the cells."""
        if self.cells % intervals:
            raise InputError(
                f"{intervals} intervals do not divide the {self.cells} cells of the pass; allowed are "
                f"{', '.join(map(str, divisors(self.cells)))}"
            )
        each = self.cells // intervals
        own = sums.reshape(-1, intervals, each * SUMS)
        return (own @ _joining(each)).reshape(*sums.shape[:-1], intervals, SUMS)


def divisors(cells: int) -> list[int]:
    """Numbers of intervals that a pass with so many cells can give."""
    return [m for m in range(1, cells + 1) if cells % m == 0]


def _add(x: FloatArray, z: FloatArray, unit: tuple[float, float], work: FloatArray, own: FloatArray) -> None:
    """Add rows of one cell to its twelve sums by dot products: they stay in the first-level cache."""
    u, square, cube, _, ones = work[:, : x.size]
    np.subtract(x, unit[0], out=u)
    u *= unit[1]
    np.multiply(u, u, out=square)
    np.multiply(u, square, out=cube)
    dot = np.dot
    own += (
        x.size, dot(u, ones), dot(square, ones), dot(u, square), dot(square, square), dot(square, cube),
        dot(cube, cube), dot(z, ones), dot(z, u), dot(z, square), dot(z, cube), dot(z, z),
    )  # fmt: skip


@lru_cache(maxsize=64)
def _joining(each: int) -> FloatArray:
    """Matrix (12 each, 12) from the sums of `each` neighbouring cells to those of the one cell that they make."""
    out = np.zeros((each, SUMS, SUMS))
    for cell in range(each):
        centre, half = (2 * cell + 1) / each - 1.0, 1.0 / each  # u of the wide cell = centre + half u
        for k in range(POWERS):
            for j in range(k + 1):
                share = comb(k, j) * centre ** (k - j) * half**j
                out[cell, j, k] = share
                if k < PRODUCTS:
                    out[cell, POWERS + j, POWERS + k] = share
        out[cell, -1, -1] = 1.0
    matrix = out.reshape(each * SUMS, SUMS)
    matrix.flags.writeable = False
    return matrix
