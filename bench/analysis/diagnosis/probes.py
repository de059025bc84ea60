"""Where a model fails: the significance of structure in its residual, beside noise that is not white.

A probe is a set of columns Z. S = |U' r|^2 / sigma^2 with U a basis of (I - QQ') W Z and r = (I - QQ') W y, Q a basis
of the whitened model; chi-squared with rank U degrees of freedom if nothing is missing. Cells are shown one by one with
their own uncertainty. Alarm if the smallest p-value is below 0.003 / number of probes (Bonferroni).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
import scipy

from bench.analysis.diagnosis.candidates import Problem, orthonormal, outside
from bench.analysis.diagnosis.spectral_line import fitted, highest, rows_of
from bench.analysis.noise.likelihood import NoiseLattice, Point, Record, Surface
from bench.analysis.noise.probability import chi2_tail
from bench.analysis.noise.whitening import Whitener
from bench.analysis.thresholds import SETTLED_DEGC_PER_MIN
from bench.base import FloatArray

_LEVEL = 0.003  # of all probes together; noise of other kinds (telegraph, spikes) reaches it about three times as often
UNLIKE_FREEDOM = 3
"""White noise, flicker and walk."""
_DEPENDENT = 1e-4  # of a column's length outside the model, whitened: less is the model's own


Direction = Literal["heating", "cooling", "constant"]
SIGNS: dict[Direction, int] = {"heating": 1, "cooling": -1, "constant": 0}


class Cell(NamedTuple):
    """A range of temperature [degC] in one direction; the ends to three digits."""

    direction: Direction
    low: float
    high: float


@dataclass(frozen=True)
class Probe:
    """Columns (n, m) that show one kind of misfit; `cells` (m,) where each column is a cell of its own."""

    name: str
    columns: FloatArray
    cells: tuple[Cell, ...] = ()


@dataclass(frozen=True)
class Finding:
    """What one probe says: p-value, statistic and its degrees of freedom.

    `shape` (n,) is the fitted misfit [deg/h]; `estimates` and `deviations` (m,) [deg/h] belong to the probe's columns.
    """

    name: str
    p: float
    statistic: float
    rank: int
    shape: FloatArray
    cells: tuple[Cell, ...] = ()
    estimates: FloatArray | None = None
    deviations: FloatArray | None = None
    note: str = ""


@dataclass(frozen=True)
class Examination:
    """All findings, most significant first; `level` is the p-value below which there is an alarm."""

    findings: tuple[Finding, ...]
    level: float

    @property
    def alarms(self) -> tuple[Finding, ...]:
        """Findings that chance does not explain."""
        return tuple(f for f in self.findings if f.p < self.level)

    @property
    def places(self) -> tuple[Finding, ...]:
        """Findings that show where an effect acts that was found by its evidence: ten times the level of an alarm."""
        return tuple(f for f in self.findings if f.p < 10.0 * self.level)


def examine(problem: Problem, probes: Sequence[Probe], lattice: NoiseLattice, point: Point) -> Examination:
    """Every probe, the periodogram and, with isothermal records, the noise test, at the noise of a lattice point."""
    ways = lattice.at([point])[0]
    q = orthonormal(ways[0].apply(problem.base))
    residual = outside(q, ways[0].apply(problem.y))
    sigma2 = float(residual @ residual) / max(1, len(residual) - q.shape[1])
    findings = []
    for probe in probes:
        moved = ways[0].apply(probe.columns)
        before = np.linalg.norm(moved, axis=0)
        moved = outside(q, moved)
        moved[:, np.linalg.norm(moved, axis=0) < _DEPENDENT * before] = 0.0
        findings.append(_finding(probe, moved, residual, sigma2))
    findings.append(periodogram(residual, q, ways[0], problem.time_s, problem.interval_s))
    if problem.statics:
        findings.append(noise_test(problem, lattice, point))
    findings = [f for f in findings if f.rank > 0]
    return Examination(tuple(sorted(findings, key=lambda f: f.p)), _LEVEL / max(1, len(findings)))


def _finding(probe: Probe, moved: FloatArray, residual: FloatArray, sigma2: float) -> Finding:
    norm = np.linalg.norm(moved, axis=0)
    scale = np.where(norm > 0.0, norm, 1.0)
    u, s, vt = np.linalg.svd(moved / scale, full_matrices=False)
    rank = int(np.sum(s > 1e-6 * s[0])) if s[0] > 0.0 else 0
    u, s, vt = u[:, :rank], s[:rank], vt[:rank]
    statistic = float(np.sum((u.T @ residual) ** 2)) / sigma2
    fitted = (vt.T / s) @ (u.T @ residual) / scale
    singly = (moved.T @ residual) / scale**2
    return Finding(
        probe.name,
        chi2_tail(statistic, rank) if rank else 1.0,
        statistic,
        rank,
        probe.columns @ fitted,
        probe.cells,
        np.where(norm > 0.0, singly, np.nan),
        np.where(norm > 0.0, np.sqrt(sigma2) / scale, np.nan),
    )


def periodogram(whitened: FloatArray, q: FloatArray, way: Whitener, time_s: FloatArray, interval_s: float) -> Finding:
    """Largest line of the spectrum of the whitened residual (n,), which lies outside the basis `q` of the base."""
    row = rows_of(time_s, interval_s)
    cycles, length, power, p = highest(whitened, row)
    refined, line = fitted(whitened, q, way, row, cycles)
    note = f"period {length * interval_s / refined:.0f} s, amplitude {np.sqrt(2.0) * float(np.std(line)):.2g} deg/h"
    return Finding("periodic", p, power, 2, line, note=note)


def noise_test(problem: Problem, lattice: NoiseLattice, point: Point) -> Finding:
    """Test whether the run has the noise of the isothermal records, or less slow noise: nothing is missing then."""
    found = unlike(problem.records()[:1], problem.statics, lattice, point)
    note = f"white noise of the run is {found.whiter:.2f} times that of the isothermal run"
    p = chi2_tail(found.statistic, UNLIKE_FREEDOM) if found.slower > 1.0 or found.noisier > 1.0 else 1.0
    return Finding("noise", p, found.statistic, UNLIKE_FREEDOM, np.zeros(len(problem.y)), note=note)


class Unlike(NamedTuple):
    """Likelihood ratio of two noises against one, chi-squared with UNLIKE_FREEDOM; white, slow and all noise of the
    first over those of the second (standard deviations, of slow noise over the time of the first).
    """

    statistic: float
    whiter: float
    slower: float
    noisier: float


def unlike(one: Sequence[Record], other: Sequence[Record], lattice: NoiseLattice, start: Point | None = None) -> Unlike:
    """Compare the noise of records.

    `lattice` is of all records in this order; the search begins at `start`, or looks everywhere.
    """

    def lowest(records: Sequence[Record], own: NoiseLattice) -> tuple[Surface, Point]:
        surface = Surface.of(records, own, restricted=True)
        if start is None:
            return surface, surface.search()
        surface.visit([start])
        return surface, surface.descend(start)

    records = (*one, *other)
    together, best = lowest(records, lattice)
    joint, at = together.height(best), best if start is None else start
    alone, whites, slows = [], [], []
    hours = float(np.ptp(one[0].time_s)) / 3600.0
    for part, offset in ((one, 0), (other, len(one))):
        surface, best = lowest(part, lattice.part(offset, len(part)))
        alone.append(surface.height(best))
        whites.append(surface.known[best][1])
        ratios = lattice.ratios(best)
        slows.append(whites[-1] * (ratios.flicker + ratios.walk * hours / 6.0))  # a walk's variance about its mean
    statistic = max(0.0, joint - sum(alone)) / _heaviness(records, lattice, at)
    white, slow = np.array(whites), np.array(slows)
    whiter, slower, noisier = (float(np.sqrt(own[0] / max(own[1], 1e-300))) for own in (white, slow, white + slow))
    return Unlike(statistic, whiter, slower, noisier)


def _heaviness(records: Sequence[Record], lattice: NoiseLattice, point: Point) -> float:
    """Variance of a sample variance over that of normal noise, at least one: (kurtosis - 1) / 2 of what is whitened."""
    left = [
        outside(orthonormal(way.apply(record.X)), way.apply(record.y))
        for record, way in zip(records, lattice.at([point])[0], strict=True)
    ]
    scaled = np.concatenate([each / max(float(np.std(each)), 1e-300) for each in left])
    return max(1.0, 0.5 * (float(np.mean(scaled**4)) - 1.0))


def cells(temperature: FloatArray, direction: FloatArray, bins: int = 8) -> Probe:
    """Temperature bins by direction (-1 cooling, 0 constant, 1 heating), each one column."""
    edges = np.linspace(np.min(temperature), np.max(temperature), bins + 1)
    which = np.clip(np.digitize(temperature, edges) - 1, 0, bins - 1)
    columns, made = [], []
    for word, sign in SIGNS.items():
        for number in range(bins):
            inside = (which == number) & (np.sign(direction) == sign)
            if inside.sum() >= 3:
                columns.append(inside.astype(np.float64))
                low, high = (float(f"{edge:.3g}") for edge in edges[number : number + 2])
                made.append(Cell(word, low, high))
    if not columns:  # few rows
        return cells(temperature, direction, bins // 2)
    return Probe("temperature x direction", np.column_stack(columns), tuple(made))


def spline(name: str, value: FloatArray, freedom: int = 6) -> Probe:
    """Smooth function of one variable: cubic B-splines, knots at quantiles so that each sees data."""
    inner = np.unique(np.quantile(value, np.linspace(0.0, 1.0, max(2, freedom - 2))))
    if len(inner) < 3 and np.ptp(value) > 0.0:
        return Probe(name, (value - value.mean())[:, None])
    if np.ptp(value) == 0.0:
        return Probe(name, np.zeros((len(value), 1)))
    knots = np.concatenate([[inner[0]] * 3, inner, [inner[-1]] * 3])
    return Probe(name, scipy.interpolate.BSpline.design_matrix(np.clip(value, inner[0], inner[-1]), knots, 3).toarray())


def direction_of(rate_of_change: FloatArray) -> FloatArray:
    """-1 cooling, 0 standing still, 1 heating (n,), from dT/dt [degC/min]."""
    return np.where(np.abs(rate_of_change) < SETTLED_DEGC_PER_MIN, 0.0, np.sign(rate_of_change))


def usual(
    time_s: FloatArray, temperature: FloatArray, rate_of_change: FloatArray, channels: Mapping[str, FloatArray]
) -> list[Probe]:
    """The probes of a run: cells, elapsed time, dT/dt [degC/min], fine temperature and each further channel."""
    return [
        cells(temperature, direction_of(rate_of_change)),
        spline("time", time_s, 8),
        spline("dT/dt", rate_of_change, 6),
        spline("fine temperature", temperature, 30),
        *(spline(name, value) for name, value in channels.items()),
    ]
