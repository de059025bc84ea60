"""Gauge R&R: how much of the spread of a quantity is the stations' and the repetitions', and how much the units'.

Equation: y = mean + station + unit + unit x station + repetition, each drawn at random. The components of variance come
from the crossed analysis of variance where every unit was measured equally often at every station, and from the
restricted likelihood (REML) in any case. An interaction with p > 0.25 is pooled with the repetitions. Sources: AIAG,
Measurement Systems Analysis, 4th ed. (2010), chapter III B; intervals: M. Hamada, S. Weerahandi, J. Quality Technology
32 (2000) 241; REML: H. D. Patterson, R. Thompson, Biometrika 58 (1971) 545.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from bench.analysis import one_blas_thread
from bench.base import FloatArray, InputError, IntArray

MOST = 1000
"""Runs of one study: the likelihood takes the number of units cubed."""
ACCEPTED = 0.30
"""Share of the spread, or of the tolerance, above which AIAG calls a measurement system unacceptable."""
_POOLED = 0.25
_DRAWS = 20_000
_STARTS = (1.0, 30.0)
"""Ratios of variances from which the most likely ones are searched."""
_CATEGORIES = 1.41
Table = tuple[FloatArray, FloatArray]
"""Degrees of freedom and sums of squares, of units, stations, interaction, repetitions."""


@dataclass(frozen=True)
class Source:
    """A line of the analysis of variance; there is no F of the repetitions."""

    name: str
    freedom: int
    squares: float
    mean_square: float
    f: float | None
    p: float | None


@dataclass(frozen=True)
class Component:
    """A standard deviation by the analysis of variance, or by REML without one; 95 % interval of the former."""

    name: str
    sigma: float
    low: float | None
    high: float | None
    reml_sigma: float
    of_study: float
    """Share of the total standard deviation."""
    of_tolerance: float | None
    """Six of it in parts of the width between the limits."""


@dataclass(frozen=True)
class Gauge:
    """A study of one quantity; `sources` are empty where not every unit was measured equally often everywhere."""

    units: int
    stations: tuple[str, ...]
    runs: int
    sources: tuple[Source, ...]
    components: tuple[Component, ...]
    """repeatability; station; interaction; reproducibility, these two; gauge, all three; unit; total."""
    categories: int
    """Of units that can be told apart; AIAG asks for five."""

    @property
    def share(self) -> float:
        """What the gauge takes: of the tolerance where there is one, else of the total spread."""
        own = next(one for one in self.components if one.name == "gauge")
        return own.of_study if own.of_tolerance is None else own.of_tolerance

    @property
    def acceptable(self) -> bool:
        """By the rule of AIAG."""
        return self.share <= ACCEPTED


def gauge(values: FloatArray, units: Sequence[str], stations: Sequence[str], tolerance: float | None = None) -> Gauge:
    """The study of values (n,) of those units that were measured at several stations.

    InputError where they are fewer than two, or no unit was measured twice at a station.
    """
    seen: dict[str, set[str]] = {}
    for one, place in zip(units, stations, strict=True):
        seen.setdefault(one, set()).add(place)
    rows = [i for i, one in enumerate(units) if len(seen[one]) > 1]
    if len({units[i] for i in rows}) < 2:
        raise InputError("fewer than two units were measured at more than one station; a gauge study needs that")
    if len(rows) > MOST:
        raise InputError(f"the study has {len(rows)} runs, at most {MOST} are allowed; choose units by --unit-filter")
    y = values[rows]
    unit = np.unique([units[i] for i in rows], return_inverse=True)[1]
    names, station = np.unique([stations[i] for i in rows], return_inverse=True)
    cell = unit * len(names) + station
    many = np.bincount(cell, minlength=(int(unit.max()) + 1) * len(names))
    if many.max() < 2:
        raise InputError("no unit was measured twice at one station; a gauge study needs repetitions")
    if np.ptp(y) == 0.0:
        raise InputError("all values are equal: there is no spread to divide")
    sources: tuple[Source, ...] = ()
    found, spread, pooled = None, None, False
    if many.min() == many.max():
        parts = _squares(y, cell, (int(unit.max()) + 1, len(names), int(many[0])))
        sources, pooled = _sources(parts)
        found, spread = _variances(*parts, many[0], pooled), _draws(*parts, many[0], pooled)
    with one_blas_thread():
        likely = _likely(y, station, unit, crossed=not pooled)
    best = likely if found is None else found
    components = _components(best, spread, likely, tolerance)
    ratio = components[5].sigma / components[4].sigma if components[4].sigma else np.inf
    categories = int(min(_CATEGORIES * ratio, 1e6))
    return Gauge(int(unit.max()) + 1, tuple(names.tolist()), len(rows), sources, components, categories)


def _squares(y: FloatArray, cell: IntArray, shape: tuple[int, int, int]) -> Table:
    units, stations, trials = shape
    table = y[np.argsort(cell, kind="stable")].reshape(shape) - y.mean()
    of_cells, of_units, of_stations = table.mean(axis=2), table.mean(axis=(1, 2)), table.mean(axis=(0, 2))
    crossed = of_cells - of_units[:, None] - of_stations
    squares = np.array([
        stations * trials * float(of_units @ of_units), units * trials * float(of_stations @ of_stations),
        trials * float(np.sum(crossed**2)), float(np.sum((table - of_cells[:, :, None]) ** 2)),
    ])  # fmt: skip
    freedom = np.array([units - 1, stations - 1, (units - 1) * (stations - 1), units * stations * (trials - 1)], float)
    return freedom, squares


def _sources(parts: Table) -> tuple[tuple[Source, ...], bool]:
    """The table with all four lines, or with three and F beside the pooled line; and whether it is pooled."""
    freedom, squares = parts
    mean = squares / freedom
    pooled = bool(scipy.stats.f.sf(mean[2] / mean[3], freedom[2], freedom[3]) > _POOLED) if mean[3] > 0.0 else False
    names = ["unit", "station", "unit x station", "repetitions"]
    if pooled:
        names = names[:2] + names[3:]
        freedom, squares = (np.append(one[:2], one[2:].sum()) for one in (freedom, squares))
        mean = squares / freedom
    beside = [2, 2, len(names) - 1, None]
    lines = []
    for i, name in enumerate(names):
        other = None if name == "repetitions" else beside[i]
        f = None if other is None or mean[other] == 0.0 else float(mean[i] / mean[other])
        p = None if f is None or other is None else float(scipy.stats.f.sf(f, freedom[i], freedom[other]))
        lines.append(Source(name, int(freedom[i]), float(squares[i]), float(mean[i]), f, p))
    return tuple(lines), pooled


def _variances(freedom: FloatArray, squares: FloatArray, trials: int, pooled: bool) -> FloatArray:
    """Of repetition, station, interaction, unit (..., 4), none below zero, from freedom (4,) and squares (..., 4)."""
    units, stations = freedom[0] + 1, freedom[1] + 1
    mean = squares / freedom
    own, crossed = mean[..., 3], mean[..., 2]
    if pooled:
        own = crossed = (squares[..., 2] + squares[..., 3]) / (freedom[2] + freedom[3])
    parts = [own, (mean[..., 1] - crossed) / (units * trials), (crossed - own) / trials,
             (mean[..., 0] - crossed) / (stations * trials)]  # fmt: skip
    found: FloatArray = np.maximum(np.stack(parts, axis=-1), 0.0)
    return found


def _draws(freedom: FloatArray, squares: FloatArray, trials: int, pooled: bool) -> FloatArray:
    """Variances (draws, 4) that the squares leave open: generalised intervals."""
    left = np.array([freedom[2] + freedom[3]]) if pooled else freedom[2:]
    apart = np.append(freedom[:2], left)
    known = np.append(squares[:2], squares[2:].sum() if pooled else squares[2:])
    drawn = known * apart / np.random.default_rng(1).chisquare(apart, (_DRAWS, apart.size))
    return _variances(freedom, np.insert(drawn, 2, 0.0, axis=1) if pooled else drawn, trials, pooled)


def _likely(y: FloatArray, station: IntArray, unit: IntArray, *, crossed: bool) -> FloatArray:
    """Variances of repetition, station, interaction (0 unless `crossed`) and unit by restricted likelihood.

    Means of cells suffice, beside the squares within: they differ by D = interaction + repetition / number, and by
    Z = (stations, units), whose rows V = D + Z G Z' are solved by Woodbury's identity.
    """
    places, scale = int(station.max()) + 1, float(np.std(y))
    cells, cell = np.unique(unit * places + station, return_inverse=True)
    many = np.bincount(cell).astype(np.float64)
    mean = np.bincount(cell, y - y.mean()) / many / scale
    within = float(np.sum(((y - y.mean()) / scale - mean[cell]) ** 2))
    z = np.zeros((cells.size, places + int(unit.max()) + 1))
    z[np.arange(cells.size), cells % places] = z[np.arange(cells.size), places + cells // places] = 1.0

    def solved(ratios: FloatArray) -> tuple[float, float]:
        own = 1.0 / (ratios[1] + 1.0 / many)
        root = np.sqrt(np.repeat(ratios[[0, 2]], (places, z.shape[1] - places)))
        columns = z * root
        factor = scipy.linalg.cho_factor(np.eye(root.size) + columns.T @ (own[:, None] * columns), lower=True)

        def inverse(values: FloatArray) -> FloatArray:
            weighed = own * values
            left: FloatArray = weighed - own * (columns @ scipy.linalg.cho_solve(factor, columns.T @ weighed))
            return left

        ones = inverse(np.ones(cells.size))
        total = float(ones.sum())
        square = max(within + float(mean @ inverse(mean)) - float(ones @ mean) ** 2 / total, 1e-300) / (y.size - 1)
        height = 2.0 * float(np.log(np.diag(factor[0])).sum()) - float(np.log(own).sum()) + np.log(total)
        return (y.size - 1) * float(np.log(square)) + height, square

    # Of ratios, not their roots or logarithms: the slope at zero tells whether zero is best.
    minimise: Any = scipy.optimize.minimize
    ends = [(0.0, None), (0.0, None if crossed else 0.0), (0.0, None)]
    tried = []
    options = {"ftol": 1e-13, "gtol": 1e-7}
    for start in _STARTS:
        begin = np.array([start, start if crossed else 0.0, start])
        tried.append(minimise(lambda r: solved(r)[0], begin, method="L-BFGS-B", bounds=ends, options=options))
    ratios = np.asarray(min(tried, key=lambda one: float(one.fun)).x, dtype=np.float64)
    return np.asarray(np.append(1.0, ratios) * solved(ratios)[1] * scale**2, dtype=np.float64)


_SUMS = {"repeatability": [0], "station": [1], "interaction": [2], "reproducibility": [1, 2], "gauge": [0, 1, 2],
         "unit": [3], "total": [0, 1, 2, 3]}  # fmt: skip


def _components(
    best: FloatArray, spread: FloatArray | None, likely: FloatArray, tolerance: float | None
) -> tuple[Component, ...]:
    total = float(np.sqrt(best.sum()))
    found = []
    for name, parts in _SUMS.items():
        sigma, other = (float(np.sqrt(one[parts].sum())) for one in (best, likely))
        low = high = None
        if spread is not None:
            low, high = np.sqrt(np.quantile(spread[:, parts].sum(axis=1), (0.025, 0.975))).tolist()
        share = None if tolerance is None else 6.0 * sigma / tolerance
        found.append(Component(name, sigma, low, high, other, sigma / total, share))
    return tuple(found)
