"""Sums for a surface in two channels: products of polynomials are polynomials, so 66 sums stand for a 21 x 21 matrix.

T_i T_k = (T_i+k + T_|i-k|) / 2 in each channel, therefore the Gram matrix of all T_i(x) T_j(z) with i + j <= p follows
from the sums of T_i(x) T_j(z) with i + j <= 2p. In their place stand P_i = T_i up to i = p and P_p+j = T_p T_j, which
cost half as much and are the same up to a well-conditioned triangular change of basis.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bench.channels import FloatArray
from bench.effects.base import Series
from bench.fit.gram import Columns, recur
from bench.fit.normal import Normal

STRETCH = 1 << 13
"""Rows at once: both tables of polynomials stay in the second-level cache."""
_PACK = 1 << 11
"""Rows of one matrix product: what BLAS packs of them stays there too."""
_TILE = 8
"""Columns of the matrix product; what reaches beyond is short and cheaper as products with vectors."""


@dataclass(frozen=True)
class Products:
    """Sums of P_i(x) P_j(z), of y T_i(x) T_j(z) and of y^2; `terms` are the (i, j) of the model, (0, 0) first."""

    x: Series
    z: Series
    terms: tuple[tuple[int, int], ...]
    offset: float = 0.0

    @property
    def order(self) -> int:
        """Highest total degree p."""
        return self.x.order

    @property
    def needs(self) -> tuple[str, ...]:
        """Channels of the two."""
        return self.x.channel, self.z.channel

    @property
    def size(self) -> int:
        """Numbers of its sums."""
        return (2 * self.order + 1) ** 2 + (self.order + 1) ** 2 + 1

    def sums(self, columns: Columns, y: FloatArray) -> FloatArray:
        """Sums (size,) of rows without gaps."""
        p, many = self.order, 2 * self.order + 1
        width = min(2 * p, _TILE)
        total, right, square = np.zeros((many, many)), np.zeros((p + 1, p + 1)), 0.0
        # Plane 0 has y T_0 .. y T_p, then P_0 .. P_2p of x; plane 1 has P_0 .. P_2p of z below the same rows.
        table = np.empty((p + 1 + many, 2, min(STRETCH, y.size)))
        table[p + 1] = 1.0
        for start in range(0, y.size, STRETCH):
            part = slice(start, start + STRETCH)
            own = table[:, :, : y[part].size]
            self._write(columns[self.x.channel][part], columns[self.z.channel][part], own[p + 1 :])
            yx, x, z = own[: p + 1, 0], own[p + 1 :, 0], own[p + 1 :, 1]
            np.subtract(y[part], self.offset, out=yx[0])
            np.multiply(x[1 : p + 1], yx[0], out=yx[1:])
            for at in range(0, yx.shape[1], _PACK):
                cut = slice(at, at + _PACK)
                sums = own[:-1, 0, cut] @ z[:width, cut].T
                right[:, : min(width, p + 1)] += sums[: p + 1, : p + 1]
                total[:-1, :width] += sums[p + 1 :]
            for j in range(width, many):
                total[: many - j, j] += x[: many - j] @ z[j]
            total[-1, 0] += np.add.reduce(x[-1])
            if p + 1 > width:  # order 1
                right[0, width:] += z[width : p + 1] @ yx[0]
            square += float(np.dot(yx[0], yx[0]))
        return np.concatenate([total.ravel(), right.ravel(), [square]])

    def _write(self, x: FloatArray, z: FloatArray, out: FloatArray) -> None:
        """P_0 .. P_2p of both (2p + 1, 2, n), at once; P_0 stands there already."""
        p, first = self.order, out[1]
        np.subtract(x, self.x.scale.centre, out=first[0])
        np.subtract(z, self.z.scale.centre, out=first[1])
        first *= self._slopes
        recur(list(out[: p + 1]))
        np.multiply(out[1 : p + 1], out[p], out=out[p + 1 :])

    @cached_property
    def _slopes(self) -> FloatArray:
        return np.array([[1.0 / self.x.scale.half], [1.0 / self.z.scale.half]])

    def normal(self, sums: FloatArray) -> Normal:
        """The quadratic form of sums (..., size) in the model's own columns; y less the offset."""
        p, many = self.order, 2 * self.order + 1
        lead = sums.shape[:-1]
        table = sums[..., : many**2].reshape(*lead, many, many)
        right = sums[..., many**2 : -1].reshape(*lead, p + 1, p + 1)
        chebyshev = self._basis @ table @ self._basis.T
        i, j = np.array(self.terms).T
        gram = np.zeros((*lead, i.size, i.size))
        for a in (i[:, None] + i, np.abs(i[:, None] - i)):
            for b in (j[:, None] + j, np.abs(j[:, None] - j)):
                gram += 0.25 * chebyshev[..., a, b]
        start = np.zeros(len(self.terms))
        start[0] = self.offset
        return Normal(gram, right[..., i, j], sums[..., -1], table[..., 0, 0], np.eye(len(self.terms)), start)

    @cached_property
    def _basis(self) -> FloatArray:
        """Matrix from P to T: T_p+j = 2 P_p+j - T_p-j."""
        p = self.order
        matrix = np.eye(2 * p + 1)
        for j in range(1, p + 1):
            matrix[p + j, p + j] = 2.0
            matrix[p + j, p - j] -= 1.0
        return matrix
