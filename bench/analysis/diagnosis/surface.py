"""What is left of the runs over any two channels, in cells, each with what the noise alone does to its mean.

The noise is that of the stretches that stand still where there are any, else that beside the model; what the model's
columns take in of it is taken off. A cell whose mean is within two deviations of it is no finding.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from bench.analysis.diagnosis.suspects import Layout
from bench.analysis.noise.estimate import Noise
from bench.analysis.noise.whitening import Whitener
from bench.base import CHANNELS, BoolArray, FloatArray, InputError, IntArray, finite
from bench.record import Dataset

RATE_OF_TEMPERATURE = "rate_of_temperature"
_CELLS = 12
_STANDS_OUT = 2.0  # deviations
_DRAWS = 500  # of the noise: deviations are known to 3 %, of any number of rows


@dataclass(frozen=True, eq=False)
class ResidualSurface:
    """Means (a, b) of the residual [deg/h] over cells of two channels, with deviations and rows; NaN without rows."""

    channels: tuple[str, str]
    units: tuple[str, str]
    edges: tuple[FloatArray, FloatArray]
    mean: FloatArray
    se: FloatArray
    count: FloatArray

    @property
    def stands_out(self) -> BoolArray:
        """Cells (a, b) whose mean is more than noise."""
        return np.asarray(np.abs(np.nan_to_num(self.mean)) > _STANDS_OUT * np.nan_to_num(self.se, nan=np.inf))

    @property
    def words(self) -> str:
        """One line for a reader."""
        first, second = self.channels
        visited, seen = int(np.sum(self.count > 0)), int(np.sum(self.stands_out))
        text = f"residual over {first} and {second}: {seen} of {visited} cells stand out of the noise"
        if not seen:
            return text
        i, j = np.unravel_index(int(np.argmax(np.where(self.stands_out, np.abs(self.mean), 0.0))), self.mean.shape)
        at = [
            f"{0.5 * (e[k] + e[k + 1]):.3g} {unit}" for e, k, unit in zip(self.edges, (i, j), self.units, strict=True)
        ]
        return f"{text}, most {self.mean[i, j]:.3g} +- {self.se[i, j]:.2g} deg/h at {at[0]} and {at[1]}"

    def to_json(self) -> dict[str, Any]:
        """The `surface` of `bench diagnose --json`: cells with rows."""
        cells = [
            {
                **{f"{name}_{end}": float(self.edges[axis][k + side]) for axis, (name, k) in enumerate(
                    zip(("first", "second"), (i, j), strict=True)) for side, end in enumerate(("from", "to"))},
                "mean_dph": finite(self.mean[i, j]), "se_dph": finite(self.se[i, j]), "count": int(self.count[i, j]),
            }
            for i, j in np.argwhere(self.count > 0).tolist()
        ]  # fmt: skip
        return {"channels": list(self.channels), "units": list(self.units), "cells": cells}


def residual_surface(layout: Layout, residual: FloatArray, channels: Sequence[str], noise: Noise) -> ResidualSurface:
    """Cells of a residual (rows,) [deg/h] over two channels.

    Raises InputError: not two channels that every row has and that change.
    """
    x, y = channels_of(layout, channels)
    first, second = channels
    edges = _edges(x), _edges(y)
    label = _place(x, edges[0]) * _CELLS + _place(y, edges[1])
    cells, inverse = np.unique(label, return_inverse=True)
    grid = np.full((3, _CELLS**2), np.nan)
    grid[2] = np.bincount(label, minlength=_CELLS**2)
    grid[0, cells] = np.bincount(inverse, residual) / np.bincount(inverse)
    grid[1, cells] = np.sqrt(_variances(layout, inverse, noise))
    mean, se, count = grid.reshape(3, _CELLS, _CELLS)
    return ResidualSurface((first, second), (_unit(first), _unit(second)), edges, mean, se, count)


def channels_of(layout: Layout, channels: Sequence[str]) -> tuple[FloatArray, FloatArray]:
    """Values (rows,) of two channels; InputError where they are not two that every row has and that change."""
    if len(channels) != 2:
        raise InputError(f"--surface takes two channels, such as temperature,{RATE_OF_TEMPERATURE}")
    return _values(layout, channels[0]), _values(layout, channels[1])


def _edges(values: FloatArray) -> FloatArray:
    return np.linspace(values.min(), values.max(), _CELLS + 1)


def _place(values: FloatArray, edges: FloatArray) -> IntArray:
    return np.clip(np.searchsorted(edges, values, side="right") - 1, 0, _CELLS - 1).astype(np.int64)


def _unit(name: str) -> str:
    return "degC/min" if name == RATE_OF_TEMPERATURE else CHANNELS[name].unit


def _values(layout: Layout, name: str) -> FloatArray:
    known = sorted({RATE_OF_TEMPERATURE, *(c for r in layout.rows.records for c in r.channels)} - {"rate"})
    if any(name not in {RATE_OF_TEMPERATURE, *r.channels} for r in layout.rows.records):
        raise InputError(f"--surface: '{name}' is no channel of these runs; known are {', '.join(known)}")
    values = layout.stacked([_of(record, name) for record in layout.rows.records])
    if not np.all(np.isfinite(values)) or np.ptp(values) == 0.0:
        raise InputError(f"--surface: '{name}' has gaps or never changes in the fitted rows; choose another channel")
    return values


def _of(record: Dataset, name: str) -> FloatArray:
    return np.nan_to_num(record.dT_dt) if name == RATE_OF_TEMPERATURE else record.channel(name)


def _variances(layout: Layout, cell: IntArray, noise: Noise) -> FloatArray:
    """Variance of the mean of the noise in each cell (k,) beside the model's columns [(deg/h)^2], by simulation."""
    problem = layout.problem
    way = Whitener.of(noise.ratios(problem.interval_s), problem.time_s, problem.interval_s, problem.white)
    draws = way.colour(np.random.default_rng(0).standard_normal((len(cell), _DRAWS)))
    draws -= problem.base @ (np.linalg.pinv(problem.base, rcond=1e-10) @ draws)
    average = scipy.sparse.csr_array((1.0 / np.bincount(cell)[cell], (cell, np.arange(len(cell)))))
    return np.asarray(noise.white_variance(problem.interval_s) * np.mean(np.asarray(average @ draws) ** 2, axis=1))
