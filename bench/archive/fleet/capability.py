"""Capability of a process against its limits: Cpk and Ppk with intervals, and the number of values outside."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from bench.archive.fleet.charts import D2
from bench.base import FloatArray

LEAST = 8
_EFFICIENCY = 0.62
"""Degrees of freedom of the mean moving range, of those of a standard deviation."""


@dataclass(frozen=True)
class Capability:
    """`cpk` by the spread of neighbours, `ppk` by that of all; 95 % intervals; NaN where nothing varies."""

    count: int
    mean: float
    cpk: float
    cpk_interval: tuple[float, float]
    ppk: float
    ppk_interval: tuple[float, float]
    outside: int


def capability(values: FloatArray, lower: float | None, upper: float | None) -> Capability | None:
    """Capability of finite values (n,) in order of time against one limit or two; None below eight values.

    Source: A. F. Bissell, Applied Statistics 39 (1990) 331, for the interval.
    """
    n = values.size
    if n < LEAST or (lower is None and upper is None):
        return None
    low, high = -np.inf if lower is None else lower, np.inf if upper is None else upper
    mean = float(np.mean(values))
    near = float(np.mean(np.abs(np.diff(values)))) / D2
    far = float(np.std(values, ddof=1))
    room = min(mean - low, high - mean)
    cpk, ppk = (room / (3 * sigma) if sigma > 0 else np.nan for sigma in (near, far))
    outside = int(np.sum((values < low) | (values > high)))
    intervals = (_interval(cpk, n, _EFFICIENCY * (n - 1)), _interval(ppk, n, n - 1.0))
    return Capability(n, mean, cpk, intervals[0], ppk, intervals[1], outside)


def _interval(index: float, n: int, freedom: float) -> tuple[float, float]:
    half = float(scipy.special.ndtri(0.975)) * np.sqrt(1 / (9 * n) + index**2 / (2 * freedom))
    return index - half, index + half


def proportion(part: int, whole: int) -> tuple[float, float]:
    """95 % interval of a proportion. Source: E. B. Wilson, J. Am. Stat. Assoc. 22 (1927) 209."""
    if whole == 0:
        return np.nan, np.nan
    found = scipy.stats.binomtest(part, whole).proportion_ci(0.95, method="wilson")
    return float(found.low), float(found.high)
