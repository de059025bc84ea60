"""Sums of products of a linear model's columns, gathered in one pass without ever holding the columns of all rows.

Two things keep the accuracy of an orthogonal factorisation at the price of normal equations. Every channel is scaled to
[-1, 1] and enters as Chebyshev polynomials. And what is nearly dependent all the same (frequency is nearly a function
of temperature) is replaced, before it is summed, by what a small sample of the rows leaves of it beside the other
columns; the bias itself is taken relative to a fit to that sample. The Gram matrix of such columns has a condition of
order one, where that of the columns themselves squares theirs. Only dependent columns pay for it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import scipy

from bench.analysis.effects.base import Series
from bench.analysis.fit.normal import Normal
from bench.base import FloatArray

STRETCH = 1 << 13
SAMPLE = 4000
"""Rows from which dependence is read."""
_DEPENDENT = 0.03
"""A column is replaced when less than this share of it is left beside the columns before it."""

Columns = Mapping[str, FloatArray]
Design = Callable[[Columns, FloatArray], None]
"""Writes the rows of a transposed design matrix (p, n) of these channels, the constant first."""


@dataclass(frozen=True)
class ChebyshevRows:
    """Design of [1, T_1..T_order of each channel]; all of one order."""

    series: tuple[Series, ...]

    def __call__(self, columns: Columns, out: FloatArray) -> None:
        """Write the rows (1 + channels * order, n)."""
        order, many = self.series[0].order, len(self.series)
        out[0] = 1.0
        table = out[1 : 1 + order * many].reshape(many, order, -1)
        first = table[:, 0]
        for row, one in zip(first, self.series, strict=True):
            np.subtract(columns[one.channel], one.scale.centre, out=row)
        first *= self._slopes
        recur([np.ones(1), *(table[:, k] for k in range(order))])

    @cached_property
    def _slopes(self) -> FloatArray:
        return np.array([[1.0 / one.scale.half] for one in self.series])


def recur(rows: Sequence[FloatArray]) -> None:
    """Write Chebyshev polynomials T_2.. into rows[2:], from rows[0] = 1 and rows[1] = T_1; rows of any shape."""
    if len(rows) > 2:
        twice = 2.0 * rows[1]
    for k in range(2, len(rows)):
        np.multiply(twice, rows[k - 1], out=rows[k])
        rows[k] -= rows[k - 2]


@dataclass(frozen=True, eq=False)
class Gram:
    """Sums of products of [columns, y] after `mix` (p + 1, p + 1): triangle of a symmetric matrix.

    `mixed` are the rows of `mix` that are not those of the identity.
    """

    needs: tuple[str, ...]
    width: int
    design: Design
    mix: FloatArray = field(repr=False)

    @classmethod
    def of(cls, needs: tuple[str, ...], width: int, design: Design, columns: Columns, y: FloatArray) -> Gram:
        """Preconditioned by a sample of rows without gaps, spread over what is known; it need not be exact."""
        table = np.empty((width, y.size))
        design({name: columns[name] for name in needs}, table)
        return cls.mixed(needs, design, table, y)

    @classmethod
    def mixed(cls, needs: tuple[str, ...], design: Design, table: FloatArray, y: FloatArray) -> Gram:
        """Preconditioned by the columns (p, n) of a sample."""
        width = len(table)
        mix = _mixing(np.vstack([table, y])) if y.size > width else np.eye(width + 1)
        return cls(needs, width, design, mix)

    @property
    def size(self) -> int:
        """Numbers of its sums."""
        return (self.width + 1) * (self.width + 2) // 2

    def sums(self, columns: Columns, y: FloatArray) -> FloatArray:
        """Sums (size,) of rows without gaps."""
        total = np.zeros((self.width + 1, self.width + 1))
        table = np.empty((self.width + 1, min(STRETCH, y.size)))
        mixing, mixed = self.mix[self._mixed], np.empty((self._mixed.size, table.shape[1]))
        for start in range(0, y.size, STRETCH):
            part = slice(start, start + STRETCH)
            own = table[:, : y[part].size]
            self.design({name: columns[name][part] for name in self.needs}, own)
            own[-1] = y[part]
            if self._mixed.size:
                own[self._mixed] = np.matmul(mixing, own, out=mixed[:, : own.shape[1]])
            for row in range(len(own)):  # half the work of a product of matrices, and BLAS packs nothing
                total[row, row:] += own[row:] @ own[row]
        sums: FloatArray = total[self._upper]
        return sums

    def normal(self, sums: FloatArray) -> Normal:
        """The quadratic form of sums (..., size)."""
        full = np.zeros((*sums.shape[:-1], self.width + 1, self.width + 1))
        full[..., self._upper[0], self._upper[1]] = sums
        full[..., self._upper[1], self._upper[0]] = sums
        n = self.width
        # Inner columns A M', inner y = y - A start: coefficients of A are M' b + start.
        return Normal(
            full[..., :n, :n], full[..., :n, n], full[..., n, n], full[..., 0, 0],
            self.mix[:n, :n].T, -self.mix[n, :n],
        )  # fmt: skip

    @cached_property
    def _upper(self) -> tuple[np.ndarray, np.ndarray]:
        return np.triu_indices(self.width + 1)

    @cached_property
    def _mixed(self) -> np.ndarray:
        return np.flatnonzero(np.any(self.mix != np.eye(self.width + 1), axis=1))


def _mixing(table: FloatArray) -> FloatArray:
    """Rows of [columns, y] (p + 1, n) made nearly orthonormal where they are not: y always, columns where it pays."""
    size = len(table)
    scale = np.linalg.norm(table, axis=1) / np.sqrt(table.shape[1])
    mix = np.eye(size)
    if np.any(scale[:-1] == 0.0) or not np.all(np.isfinite(scale)):
        return mix
    r = scipy.linalg.qr((table / scale[:, None]).T, mode="r")[0][:size] / np.sqrt(table.shape[1])
    left = np.abs(np.diag(r))
    for row in range(1, size):
        is_y = row == size - 1
        if not is_y and (left[row] >= _DEPENDENT or left[row] < 1e-13):
            continue
        share = (
            scipy.linalg.solve_triangular(r[:row, :row], r[:row, row]) if np.all(left[:row] > 1e-13) else np.zeros(row)
        )
        own = np.zeros(size)
        own[row], own[:row] = 1.0 / scale[row], -share / scale[:row]
        # The rest to order one, so that no digit of a small remainder is lost; y keeps its unit.
        mix[row] = own * (scale[row] if is_y else 1.0 / left[row])
    return mix
