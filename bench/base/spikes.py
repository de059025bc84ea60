"""Values that stand alone among their neighbours: a lost frame, a knock at the chamber, a digit that was misread."""

from __future__ import annotations

import numpy as np

from bench.base.channels import BoolArray, FloatArray

_BENT = 0.297  # of the second differences of white noise: its distance from the median of five, medians of the sizes


def despike(residual: FloatArray, limit: float = 6.0, least: float = 0.0) -> BoolArray:
    """Rows (n,) to keep: those that have a value within `limit` robust standard deviations of the median of five
    neighbours.

    For the residual of the present model, before anything else: a few spikes make a run look noisier than it is. The
    limit is 4.4 standard deviations of white noise, as half of the rows are near the median of their neighbours. A step
    or a slow error is not a spike, nor what is no further from its neighbours than `least`.
    """
    keep = np.isfinite(residual)
    known = residual[keep]
    if known.size < 5:
        return keep
    off = known - _around(known)
    if most := max(limit * _scale(known, off), least):
        keep[keep] = np.abs(off) <= most
    return keep


def deviation(known: FloatArray) -> float:
    """Robust deviation of values (n,) without gaps, at least 5, from the median of five neighbours.

    Where they change by more than their noise from one to the next, most are the median of their neighbours: it is
    that of the second differences then.
    """
    return _scale(known, known - _around(known))


def _scale(known: FloatArray, off: FloatArray) -> float:
    """The same of values that are so far `off` (n,)."""
    return 1.4826 * max(float(np.median(np.abs(off))), _BENT * float(np.median(np.abs(np.diff(known, 2)))))


def _around(known: FloatArray) -> FloatArray:
    """Median (n,) of each value's five neighbours."""
    return np.asarray(np.median(np.lib.stride_tricks.sliding_window_view(np.pad(known, 2, mode="reflect"), 5), axis=1))
