"""An isothermal run on a rate table that changes its rate: the error of the scale factor is no noise."""

from __future__ import annotations

import numpy as np

from bench.analysis.thresholds import TURNING_DPS
from bench.base import FloatArray, IntArray
from bench.record import Dataset

_ORDER = 3  # a scale factor that is wrong, differs by the sense of turning and bends with the rate


def scale_columns(record: Dataset, rows: IntArray) -> FloatArray:
    """Powers of the applied rate over its largest value, about their means (n, p) of the rows (n,); none where the
    table does not change its rate.
    """
    applied = np.nan_to_num(record.channels.get("applied_rate", np.zeros(len(record)))[rows])
    if np.ptp(applied) <= TURNING_DPS:
        return np.zeros((rows.size, 0))
    order = min(_ORDER, np.unique(np.round(applied)).size - 1)
    powers = (applied / np.max(np.abs(applied)))[:, None] ** np.arange(1, max(order, 1) + 1)
    return np.asarray(powers - powers.mean(axis=0))


def at_rest(record: Dataset, rows: IntArray) -> Dataset:
    """The record whose rows (n,) have no error of the scale factor left in their bias, as if the table stood still."""
    columns = scale_columns(record, rows)
    known = np.isfinite(record.bias[rows])
    if not columns.size or not known.any():
        return record
    bias = record.bias[rows][known]
    rate = record.channel("rate").copy()
    rate[rows] -= columns @ np.linalg.lstsq(columns[known], bias - bias.mean())[0]
    return record.with_channel("rate", rate)
