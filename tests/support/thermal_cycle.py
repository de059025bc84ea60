"""A slow cycle of temperature with sensor noise, its sums in cells, and the curve of a fit to them."""

import numpy as np

from bench.analysis.effects.spline import Spline
from bench.analysis.fit.cells import Cells
from bench.analysis.fit.state import State
from bench.record.dataset import Dataset

HZ = 50.0


def record(n=60_000, seed=0, step=0.0):
    """A slow cycle of temperature with sensor noise, at 50 Hz; `step` is that of the sensor [degC]."""
    random = np.random.default_rng(seed)
    time = np.arange(n) / HZ
    temperature = 22.5 - 62.5 * np.cos(2 * np.pi * time / time[-1]) + random.normal(0.0, 0.003, n)
    if step:
        temperature = np.round(temperature / step) * step
    y = 12.0 + 3.0 * np.sin(temperature / 20.0) + 0.02 * temperature + random.normal(0.0, 1.0, n)
    return time, temperature, y


def in_cells(time, temperature, y, cells=96, ends=(-41.0, 86.0), **options):
    state = State(Cells(*ends, cells, 10.0), **options)
    state.add(time, {"temperature": temperature}, y)
    return state


def curve(solved, m, ends, scale, at):
    spline = Spline(m, ends, scale)
    rows = Dataset("at", np.arange(float(at.size)), {"temperature": at, "rate": at}, np.zeros(at.size, dtype=int))
    return solved.beta[0] + spline.columns(rows, {}) @ solved.beta[1:]
