"""The result of one pass over a record: sums for each block of time, which add up to any selection of blocks.

A pass cuts the rows where a block of time ends (200 s) and where the segment changes. Each piece gives one vector of
sums, of some kilobytes. These are enough for the fit to all blocks, to those that remain when some are held out, to
heating or cooling alone, to two runs together, and to a record that still grows. No row is read twice, and none is
kept.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Protocol

import numpy as np

from bench.base import BoolArray, FloatArray, IntArray
from bench.record import STILL_DEGC_PER_MIN

BLOCK_S = 200.0


class Sums(Protocol):
    """What is summed over rows without gaps; a pure function of the rows, so that sums add."""

    @property
    def needs(self) -> tuple[str, ...]:
        """Channels that it reads."""

    @property
    def size(self) -> int:
        """Numbers."""

    def sums(self, columns: Mapping[str, FloatArray], y: FloatArray) -> FloatArray:
        """Sums (size,) of rows."""


@dataclass(eq=False)
class State:
    """Sums of each block of time of a record, one vector a block; grows by `add`.

    `touched` counts the rows that were ever read: beside the rows of the record, how often each was.
    """

    sums: Sums
    block_s: float = BLOCK_S
    touched: int = 0
    _keys: list[tuple[int, int, int]] = field(default_factory=list, repr=False)
    _vectors: list[FloatArray] = field(default_factory=list, repr=False)
    _spans: list[list[float]] = field(default_factory=list, repr=False)
    _places: dict[tuple[int, int, int], int] = field(default_factory=dict, repr=False)

    def add(
        self,
        time: FloatArray,
        columns: Mapping[str, FloatArray],
        y: FloatArray,
        segment: IntArray | None = None,
        run: int = 0,
    ) -> None:
        """Take in rows (n,) in order of time; a row with a gap in a channel that is needed, or in y, is left out."""
        if not time.size:
            return
        self.touched += int(time.size)
        # Blocks are told by their borders alone: a quotient rounds, and puts a row on a border into either.
        first, last = (int(np.floor(at / self.block_s)) for at in (time[0], time[-1]))
        borders = np.arange(first, last + 2) * self.block_s
        inner = np.searchsorted(time, borders)
        cuts = inner if segment is None else np.concatenate([inner, np.flatnonzero(segment[1:] != segment[:-1]) + 1])
        edges = np.unique(np.concatenate([[0], cuts, [time.size]])).tolist()
        for start, stop in pairwise(edges):
            part, own, at = _rows(slice(start, stop), self.sums.needs, columns, y, time)
            vector = self.sums.sums(part, own)
            if not np.all(np.isfinite(vector)):  # seen in the sums, which cost less than looking at each row
                part, own, at = _rows(_present(part, own), self.sums.needs, part, own, at)
                vector = self.sums.sums(part, own)
            if own.size:
                block = first - 1 + int(np.searchsorted(borders, at[0], side="right"))
                key = (run, block, -1 if segment is None else int(segment[start]))
                self._take(key, vector, _span(at, part.get("temperature")))

    def _take(self, key: tuple[int, int, int], vector: FloatArray, span: list[float]) -> None:
        place = self._places.setdefault(key, len(self._keys))
        if place == len(self._keys):
            self._keys.append(key)
            self._vectors.append(vector)
            self._spans.append(span)
            return
        self._vectors[place] += vector
        own = self._spans[place]
        self._spans[place] = [*min(own[:2], span[:2]), *max(own[2:], span[2:])]

    @property
    def table(self) -> FloatArray:
        """Sums (blocks, size)."""
        return np.array(self._vectors) if self._vectors else np.zeros((0, self.sums.size))

    @property
    def run(self) -> IntArray:
        """Run of each block."""
        return self._key(0)

    @property
    def segment(self) -> IntArray:
        """Segment of each block, -1 outside."""
        return self._key(2)

    def _key(self, which: int) -> IntArray:
        return np.array([key[which] for key in self._keys], dtype=np.int64)

    @property
    def direction(self) -> IntArray:
        """+1 heating, -1 cooling, 0 constant or unknown, of each block from its first to its last temperature."""
        begin, from_degc, end, to_degc = np.array(self._spans, dtype=np.float64).reshape(-1, 4).T
        with np.errstate(invalid="ignore", divide="ignore"):
            slope = np.nan_to_num(60.0 * (to_degc - from_degc) / (end - begin), posinf=0.0, neginf=0.0)
        return np.where(np.abs(slope) < STILL_DEGC_PER_MIN, 0, np.sign(slope)).astype(np.int64)

    def grouped(self, label: IntArray, keep: BoolArray | None = None) -> FloatArray:
        """Sums (groups, size) of the blocks of each label (blocks,), in order of the labels."""
        chosen = np.ones(len(label), dtype=bool) if keep is None else keep
        groups = np.unique(label[chosen])
        share = (label[chosen] == groups[:, None]).astype(np.float64)
        sums: FloatArray = share @ self.table[chosen]
        return sums

    def folds(self, groups: int = 20) -> IntArray:
        """Label (blocks,) of contiguous groups of blocks, none across two runs."""
        run = self.run
        labels, used = np.zeros(run.size, dtype=np.int64), 0
        for one in np.unique(run):
            rows = np.flatnonzero(run == one)
            own = min(rows.size, max(1, round(groups * rows.size / run.size)))
            labels[rows] = used + np.arange(rows.size) * own // rows.size
            used += own
        return labels


def _rows(
    rows: slice | BoolArray, needs: Sequence[str], columns: Mapping[str, FloatArray], y: FloatArray, time: FloatArray
) -> tuple[dict[str, FloatArray], FloatArray, FloatArray]:
    return {name: columns[name][rows] for name in needs}, y[rows], time[rows]


def _present(columns: Mapping[str, FloatArray], y: FloatArray) -> BoolArray:
    rows: BoolArray = np.isfinite(y)
    for column in columns.values():
        rows &= np.isfinite(column)
    return rows


def _span(time: FloatArray, temperature: FloatArray | None) -> list[float]:
    ends = [(np.nan, np.nan)] if temperature is None else [(temperature[0], temperature[-1])]
    return [float(time[0]), float(ends[0][0]), float(time[-1]), float(ends[0][1])]
