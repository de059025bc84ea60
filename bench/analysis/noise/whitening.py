"""Whitening of means of a gyro's rate in O(n): white noise + flicker + rate random walk, gaps allowed.

The covariance of means over `interval_s` is sigma^2 C with C = I + rho_f F + rho_r R:

* I is the white noise, sigma^2 = N^2 / interval [h];
* F is flicker of B = 1 deg/h, S(f) = B^2/(2 pi f): Ornstein-Uhlenbeck processes with log-spaced time constants;
* R is a rate random walk of K = 1 deg/h/sqrt(h) that starts at zero with the record.

Both are averaged over the interval exactly: off the diagonal the mean of an OU process is an OU process again and the
mean of a walk is the walk at mid-interval, so averaging only changes a gain and the diagonal. C is therefore
semiseparable with one state to each time constant, and its Cholesky factor follows from the recursion of
D. Foreman-Mackey et al., "Fast and scalable Gaussian process modeling", AJ 154 (2017) 220. Rows are then taken in
blocks so that whitening a matrix is a few small matrix products; whitened row i depends on rows up to i only.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bench.base import FloatArray

_RATIO = 4.0  # of neighbouring time constants: the sum is within 1.5 % of 1/f (tests/test_whitening.py)
_LONGEST_S = 131072.0  # 36 h: beyond any run, where flicker is a constant to the fit
_BLOCK = 32


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


def covariance(time_s: FloatArray, interval_s: float, ratios: Ratios, white: FloatArray | None = None) -> FloatArray:
    """Dense C (n, n) [1] of means at mid times (n,) [s]: what the recursion factorises. `white` (n,) replaces I."""
    shape = _Shape.of(interval_s)
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


@dataclass(frozen=True)
class Whitener:
    """W with W C W' = I for one record, C as above; `log_det` is ln |C|."""

    ratios: Ratios
    log_det: float
    rows: int
    factor: tuple[FloatArray, FloatArray, FloatArray]
    """Weights (rows, states) and pivots (rows,) of the recursion, and how its states decay (rows, states)."""

    @cached_property
    def transfer(self) -> FloatArray:
        """Matrices (blocks, states + 32, states + 32): [state, rows] before a block to [state, whitened rows] after
        it. Made when it is needed: of the whiteners that are made ahead some never are.
        """
        return _transfer(*self.factor)

    @staticmethod
    def of(ratios: Ratios, time_s: FloatArray, interval_s: float, white: FloatArray | None = None) -> Whitener:
        """For increasing mid times (n,) [s]; `white` (n,) scales the white variance of means over fewer samples."""
        return whiteners([ratios], time_s, interval_s, white)[0]

    def apply(self, matrix: FloatArray) -> FloatArray:
        """W @ matrix for columns (n, k) or one vector (n,)."""
        if self.ratios == Ratios():  # white noise: no row depends on another
            diagonal = 1.0 / np.sqrt(self.factor[1])
            return np.asarray(matrix * (diagonal if matrix.ndim == 1 else diagonal[:, None]))

        def whiten(transfer: FloatArray, work: FloatArray, states: int) -> FloatArray:
            result: FloatArray = transfer @ work
            work[:states] = result[:states]
            return result[states:]

        return self._through(matrix, whiten)

    def colour(self, matrix: FloatArray) -> FloatArray:
        """W^-1 @ matrix for columns (n, k): turns independent normal numbers into this noise with white variance 1."""

        def colour(transfer: FloatArray, work: FloatArray, states: int) -> FloatArray:
            known = transfer[states:, :states] @ work[:states]
            work[states:] = np.linalg.solve(transfer[states:, states:], work[states:] - known)
            work[:states] = transfer[:states] @ work
            return work[states:]

        return self._through(matrix, colour)

    def _through(self, matrix: FloatArray, step: Callable[[FloatArray, FloatArray, int], FloatArray]) -> FloatArray:
        """Rows of a matrix block by block; `step` turns a block's rows and takes the states in `work` past it."""
        columns = matrix.reshape(self.rows, -1)
        blocks, width, _ = self.transfer.shape
        states = width - _BLOCK
        stacked = np.zeros((blocks * _BLOCK, columns.shape[1]))
        stacked[: self.rows] = columns
        work = np.zeros((width, columns.shape[1]))
        for block, transfer in enumerate(self.transfer):
            rows = slice(block * _BLOCK, (block + 1) * _BLOCK)
            work[states:] = stacked[rows]
            stacked[rows] = step(transfer, work, states)
        return stacked[: self.rows].reshape(matrix.shape)


