"""White noise of a run beside that of its isothermal record: where it grows with temperature, that is not drift.

Neighbouring rows at one rate of the table differ almost only by white noise, even where the model lacks an effect.
Where their differences are not those of the isothermal record, the run's white variance is taken from them, by
temperature; what the noise test still finds after that is slow.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bench.analysis.diagnosis.suspects import Layout
from bench.analysis.thresholds import TURNING_DPS
from bench.base import FloatArray, IntArray

_BINS = 6  # of temperature
_SURE = 4.0  # standard deviations of a bin's logarithm


def levelled(layout: Layout) -> tuple[Layout, str]:
    """The layout with the white noise of its run, and the finding in words; as it was where they do not differ."""
    if layout.still is None:
        return layout, ""
    problem = layout.problem
    applied = [np.nan_to_num(r.channels.get("applied_rate", np.zeros(len(r)))) for r in layout.rows.records]
    at_one_rate = np.abs(np.diff(layout.stacked(applied))) <= TURNING_DPS
    near = np.flatnonzero((np.diff(problem.time_s) < 1.5 * problem.interval_s) & at_one_rate)
    square = (np.diff(layout.beyond(problem.y))[near] / np.sqrt(_pairs(problem.white, near))) ** 2
    still = problem.statics[0].steps(problem.interval_s) ** 2  # the unit's own; sisters have a white noise of theirs
    temperature = layout.temperature
    edges = np.quantile(temperature[near], np.linspace(0.0, 1.0, _BINS + 1))
    which = np.clip(np.searchsorted(edges, temperature[near]) - 1, 0, _BINS - 1)
    counts = np.bincount(which, minlength=_BINS)
    if counts.min() < 3:
        return layout, ""
    ratio = np.bincount(which, square, _BINS) / counts / np.mean(still)
    # Differences of white noise overlap: the variance of their mean square is 3 / n of its square, not 2 / n.
    deviation = np.sqrt(3.0 / counts + 3.0 / len(still))
    if np.all(np.abs(np.log(ratio)) < _SURE * deviation):
        return layout, ""
    white = np.interp(temperature, 0.5 * (edges[1:] + edges[:-1]), ratio)
    low, high = np.sqrt([ratio.min(), ratio.max()])
    words = f"white noise of the run is {low:.2f} to {high:.2f} times that of the isothermal run, by temperature"
    return replace(layout, white=white), words


def _pairs(white: FloatArray | None, near: IntArray) -> FloatArray:
    """Mean of the white variances of each row and the next."""
    if white is None:
        return np.ones(len(near))
    return np.asarray(0.5 * (white[near] + white[near + 1]))
