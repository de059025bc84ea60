"""Means that stand out of all others: single ones, and short stretches that nothing recorded explains."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from bench.base import OUTPUTS, BoolArray, FloatArray, despike, deviation
from bench.record import Dataset

_LONGEST_S = 1200.0
_SHARP = 2  # rows in which a stretch begins, and ends: the first is a mean of both where it begins within it
_EDGE = 8.0  # robust deviations, of the change over these rows
_BACK = 0.3  # of its height: the values return to where they were
_FLAT = 3.0  # robust deviations that its rows are from its height, beside as much
_BESIDE = 5  # rows before, in and after it, at least
_MOVES, _SCATTER = 5.0, 0.3  # robust deviations, and deviations of the whole: a channel that changes by more moves
_MOST, _SHARE = 3, 0.1  # stretches of one record, and its rows in them: what comes more often is no accident
_CERTAIN = 8.0  # robust deviations, 5.9 standard deviations: no Gaussian noise reaches them, and a floor keeps its tail


class Stretch(NamedTuple):
    """Rows `first` to before `end` of a record that stand out by `height`, in the unit of the values."""

    first: int
    end: int
    height: float


def stand_out(values: FloatArray, interval_s: float, channels: Sequence[FloatArray] = ()) -> list[Stretch]:
    """Stretches of up to 20 minutes in which values (n,) jump away and back within a row or two, and none of the
    recorded `channels` (n,) moves at both ends: a hand at the chamber, a disturbed line, a loop that lost its lock.

    A thermal effect has no such edges, and a state that changes comes back or stays. Nothing where there are many.
    """
    rows = np.flatnonzero(np.isfinite(values))
    known = values[rows]
    if known.size < 4 * _BESIDE or not (noise := deviation(known)):
        return []
    ends = _edges(known, _EDGE * noise)
    found = list[Stretch]()
    for (begin, up), (leave, down) in pairwise(ends):
        first, end = begin + 1, leave + _SHARP
        before, after = known[max(begin - _BESIDE + 1, 0) : begin + 1], known[end : end + _BESIDE]
        inside = known[begin + _SHARP : leave + 1]
        if up * down > 0.0 or inside.size < _BESIDE or not after.size or (end - first) * interval_s > _LONGEST_S:
            continue
        level = 0.5 * (np.median(before) + np.median(after))
        height = float(np.median(inside) - level)
        if abs(height) < _EDGE * noise or abs(np.median(after) - np.median(before)) > _BACK * abs(height):
            continue
        if float(np.max(np.abs(inside - level - height))) > _BACK * abs(height) + _FLAT * noise:
            continue  # a resonance or a transition that is passed has flanks, and a top
        if not any(_moves(c[rows], begin) and _moves(c[rows], leave) for c in channels):
            found.append(Stretch(int(rows[first]), int(rows[end - 1]) + 1, height))
    some = len(found) <= _MOST and sum(one.end - one.first for one in found) <= _SHARE * len(values)
    return found if some else []


def regular(run: Dataset, residual: FloatArray) -> tuple[BoolArray, list[Stretch]]:
    """Rows (n,) of a run to keep, without spikes of a residual (n,) and stretches that stand out; and these."""
    kept = despike(residual)
    plain = np.where(kept, residual, np.nan)
    channels = [values for name, values in run.channels.items() if name not in OUTPUTS]
    found = stand_out(plain, run.interval_s, channels := [*channels, run.dT_dt])
    found = [one for one in found if not any(_with(plain, channel, one) for channel in channels)]
    return kept & _undisturbed(found, len(kept)), found


def _with(residual: FloatArray, channel: FloatArray, one: Stretch) -> bool:
    """Whether a channel may be the cause: the run has hardly any other rows where it is as there, or these stand out,
    too.
    """
    inside = np.zeros(len(residual), dtype=bool)
    inside[one.first : one.end] = True
    known = channel[inside & np.isfinite(channel)]
    if not known.size:
        return False
    low, high = np.quantile(known, [0.1, 0.9])
    alike = residual[~inside & (channel >= low) & (channel <= high) & np.isfinite(residual)]
    off = (alike - np.nanmedian(residual)) * np.sign(one.height)
    return alike.size < _BESIDE or bool(np.mean(off > _BACK * abs(one.height)) > _SHARE)


def spiky(rate: FloatArray, rows: int, interval_s: float) -> BoolArray:
    """Rows (n,) of `interval_s` that lie in a mean over so many `rows` that is a spike, or in means that stand out."""
    means = np.pad(rate, (0, -len(rate) % rows), constant_values=np.nan).reshape(-1, rows)
    known = np.isfinite(means)
    count = known.sum(axis=1)
    mean = np.where(count > 0, np.where(known, means, 0.0).sum(axis=1) / np.maximum(count, 1), np.nan)
    kept = despike(mean, _CERTAIN)
    kept &= _undisturbed(stand_out(np.where(kept, mean, np.nan), interval_s * rows), len(mean))
    return np.repeat(np.isfinite(mean) & ~kept, rows)[: len(rate)]


def _undisturbed(stretches: Sequence[Stretch], rows: int) -> BoolArray:
    """Rows (n,) of so many that lie in none of the stretches."""
    kept = np.ones(rows, dtype=bool)
    for one in stretches:
        kept[one.first : one.end] = False
    return kept


def _edges(known: FloatArray, limit: float) -> list[tuple[int, float]]:
    """Last row before each sharp change by more than a limit, and the change; of neighbours the first of its sign."""
    change = known[_SHARP:] - known[:-_SHARP]
    found = list[tuple[int, float]]()
    last = -_SHARP - 1
    for row in np.flatnonzero(np.abs(change) > limit).tolist():
        if row - last > 1 or change[row] * change[last] < 0.0:
            found.append((row, float(change[row])))
        last = row
    return found


def _moves(channel: FloatArray, row: int) -> bool:
    """Whether a channel without gaps about there changes sharply, too."""
    change = np.abs(channel[_SHARP:] - channel[:-_SHARP])
    if not np.isfinite(change).any():
        return False
    near, usual = change[max(row - 1, 0) : row + 2], 1.4826 * float(np.nanmedian(change))
    return bool(np.nanmax(near, initial=0.0) > max(_MOVES * usual, _SCATTER * float(np.nanstd(channel))))
