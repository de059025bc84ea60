"""The Allan deviation of a rate record, with gaps.

Overlapping estimator of IEEE Std 952-1997 annex C; a term counts only if every sample it spans is present.
The degrees of freedom are those of S. Stein, "Frequency and time: their measurement and characterization" (1985),
as in IEEE Std 1139, for the noise type that the local slope suggests.

Differences are taken in pieces that stay in the cache, from left to right: each averaging time reads the phase from
memory once.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from bench.analysis.noise.probability import chi2_quantile
from bench.base import FloatArray, InputError, IntArray

SECONDS_PER_HOUR = 3600.0
FLICKER_FLOOR = float(np.sqrt(2.0 * np.log(2.0) / np.pi))
"""Allan deviation of flicker noise with coefficient B = 1 deg/h [deg/h] (IEEE 952: 0.664)."""

_PIECE = 24576  # doubles: the phase, first and second differences of a piece stay in the second-level cache
_OVERLAP = _PIECE // 8  # averaging times up to this recompute the overlap of pieces, longer ones have none


@dataclass(frozen=True)
class AllanCurve:
    """Allan deviation [deg/h] over averaging time [s] with its 95 % band and the number of terms, each (m,)."""

    tau_s: FloatArray
    deviation_dph: FloatArray
    low_dph: FloatArray
    high_dph: FloatArray
    counts: IntArray


def allan_deviation(rate_dph: FloatArray, interval_s: float, taus_s: FloatArray | None = None) -> AllanCurve:
    """Exact overlapping Allan deviation of a rate record (n,) [deg/h]; NaN marks a missing sample.

    Without `taus_s` ten averaging times a decade up to a third of the record. Times are rounded to whole samples and
    those without a single complete term are left out. Raises InputError when nothing can be said.
    """
    phase, missing = _phase(rate_dph)
    samples = len(rate_dph)
    factors = _decade_factors(samples) if taus_s is None else np.unique(np.rint(np.asarray(taus_s) / interval_s))
    terms = [(int(m), *_mean_square(phase, missing, int(m))) for m in factors if m >= 1]
    return _curve(terms, interval_s, samples)


def _phase(rate_dph: FloatArray) -> tuple[FloatArray, IntArray | None]:
    """Angle at the edges of the samples (n+1,) [deg/h x samples] and the number of samples missing before each edge.

    None stands for no sample missing.
    """
    phase, missing = np.empty(len(rate_dph) + 1), None
    phase[0] = 0.0
    with np.errstate(all="ignore"):
        total = float(np.sum(rate_dph))
    if len(rate_dph) >= 3 and np.isfinite(total):  # one look instead of two where nothing is missing
        np.subtract(rate_dph, total / len(rate_dph), out=phase[1:])
    else:
        present = np.isfinite(rate_dph)
        if (count := int(np.count_nonzero(present))) < 3:
            raise InputError(f"the Allan deviation needs at least 3 samples, {count} present")
        phase[1:] = np.where(present, rate_dph - np.mean(rate_dph, where=present), 0.0)
        missing = np.concatenate([[0], np.cumsum(~present)]).astype(np.int64)
    np.cumsum(phase, out=phase)
    return phase, missing


def _mean_square(phase: FloatArray, missing: IntArray | None, m: int) -> tuple[float, int]:
    """Mean square of the second difference over m, and the number of complete terms."""
    square, count = 0.0, 0
    for start, second in _second_differences(phase, m):
        whole = second
        if missing is not None:
            stop = start + len(second)
            whole = second[missing[start + 2 * m : stop + 2 * m] == missing[start:stop]]
        square += float(whole @ whole)
        count += len(whole)
    return (square / count, count) if count else (0.0, 0)


def _second_differences(phase: FloatArray, m: int) -> Iterator[tuple[int, FloatArray]]:
    """Pieces of x[i + 2m] - 2 x[i + m] + x[i], each with its first i; the next piece overwrites the last."""
    terms = len(phase) - 2 * m
    if m <= _OVERLAP:
        first, second = np.empty(_PIECE + m), np.empty(_PIECE)
        for start in range(0, terms, _PIECE):
            rows = min(_PIECE, terms - start)
            np.subtract(phase[start + m : start + rows + 2 * m], phase[start : start + rows + m], out=first[: rows + m])
            yield start, np.subtract(first[m : rows + m], first[:rows], out=second[:rows])
        return
    # Columns of the phase wrapped at m: the first difference below is the one above at the next step.
    width = -(-m // -(-m // _PIECE))
    above, below, second = np.empty(width), np.empty(width), np.empty(width)
    for column in range(0, min(m, max(terms, 0)), width):
        rows = min(width, m - column, terms - column)
        np.subtract(phase[column + m : column + m + rows], phase[column : column + rows], out=above[:rows])
        for start in range(column, terms, m):
            rows = min(rows, terms - start)
            here = slice(start + m, start + m + rows)
            np.subtract(phase[start + 2 * m : start + 2 * m + rows], phase[here], out=below[:rows])
            yield start, np.subtract(below[:rows], above[:rows], out=second[:rows])
            above, below = below, above


def _curve(terms: list[tuple[int, float, int]], interval_s: float, samples: int) -> AllanCurve:
    kept = sorted({m: (square, count) for m, square, count in terms if count > 0 and square > 0}.items())
    if not kept:
        raise InputError("the Allan deviation has no complete term: record too short, too full of gaps or constant")
    factors = np.array([m for m, _ in kept], dtype=np.float64)
    tau_s = factors * interval_s
    deviation = np.sqrt(np.array([square for _, (square, _) in kept]) / 2.0) / factors
    counts = np.array([count for _, (_, count) in kept], dtype=np.int64)
    # A record with gaps is worth as much as a whole one with the same number of terms.
    whole = np.minimum(samples, counts + 2 * factors - 1)
    slope = np.gradient(np.log(deviation), np.log(tau_s)) if len(tau_s) > 1 else np.array([-0.5])
    freedom = np.array([_freedom(n, m, s) for n, m, s in zip(whole, factors, slope, strict=True)])
    low = deviation * np.sqrt(freedom / chi2_quantile(0.975, freedom))
    high = deviation * np.sqrt(freedom / chi2_quantile(0.025, freedom))
    return AllanCurve(tau_s, deviation, low, high, counts)


def _freedom(n: float, m: float, slope: float) -> float:
    """Equivalent degrees of freedom for n samples averaged by m; white, flicker or walk by the slope."""
    n = n + 1  # the formulas count phase points
    if slope < -0.25:
        value = (3 * (n - 1) / (2 * m) - 2 * (n - 2) / n) * 4 * m**2 / (4 * m**2 + 5)
    elif slope < 0.25:
        value = 2 * (n - 2) / (2.3 * n - 4.9) * (n - 2) if m == 1 else 5 * n**2 / (4 * m * (n + 3 * m))
    else:
        value = (n - 2) / m * ((n - 1) ** 2 - 3 * m * (n - 1) + 4 * m**2) / (n - 3) ** 2 if n > 3 else 1.0
    return max(1.0, float(value))


def _decade_factors(samples: int) -> FloatArray:
    top = max(1, samples // 3)
    return np.unique(np.rint(np.logspace(0.0, np.log10(top), 1 + int(10 * np.log10(top)))))
