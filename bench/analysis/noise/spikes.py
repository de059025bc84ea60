"""Means that stand out of all others: single ones, and short stretches that nothing recorded explains."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from bench.base import OUTPUTS, BoolArray, FloatArray, IntArray, despike, deviation
from bench.record import Dataset

_LONGEST_S, _FADED_S = 1200.0, 2400.0  # of a stretch, and of one that fades
_SHARP = 2  # rows in which a stretch begins, and ends: the first is a mean of both where it begins within it
_EDGE = 8.0  # robust deviations, of the change over these rows
_BACK = 0.3  # of its height: the values return to where they were
_FLAT = 3.0  # robust deviations that its rows are from its height, beside as much
_BESIDE = 5  # rows before, in and after it, at least
_MOVES, _SCATTER = 5.0, 0.3  # robust deviations, and deviations of the whole: a channel that changes by more moves
_NEAR = 0.02  # of the deviation of a channel: it is the same there
_MOST, _MOST_ROWS = 6, 0.25  # stretches of one record, and its rows in them: what comes more often is no accident
_SHARE = 0.1  # of the rows where a channel is as in a stretch: it may be the cause where more stand out, too
_MOST_EDGES, _MOST_PAIRS = 100, 40  # sharp changes, and stretches between two of them, that are looked at
_CERTAIN = 8.0  # robust deviations, 5.9 standard deviations: no Gaussian noise reaches them, and a floor keeps its tail


class Stretch(NamedTuple):
    """Rows `first` to before `end` of a record that stand out by `height`, in the unit of the values."""

    first: int
    end: int
    height: float


def stand_out(
    values: FloatArray,
    interval_s: float,
    channels: Sequence[FloatArray] = (),
    without: Callable[[BoolArray], FloatArray] | None = None,
) -> list[Stretch]:
    """Stretches of up to 20 minutes in which values (n,) jump away and back within a row or two: a hand at the chamber,
    a disturbed line, a loop that lost its lock; at rest also those of up to 40 minutes in which a shock fades.

    A thermal effect has no such edges, and a state that changes comes back or stays. None that one of the recorded
    `channels` (n,) may cause; nothing where there are many. Where `values` are what a curve leaves, `without` gives
    what is left (n,) of one fitted without some rows (n,): a curve that follows a stretch hides it. A shock does not
    count there: cracks and turns of the temperature look like it.
    """
    known, rows, found = np.flatnonzero(np.isfinite(values)), np.arange(len(values)), list[Stretch]()
    for begin, leave in jumps(values[known], interval_s):
        first, end = int(known[begin + 1]), int(known[leave + 1]) + 1
        left = values if without is None else without((rows >= first) & (rows < end))
        one = _stands(left, first, end)
        moved = any(moves(c[known], begin) and moves(c[known], leave) for c in channels)
        if one and not moved and not any(_with(left, channel, one) for channel in channels):
            found.append(one)
    if not found and without is None:
        for first in sharp(values).tolist():
            one, at = _fades(values, first, int(_FADED_S / interval_s)), int(np.searchsorted(known, first)) - 1
            if one and not any(moves(c[known], at) or _with(values, c, one) for c in channels):
                found.append(one)
    return _few(found, len(values))


def stretches(
    run: Dataset, residual: FloatArray, without: Callable[[BoolArray], FloatArray] | None = None
) -> list[Stretch]:
    """Stretches of a residual (n,) of a run that stand out of a curve, or at rest, and that no channel may cause."""
    return stand_out(residual, run.interval_s, causes(run), without)


def causes(run: Dataset) -> list[FloatArray]:
    """What was recorded beside the outputs of the unit, (n,) each: the channels, and how fast the temperature moves."""
    return [*(values for name, values in run.channels.items() if name not in OUTPUTS), run.dT_dt]


def sharp(values: FloatArray, *, beside_slow: bool = False) -> IntArray:
    """Rows of values (n,) before which they change sharply, beside how they scatter; `beside_slow` changes, beside how
    they do from row to row.
    """
    rows = np.flatnonzero(despike(values))
    known = values[rows]
    if known.size < 4 * _BESIDE:
        return rows[:0]
    noise = deviation(known[_SHARP:] - known[:-_SHARP]) / np.sqrt(2.0) if beside_slow else deviation(known)
    if not noise:
        return rows[:0]
    return rows[[at + 1 for at, _ in _edges(known, _EDGE * noise)]]


def jumps(known: FloatArray, interval_s: float) -> list[tuple[int, int]]:
    """Rows before two sharp changes of values (n,) without gaps, one up and one down, up to 20 minutes apart; none
    where there are many.
    """
    if known.size < 4 * _BESIDE or not (noise := deviation(known)):
        return []
    found = list[tuple[int, int]]()
    for (begin, up), (leave, down) in combinations(_edges(known, _EDGE * noise)[:_MOST_EDGES], 2):
        apart = leave - begin
        if up * down < 0.0 and _BESIDE < apart <= _LONGEST_S / interval_s and leave + _SHARP < known.size:
            found.append((begin, leave))
    return found if len(found) <= _MOST_PAIRS else []


def _stands(values: FloatArray, first: int, end: int) -> Stretch | None:
    """Values (n,) between two jumps as a stretch that stands out, flat, of what was before and after; None: not so."""
    rows = np.flatnonzero(despike(values))
    known, (start, stop) = values[rows], np.searchsorted(rows, [first, end]).tolist()
    before, after = known[max(start - _BESIDE, 0) : start], known[stop : stop + _BESIDE]
    inside, noise = known[start + _SHARP - 1 : stop - _SHARP + 1], deviation(known)
    if not (before.size and after.size and inside.size):
        return None
    level = 0.5 * (np.median(before) + np.median(after))
    height = float(np.median(inside) - level)
    if abs(height) < _EDGE * noise or abs(np.median(after) - np.median(before)) > _BACK * abs(height):
        return None
    # A resonance or a transition that is passed has flanks, and a top.
    flat = float(np.max(np.abs(inside - level - height))) <= _BACK * abs(height) + _FLAT * noise
    return Stretch(first, end, height) if flat else None


def _fades(values: FloatArray, first: int, longest: int) -> Stretch | None:
    """Values (n,) that jump away at a row and come back by themselves within so many rows; None: they do not."""
    rows = np.flatnonzero(np.isfinite(values))
    start = int(np.searchsorted(rows, first))
    known = values[rows]
    before, inside = known[max(start - _BESIDE, 0) : start], known[start : start + longest + _BESIDE]
    if before.size < _BESIDE or inside.size < 2 * _BESIDE:
        return None
    noise, off = deviation(known), inside - np.median(before)
    sign = float(np.sign(off[np.argmax(np.abs(off[: _SHARP + 1]))]))
    off *= sign
    height = float(np.max(off[: _SHARP + 1]))
    near = _FLAT * noise
    calm = np.convolve(np.abs(off) <= near, np.ones(_BESIDE), "valid") >= _BESIDE - 1
    if height < _EDGE * noise or not calm.any() or (back := int(np.argmax(calm))) < 2 * _BESIDE:
        return None
    falls = off[int(np.argmax(off[: _SHARP + 1])) : back]
    alone = float(np.max(falls - np.minimum.accumulate(falls))) <= near + 0.05 * height and falls.min() >= -near
    last = min(start + back + back // 2, len(rows)) - 1  # the rest of it is below the noise of a row, not of many
    return Stretch(first, int(rows[last]) + 1, sign * height) if alone else None


def _few(found: list[Stretch], rows: int) -> list[Stretch]:
    """Those of these stretches of so many rows that do not overlap, the highest first, where there are few."""
    kept = list[Stretch]()
    for one in sorted(found, key=lambda one: -abs(one.height)):
        if all(one.end <= other.first or other.end <= one.first for other in kept):
            kept.append(one)
    found = sorted(kept)
    return found if len(found) <= _MOST and sum(one.end - one.first for one in found) <= _MOST_ROWS * rows else []


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
    wider = max(0.5 * (_NEAR * float(np.nanstd(channel)) - (high - low)), 0.0)  # where it stands still
    alike = residual[~inside & (channel >= low - wider) & (channel <= high + wider) & np.isfinite(residual)]
    off = (alike - np.nanmedian(residual)) * np.sign(one.height)
    return alike.size < _BESIDE or bool(np.mean(off > _BACK * abs(one.height)) > _SHARE)


def spiky(rate: FloatArray, rows: int, interval_s: float) -> BoolArray:
    """Rows (n,) of `interval_s` that lie in a mean over so many `rows` that is a spike, or in means that stand out."""
    means = np.pad(rate, (0, -len(rate) % rows), constant_values=np.nan).reshape(-1, rows)
    known = np.isfinite(means)
    count = known.sum(axis=1)
    mean = np.where(count > 0, np.where(known, means, 0.0).sum(axis=1) / np.maximum(count, 1), np.nan)
    kept = despike(mean, _CERTAIN)
    for one in stand_out(np.where(kept, mean, np.nan), interval_s * rows):
        kept[one.first : one.end] = False
    return np.repeat(np.isfinite(mean) & ~kept, rows)[: len(rate)]


def _edges(known: FloatArray, limit: float) -> list[tuple[int, float]]:
    """Last row before each sharp change by more than a limit, and the change; of neighbours the first of its sign.

    A slope is no such change: that of a curve which follows a stretch in part is steep all about it.
    """
    change = known[_SHARP:] - known[:-_SHARP]
    about = np.lib.stride_tricks.sliding_window_view(np.pad(change, _BESIDE, mode="reflect"), 2 * _BESIDE + 1)
    change = change - np.median(about, axis=1)
    found = list[tuple[int, float]]()
    last = -_SHARP - 1
    for row in np.flatnonzero(np.abs(change) > limit).tolist():
        if row - last > 1 or change[row] * change[last] < 0.0:
            found.append((row, float(change[row])))
        last = row
    return found


def moves(channel: FloatArray, row: int) -> bool:
    """Whether a channel without gaps about there changes sharply, too."""
    change = np.abs(channel[_SHARP:] - channel[:-_SHARP])
    if not np.isfinite(change).any():
        return False
    near, usual = change[max(row - 1, 0) : row + 2], 1.4826 * float(np.nanmedian(change))
    return bool(np.nanmax(near, initial=0.0) > max(_MOVES * usual, _SCATTER * float(np.nanstd(channel))))
