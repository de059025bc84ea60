"""A summary of a record in some six kilobytes, from which linear models are solved as from its rows.

Two summaries of the same weighted rows:

* `cells`: the range of temperature in 48 equal cells, in each the sums of w u^0 .. w u^6 and w y u^0 .. w y u^3 with u
  in [-1, 1] inside the cell. Every cubic spline whose knots are borders of cells follows from them exactly.
* triangles: R of the QR factorisation of [1, Chebyshev polynomials, y], of temperature up to order 12, and of the four
  channels of `regression` up to order 3. A triangle keeps the accuracy of QR where the columns are nearly collinear
  (frequency is nearly a function of temperature), which a Gram matrix squares away.

Both add: two records of the same ranges merge into what one pass over both gives. The constant, weights and scales are
those of `bench.analysis.fit`, so coefficients, RMS and condition agree with it to rounding.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy

from bench.analysis.effects.base import Scale, Series
from bench.analysis.effects.regression import Regression
from bench.analysis.fit.cells import POWERS, SUMS, Cells
from bench.analysis.thresholds import LEAST_RANGE_DEGC
from bench.base import BoolArray, FloatArray, InputError
from bench.record import Dataset

CELLS = 48
"""Splines of 2, 3, 4, 6, 8, 12, 16, 24 and 48 intervals have their knots on borders."""

ORDER = {"static": 12, "joint": 3}
"""Highest order of the polynomials in temperature alone, and in the four channels."""

CHANNELS = Regression.needs
Ranges = Mapping[str, tuple[float, float]]

_STATIC, _JOINT = ORDER["static"] + 2, 4 * ORDER["joint"] + 2
_UPPER = {size: np.triu_indices(size) for size in (_STATIC, _JOINT)}
SIZE = 2 * len(CHANNELS) + 6 + 12 * CELLS + 1 + len(_UPPER[_STATIC][0]) + len(_UPPER[_JOINT][0])
"""Numbers of a packed state."""


@dataclass(frozen=True, eq=False)
class Moments:
    """The state. `ranges` (4, 2) of the channels, NaN without one; `offset` [deg/h] is taken off y in the cells."""

    ranges: FloatArray
    weight: FloatArray
    """(2,) sum of weights of the rows with a temperature, and of those with all four channels."""
    rows: FloatArray
    """(2,) their number."""
    full: float
    """Samples of a full bin, of which a row's weight is its share."""
    offset: float
    cell_rows: FloatArray
    powers: FloatArray
    """(48, 7)"""
    products: FloatArray
    """(48, 4)"""
    square: float
    static: FloatArray
    """(14, 14) upper triangle of temperature alone."""
    joint: FloatArray
    """(14, 14) upper triangle of the four channels."""

    @classmethod
    def of(cls, records: Sequence[Dataset], ranges: Ranges | None = None) -> Moments:
        """State of all rows of these records; `ranges` where they are known before (a live run, a merge).

        InputError: no row, or a temperature that stands still.
        """
        usable = [np.isfinite(r.bias) & np.isfinite(r.channel("temperature")) for r in records]
        if not any(mask.any() for mask in usable):
            raise InputError(
                f"{', '.join(r.name for r in records) or 'no record'}: zero rows with rate and temperature"
            )
        whole = [mask & _joint_rows(record) for record, mask in zip(records, usable, strict=True)]
        counts = np.concatenate([r.count("rate")[m] for r, m in zip(records, usable, strict=True)])
        if ranges is None:
            ranges = _ranges(records, usable, whole)
        bounds = np.array([ranges.get(channel, (np.nan, np.nan)) for channel in CHANNELS])
        state = _empty(bounds, float(np.median(counts)))
        for record, mask, all_four in zip(records, usable, whole, strict=True):
            state = state.adding(record, mask, all_four)
        return state

    def adding(self, record: Dataset, mask: BoolArray, whole: BoolArray) -> Moments:
        """The state with more rows."""
        y, weight = record.bias[mask], np.minimum(record.count("rate")[mask] / self.full, 1.0)
        x = record.channel("temperature")[mask]
        offset = float(np.mean(y)) if not self.rows[0] and y.size else self.offset
        cell_rows, powers, products, square = _cells(x, y - offset, weight, self.ranges[0])
        own = replace(
            self,
            offset=offset,
            rows=np.array([mask.sum(), whole.sum()], dtype=np.float64),
            weight=np.array([weight.sum(), np.sum(weight[whole[mask]])]),
            cell_rows=cell_rows,
            powers=powers,
            products=products,
            square=float(square),
            static=_factor([_series("temperature", self.ranges, "static")], record.select(mask), weight),
            joint=np.zeros((_JOINT, _JOINT)),
        )
        if whole.any() and np.all(np.isfinite(self.ranges)):
            series = [_series(channel, self.ranges, "joint") for channel in CHANNELS]
            own = replace(own, joint=_factor(series, record.select(whole), weight[whole[mask]]))
        return merged(self, own)

    def pack(self) -> FloatArray:
        """All of it as one vector (SIZE,)."""
        parts = (
            self.ranges, self.weight, self.rows, self.full, self.offset, self.cell_rows, self.powers, self.products,
            self.square, self.static[_UPPER[_STATIC]], self.joint[_UPPER[_JOINT]],
        )  # fmt: skip
        return np.concatenate([np.ravel(part) for part in parts])

    @classmethod
    def unpack(cls, values: FloatArray) -> Moments:
        """The state of a vector; InputError where it has not the right size or is not finite."""
        if values.shape != (SIZE,) or not np.all(np.isfinite(values[2 * len(CHANNELS) :])):
            raise InputError(
                f"moments are damaged: {np.count_nonzero(np.isfinite(values))} of {SIZE} numbers are there"
            )
        lengths = (8, 2, 2, 1, 1, CELLS, 7 * CELLS, 4 * CELLS, 1, len(_UPPER[_STATIC][0]))
        parts = np.split(np.array(values), np.cumsum(lengths))
        return cls(
            ranges=parts[0].reshape(4, 2), weight=parts[1], rows=parts[2], full=float(parts[3][0]),
            offset=float(parts[4][0]), cell_rows=parts[5], powers=parts[6].reshape(CELLS, 7),
            products=parts[7].reshape(CELLS, 4), square=float(parts[8][0]),
            static=_triangle(parts[9], _STATIC), joint=_triangle(parts[10], _JOINT),
        )  # fmt: skip


