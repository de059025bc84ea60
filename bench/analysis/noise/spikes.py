"""Single means that stand out of all others: a lost frame, a knock at the chamber, a digit that was misread."""

from __future__ import annotations

import numpy as np

from bench.base import BoolArray, FloatArray

_BENT = 0.297  # of the second differences of white noise: its distance from the median of five, medians of the sizes
_CERTAIN = 8.0  # robust deviations, 5.9 standard deviations: no Gaussian noise reaches them, and a floor keeps its tail


def despike(residual: FloatArray, limit: float = 6.0) -> BoolArray:
    """Rows (n,) to keep: those that have a value within `limit` robust standard deviations of the median of five
    neighbours.

    For the residual of the present model, before anything else: a few spikes make a run look noisier than it is. The
    limit is 4.4 standard deviations of white noise, as half of the rows are near the median of their neighbours. A step
    or a slow error is not a spike. Where an error changes by more than its noise from row to row, most rows are the
    median of their neighbours: the noise is that of the second differences then.
    """
    keep = np.isfinite(residual)
    known = residual[keep]
    if known.size < 5:
        return keep
    around = np.median(np.lib.stride_tricks.sliding_window_view(np.pad(known, 2, mode="reflect"), 5), axis=1)
    off = known - around
    deviation = 1.4826 * max(float(np.median(np.abs(off))), _BENT * float(np.median(np.abs(np.diff(known, 2)))))
    if deviation > 0.0:
        keep[keep] = np.abs(off) <= limit * deviation
    return keep


def spiky(rate: FloatArray, rows: int) -> BoolArray:
    """Rows (n,) that lie in a mean over so many `rows` that is a spike."""
    means = np.pad(rate, (0, -len(rate) % rows), constant_values=np.nan).reshape(-1, rows)
    known = np.isfinite(means)
    count = known.sum(axis=1)
    mean = np.where(count > 0, np.where(known, means, 0.0).sum(axis=1) / np.maximum(count, 1), np.nan)
    return np.repeat(np.isfinite(mean) & ~despike(mean, _CERTAIN), rows)[: len(rate)]
