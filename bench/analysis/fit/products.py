"""Sums for a surface in two channels: products of polynomials are polynomials, so 66 sums stand for a 21 x 21 matrix.

T_i T_k = (T_i+k + T_|i-k|) / 2 in each channel, therefore the Gram matrix of all T_i(x) T_j(z) with i + j <= p follows
from the sums of T_i(x) T_j(z) with i + j <= 2p. In their place stand P_i, products of centred squares, which cost one
multiplication each and are the same up to a well-conditioned triangular change of basis. Only the triangle
i + j <= 2p is summed, column by column as products of a matrix with a vector: BLAS packs nothing for those.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.polynomial import chebyshev

from bench.analysis.effects.base import Series
from bench.analysis.fit.gram import Columns
from bench.analysis.fit.normal import Normal
from bench.base import FloatArray

STRETCH = 1 << 13
_CENTRE = {2: 0.5, 4: 0.125}
"""What is taken off the squares x x and P_2 P_2: they become T_2 / 2 and T_4 / 8, and their products stay apart."""


@dataclass(frozen=True)
class Products:
    """Sums of P_i(x) P_j(z), i + j <= 2p, of y P_i(x) P_j(z), i + j <= p, and of y^2.

    `terms` are the (i, j) of the model, (0, 0) first.
    """

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
        total, square = np.zeros((many, p + 1 + many)), 0.0
        # Plane 0 has y P_p .. y P_0, then P_0 .. P_2p of x; plane 1 has P_0 .. P_2p of z below the same rows. So what
        # a P_j(z) is multiplied with, y P_p-j .. y P_0 and P_0 .. P_2p-j, lies together.
        table = np.empty((p + 1 + many, 2, min(STRETCH, y.size)))
        table[p + 1] = 1.0
        for start in range(0, y.size, STRETCH):
            part = slice(start, start + STRETCH)
            own = table[:, :, : y[part].size]
            self._write(columns[self.x.channel][part], columns[self.z.channel][part], own[p + 1 :])
            x, z = own[:, 0], own[p + 1 :, 1]
            np.subtract(y[part], self.offset, out=x[p])
            np.multiply(x[p + 2 : 2 * p + 2], x[p], out=x[:p][::-1])
            for j in range(many):
                wanted = slice(min(j, p + 1), p + 1 + many - j)
                total[j, wanted] += x[wanted] @ z[j]
            square += float(np.dot(x[p], x[p]))
        return np.concatenate([total[:, p + 1 :].T.ravel(), total[: p + 1, p::-1].T.ravel(), [square]])

    def _write(self, x: FloatArray, z: FloatArray, out: FloatArray) -> None:
        """P_0 .. P_2p of both (2p + 1, 2, n), at once; P_0 stands there already."""
        first, many = out[1], len(out)
        np.subtract(x, self.x.scale.centre, out=first[0])
        np.subtract(z, self.z.scale.centre, out=first[1])
        first *= self._slopes
        np.multiply(first, first, out=out[2])
        out[2] -= _CENTRE[2]
        if many > 3:
            np.multiply(first, out[2], out=out[3])
            np.multiply(out[2], out[2], out=out[4])
            out[4] -= _CENTRE[4]
        for k in range(5, many, 4):
            own = out[k : k + 4]
            np.multiply(out[k - 4 : k - 4 + len(own)], out[4], out=own)

    @cached_property
    def _slopes(self) -> FloatArray:
        return np.array([[1.0 / self.x.scale.half], [1.0 / self.z.scale.half]])

    def normal(self, sums: FloatArray) -> Normal:
        """The quadratic form of sums (..., size) in the model's own columns; y less the offset."""
        p, many = self.order, 2 * self.order + 1
        lead = sums.shape[:-1]
        table = sums[..., : many**2].reshape(*lead, many, many)
        right = sums[..., many**2 : -1].reshape(*lead, p + 1, p + 1)
        moments = self._basis @ table @ self._basis.T
        i, j = np.array(self.terms).T
        gram = np.zeros((*lead, i.size, i.size))
        for a in (i[:, None] + i, np.abs(i[:, None] - i)):
            for b in (j[:, None] + j, np.abs(j[:, None] - j)):
                gram += 0.25 * moments[..., a, b]
        start = np.zeros(len(self.terms))
        start[0] = self.offset
        right = self._basis[: p + 1, : p + 1] @ right @ self._basis[: p + 1, : p + 1].T
        return Normal(gram, right[..., i, j], sums[..., -1], table[..., 0, 0], np.eye(len(self.terms)), start)

    @cached_property
    def _basis(self) -> FloatArray:
        """Matrix from P to T."""
        rows: list[FloatArray] = [np.ones(1), np.array([0.0, 1.0])]
        for k in range(2, 2 * self.order + 1):
            one, other = (1, 1) if k == 2 else (1, 2) if k == 3 else (2, 2) if k == 4 else (k - 4, 4)
            product = chebyshev.chebmul(rows[one], rows[other])
            product[0] -= _CENTRE.get(k, 0.0)
            rows.append(np.asarray(product, dtype=np.float64))
        own = np.array([np.pad(row, (0, len(rows) - len(row))) for row in rows])  # P as a series of T
        matrix: FloatArray = np.linalg.inv(own)
        return matrix