def merged(first: Moments, second: Moments) -> Moments:
    """State of the rows of both; InputError unless their ranges and their samples a bin are the same."""
    if not np.array_equal(first.ranges, second.ranges, equal_nan=True) or first.full != second.full:
        raise InputError("moments over different ranges or bins cannot be merged; make them with common ranges")
    shift = second.offset - first.offset if first.rows[0] else 0.0
    offset = first.offset if first.rows[0] else second.offset
    products = second.products + shift * second.powers[:, :4]
    square = second.square + 2 * shift * second.products[:, 0].sum() + shift**2 * second.powers[:, 0].sum()
    return Moments(
        ranges=first.ranges,
        weight=first.weight + second.weight,
        rows=first.rows + second.rows,
        full=first.full,
        offset=offset,
        cell_rows=first.cell_rows + second.cell_rows,
        powers=first.powers + second.powers,
        products=first.products + products,
        square=first.square + float(square),
        static=_stacked(first.static, second.static),
        joint=_stacked(first.joint, second.joint),
    )


def _cells(x: FloatArray, y: FloatArray, weight: FloatArray, bounds: FloatArray) -> tuple[FloatArray, ...]:
    """Rows, powers, products and square sum of y in the cells."""
    low, high = bounds.tolist()
    cells = Cells(low, high, CELLS)
    sums = cells.of(x, y, weight).reshape(CELLS, SUMS)
    rows = cells.of(x, y, np.ones_like(x)).reshape(CELLS, SUMS)[:, 0]
    return rows, sums[:, :POWERS], sums[:, POWERS:-1], sums[:, -1].sum()


def _factor(series: Sequence[Series], record: Dataset, weight: FloatArray) -> FloatArray:
    """R (p, p) of the weighted columns [1, Chebyshev polynomials, y]."""
    columns = [np.ones((len(record), 1)), *(one.columns(record) for one in series), record.bias[:, None]]
    weighted = np.hstack(columns) * np.sqrt(weight)[:, None]
    return _square(scipy.linalg.qr(weighted, mode="r")[0], weighted.shape[1])


def _stacked(first: FloatArray, second: FloatArray) -> FloatArray:
    if not first.any():
        return second
    return _square(scipy.linalg.qr(np.vstack([first, second]), mode="r")[0], len(first)) if second.any() else first


def _square(r: Any, size: int) -> FloatArray:
    out = np.zeros((size, size))
    rows = min(size, len(r))
    out[:rows] = np.triu(r)[:rows]
    return out


def _triangle(values: FloatArray, size: int) -> FloatArray:
    out = np.zeros((size, size))
    out[_UPPER[size]] = values
    return out


def _series(channel: str, ranges: FloatArray, which: str) -> Series:
    low, high = ranges[CHANNELS.index(channel)].tolist()
    return Series(channel, ORDER[which], Scale(low, high))


def _joint_rows(record: Dataset) -> BoolArray:
    if any(channel not in record.channels for channel in CHANNELS):
        return np.zeros(len(record), dtype=bool)
    rows: BoolArray = np.all([np.isfinite(record.channel(channel)) for channel in CHANNELS], axis=0)
    return rows


def _ranges(records: Sequence[Dataset], usable: Sequence[BoolArray], whole: Sequence[BoolArray]) -> Ranges:
    """Ranges over the rows; without those of `regression` where a channel is missing or stands still."""
    scale = Scale.of([r.select(m) for r, m in zip(records, usable, strict=True)], "temperature", LEAST_RANGE_DEGC)
    ranges = {"temperature": (scale.low, scale.high)}
    selected = [r.select(m) for r, m in zip(records, whole, strict=True) if m.any()]
    for channel in CHANNELS[1:]:
        try:
            scale = Scale.of(selected, channel)
        except (InputError, ValueError):  # it has no value, or only one
            continue
        ranges[channel] = (scale.low, scale.high)
    return ranges


def _empty(ranges: FloatArray, full: float) -> Moments:
    nothing = np.zeros(2)
    return Moments(
        ranges, nothing, nothing, full, 0.0, np.zeros(CELLS), np.zeros((CELLS, 7)), np.zeros((CELLS, 4)), 0.0,
        np.zeros((_STATIC, _STATIC)), np.zeros((_JOINT, _JOINT)),
    )  # fmt: skip
