"""Likelihood of every candidate at every grid point under every noise, for many responses at once.

At each point of the noise lattice the base and all columns of all candidates are whitened and made orthogonal to the
base once; what remains for each response (the run, or simulated nulls) are inner products.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from bench.analysis.diagnosis.candidates import Candidate, Problem, Theta, orthonormal, outside
from bench.analysis.diagnosis.refine import Start
from bench.analysis.noise.likelihood import NoiseLattice, Point, spanned
from bench.analysis.noise.whitening import Whitener
from bench.base import BoolArray, FloatArray, IntArray, shared

DEPENDENT = 1e-9
"""A column with less than this share of its variance outside the base counts as part of the base."""

_NEARLY = 0.05  # of the variance of a column that is not in another
_SINGLE: np.dtype[Any] = np.dtype(np.float32)
_ROUNDED = 1e-6  # of a square sum: what is left in single precision is not known better
_COLUMNS = 256  # at once, at least: many more do not fit the cache

_ADDS, _SHIFTS, _REPLACES = "adds", "shifts", "replaces"
"""What the columns of an entry do with the base: stand beside it, change its curve as they are, or replace it."""
_SINGLES = _ADDS, 1
"""Most entries: one column that stands beside the base."""


@dataclass(frozen=True)
class Scan:
    """Lowest -2 ln L (restricted, see `evidence`) over the noise points: of the base (m,), of every entry (entries, m),
    and at which point that is for the first response (entries,).
    """

    entries: tuple[tuple[int, Theta], ...]
    excited: FloatArray
    """Largest share of an entry's variance outside the base (entries,)."""
    base: FloatArray
    values: FloatArray
    where: IntArray

    @cached_property
    def which(self) -> IntArray:
        """The candidate of each entry (entries,)."""
        return np.array([index for index, _ in self.entries], dtype=np.int64)

    def starts(self, index: int, points: Sequence[Point]) -> tuple[Start, ...]:
        """Where refinement of one candidate may begin: its grid for the first response; `points` are those scanned."""
        own = np.flatnonzero(self.which == index)
        return tuple(Start(self.entries[i][1], points[self.where[i]], float(self.values[i, 0])) for i in own)


