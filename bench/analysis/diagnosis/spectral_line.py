"""The largest line in the spectrum of a whitened residual: its chance, its period off the grid, and its size.

The spectrum is taken of the whitened residual, where chance makes every line equally likely. Period and size belong to
the residual itself: sine and cosine are whitened and fitted beside the model's columns, generalised least squares, and
the period is refined between the neighbours of the line on the grid.
"""

from __future__ import annotations

import numpy as np

from bench.analysis.diagnosis.candidates import outside
from bench.analysis.noise.lines import refined
from bench.analysis.noise.whitening import Whitener
from bench.base import FloatArray, IntArray

_LONGEST_GAP = 100  # rows: longer ones, as between runs, are closed up


def rows_of(time_s: FloatArray, interval_s: float) -> IntArray:
    """Place of each row (n,) on an even grid, long gaps closed up."""
    steps = np.rint(np.diff(time_s, prepend=time_s[0]) / interval_s).astype(np.int64)
    return np.asarray(np.cumsum(np.minimum(steps, _LONGEST_GAP)))


def highest(whitened: FloatArray, row: IntArray) -> tuple[int, int, float, float]:
    """Cycles of the largest line in the length of the record, that length in rows, its power, and its chance.

    p = 1 - (1 - e^-max)^m; missing rows count as zero.
    """
    filled = np.zeros(int(row[-1]) + 1)
    filled[row] = whitened
    power = np.abs(np.fft.rfft(filled))[1:-1] ** 2 / float(whitened @ whitened)
    top = int(np.argmax(power))
    p = float(-np.expm1(len(power) * np.log1p(-np.exp(-power[top]))))
    return top + 1, len(filled), float(power[top]), p


def fitted(
    whitened: FloatArray, q: FloatArray, way: Whitener, row: IntArray, cycles: float
) -> tuple[float, FloatArray]:
    """Cycles of the line, refined, and the line itself (n,) [deg/h]; `whitened` (n,) is beside the basis `q`."""
    length = float(row[-1]) + 1.0

    def waves(each: FloatArray) -> FloatArray:
        phase = 2.0 * np.pi * np.multiply.outer(np.asarray(row, dtype=np.float64) / length, each)
        return np.hstack([np.cos(phase), np.sin(phase)])

    def gains(each: FloatArray) -> FloatArray:
        columns = outside(q, way.apply(waves(each)))
        pairs = np.stack([columns[:, : len(each)], columns[:, len(each) :]], axis=-1)
        product = np.einsum("nfk,n->fk", pairs, whitened)
        gram = np.einsum("nfk,nfl->fkl", pairs, pairs)
        solved = np.linalg.solve(
            gram + 1e-12 * np.trace(gram, axis1=1, axis2=2)[:, None, None] * np.eye(2), product[..., None]
        )
        return np.asarray(np.einsum("fk,fk->f", product, solved[..., 0]))

    found = refined(gains, cycles)
    line = waves(np.array([found]))
    beta = np.linalg.lstsq(outside(q, way.apply(line)), whitened, rcond=None)[0]
    return found, line @ beta
