"""The second source paper's calibration: the input quantity as a surface over the raw output and the temperature.

Equation: Rate(NR, T) = sum_m C_m u^i v^j, i + j <= n, u and v the raw output NR and the temperature T mapped to
[-1, 1]; n = 5 has 21 coefficients, C0 ... C20 by total degree, then falling power of NR: 1, u, v, u^2, u v, v^2, ...
De-normalised coefficients stand in the same order for NR^i T^j.
Data: rate steps at fixed temperatures and temperature steps at fixed rates; at each rate the temperature is cut into
bins of equal width, and each bin is the mean of all its samples and counts as one point: a long soak counts no more
than a quick passage.
Two ways to the same coefficients, which must agree: least squares by QR, and discrete orthogonal polynomials (G. E.
Forsythe, J. SIAM 5 (1957) 74; two variables by repeated orthogonalisation of products).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import comb

import numpy as np

from bench.analysis.effects.base import Scale
from bench.analysis.effects.surface import surface_powers
from bench.analysis.fit.solve import one_blas_thread, solve
from bench.analysis.thresholds import LEAST_RANGE_DEGC, MOST_CONDITION
from bench.base import DPH_PER_DPS, BoolArray, FloatArray, InputError, IntArray
from bench.record import Dataset

BIN_DEGC = 2.0
SAMPLES = 2
"""Least number of samples behind each bin."""
LEVEL_SHARE = 0.01
"""References closer than this share of their range are one step of the table."""
AGREEMENT = 1e-9
"""Greatest relative difference between the two ways."""


@dataclass(frozen=True, eq=False)
class Points:
    """Means of bins (n,): raw output, temperature [degC], reference; `left_out` bins had too few."""

    raw: FloatArray
    temperature: FloatArray
    reference: FloatArray
    left_out: int = 0


@dataclass(frozen=True, eq=False)
class RateSurface:
    """A fitted surface; `normalised` and `coefficients` (N,) stand in the order of `powers`."""

    order: int
    raw: Scale
    temperature: Scale
    normalised: FloatArray
    rms: float
    condition: float
    disagreement: float
    """Greatest difference to the surface by orthogonal polynomials, over the points, relative to the reference."""

    @property
    def powers(self) -> tuple[tuple[int, int], ...]:
        """(i, j) of C0, C1, ..."""
        return surface_powers(self.order)

    @property
    def coefficients(self) -> FloatArray:
        """De-normalised coefficients of NR^i T^j, computed exactly and rounded once."""
        sums = {power: Fraction(0) for power in self.powers}
        raw, temperature = _shifts(self.raw, self.order), _shifts(self.temperature, self.order)
        for value, (i, j) in zip(self.normalised.tolist(), self.powers, strict=True):
            for p in range(i + 1):
                for q in range(j + 1):
                    sums[p, q] += Fraction(value) * raw[i][p] * temperature[j][q]
        return np.array([float(sums[power]) for power in self.powers])

    def predict(self, raw: FloatArray, temperature: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Input quantity (n,), and where a point was outside the fitted box: there it is clamped, not extrapolated."""
        u, v = self.raw.unit(raw), self.temperature.unit(temperature)
        inside = np.clip(u, -1.0, 1.0), np.clip(v, -1.0, 1.0)
        outside = (np.abs(u) > 1.0 + 1e-12) | (np.abs(v) > 1.0 + 1e-12)
        return monomials(*inside, self.order) @ self.normalised, outside


def monomials(u: FloatArray, v: FloatArray, order: int) -> FloatArray:
    """Columns u^i v^j (n, N) in the order of `surface_powers`."""
    return np.column_stack([u**i * v**j for i, j in surface_powers(order)])


def points_of(dataset: Dataset) -> Points:
    """Binned points of a run on a rate table, raw output and reference in deg/s. InputError where it has no table."""
    raw, reference = dataset.own_rate / DPH_PER_DPS, dataset.channel("applied_rate")
    return binned(raw, dataset.channel("temperature"), reference)


def binned(
    raw: FloatArray,
    temperature: FloatArray,
    reference: FloatArray,
    bin_degc: float = BIN_DEGC,
    samples: int = SAMPLES,
) -> Points:
    """Means over bins of equal width in temperature at each step of the reference.

    Bins of fewer than `samples` rows are left out. Raises InputError where no bin has enough.
    """
    groups, left_out = bin_rows(raw, temperature, reference, bin_degc, samples)
    means = [_means(values, groups) for values in (raw, temperature, reference)]
    return Points(means[0], means[1], means[2], left_out)


def binned_record(record: Dataset) -> Dataset:
    """The bins of a run as the rows of a record, in the order of their mean times: every bin counts the same."""
    temperature, applied = (record.channel(name) for name in ("temperature", "applied_rate"))
    return means_of(record, bin_rows(record.own_rate, temperature, applied, BIN_DEGC, SAMPLES)[0])


def means_of(record: Dataset, groups: Sequence[IntArray]) -> Dataset:
    """Means over groups of rows as the rows of a record, in the order of their mean times."""
    time = _means(record.time, groups)
    order = np.argsort(time, kind="stable")
    # Bins that interleave may have one mean time; a record's rows have each their own.
    time = time[order] + 1e-6 * np.arange(len(groups))
    channels = {name: _means(column, groups)[order] for name, column in record.channels.items()}
    segment = np.array([record.segment[group[0]] for group in groups], dtype=np.int64)[order]
    return Dataset(
        record.name,
        time,
        channels,
        segment,
        record.segments,
        record.interval_s,
        corrected=record.corrected,
        unit=record.unit,
    )


