"""Contiguous pieces of a record that are left out in turn, so that it proves a model by itself."""

from __future__ import annotations

from math import isfinite

import numpy as np

from bench.analysis.thresholds import MOST_EXTRAPOLATED, NEAR_RANGE
from bench.base import BoolArray, FloatArray, IntArray
from bench.record import Dataset

BLOCKS = 20
_MOST_BLOCKS = 80
_LEAST_ROWS = 3
_PAUSE_S = 900.0  # longest gap between means over which a straight line stands for the temperature
_RECOVERS_S = 1800.0
_SWING = 0.1  # of the range of temperature: what turns back by more ends a leg


def pieces_of(record: Dataset) -> IntArray:
    """Contiguous blocks (n,) of a record: 20, and more where those would take the ends of its temperatures with them.

    A record that reaches its coldest and its warmest temperature once cannot be predicted there without them.
    """
    rows, degc = np.arange(len(record), dtype=np.int64), record.channel("temperature")
    known, count = np.isfinite(degc), BLOCKS
    while True:
        pieces: IntArray = rows * count // max(rows.size, 1)
        if _taken_share(pieces[known], degc[known]) <= MOST_EXTRAPOLATED:
            return pieces
        count *= 2
        if count > _MOST_BLOCKS or rows.size < _LEAST_ROWS * count:
            return rows * BLOCKS // max(rows.size, 1)


def _taken_share(pieces: IntArray, degc: FloatArray) -> float:
    """Share of the temperatures (n,) that lie beyond those of all other blocks, as a score counts them."""
    outside = 0
    for end in (degc, -degc):
        order = np.argsort(end)
        others = end[order][pieces[order] != pieces[order[0]]]
        if others.size:
            outside += int(np.sum(end < others[0] - NEAR_RANGE * np.ptp(others)))
    return outside / max(degc.size, 1)


def pauses(record: Dataset) -> list[tuple[float, float]]:
    """Times [s] at which the data of a record begin again after a pause, and how long each pause lasted [s]."""
    time = record.time[np.isfinite(record.bias)]
    gaps = np.diff(time)
    return [(float(time[row + 1]), float(gaps[row])) for row in np.flatnonzero(gaps > _PAUSE_S).tolist()]


def after_pauses(record: Dataset) -> BoolArray:
    """Rows (n,) that follow a pause so closely that the state of what has a memory is not known in them: as long as the
    pause lasted, and half an hour at most.
    """
    late = np.zeros(len(record), dtype=bool)
    for begin_s, lasted_s in pauses(record):
        late |= (record.time >= begin_s) & (record.time < begin_s + min(lasted_s, _RECOVERS_S))
    return late


def legs_of(temperature: FloatArray) -> IntArray:
    """Leg (n,) of each row of a record: from one turning point of the temperature (n,) [degC] to the next."""
    swing = max(_SWING * float(np.nanmax(temperature) - np.nanmin(temperature)), 1.0)
    turns, begin, sign = [], 0, 0
    extreme = temperature[0]
    for row, value in enumerate(temperature.tolist()):
        if not isfinite(value):
            continue
        if not isfinite(extreme) or ((value - extreme) * sign >= 0.0 and sign):
            extreme, begin = value, row
        elif abs(value - extreme) > swing:
            turns += [begin] if sign else []
            sign = 1 if value > extreme else -1
            extreme, begin = value, row
    label = np.zeros(len(temperature), dtype=np.int64)
    label[turns] = 1
    return np.asarray(np.cumsum(label))
