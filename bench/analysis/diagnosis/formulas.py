"""A formula for what no effect of the catalogue explains: searched breadth first, refined, grown, pruned by its price.

Every formula of one and of two blocks is scored at once beside the model, by the likelihood that ranks named effects
and at the same noise; the best are refined continuously with the noise profiled anew, then grown by one block. A
formula pays k ln n for what it estimates and 2 ln N for the N formulas of its size that were tried (a uniform prior
over them). What chance reaches is learnt from noise simulated from the model alone, as for named effects.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache, partial, reduce

import numpy as np

from bench.analysis.diagnosis.blocks import Block, Bounds, Formula
from bench.analysis.diagnosis.candidates import Candidate, Theta, about, outside
from bench.analysis.diagnosis.evidence import drawn
from bench.analysis.diagnosis.found_formula import FoundFormula, alike
from bench.analysis.diagnosis.grammar import Grammar
from bench.analysis.diagnosis.refine import Refiner, Start
from bench.analysis.diagnosis.scan import Library, Scan
from bench.analysis.diagnosis.spectral_line import rows_of
from bench.analysis.diagnosis.suspects import Layout
from bench.analysis.effects.expression import Expression
from bench.analysis.effects.formula import Data
from bench.analysis.noise.likelihood import NoiseLattice, Point, gls, moved
from bench.analysis.thresholds import FORMULA_EVIDENCE, WRONGLY_NAMED
from bench.base import FloatArray, InputError, shared

_DECADE = 16
_BEAM = 12  # formulas that are grown into those of heating and of cooling alone
_LEADERS = 36  # that are refined, of the grid,
_HIDDEN = 10  # … and further ones whose parameters may hide more
_GROWN = 3  # leaders that grow
_UNLIKE = 1  # further leader that grows, unlike these
_NEARLY = 0.9  # correlation of whitened columns
_STEPS = 3  # by which each of them grows at most
_BRANCHES = 2  # that are refined in each step
_LOOKED_AT = 1000  # best entries of the grid
_SHARING = 6  # leaders that may have the same block
_REFINED = 6.0  # evidence that the refinement of a parameter adds, where it adds any
_NEAR = 10.0  # evidence that refinement may add to what the grid shows
_SHOWN = 0.6  # share of a strong evidence that the grid shows at least
_NULLS = 60
_ABOUT = 400  # parameters tried about those of a formula that jumps,
_NEARER = (-3.0, -0.8)  # … by powers of ten of their ranges
_PEAKS = 6  # of the periodogram
_JUMPS = 4  # of each direction
_MOST_STEPS = 1000  # that are tried in one run
_APART = 5  # rows between two of them
_PADDED = 4  # times its length: a peak lies between the frequencies of a discrete transform


class FormulaSearch:
    """One search beside one layout."""

    def __init__(
        self,
        layout: Layout,
        lattice: NoiseLattice,
        seed: int = 0,
        best: Point | None = None,
        workers: int = 1,
        first: FoundFormula | None = None,
    ) -> None:
        """`lattice` and the noise point `best` of the layout may be those of an earlier evidence beside it; `first` is
        a formula that the layout has already: what may stand beside it is tried, too.
        """
        self._first = first
        self._layout, self._lattice, self._seed, self._workers = layout, lattice, seed, workers
        self.grammar = Grammar(layout.seen, layout.rows.masks)
        self._data = [Data(record) for record in layout.seen]
        self._values: dict[tuple[str, Theta], FloatArray] = {}
        self._refiner = Refiner(layout.problem, lattice)
        self._surface = self._refiner.alone
        self._best = self._surface.search() if best is None else best
        self._surface.visit([self._best])

    def search(self, least: float = 0.0, near: float = -np.inf) -> tuple[FoundFormula, ...]:
        """Formulas that pay for what they estimate and for what was tried, best first; see `FORMULA_EVIDENCE`.

        Where none has more than the `least` evidence, what chance reaches is not simulated: it only takes from them.
        Where none of the grid and of the few that promise most comes `near` this evidence, there is no answer.
        """
        singles = [*self.grammar.singles(), self.grammar.line(self._periods())]
        singles += self.grammar.snaps(*self._jumps())
        pairs = self.grammar.pairs()
        first = self._first
        beside = [] if first is None else list(self.grammar.beside(first.formula, first.theta))
        formulas = [*singles, *pairs, *(formula for formula, _ in beside)]
        candidates = [*map(self._candidate, [*singles, *pairs]), *self._tried(beside)]
        sizes = len(singles), len(pairs) + len(beside)
        price = np.repeat([self._price(size) for size in sizes], sizes)
        library = Library(self._layout.problem, candidates)
        points = self._points()
        scan = library.scan(self._lattice, points, self._layout.problem.y[:, None], self._still(), self._workers)
        paid = library.paid(candidates) + price[scan.which]
        rough = scan.base[0] - scan.values[:, 0] - paid
        if not rough.max() > _SHOWN * near - _NEAR:
            return ()
        leaders = self._leaders(rough, scan, formulas)
        # The grid shows the less of a formula, the more parameters are to be refined.
        open_ = np.array([len(formula.parameters) for formula in formulas])
        hidden = self._leaders(rough + _REFINED * open_[scan.which], scan, formulas)
        leaders += [index for index in hidden if index not in leaders][:_HIDDEN]
        # A product may only make up for a grid that is too coarse for one of its blocks, which is tried alone, too.
        alone = {one.blocks[0].text: index for index, one in enumerate(singles)}
        parts = [block.text for index in leaders[:_GROWN] for block in formulas[index].blocks]
        leaders += [alone[text] for text in parts if text in alone]
        tasks = [
            partial(self._refined, formulas[index], candidates[index], scan.starts(index, points), float(price[index]))
            for index in dict.fromkeys(leaders)
        ]
        found = shared(tasks[:_GROWN], self._workers)
        if not max([rough.max(), *(one.evidence for one in found)]) > near - _NEAR:
            return ()
        found += shared(tasks[_GROWN:], self._workers)
        for one in tuple(found):  # what a memory that is too short to tell stands for was crowded out by it
            if plain := one.formula.at_once(one.theta):
                found += self._longer(one, [(plain[0], (plain[1],))], self._tried_of(one, sizes))
        found.sort(key=lambda one: -one.evidence)
        for one in _growing(found):
            found += self._grown(one, self._tried_of(one, sizes))
        found.sort(key=lambda one: -one.evidence)
        for one in found[:_BEAM]:
            found += self._longer(one, one.formula.one_way(one.theta), self._tried_of(one, sizes))
        # What chance reaches beyond the usual threshold is paid for, too.
        found.sort(key=lambda one: -one.evidence)
        chance = self._chance(library, points, paid) if found and found[0].evidence > least else 0.0
        return tuple(replace(one, evidence=one.evidence - max(0.0, chance - FORMULA_EVIDENCE)) for one in found)

    @staticmethod
    def _tried_of(one: FoundFormula, sizes: Sequence[int]) -> int:
        """Formulas of its size that were tried, by the number of blocks."""
        return sizes[min(len(one.formula.blocks), len(sizes)) - 1]

    def _price(self, count: int) -> float:
        return 2.0 * float(np.log(max(count, 1)))

    def _candidate(self, formula: Formula) -> Candidate:
        return Candidate(
            name=formula.product(formula.names),
            columns=lambda theta: self.columns(formula, theta),
            many=lambda thetas: self._many(formula, thetas),
            parameters=formula.parameters,
            change_point=formula.places > 0,
            tried=formula.grid(),
        )

    def _tried(self, grown: Sequence[tuple[Formula, tuple[Theta, ...]]]) -> list[Candidate]:
        return [replace(self._candidate(formula), tried=tried) for formula, tried in grown]

    def columns(self, formula: Formula, theta: Theta) -> FloatArray:
        """Columns (n, k), one for each amplitude, at the rows of the layout."""
        return self._many(formula, [theta])[:, 0]

    def _many(self, formula: Formula, thetas: Sequence[Theta]) -> FloatArray:
        """The same of many parameters (n, many, k): each block is evaluated once for each of its own."""
        factors = [
            self._factor(block.text, block, [theta[own] for theta in thetas])
            for block, own in zip(formula.blocks, formula.own, strict=True)
        ]
        value = reduce(np.multiply, factors)
        if formula.pair:
            sine = formula.blocks[0]
            cosine = self._factor(
                sine.text.replace("sin(", "cos(", 1), sine, [theta[formula.own[0]] for theta in thetas]
            )
            return np.stack([value, reduce(np.multiply, factors[1:], cosine)], axis=2)
        if formula.along is None:
            return value[:, :, None]
        moved = self._block(formula.along.text, formula.along, ())[:, None]
        return np.stack([value * moved**power for power in range(formula.degree + 1)], axis=2)

    def _factor(self, text: str, block: Block, own: Sequence[Theta]) -> FloatArray:
        """A block at each of these parameters (n, many)."""
        if len(own) == 1:
            return self._block(text, block, own[0])[:, None]
        different = {each: number for number, each in enumerate(dict.fromkeys(own))}
        values = np.column_stack([self._block(text, block, each) for each in different])
        return values if len(different) == len(own) else values[:, [different[each] for each in own]]

    def _block(self, text: str, block: Block, own: Theta) -> FloatArray:
        key = (text, own)
        if key not in self._values:
            if len(self._values) > 4000:
                self._values.clear()
            effect = _expression(text, block.bounds)
            named = dict(zip(effect.bounds, own, strict=True))
            try:
                columns = [effect.parsed.columns(data, named)[:, 0] for data in self._data]
                self._values[key] = self._layout.stacked(columns)
            except InputError:  # not finite somewhere: it explains nothing
                self._values[key] = np.zeros(len(self._layout.problem.y))
        return self._values[key]

    def _still(self) -> list[FloatArray]:
        return [record.y[:, None] for record in self._layout.problem.statics]

    def _points(self) -> list[Point]:
        """The base's noise and less of it: what a formula explains is taken out of the noise."""
        flicker, walk = self._best
        decades = ((0, 0), (1, 0), (0, 1), (1, 1), (0, 2), (2, 2), (0, 4), (4, 4))
        return sorted({(moved(flicker, -_DECADE * f), moved(walk, -_DECADE * w)) for f, w in decades}, reverse=True)

    def _chance(self, library: Library, points: Sequence[Point], paid: FloatArray) -> float:
        """The evidence that the best formula reaches in simulated runs without any effect, at the usual level."""
        problem = self._layout.problem
        mean = problem.base @ gls(problem.base, problem.y, self._lattice.way(self._best)).beta
        near = sorted(self._surface.region(self._best, 8.0, step=_DECADE), key=self._surface.height)[:8]
        run, *statics = drawn(self._surface, near, np.random.default_rng(self._seed), _NULLS)
        some = list(dict.fromkeys([*near[:3], *points[:4]]))
        scan = library.scan(self._lattice, some, mean[:, None] + run, statics, self._workers)
        best = (scan.base - scan.values - paid[:, None]).max(axis=0)
        return max(0.0, float(np.quantile(best, 1.0 - WRONGLY_NAMED)))

    def _leaders(self, rough: FloatArray, scan: Scan, formulas: Sequence[Formula]) -> list[int]:
        """The formulas that are best on the grid, each once; few with the same block, which would crowd out others."""
        found: list[int] = []
        shares: Counter[str] = Counter()
        for entry in np.argsort(-rough)[:_LOOKED_AT]:
            index = int(scan.which[entry])
            blocks = [block.text for block in formulas[index].blocks]
            if index in found or scan.excited[entry] < 1e-6 or max(shares[text] for text in blocks) >= _SHARING:
                continue
            found.append(index)
            shares.update(blocks)
            if len(found) >= _LEADERS:
                break
        return found

    def _refined(self, formula: Formula, candidate: Candidate, grid: Sequence[Start], price: float) -> FoundFormula:
        theta, point, reached = self._refiner.refine(candidate, grid, self._best)
        if formula.jagged:
            near = replace(candidate, tried=self._about(formula, theta))
            scan = Library(self._layout.problem, [near]).scan(
                self._lattice, [point], self._layout.problem.y[:, None], self._still()
            )
            again = self._refiner.refine(near, scan.starts(0, [point]), self._best)
            theta, point, reached = min((theta, point, reached), again, key=lambda found: found[2])
        columns, base = self.columns(formula, theta), self._layout.problem.base
        paid = candidate.paid(base.shape[1], columns.shape[1])
        log_n = float(np.log(len(self._layout.problem.y)))
        evidence = self._surface.height(self._best) - reached - paid * log_n - price
        way = self._lattice.way(point)
        sigma2 = self._refiner.sigma2(candidate, theta, point)
        fit = gls(np.column_stack([base, columns]), self._layout.problem.y, way, sigma2)
        own = fit.beta[base.shape[1] :]
        contribution = columns @ own
        beside = self._refiner.at(point)
        white = outside(beside.basis, way.apply(contribution))
        size = slice(base.shape[1], None)
        covariance = self._refiner.covariance(candidate, theta, fit.beta, point)[size, size]
        gains = np.cumsum(beside.residual**2 - fit.residual**2) / sigma2
        return FoundFormula(formula, theta, evidence, point, own, covariance, contribution, white, gains)

    @staticmethod
    def _about(formula: Formula, theta: Theta) -> tuple[Theta, ...]:
        """Parameters about these, nearer and farther: where rows jump, a slope leads to the next jump only."""
        rng = np.random.default_rng(0)
        moved = rng.standard_normal((_ABOUT, len(theta))) * 10.0 ** rng.uniform(*_NEARER, (_ABOUT, 1))
        return about(formula.parameters, theta, moved)

    def _grown(self, one: FoundFormula, tried: int) -> list[FoundFormula]:
        """The formula with a block or a parameter more, and again, while that pays; of its size `tried` were tried."""
        found: list[FoundFormula] = []
        for _ in range(_STEPS):
            longer = list(self.grammar.grown(one.formula, one.theta))
            # All that this one could have become, of all that could have been this one; the order of blocks is none.
            tried = tried * len(longer) // (len(one.formula.blocks) + 1)
            better = self._longer(one, longer, tried)
            if not better or better[0].evidence <= one.evidence:
                break
            found += better
            one = better[0]
            # What it began with may have stood for what it has become.
            while pruned := self._pruned(one, tried):
                found += pruned
                best = max(pruned, key=lambda each: each.evidence)
                if best.evidence <= one.evidence:
                    break
                one = best
        return found

    def _pruned(self, one: FoundFormula, tried: int) -> list[FoundFormula]:
        """The formula without each of its blocks, refined, if it has several."""
        tasks = []
        for formula, theta in one.formula.shorter(one.theta):
            candidate = self._candidate(formula)
            start = Start(theta, one.point, self._refiner.height(candidate, theta, one.point))
            tasks.append(partial(self._refined, formula, candidate, (start,), self._price(tried)))
        return shared(tasks, self._workers)

    def _longer(
        self, one: FoundFormula, longer: Sequence[tuple[Formula, tuple[Theta, ...]]], tried: int
    ) -> list[FoundFormula]:
        """The most promising of what the formula becomes in one step, refined, best first."""
        if not longer:
            return []
        candidates = self._tried(longer)
        library = Library(self._layout.problem, candidates)
        points = [one.point, self._best]
        scan = library.scan(self._lattice, points, self._layout.problem.y[:, None], self._still())
        price = self._price(tried)
        rough = self._surface.height(self._best) - scan.values[:, 0] - library.paid(candidates) - price
        formulas, size = [formula for formula, _ in longer], len(one.formula.blocks)
        # Refinement gives most to a block that became another one: no parameter of its own was refined for that.
        became = np.array([each.parameters != one.formula.parameters and len(each.blocks) == size for each in formulas])
        likely = sorted(np.flatnonzero(became[scan.which]), key=lambda entry: -rough[entry])[:1]
        found = [
            self._refined(formulas[index], candidates[index], scan.starts(index, points), price)
            for index in dict.fromkeys(
                (*self._leaders(rough, scan, formulas)[:_BRANCHES], *scan.which[likely].tolist())
            )
            if rough[scan.which == index].max() > one.evidence - _NEAR
        ]
        return sorted(found, key=lambda each: -each.evidence)

    def _jumps(self) -> tuple[list[float], list[float]]:
        """Temperatures [degC] of the largest jumps of the residual while it is heated, and while it is cooled.

        Beside noise that walks a jump is seen at its very row only, which no grid of temperatures meets. Jumps may be
        what makes the noise walk: they are looked for in less of it, too.
        """
        found: tuple[list[float], list[float]] = [], []
        temperature, slope = self._layout.temperature, self._layout.slope
        for point in dict.fromkeys((self._best, (min(self._best[0], 0), min(self._best[1], 0)))):
            left = [_JUMPS, _JUMPS]
            for row in self._steps(point):
                cooled = int(slope[row] <= 0.0)
                left[cooled] -= 1
                if left[cooled] >= 0:
                    found[cooled].append(0.5 * float(temperature[row - 1] + temperature[row]))
        return found

    def _steps(self, point: Point) -> list[int]:
        """Rows at which a step explains more of the residual than at those near it, the largest first."""
        at, rows = self._refiner.at(point), len(self._layout.problem.y)
        first = np.arange(1, rows, max(1, rows // _MOST_STEPS))
        steps = (np.arange(rows)[:, None] >= first).astype(np.float64)
        white = outside(at.basis, self._lattice.way(point).apply(steps))
        gain = (at.residual @ white) ** 2 / np.maximum(np.sum(white**2, axis=0), 1e-12)
        near = np.lib.stride_tricks.sliding_window_view(np.pad(gain, _APART), 2 * _APART + 1).max(axis=1)
        return [int(first[i]) for i in np.argsort(-gain) if gain[i] == near[i]]

    def _periods(self) -> list[float]:
        """Periods [s] of the largest lines of the whitened residual, between the frequencies of the transform."""
        problem = self._layout.problem
        rest = self._refiner.at(self._best).residual
        row = rows_of(problem.time_s, problem.interval_s)
        filled = np.zeros(int(row[-1]) + 1)
        filled[row] = rest
        size = _PADDED * len(filled)
        power = np.abs(np.fft.rfft(filled, size))
        inner = np.flatnonzero((power[1:-1] > power[:-2]) & (power[1:-1] >= power[2:])) + 1
        inner = inner[inner > 1.5 * _PADDED]
        top = inner[np.argsort(-power[inner])[:_PEAKS]]
        return [float(size * problem.interval_s / i) for i in top] or [self.grammar.ranges.length_s / 4.0]


def _growing(found: Sequence[FoundFormula]) -> list[FoundFormula]:
    """The best, and the best of those that are unlike all of these: what is alike may have the same beginning."""
    kept = list(found[:_GROWN])
    for one in found[_GROWN:]:
        if not any(alike(one.white, each.white, _NEARLY) for each in kept):
            kept.append(one)
        if len(kept) == _GROWN + _UNLIKE:
            break
    return kept


@lru_cache(maxsize=512)
def _expression(text: str, bounds: tuple[tuple[str, Bounds], ...]) -> Expression:
    """A block as an effect; parsed once for all its parameters."""
    return Expression(f"k * {text.format(**{name: name for name, _ in bounds})}", dict(bounds))