def _means(values: FloatArray, groups: Sequence[IntArray]) -> FloatArray:
    return np.array([values[group].mean() for group in groups])


def bin_rows(
    raw: FloatArray, temperature: FloatArray, reference: FloatArray, bin_degc: float, samples: int
) -> tuple[list[IntArray], int]:
    """Rows of each bin, and how many bins had fewer than `samples`. InputError where no bin has enough."""
    rows = np.flatnonzero(np.isfinite(raw) & np.isfinite(temperature) & np.isfinite(reference))
    if rows.size == 0:
        raise InputError("no row with raw output, temperature and reference: the surface needs a run on a table")
    cell = np.floor((temperature[rows] - temperature[rows].min()) / bin_degc).astype(np.int64)
    _, label = np.unique(np.column_stack([_levels(reference[rows]), cell]), axis=0, return_inverse=True)
    groups = np.split(np.argsort(label, kind="stable"), np.cumsum(np.bincount(label.ravel()))[:-1])
    kept = [rows[group] for group in groups if group.size >= samples]
    if not kept:
        raise InputError(
            f"no bin of {bin_degc:g} degC has {samples} samples at one rate; record longer, or widen the bins"
        )
    return kept, len(groups) - len(kept)


def _levels(reference: FloatArray) -> IntArray:
    """Number of the step of the table to which each row belongs (n,)."""
    order = np.argsort(reference, kind="stable")
    least = LEVEL_SHARE * max(float(np.ptp(reference)), 1e-12)
    level = np.zeros(reference.size, dtype=np.int64)
    level[order] = np.cumsum(np.diff(reference[order], prepend=reference[order][0]) > least)
    return level


def fit_surface(points: Points, order: int = 5) -> RateSurface:
    """Surface through the points, by both ways. InputError: too few points, rates or degC; the ways do not agree."""
    size = (order + 1) * (order + 2) // 2
    levels = int(_levels(points.reference).max()) + 1
    if points.raw.size < size or levels <= order:
        raise InputError(
            f"surface of order {order}: {points.raw.size} points at {levels} rates, it needs {size} at {order + 1}; "
            "record more steps or lower the order"
        )
    raw, temperature = (Scale(float(v.min()), float(v.max())) for v in (points.raw, points.temperature))
    if temperature.half * 2 < LEAST_RANGE_DEGC:
        raise InputError(f"surface: the temperature moves by {2 * temperature.half:.3g} degC only")
    columns = monomials(raw.unit(points.raw), temperature.unit(points.temperature), order)
    with one_blas_thread():
        solution = solve(columns, points.reference, np.ones(points.raw.size))
    if not solution.condition < MOST_CONDITION:
        raise InputError(
            f"surface of order {order} is not determined by these points (condition {solution.condition:.1g}): too few "
            "different temperatures; record more steps or lower the order"
        )
    other = orthogonal(raw.unit(points.raw), temperature.unit(points.temperature), points.reference, order)
    apart = float(np.abs(columns @ (solution.beta - other)).max() / np.abs(points.reference).max())
    if not apart <= AGREEMENT:
        raise InputError(
            f"surface: least squares and orthogonal polynomials differ by {apart:.2g}, limit {AGREEMENT:g}"
        )
    rms = float(np.sqrt(np.mean(solution.residual**2)))
    return RateSurface(order, raw, temperature, solution.beta, rms, solution.condition, apart)


def orthogonal(u: FloatArray, v: FloatArray, y: FloatArray, order: int) -> FloatArray:
    """Coefficients (N,) of u^i v^j by polynomials that are orthogonal over these points: no system is solved.

    Each new polynomial is an earlier one times u or v, less its parts along all before it, twice for rounding.
    """
    powers = surface_powers(order)
    at = {power: k for k, power in enumerate(powers)}
    basis, monomial = np.zeros((len(powers), u.size)), np.zeros((len(powers), len(powers)))
    for k, (i, j) in enumerate(powers):
        if k == 0:
            values, own = np.ones(u.size), np.eye(1, len(powers))[0]
        else:
            factor, before = (u, (i - 1, j)) if i else (v, (i, j - 1))
            values, own = factor * basis[at[before]], np.zeros(len(powers))
            for m, (a, b) in enumerate(powers[: at[before] + 1]):
                own[at[(a + 1, b) if i else (a, b + 1)]] = monomial[at[before], m]
        for _ in range(2):
            along = basis[:k] @ values
            values, own = values - along @ basis[:k], own - along @ monomial[:k]
        size = float(np.linalg.norm(values))
        basis[k], monomial[k] = values / size, own / size
    # Projected one after the other on what is left: rounding of the first does not enter the last.
    left, out = y.copy(), np.zeros(len(powers))
    for k in range(len(powers)):
        amplitude = float(basis[k] @ left)
        left, out = left - amplitude * basis[k], out + amplitude * monomial[k]
    return out


def _shifts(scale: Scale, order: int) -> list[list[Fraction]]:
    """Coefficient of x^p in ((x - centre) / half)^i: [i][p]."""
    centre, half = Fraction(scale.centre), Fraction(scale.half)
    return [[comb(i, p) * (-centre) ** (i - p) / half**i for p in range(i + 1)] for i in range(order + 1)]
