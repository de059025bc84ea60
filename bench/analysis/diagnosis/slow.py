"""What a residual shows at noise that is not free to swallow it: that of the isothermal run, or of the run's own soaks.

A slow cause is what free noise takes first. Here the noise is what stands still: of all ratios that the soaks allow
(95 % by the restricted likelihood) the one at which the cells of temperature by direction stand out least, with the
soaks' own white variance. What still stands out is no noise that the soaks have.
"""

from __future__ import annotations

import numpy as np

from bench.analysis.diagnosis.candidates import orthonormal, outside
from bench.analysis.diagnosis.probes import cells, direction_of
from bench.analysis.diagnosis.suspects import Layout
from bench.analysis.noise.floor import stretches_of
from bench.analysis.noise.likelihood import NoiseLattice, Record, Surface
from bench.analysis.noise.probability import chi2_quantile, chi2_tail
from bench.analysis.thresholds import SETTLED_DEGC_PER_MIN

_LEVEL = 0.005
_LEAST_ROWS = 20  # of a soak, after its first half
_MOST_POINTS = 24


def structure(layout: Layout) -> str:
    """What the residual map shows beside the noise of what stands still; empty where that noise explains it."""
    problem = layout.problem
    records = problem.statics or _soaks(layout)
    if not records:
        return ""
    lattice = NoiseLattice((*problem.records()[:1], *records), problem.interval_s)
    surface = Surface.of(records, lattice.part(1, len(records)), restricted=True)
    region = surface.region(best := surface.search(), float(chi2_quantile(0.95, 2)), step=8)
    points = sorted(region, key=lambda point: (-point[1], -point[0]))[:_MOST_POINTS] or [best]
    probe = cells(layout.temperature, direction_of(layout.slope))
    least = 0.0
    for point, ways in zip(points, lattice.at(points), strict=True):
        way = ways[0]
        q = orthonormal(way.apply(problem.base))
        u = orthonormal(outside(q, way.apply(probe.columns)))
        seen = u.T @ outside(q, way.apply(problem.y))
        least = max(least, chi2_tail(float(seen @ seen) / surface.known[point][1], u.shape[1]))
    if least >= _LEVEL:
        return ""
    source = "the isothermal run" if problem.statics else "the run's own soaks"
    return f"its means by temperature and direction stand out of the noise of {source} (p {least:.1g})"


def _soaks(layout: Layout) -> tuple[Record, ...]:
    """The second halves of the stretches that stand still, each beside a line of its own."""
    found = []
    for record, mask in zip(layout.rows.records, layout.rows.masks, strict=True):
        still = mask & (np.abs(np.nan_to_num(record.dT_dt, nan=np.inf)) < SETTLED_DEGC_PER_MIN)
        for first, last in stretches_of(still):
            rows = np.arange((first + last) // 2, last)
            if rows.size >= _LEAST_ROWS:
                at = np.linspace(-1.0, 1.0, rows.size)
                found.append(Record(record.time[rows], record.bias[rows], np.vander(at, 2)))
    return tuple(found)