class Library:
    """All candidates at all grid points, columns of equal width stacked."""

    def __init__(self, problem: Problem, candidates: Sequence[Candidate]) -> None:
        """Columns are computed here once; every later step only whitens them."""
        grids = [candidate.grid() for candidate in candidates]
        self.problem, self.candidates = problem, len(candidates)
        self.entries = tuple((index, theta) for index, grid in enumerate(grids) for theta in grid)
        self.replaces = np.repeat([_use(candidate) == _REPLACES for candidate in candidates], [len(g) for g in grids])
        self.widths = np.ones(len(self.entries), dtype=np.int64)
        self._shares = np.ones(len(self.entries))  # of the variance of single columns outside the base
        self._stacks: list[tuple[IntArray, str, int, FloatArray]] = []
        self._still: dict[int, FloatArray] = {}  # columns of entries that act in the unit's isothermal run, too
        alike: dict[tuple[str, int], list[tuple[IntArray, FloatArray]]] = {}
        basis, end = orthonormal(problem.base), 0
        for candidate, grid in zip(candidates, grids, strict=True):
            columns = candidate.on(grid)
            use, width = _use(candidate), columns.shape[2]
            which = np.arange(end, end + len(grid))
            end += len(grid)
            self.widths[which] = width
            if candidate.still is not None:
                self._still[int(which[0])] = candidate.still / np.linalg.norm(outside(basis, columns[:, 0]))
            own = alike.setdefault((use, width), [])
            own.append((which, columns.reshape(len(columns), -1)))
            if (use, width) == _SINGLES and sum(len(each) for each, _ in own) >= _COLUMNS:
                self._stack(*_SINGLES, alike.pop(_SINGLES), basis)  # as they come: all of them are large
        for (use, width), own in alike.items():
            self._stack(use, width, own, basis)

    def _stack(self, use: str, width: int, parts: Sequence[tuple[IntArray, FloatArray]], basis: FloatArray) -> None:
        """Keep entries and their columns (n, k) in one; of columns that are added alone, and shifts, what is beside the
        base.
        """
        which, columns = np.concatenate([each for each, _ in parts]), np.hstack([own for _, own in parts])
        if (use, width) == _SINGLES:
            self._shares[which], columns = _beside(basis, columns)
        elif use == _SHIFTS:
            columns = outside(basis, columns).astype(_SINGLE)
        self._stacks.append((which, use, width, columns))

    def paid(self, candidates: Sequence[Candidate]) -> FloatArray:
        """What the parameters of every entry cost in evidence (entries,)."""
        base, log_n = self.problem.base.shape[1], float(np.log(len(self.problem.y)))
        return np.array([
            candidates[index].paid(base, int(width)) * log_n
            for (index, _), width in zip(self.entries, self.widths, strict=True)
        ])  # fmt: skip

    def scan(
        self,
        lattice: NoiseLattice,
        points: Sequence[Point],
        run: FloatArray,
        statics: list[FloatArray],
        workers: int = 1,
    ) -> Scan:
        """Best over the points for responses `run` (n, m) and the isothermal records' `statics` (n_s, m) each."""
        size = -(-len(points) // workers)
        tasks = [
            partial(self._part, lattice, points[first : first + size], run, statics)
            for first in range(0, len(points), size)
        ]
        best, *others = shared(tasks, workers)
        for number, other in enumerate(others, start=1):
            where = np.where(other.values[:, 0] < best.values[:, 0], other.where + number * size, best.where)
            values = np.minimum(best.values, other.values)
            base, excited = np.minimum(best.base, other.base), np.maximum(best.excited, other.excited)
            best = replace(best, excited=excited, base=base, values=values, where=where)
        return best

    def couples(self, way: Whitener, run: FloatArray, left_out: BoolArray) -> tuple[FloatArray, IntArray]:
        """Square sum that any two candidates explain together of a response (n,) under one noise, at most (candidates,
        candidates), and the entry of the first there; for those of one column, a moved abscissa as a column.

        Columns that are nearly one are no couple: what they differ in is not told from rounding. Entries may be
        `left_out` (entries,).
        """
        every, place = np.zeros((2, self.candidates, self.candidates))
        q = spanned(way.apply(self.problem.base), np.linalg.norm(self.problem.base, axis=0))[0]
        residual = outside(q, way.apply(run))
        single = [each for each in self._stacks if each[1] == _SHIFTS or each[1:3] == _SINGLES]
        if not single:
            return every, place.astype(np.int64)
        which = np.concatenate([own for own, *_ in single])
        columns = np.hstack([outside(q.astype(_SINGLE), way.apply(own)) for *_, own in single])
        columns /= np.maximum(np.linalg.norm(columns, axis=0), 1e-12)
        order = np.argsort(which, kind="stable")
        order = order[~left_out[which[order]]]
        which, columns = which[order], columns[:, order]
        names, first = np.unique([self.entries[i][0] for i in which], return_index=True)
        alone = columns.T @ residual.astype(_SINGLE)
        alike = columns.T @ columns
        gain = alone[:, None] ** 2 + alone**2 - 2.0 * alike * (alone[:, None] * alone)
        gain /= np.maximum(1.0 - alike**2, _NEARLY)
        gain[alike**2 > 1.0 - _NEARLY] = 0.0
        across = np.maximum.reduceat(gain, first, axis=1)
        ends = [*first[1:], len(which)]
        for name, begin, end in zip(names, first, ends, strict=True):
            best = begin + np.argmax(across[begin:end], axis=0)
            every[name, names], place[name, names] = across[best, np.arange(len(names))], which[best]
        return every, place.astype(np.int64)

    def _part(self, lattice: NoiseLattice, points: Sequence[Point], run: FloatArray, statics: list[FloatArray]) -> Scan:
        """Best over some of the points."""
        base = np.full(run.shape[1], np.inf)
        values = np.full((len(self.entries), run.shape[1]), np.inf)
        where = np.zeros(len(self.entries), dtype=np.int64)
        excited = np.zeros(len(self.entries))
        flat, none = lattice.white(), [response[:, :0] for response in statics]
        alike = self._alike(flat, self._quiet(flat, none))
        white, white_base = self._run(flat[0], run[:, :0], excited, alike)[2:]
        for number, ways in enumerate(lattice.at(points)):
            log_det, total = sum(way.log_det for way in ways), self.problem.rows
            still = np.zeros(run.shape[1])
            quiet = self._quiet(ways, statics)
            for basis, volume, left in quiet:
                still += np.einsum("ij,ij->j", left, left)
                log_det += volume
                total -= basis.shape[1]
            rss0, rss, volumes, (volume, rank) = self._run(ways[0], run, excited, self._alike(ways, quiet))
            total -= rank
            base = np.minimum(base, total * np.log((rss0 + still) / total) + log_det + volume)
            further = volumes - white + np.where(self.replaces, white_base[0], volume)
            rss += still
            np.log(rss, out=rss)
            rss *= total
            rss += (further + log_det - total * np.log(total))[:, None]
            where[rss[:, 0] < values[:, 0]] = number
            np.minimum(values, rss, out=values)
        return Scan(self.entries, excited, base, values, where)

    def _quiet(
        self, ways: Sequence[Whitener], statics: Sequence[FloatArray]
    ) -> list[tuple[FloatArray, float, FloatArray]]:
        """Of every isothermal record under one noise: basis of its columns and their ln |X' C^-1 X|, and what the basis
        leaves of the responses (n_s, m).
        """
        found = []
        for record, way, response in zip(self.problem.statics, ways[1:], statics, strict=True):
            basis, volume = spanned(way.apply(record.X), np.linalg.norm(record.X, axis=0))
            found.append((basis, volume, outside(basis, way.apply(response))))
        return found

    def _alike(
        self, ways: Sequence[Whitener], quiet: Sequence[tuple[FloatArray, float, FloatArray]]
    ) -> dict[int, tuple[float, FloatArray]]:
        """Of the entries that act in the unit's isothermal run, too: square sum of their column there beside the base,
        and its product with what is left of each response (m,).
        """
        if not self._still:
            return {}
        basis, _, left = quiet[0]
        own = {entry: outside(basis, ways[1].apply(column[:, 0])) for entry, column in self._still.items()}
        return {entry: (float(column @ column), column @ left) for entry, column in own.items()}

    def _run(
        self, way: Whitener, run: FloatArray, excited: FloatArray, alike: Mapping[int, tuple[float, FloatArray]]
    ) -> tuple[FloatArray, FloatArray, FloatArray, tuple[float, int]]:
        """Residual square sums of the run under one noise: base (m,), entries (entries, m); ln |X' C^-1 X| of the
        entries' columns outside the base (entries,), and that of the base with its rank.

        Entries `alike` explain a part of the isothermal run, too.
        """
        white = way.apply(run)
        q, volume = spanned(way.apply(self.problem.base), np.linalg.norm(self.problem.base, axis=0))
        residual = outside(q, white)
        volumes = np.zeros(len(self.entries))
        rss0 = np.einsum("ij,ij->j", residual, residual)
        rss = np.empty((len(self.entries), run.shape[1]))
        few = q.T.astype(_SINGLE), residual.astype(_SINGLE)
        for which, use, width, stacked in self._stacks:
            columns = way.apply(stacked)
            if (use, width) == _SINGLES:
                excited[which] = self._shares[which]
                power, product = _single(columns, *few)
                for place in np.flatnonzero(np.isin(which, list(alike))).tolist():
                    more = alike[int(which[place])]
                    power[place], product[place] = power[place] + more[0], product[place] + more[1]
                gain = product**2 / np.where(power > 0.0, power, np.inf)[:, None]
                volumes[which] = np.log(power, where=power > 0.0, out=np.zeros_like(power))
                rss[which] = np.maximum(rss0 - gain, _ROUNDED * rss0)
                continue
            if use == _SHIFTS:
                power, product = _single(columns, *few)
                rss[which] = np.maximum(rss0 - 2.0 * product + power[:, None], _ROUNDED * rss0)
                excited[which] = 1.0
                continue
            if use == _REPLACES:
                gain, volumes[which] = _explained(columns, width, white)
                rss[which] = np.maximum(np.einsum("ij,ij->j", white, white) - gain, 0.0)
                excited[which] = 1.0
                continue
            before = np.einsum("ij,ij->j", columns, columns)
            columns = outside(q, columns)
            share = np.einsum("ij,ij->j", columns, columns) / np.maximum(before, 1e-300)
            columns[:, share < DEPENDENT] = 0.0
            excited[which] = np.maximum(excited[which], share.reshape(-1, width).max(axis=1))
            gain, volumes[which] = _explained(columns, width, residual)
            rss[which] = np.maximum(rss0 - gain, 1e-300)
        return rss0, rss, volumes, (volume, q.shape[1])


def _use(candidate: Candidate) -> str:
    if candidate.kind == "term":
        return _ADDS
    return _SHIFTS if candidate.shift else _REPLACES


def _explained(columns: FloatArray, width: int, response: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Square sum that each group of `width` columns explains of each response (groups, m), and ln |X'X| (groups,)."""
    groups = columns.T.reshape(-1, width, len(columns))
    norms = np.linalg.norm(groups, axis=2, keepdims=True)
    scaled = groups / np.maximum(norms, 1e-300)
    product = (scaled.reshape(-1, len(columns)) @ response).reshape(len(groups), width, -1)
    values, vectors = np.linalg.eigh(scaled @ scaled.transpose(0, 2, 1))
    known = values > values[:, -1:] * 1e-12
    inverse = np.where(known, 1.0 / np.maximum(values, 1e-300), 0.0)
    turned = vectors.transpose(0, 2, 1) @ product
    present = norms[:, :, 0] > 0.0
    volume = np.log(np.where(known, values, 1.0)).sum(axis=1)
    volume += 2.0 * np.log(np.where(present, norms[:, :, 0], 1.0)).sum(axis=1)
    return np.asarray(np.einsum("gk,gkm->gm", inverse, turned**2)), np.asarray(volume)


def _beside(basis: FloatArray, columns: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Share (k,) of the variance of columns (n, k) outside a basis; that part (n, k), scaled, in single precision.

    What the base spans changes nothing beside it at any noise. Without it whitening does not cancel large numbers, and
    single precision, which halves the work, leaves the evidence of a grid point known to about 0.01.
    """
    left = outside(basis, columns)
    norms = np.linalg.norm(left, axis=0)
    share = (norms / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)) ** 2
    left *= np.where(share < DEPENDENT, 0.0, 1.0 / np.maximum(norms, 1e-300))
    return share, left.astype(_SINGLE)


def _single(columns: FloatArray, basis: FloatArray, residual: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Square sum (k,) of what a basis (r, n) leaves of each column, and its product with what it leaves (n, m)."""
    inside = basis @ columns
    power = np.einsum("ij,ij->j", columns, columns) - np.einsum("ij,ij->j", inside, inside)
    return np.maximum(power, 0.0).astype(np.float64), (columns.T @ residual).astype(np.float64)
