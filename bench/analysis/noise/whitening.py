"""Whitening of means of a gyro's rate in O(n): white noise + flicker + rate random walk, gaps allowed.

The covariance of means over `interval_s` is sigma^2 C with C = I + rho_f F + rho_r R:

* I is the white noise, sigma^2 = N^2 / interval [h];
* F is flicker of B = 1 deg/h, S(f) = B^2/(2 pi f): Ornstein-Uhlenbeck processes with log-spaced time constants;
* R is a rate random walk of K = 1 deg/h/sqrt(h) that starts at zero with the record.

Both are averaged over the interval exactly: off the diagonal the mean of an OU process is an OU process again and the
mean of a walk is the walk at mid-interval, so averaging only changes a gain and the diagonal. C is therefore
semiseparable with one state to each time constant, and its Cholesky factor follows from the recursion of
D. Foreman-Mackey et al., "Fast and scalable Gaussian process modeling", AJ 154 (2017) 220, here a block of rows at a
time: what earlier rows know of a block is taken from its covariance, and what is left is factorised densely. Making a
whitener and whitening a matrix are a few small matrix products a block; whitened row i depends on rows up to i only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from bench.base import FloatArray

_RATIO = 4.0  # of neighbouring time constants: the sum is within 1.5 % of 1/f (tests/test_whitening.py)
_LONGEST_S = 131072.0  # 36 h: beyond any run, where flicker is a constant to the fit
_LEAST_APART = 0.7  # intervals: nearer ones would overlap, and C, which is that of whole means, not be positive
_BLOCK = 32
_FEW = 8  # columns up to which one LAPACK call goes through the blocks faster than a product for each


@dataclass(frozen=True)
class Ratios:
    """Noise relative to the white variance of one mean: flicker B^2/sigma^2, walk K^2/sigma^2 [1/h]."""

    flicker: float = 0.0
    walk: float = 0.0


@dataclass(frozen=True)
class _Shape:
    """Covariance of means for unit flicker: OU time constants [s], gains off the diagonal, term on the diagonal."""

    tau_s: FloatArray
    gain: FloatArray
    diagonal: float

    @staticmethod
    def of(interval_s: float) -> _Shape:
        poles = int(np.ceil(np.log(_LONGEST_S / interval_s) / np.log(_RATIO))) + 2
        tau_s: FloatArray = interval_s * np.power(_RATIO, np.arange(-1.0, poles - 1))
        x = interval_s / tau_s
        variance = np.log(_RATIO) / np.pi
        gain = variance * (np.sinh(x / 2.0) / (x / 2.0)) ** 2
        # Time constants below the first are white in the means: their sum is a geometric series.
        faster = variance * 2.0 * tau_s[0] / interval_s / (_RATIO - 1.0)
        diagonal = float(np.sum(variance * 2.0 * (x - 1.0 + np.exp(-x)) / x**2) + faster)
        return _Shape(tau_s, gain, diagonal)


def _apart(time_s: FloatArray, interval_s: float) -> FloatArray:
    """Mid times (n,) [s] moved apart where gaps within the intervals brought them nearer than whole ones can be."""
    steps = _LEAST_APART * interval_s * np.arange(len(time_s))
    near = np.any(np.diff(time_s) < _LEAST_APART * interval_s)
    return np.maximum.accumulate(time_s - steps) + steps if near else time_s


def covariance(time_s: FloatArray, interval_s: float, ratios: Ratios, white: FloatArray | None = None) -> FloatArray:
    """Dense C (n, n) [1] of means at mid times (n,) [s]: what the recursion factorises. `white` (n,) replaces I."""
    shape, time_s = _Shape.of(interval_s), _apart(time_s, interval_s)
    lag = np.abs(time_s[:, None] - time_s[None, :])
    since_h = (time_s - time_s[0] + interval_s / 2.0) / 3600.0
    dense: FloatArray = ratios.walk * np.minimum(since_h[:, None], since_h[None, :])
    for tau, gain in zip(shape.tau_s, shape.gain, strict=True):
        dense += ratios.flicker * gain * np.exp(-lag / tau)
    diagonal = np.ones(len(time_s)) if white is None else white
    np.fill_diagonal(
        dense, diagonal + ratios.flicker * shape.diagonal + ratios.walk * (since_h - interval_s / 3600.0 / 6.0)
    )
    return dense


def flicker_by_lag(rows: int, interval_s: float) -> FloatArray:
    """Covariance (rows,) of means that are 0, 1, 2 … intervals apart, of flicker of B = 1 deg/h [(deg/h)^2]."""
    shape = _Shape.of(interval_s)
    lag_s = np.arange(rows, dtype=np.float64) * interval_s
    lags = np.zeros(rows)
    for tau, gain in zip(shape.tau_s, shape.gain, strict=True):
        lags += gain * np.exp(-lag_s / tau)
    lags[0] = shape.diagonal
    return lags


@dataclass(frozen=True, eq=False)
class Whitener:
    """W with W C W' = I for one record, C as above; `log_det` is ln |C|.

    `transfer` are matrices (blocks, states + 32, states + 32): [state, rows] before a block to [state, whitened rows]
    after it. `white` (n,) is the diagonal of C where there is neither flicker nor walk, None elsewhere.
    """

    ratios: Ratios
    log_det: float
    rows: int
    transfer: FloatArray
    white: FloatArray | None = None

    @staticmethod
    def of(ratios: Ratios, time_s: FloatArray, interval_s: float, white: FloatArray | None = None) -> Whitener:
        """For increasing mid times (n,) [s]; `white` (n,) scales the white variance of means over fewer samples."""
        return Recursion(time_s, interval_s, white).whiteners([ratios])[0]

    def apply(self, matrix: FloatArray) -> FloatArray:
        """W @ matrix for columns (n, k) or one vector (n,), in the precision of the matrix."""
        if self.white is not None:  # no row depends on another
            diagonal = (1.0 / np.sqrt(self.white)).astype(matrix.dtype)
            return np.asarray(matrix * (diagonal if matrix.ndim == 1 else diagonal[:, None]))
        columns = matrix.reshape(self.rows, -1)
        few = 0 < columns.shape[1] <= _FEW and columns.dtype == np.float64
        return (self._few(columns) if few else self._many(columns)).reshape(matrix.shape)

    @cached_property
    def _band(self) -> FloatArray:
        """The recursion of the states (2 states, blocks * states), a unit triangle in LAPACK's banded form."""
        count, states = len(self.transfer), self.transfer.shape[1] - _BLOCK
        row, column = np.indices((states, states))
        band = np.zeros((2 * states, count + 1, states))
        band[states + row - column, :count, column] = -self.transfer[:, :states, :states].transpose(1, 2, 0)
        return np.asfortranarray(band.reshape(2 * states, -1))

    def _few(self, columns: FloatArray) -> FloatArray:
        """The same of a few columns (n, k): all blocks at once."""
        states = self.transfer.shape[1] - _BLOCK
        rows = self._blocks(columns)[:, states:]
        known = np.zeros((len(rows) + 1, states, rows.shape[2]))  # before each block
        np.matmul(self.transfer[:, :states, states:], rows, out=known[1:])  # from its rows alone
        known = scipy.linalg.lapack.dtbtrs(self._band, known.reshape(-1, rows.shape[2]), uplo="L", diag="U")[0].reshape(
            known.shape
        )
        white = self.transfer[:, states:, states:] @ rows
        white += self.transfer[:, states:, :states] @ known[:-1]
        return white.reshape(-1, rows.shape[2])[: self.rows]

    def _many(self, columns: FloatArray) -> FloatArray:
        """The same of many columns (n, k): one block after the other, so that what is worked on stays in the cache."""
        states, white = self.transfer.shape[1] - _BLOCK, np.empty_like(columns)
        before = np.zeros((states + _BLOCK, columns.shape[1]), columns.dtype)
        after = np.empty_like(before)
        begins = range(0, self.rows, _BLOCK)
        for transfer, begin in zip(self.transfer.astype(columns.dtype, copy=False), begins, strict=True):
            rows = columns[begin : begin + _BLOCK]
            before[states : states + len(rows)] = rows
            before[states + len(rows) :] = 0.0
            np.dot(transfer, before, out=after)
            white[begin : begin + _BLOCK] = after[states : states + len(rows)]
            before[:states] = after[:states]
        return white

    def colour(self, matrix: FloatArray) -> FloatArray:
        """W^-1 @ matrix for columns (n, k): turns independent normal numbers into this noise with white variance 1."""
        states = self.transfer.shape[1] - _BLOCK
        both = self._blocks(matrix.reshape(self.rows, -1))
        before = np.zeros_like(both[0, :states])
        for transfer, block in zip(self.transfer, both, strict=True):
            known = transfer[states:, :states] @ before
            block[states:] = np.linalg.solve(transfer[states:, states:], block[states:] - known)
            block[:states] = before
            before = transfer[:states] @ block
        return both[:, states:].reshape(len(both) * _BLOCK, both.shape[2])[: self.rows].reshape(matrix.shape)

    def _blocks(self, columns: FloatArray) -> FloatArray:
        """Blocks (blocks, states + 32, k): states of zero, the rows (n, k), zeros after the last."""
        blocks, width, _ = self.transfer.shape
        both = np.zeros((blocks, width, columns.shape[1]), columns.dtype)
        whole = self.rows // _BLOCK
        both[:whole, width - _BLOCK :] = columns[: whole * _BLOCK].reshape(whole, _BLOCK, columns.shape[1])
        rest = columns[whole * _BLOCK :]
        if len(rest):
            both[whole, width - _BLOCK :][: len(rest)] = rest
        return both