def whiteners(
    ratios: Sequence[Ratios], time_s: FloatArray, interval_s: float, white: FloatArray | None = None
) -> list[Whitener]:
    """One Whitener for each of the ratios: the recursion over rows runs once for all of them."""
    if (
        len(ratios) == 1
    ):  # numpy sums a single column in another order: the digits would depend on the number of columns
        return whiteners([*ratios, *ratios], time_s, interval_s, white)[:1]
    shape = _Shape.of(interval_s)
    rows, many = len(time_s), len(ratios)
    flicker = np.array([r.flicker for r in ratios])
    walk = np.array([r.walk for r in ratios])
    since_h = (time_s - time_s[0] + interval_s / 2.0) / 3600.0
    steps = np.diff(time_s, prepend=time_s[0])
    decay = np.column_stack([np.exp(-steps[:, None] / shape.tau_s), np.ones(rows)])
    source = np.empty((many, len(shape.tau_s) + 1))
    source[:, :-1] = flicker[:, None] * shape.gain
    base = np.ones(rows) if white is None else white
    averaging = flicker * shape.diagonal - walk * interval_s / 3600.0 / 6.0
    diagonal = base + (averaging[:, None] + walk[:, None] * since_h)
    weights, pivots = _factorise(source, walk[:, None] * since_h, decay, diagonal)
    log_dets = np.log(pivots).sum(axis=1).tolist()
    factors = zip(ratios, log_dets, weights, pivots, strict=True)
    return [Whitener(ratio, log_det, rows, (weight, pivot, decay)) for ratio, log_det, weight, pivot in factors]


def _factorise(
    source: FloatArray, walked: FloatArray, decay: FloatArray, diagonal: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """C = L D L' with L = I + tril(1 w'): weights w (many, rows, states) and pivots D (many, rows)."""
    many, rows = diagonal.shape
    states = decay.shape[1]
    weights = np.empty((rows, states, many))
    pivots = np.empty((rows, many))
    gains = np.ascontiguousarray(source.T)
    carried = np.zeros((states, states, many))
    product = np.empty_like(carried)
    diagonals, walks = np.ascontiguousarray(diagonal.T), np.ascontiguousarray(walked.T)
    fade = (decay[:, :, None] * decay[:, None, :])[..., None]
    for row in range(rows):
        carried *= fade[row]
        known = carried.sum(axis=0)
        gains[-1] = walks[row]
        pivots[row] = diagonals[row] - known.sum(axis=0)
        gap = gains - known
        weights[row] = gap / pivots[row]
        np.multiply(gap[:, None, :], weights[row, None, :, :], out=product)
        carried += product
    return np.ascontiguousarray(weights.transpose(2, 0, 1)), np.ascontiguousarray(pivots.T)


def _transfer(weights: FloatArray, pivots: FloatArray, decay: FloatArray) -> FloatArray:
    """`Whitener.transfer`, all blocks at once."""
    rows, states = weights.shape
    blocks = -(-rows // _BLOCK)
    pad = blocks * _BLOCK - rows
    weights = np.pad(weights, ((0, pad), (0, 0))).reshape(blocks, _BLOCK, states)
    pivots = np.pad(pivots, (0, pad), constant_values=1.0).reshape(blocks, _BLOCK)
    decay = np.pad(decay, ((0, pad), (0, 0)), constant_values=1.0).reshape(blocks, _BLOCK, states)
    transfer = np.zeros((blocks, states + _BLOCK, states + _BLOCK))
    state = transfer[:, :states]
    state[:] = np.eye(states, states + _BLOCK)
    for row in range(_BLOCK):
        known = state[:, :, : states + row + 1]  # a row depends on none that comes later
        known *= decay[:, row, :, None]
        innovation = -known.sum(axis=1)
        innovation[:, -1] += 1.0
        known += weights[:, row, :, None] * innovation[:, None, :]
        transfer[:, states + row, : states + row + 1] = innovation / np.sqrt(pivots[:, row, None])
    return transfer
