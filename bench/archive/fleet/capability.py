"""Capability of a process against its limits: Cpk and Ppk with intervals, and the number of values outside.

Room over three sigma says how many units are outside only where the values are normal. Where they are skewed, they are
transformed to normal values first, limits included (G. E. P. Box, D. R. Cox, J. R. Stat. Soc. B 26 (1964) 211;
I.-K. Yeo, R. A. Johnson, Biometrika 87 (2000) 954). Where that
does not help, Ppk is that of a normal process with the share of values that was found outside, with the exact interval
of that share, and there is no Cpk.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import scipy

from bench.archive.fleet.charts import D2
from bench.base import FloatArray

LEAST = 8
_EFFICIENCY = 0.62
"""Degrees of freedom of the mean moving range, of those of a standard deviation."""
_LEAST_SHAPE, _CERTAIN = 20, 1e-3
_SKEWED, _HEAVY = 0.5, 0.7
"""Skewness, and excess of the kurtosis, from which on the share outside is another than that of a normal process."""
Shape = Literal["normal", "transformed", "counted"]


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
    shape: Shape = "normal"
    """How the indices were found: from normal values, from transformed ones, from the share outside."""


def capability(values: FloatArray, lower: float | None, upper: float | None) -> Capability | None:
    """Capability of finite values (n,) in order of time against one limit or two; None below eight values.

    Source: A. F. Bissell, Applied Statistics 39 (1990) 331, for the interval.
    """
    if values.size < LEAST or (lower is None and upper is None):
        return None
    low, high = -np.inf if lower is None else lower, np.inf if upper is None else upper
    found = _of_normal(values, low, high)
    if _normal(values):
        return found
    moved, ends = _transformed(values, low, high)
    if not _normal(moved):
        return replace(found, cpk=np.nan, cpk_interval=(np.nan, np.nan), **_counted(values, low, high))
    return replace(_of_normal(moved, *ends), mean=found.mean, outside=found.outside, shape="transformed")


def _normal(values: FloatArray) -> bool:
    """Whether nothing says that more are in the tails than in those of a normal distribution."""
    if values.size < _LEAST_SHAPE or np.ptp(values) == 0.0:
        return True
    off = abs(float(scipy.stats.skew(values))) > _SKEWED or float(scipy.stats.kurtosis(values)) > _HEAVY
    return not (off and float(scipy.stats.normaltest(values).pvalue) < _CERTAIN)


def _transformed(values: FloatArray, low: float, high: float) -> tuple[FloatArray, tuple[float, float]]:
    """Values (n,) and limits by the power transformation that makes them most like normal ones.

    That of Box and Cox where all values are positive, that of Yeo and Johnson of standardised values anywhere.
    """
    centre, scale = float(np.median(values)), float(np.std(values))
    ways: list[tuple[Callable[..., Any], FloatArray, tuple[float, float]]] = [
        (scipy.stats.yeojohnson, (values - centre) / scale, ((low - centre) / scale, (high - centre) / scale))
    ]
    if values.min() > 0.0:
        ways.append((scipy.stats.boxcox, values / centre, (max(low, 0.0) / centre, high / centre)))
    made = []
    for transform, given, ends in ways:
        moved, power = transform(given)
        made.append((moved, (_moved(transform, ends[0], float(power)), _moved(transform, ends[1], float(power)))))
    return max(made, key=lambda one: float(scipy.stats.normaltest(one[0]).pvalue))


def _moved(transform: Callable[..., Any], end: float, power: float) -> float:
    """A limit, transformed; infinite where there is none, or where the transformation never reaches it."""
    if not np.isfinite(end) or (transform is scipy.stats.boxcox and end <= 0.0):
        return float(np.copysign(np.inf, end if end != 0.0 else -1.0))
    moved = float(transform(np.array([end]), power)[0])
    return moved if np.isfinite(moved) else float(np.copysign(np.inf, end))


def _counted(values: FloatArray, low: float, high: float) -> dict[str, Any]:
    """Ppk of the share outside; its upper end is infinite where none is."""
    outside, n = int(np.sum((values < low) | (values > high))), values.size
    share = scipy.stats.binomtest(outside, n).proportion_ci(0.95, method="exact")
    best, worst, middle = (
        -float(scipy.special.ndtri(one)) / 3.0 for one in (share.low, share.high, (outside + 0.5) / (n + 1))
    )
    return {"ppk": middle, "ppk_interval": (worst, best), "shape": "counted"}


def _of_normal(values: FloatArray, low: float, high: float) -> Capability:
    n, mean = values.size, float(np.mean(values))
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
