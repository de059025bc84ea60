"""Single means that stand out of all others."""

from __future__ import annotations

import numpy as np

from bench.base import BoolArray, FloatArray, despike

_CERTAIN = 8.0  # robust deviations, 5.9 standard deviations: no Gaussian noise reaches them, and a floor keeps its tail


def spiky(rate: FloatArray, rows: int) -> BoolArray:
    """Rows (n,) that lie in a mean over so many `rows` that is a spike."""
    means = np.pad(rate, (0, -len(rate) % rows), constant_values=np.nan).reshape(-1, rows)
    known = np.isfinite(means)
    count = known.sum(axis=1)
    mean = np.where(count > 0, np.where(known, means, 0.0).sum(axis=1) / np.maximum(count, 1), np.nan)
    return np.repeat(np.isfinite(mean) & ~despike(mean, _CERTAIN), rows)[: len(rate)]
