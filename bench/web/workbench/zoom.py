"""A part of a run at screen resolution: means of as many bins as there are pixels, and extremes of every bin.

Wide views are made from the 1 s means, narrow ones from the samples, of which only the necessary row groups are read.
Extremes are those of the means or samples, so that a view shows a spike of one sample.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bench.base import DPH_PER_DPS, FloatArray, InputError, IntArray
from bench.record import EARTH, Dataset, SampleFile

SAMPLES_WITHIN_S = 1200.0
"""Longest range that is read from the samples [s]."""
MOST_BINS = 2000


@dataclass(frozen=True, eq=False)
class View:
    """Bins (n,) of a range; NaN where nothing was captured. Bias in deg/h, temperature in degC."""

    time: FloatArray
    bias: FloatArray
    low: FloatArray
    high: FloatArray
    temperature: FloatArray
    fitted: FloatArray | None
    interval_s: float
    of: str
    """Name of the data whose extremes `low` and `high` are."""

    def dataset(self, name: str) -> Dataset:
        """The means as a dataset, for the figures of the report."""
        return Dataset(
            name, self.time, {"rate": self.bias, "temperature": self.temperature},
            np.zeros(self.time.size, dtype=np.int64), interval_s=self.interval_s,
        )  # fmt: skip


def view(
    base: Dataset, samples: Path, span: tuple[float | None, float | None], bins: int, fitted: FloatArray | None
) -> View:
    """The range `span` [s] of a run in about `bins` bins; `base` are its 1 s means, `fitted` (n,) the model for them.

    InputError for a range without data.
    """
    first, last = float(base.time[0]) - 0.5, float(base.time[-1]) + 0.5
    begin = first if span[0] is None else max(first, span[0])
    end = last if span[1] is None else min(last, span[1])
    if not end > begin:
        raise InputError(f"{base.name}: no data in this range; the run has {first:g} to {last:g} s, choose among them")
    width = (end - begin) / min(max(bins, 10), MOST_BINS)
    read = _samples(samples, begin, end) if end - begin <= SAMPLES_WITHIN_S and samples.is_file() else None
    if read is not None and read[0].size:
        time, bias, temperature = read
        if EARTH in base.channels:
            bias = bias - np.interp(time, base.time, base.channels[EARTH])
        known = None if fitted is None else np.interp(time, base.time, fitted)
        return _binned((time, bias, temperature, known), width, 0.0, "samples")
    rows = (base.time >= begin) & (base.time <= end)
    if not rows.any():
        raise InputError(f"{base.name}: nothing was captured from {begin:g} to {end:g} s")
    known = None if fitted is None else fitted[rows]
    columns = base.time[rows], base.bias[rows], base.channel("temperature")[rows], known
    return _binned(columns, width, base.interval_s, f"{base.interval_s:g} s means")


def _binned(
    columns: tuple[FloatArray, FloatArray, FloatArray, FloatArray | None], width: float, least: float, of: str
) -> View:
    """Means of bins of `width` [s], extremes of the bias; a bin without a row in the middle of the range is a gap.

    No bin is shorter than a step of the rows, which another program may have logged at long steps, or than `least`.
    """
    time, bias, temperature, fitted = columns
    step = max(least, float(np.median(np.diff(time))) if time.size > 1 else 0.0)
    begin, interval = float(time[0]) - step / 2, max(width, step)  # a row with jitter remains in its bin
    which = np.floor((time - begin) / interval).astype(np.int64)
    starts = np.flatnonzero(np.diff(which, prepend=which[0] - 1))
    filled = which[starts] - which[0]
    size = int(filled[-1]) + 1

    def spread(values: FloatArray) -> FloatArray:
        out = np.full(size, np.nan)
        out[filled] = values
        return out

    middle = begin + (which[0] + np.arange(size) + 0.5) * interval
    with np.errstate(invalid="ignore"):
        return View(
            time=middle,
            bias=spread(_means(bias, starts)),
            low=spread(np.fmin.reduceat(bias, starts)),
            high=spread(np.fmax.reduceat(bias, starts)),
            temperature=spread(_means(temperature, starts)),
            fitted=None if fitted is None else spread(_means(fitted, starts)),
            interval_s=interval,
            of=of,
        )


def _means(values: FloatArray, starts: IntArray) -> FloatArray:
    present = np.isfinite(values)
    count = np.add.reduceat(present.astype(np.float64), starts)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean: FloatArray = np.add.reduceat(np.where(present, values, 0.0), starts) / count
    return mean


def _samples(path: Path, begin: float, end: float) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Time, bias and temperature of every sample of a range; None if the file does not contain them."""
    with SampleFile(path) as source:
        if not {"time", "rate", "temperature"} <= set(source.names):
            return None
        needed = [name for name in ("time", "rate", "temperature", "applied_rate") if name in source.names]
        groups = list(_groups(source, begin, end))
        if not groups:
            return None
        columns = source.read(needed, groups)
    first, last = np.searchsorted(columns["time"], [begin, end])
    time, rate, temperature = (columns[name][first:last] for name in ("time", "rate", "temperature"))
    if "applied_rate" in columns:
        rate = rate - DPH_PER_DPS * np.nan_to_num(columns["applied_rate"][first:last])
    return time, rate, temperature


def _groups(source: SampleFile, begin: float, end: float) -> Iterator[int]:
    """Row groups that overlap the range, by the statistics in the file; without statistics, all."""
    for group in source.groups:
        known = source.ends("time", group)
        if known is None or (known[1] >= begin and known[0] <= end):
            yield group
