"""The memory of what is left, where no short formula describes it: the response to a change of temperature over lag.

After a step of 1 degC the bias is off by h(lag) [deg/h/degC]; what is left is the sum of such responses to all changes
before. h is one value to each of log-spaced lags, with a Gaussian process over the logarithm of the lag as its prior:
its size, its smoothness, the longest lag and the noise maximise the marginal likelihood beside the model's columns
(restricted: these are integrated out). Before its first row a run is taken to have stood still. Source:
C. E. Rasmussen, C. K. I. Williams, Gaussian Processes for Machine Learning (2006), chapters 2 and 5.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from bench.analysis.diagnosis.candidates import outside
from bench.analysis.diagnosis.suspects import Layout
from bench.analysis.effects.operators import shifted
from bench.analysis.noise.likelihood import NoiseLattice, Point, Record, Surface, spanned
from bench.analysis.noise.whitening import Whitener
from bench.base import FloatArray, finite

LEAST_EVIDENCE = 16.0
"""Gain in 2 ln L that no run without a memory reached (tests/analysis/test_kernel.py)."""
_STEP = 2.0**0.5  # of the lags' ends
_LONGEST_SHARE = 0.4  # of the run: of a longer memory it has seen too little
_LENGTHS = 3  # steps of the lags between two lengths of a prior
_SMOOTH = (0.4, 0.8, 1.6)  # length scales of ln(lag)
_SIZES = np.exp2(np.arange(-14.0, 15.0))  # of the prior, relative to what moves one row by its white noise
_WITHIN = 0.9
_TRACE = 1e-4  # weight of a prior below which it moves no digit


@dataclass(frozen=True, eq=False)
class Kernel:
    """Response `value` (m,) [deg/h/degC] and its deviation `sd` (m,) at lags `lag_s` (m,), and the gain in 2 ln L."""

    lag_s: FloatArray
    value: FloatArray
    sd: FloatArray
    evidence: float

    @property
    def memory_s(self) -> float:
        """Lag within which nine tenths of the response to a ramp lie, of what stands out of its deviation."""
        ends = np.concatenate([[0.0], np.sqrt(self.lag_s[1:] * self.lag_s[:-1]), [self.lag_s[-1] * _STEP**0.5]])
        own = np.where(np.abs(self.value) > 2.0 * self.sd, np.abs(self.value), 0.0) * np.diff(ends)
        share = np.concatenate([[0.0], np.cumsum(own)]) / max(float(own.sum()), 1e-300)
        return float(np.interp(_WITHIN, share, ends))

    @property
    def words(self) -> str:
        """One line for a reader."""
        return f"memory: about {max(self.memory_s / 60.0, 0.5):.2g} min of the changes of temperature"

    def to_json(self) -> dict[str, Any]:
        """The `kernel` of `bench diagnose --json`."""
        return {
            "lag_s": [finite(lag) for lag in self.lag_s],
            "value": [finite(value) for value in self.value],
            "sd": [finite(sd) for sd in self.sd],
            "unit": "deg/h/degC",
            "memory_s": finite(self.memory_s),
            "evidence": finite(self.evidence),
        }


def kernel_of(layout: Layout, lattice: NoiseLattice) -> Kernel | None:
    """The memory of what the model leaves of the runs; None where the runs show none."""
    ends = _ends(layout)
    if len(ends) < 4:
        return None
    columns, lag_s = delayed(layout, ends), _middles(ends)
    search = _Search(layout, lattice, columns, lag_s)
    surface = Surface(lattice, search.measure)
    point = surface.search()
    plain = Surface.of(layout.problem.records(), lattice, restricted=True)
    evidence = plain.height(plain.search()) - surface.height(point)
    if evidence < LEAST_EVIDENCE:
        return None
    return Kernel(lag_s, *search.posterior(point), float(evidence))


def delayed(layout: Layout, ends: FloatArray) -> FloatArray:
    """Columns (n, m): changes of temperature [degC] between lags `ends` (m + 1,) [s] before each row."""
    parts = []
    for record in layout.seen:
        temperature = record.channel("temperature")
        at = [shifted(record.time, temperature, lag) for lag in ends.tolist()]
        parts.append(-np.diff(np.array(at), axis=0).T)
    return np.column_stack([layout.stacked([part[:, i] for part in parts]) for i in range(len(ends) - 1)])


def _ends(layout: Layout) -> FloatArray:
    interval_s = layout.problem.interval_s
    longest = _LONGEST_SHARE * max(float(np.ptp(time)) for time in layout.rows.time)
    many = int(np.floor(np.log(max(longest / interval_s, 1.0)) / np.log(_STEP)))
    return np.concatenate([[0.0], interval_s * _STEP ** np.arange(many + 1.0)])


def _middles(ends: FloatArray) -> FloatArray:
    return np.concatenate([[0.5 * ends[1]], np.sqrt(ends[2:] * ends[1:-1])])


class _Search:
    """Marginal likelihood of kernels of all lengths at a point of the noise lattice."""

    def __init__(self, layout: Layout, lattice: NoiseLattice, columns: FloatArray, lag_s: FloatArray) -> None:
        self.problem, self.lattice, self.columns = layout.problem, lattice, columns
        scale = float(np.sqrt(np.mean(columns**2)))
        lengths = lag_s[2::_LENGTHS]
        self.roots = [_root(lag_s, smooth, length_s) / scale for length_s in lengths for smooth in _SMOOTH]

    def measure(self, point: Point) -> tuple[float, float]:
        """-2 ln L, averaged over all priors, and the noise's variance at these ratios of the noise."""
        heights, sigma2 = self._heights(point)
        least = float(heights.min())
        mean = least - 2.0 * float(np.log(np.mean(np.exp(-0.5 * (heights - least)))))
        return mean, float(sigma2[np.argmin(heights)])

    def posterior(self, point: Point) -> tuple[FloatArray, FloatArray]:
        """Mean and deviation (m,) of the kernel, over all priors by what they explain."""
        heights, sigma2 = self._heights(point)
        share = np.exp(-0.5 * (heights - heights.min()))
        share /= share.sum()
        own, columns, _ = self._whitened(point)
        first, second = np.zeros(columns.shape[1]), np.zeros(columns.shape[1])
        for weight, variance, (root, size) in zip(share, sigma2, product(self.roots, _SIZES), strict=True):
            if weight > _TRACE:
                u, d, vt = np.linalg.svd(columns @ root, full_matrices=False)
                grown = 1.0 + size * d**2
                mean = root @ (vt.T @ (size * d / grown * (u.T @ own)))
                spread = np.eye(len(d)) - (vt.T * (1.0 - 1.0 / grown)) @ vt
                own_square = variance * size * np.sum((root @ spread) * root, axis=1)
                first += weight * mean
                second += weight * (own_square + mean**2)
        return first, np.sqrt(np.maximum(second - first**2, 0.0))

    def _heights(self, point: Point) -> tuple[FloatArray, FloatArray]:
        """-2 ln L and variance of the noise (k,) of every prior: each root with each size."""
        own, columns, fixed = self._whitened(point)
        rows, square = len(own) - self.problem.base.shape[1], float(own @ own)
        for record, way in zip(self.problem.statics, self.lattice.at([point])[0][1:], strict=True):
            left, more = _beside(record, way, record.y[:, None])
            rows, square, fixed = rows + len(left) - record.X.shape[1], square + float(np.sum(left**2)), fixed + more
        heights, variances = [], []
        for root in self.roots:
            u, d, _ = np.linalg.svd(columns @ root, full_matrices=False)
            seen = (u.T @ own) ** 2
            grown = 1.0 + _SIZES[:, None] * d**2
            variance = (square - (seen * (1.0 - 1.0 / grown)).sum(axis=1)) / rows
            heights.append(rows * np.log(variance) + np.log(grown).sum(axis=1) + fixed)
            variances.append(variance)
        return np.concatenate(heights), np.concatenate(variances)

    def _whitened(self, point: Point) -> tuple[FloatArray, FloatArray, float]:
        """Output (n,) and delayed changes (n, m), whitened, beside the model's columns; ln |C| and ln |X' C^-1 X|."""
        both = np.column_stack([self.columns, self.problem.y])
        left, fixed = _beside(self.problem.records()[0], self.lattice.way(point), both)
        return left[:, -1], left[:, :-1], fixed


def _beside(record: Record, way: Whitener, values: FloatArray) -> tuple[FloatArray, float]:
    """Whitened values (n, k) beside the record's columns, and ln |C| + ln |X' C^-1 X|."""
    white = way.apply(np.column_stack([record.X, values]))
    width = record.X.shape[1]
    basis, volume = spanned(white[:, :width], np.linalg.norm(record.X, axis=0))
    return outside(basis, white[:, width:]), volume + way.log_det


def _root(lag_s: FloatArray, smooth: float, length_s: float) -> FloatArray:
    """Square root (m, m) of the prior's covariance; beyond its length the size falls as one over the lag."""
    logs = np.log(lag_s)
    values, vectors = np.linalg.eigh(np.exp(-0.5 * ((logs[:, None] - logs[None, :]) / smooth) ** 2))
    fades = 1.0 / (1.0 + lag_s / length_s)
    return np.asarray(fades[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)))