class Recursion:
    """What the whiteners of rows at mid times (n,) [s] have in common; `white` (n,) as for `Whitener.of`."""

    def __init__(self, time_s: FloatArray, interval_s: float, white: FloatArray | None = None) -> None:
        """Covariances within each block, and of each of its rows with the states at its end, for unit ratios."""
        shape, time_s = _Shape.of(interval_s), _apart(time_s, interval_s)
        self._rows = len(time_s)
        self._white = np.ones(self._rows) if white is None else white
        padding = (0, -self._rows % _BLOCK)
        time, present = np.pad(time_s, padding, mode="edge"), np.pad(np.ones(self._rows), padding)
        since_h = (time - time_s[0] + interval_s / 2.0) / 3600.0 * present
        end_s = time[_BLOCK - 1 :: _BLOCK]
        entry_s = np.concatenate([time[:1], end_s[:-1]])
        time, since_h, present = (values.reshape(-1, _BLOCK) for values in (time, since_h, present))
        lag_s = np.abs(time[:, :, None] - time[:, None, :])
        both = present[:, :, None] * present[:, None, :]
        self._flicker, self._walk = np.zeros(lag_s.shape), np.minimum(since_h[:, :, None], since_h[:, None, :])
        for tau, gain in zip(shape.tau_s, shape.gain, strict=True):
            self._flicker += gain * np.exp(-lag_s / tau) * both
        rows = np.arange(_BLOCK)
        self._flicker[:, rows, rows] = shape.diagonal * present
        self._walk[:, rows, rows] -= interval_s / 3600.0 / 6.0 * present
        self._diagonal = np.zeros(lag_s.shape)
        self._diagonal[:, rows, rows] = np.pad(self._white, padding, constant_values=1.0).reshape(-1, _BLOCK)
        rate = np.append(1.0 / shape.tau_s, 0.0)  # a walk does not fade
        self._seen = np.exp(-(time - entry_s[:, None])[:, :, None] * rate) * present[:, :, None]
        self._fade = np.exp(-(end_s - entry_s)[:, None] * rate)
        self._pushed = np.exp(-rate[:, None] * (end_s[:, None] - time)[:, None, :]) * present[:, None, :]
        self._pushed[:, :-1] *= shape.gain[:, None]
        self._pushed[:, -1] *= since_h

    def whiteners(self, ratios: Sequence[Ratios]) -> list[Whitener]:
        """One for each of the ratios."""
        flicker = np.array([r.flicker for r in ratios])[:, None, None, None]
        walk = np.array([r.walk for r in ratios])[:, None, None, None]
        blocks, states, _ = self._pushed.shape
        own = flicker * self._flicker
        own += walk * self._walk
        own += self._diagonal
        pushed = np.concatenate([np.repeat(flicker, states - 1, axis=2), walk], axis=2) * self._pushed
        carried = np.zeros((len(ratios), states, states))  # covariance of the states that the rows so far explain
        told = np.empty_like(pushed)
        transfer = np.empty((len(ratios), blocks, states + _BLOCK, states + _BLOCK))
        inverse = transfer[:, :, states:, states:]
        for block in range(blocks):
            seen, fade = self._seen[block], self._fade[block]
            known = seen @ carried
            lower = np.linalg.cholesky(own[:, block] - known @ seen.T)
            # A tenth of the work of a full inverse.
            inverse[:, block] = inverted = np.array([scipy.linalg.lapack.dtrtri(one.T)[0].T for one in lower])
            told[:, block] = each = (pushed[:, block] - fade[:, None] * known.mT) @ inverted.mT
            carried = fade[:, None] * carried * fade + each @ each.mT
        transfer[:, :, states:, :states] = -(inverse @ self._seen)
        transfer[:, :, :states, states:] = told @ inverse
        transfer[:, :, :states, :states] = told @ transfer[:, :, states:, :states]
        transfer[:, :, range(states), range(states)] += self._fade
        log_det = -2.0 * np.log(np.diagonal(inverse, axis1=2, axis2=3)).sum(axis=(1, 2))
        made = zip(ratios, log_det.tolist(), transfer, strict=True)
        return [Whitener(r, d, self._rows, t, self._white if r == Ratios() else None) for r, d, t in made]
