"""The Earth's rotation along the sensitive axis of a unit, out of its stated orientation.

A level axis at latitude L and azimuth A sees x cos L cos A, a vertical one x sin L (IEEE Std 952-2020, annex on test
set-ups), where x is the sidereal rate. Nothing is removed from a run that does not state its orientation.
"""

from __future__ import annotations

import numpy as np

from bench.base import FloatArray
from bench.record.records.manifest import Orientation

EARTH_DPH = 15.041067
"""Sidereal rotation of the Earth [deg/h]."""
EARTH = "earth_rate"
"""Channel of a dataset: what the Earth turned along the axis [deg/h]; absent where the orientation is not stated."""
NOT_STATED = "Earth rate: part of the bias, not removed"


def earth_rate(orientation: Orientation, time: FloatArray, applied_dps: FloatArray | None = None) -> FloatArray:
    """Earth rate along the axis [deg/h], means over equal intervals around `time` [s] (n,).

    `applied_dps`: rate of a table (n,), NaN for none: its axis is vertical, positive rates are counter-clockwise from
    above, and a level axis turns with it from its azimuth at the first row.
    """
    latitude = np.radians(orientation.latitude_deg)
    if orientation.axis != "level":
        up = 1.0 if orientation.axis == "vertical" else -1.0
        return np.full(time.shape, up * EARTH_DPH * np.sin(latitude))
    azimuth = np.radians(orientation.azimuth_deg or 0.0)
    size = EARTH_DPH * np.cos(latitude)
    if applied_dps is None or not np.any(np.nan_to_num(applied_dps)):
        return np.full(time.shape, size * np.cos(azimuth))
    rate, width = np.radians(np.nan_to_num(applied_dps)), float(np.median(np.diff(time))) if time.size > 1 else 1.0
    steps = np.diff(time, prepend=time[0]) * 0.5 * (rate + np.concatenate((rate[:1], rate[:-1])))
    # Within an interval the axis sweeps an arc; the mean of its cosine is that of its middle times a sinc.
    return np.asarray(size * np.cos(azimuth - np.cumsum(steps)) * np.sinc(rate * width / (2.0 * np.pi)))


def earth_told(orientation: Orientation | None) -> str:
    """What is removed, as one sentence without its end."""
    if orientation is None:
        return f"{NOT_STATED} (latitude, axis and azimuth are not stated)"
    where = f"latitude {orientation.latitude_deg:g} deg, axis {orientation.axis.replace('_', ' ')}"
    if orientation.axis == "level":
        where += f", azimuth {orientation.azimuth_deg or 0.0:g} deg"
    value = float(earth_rate(orientation, np.zeros(1))[0])
    return f"Earth rate: {value:.4f} deg/h along the axis ({where}) is removed from the bias"
