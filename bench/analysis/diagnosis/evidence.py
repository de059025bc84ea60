"""Which effect is missing: evidence of each candidate by generalised least squares, the noise fitted anew for each.

E_j = (-2 ln L of the base) - (-2 ln L with candidate j) - k_j ln n: base and candidate are fitted together, its
nonlinear parameters searched on a grid and then continuously, and the noise ratios profiled on either side. What chance
alone reaches is learnt from runs of the fitted base with the noise beside the best candidate: beside the base alone a
slow effect is taken for slow noise, and chance then seems to reach as far as the effect.

L is marginal: amplitudes are integrated out under a prior, normal about zero with the variance of the white noise for
a column of RMS one outside the base. This adds ln |X' C^-1 X| - ln |X' X| to -2 ln L and leaves k ln n, all there is of
it in white noise. Among slow noise a slow column is determined less well and costs less, and the noise beside it is not
taken for less than it is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import NamedTuple, TypeVar

import numpy as np

from bench.analysis.diagnosis.candidates import Candidate, Problem, Theta, joint
from bench.analysis.diagnosis.refine import Interval, Refiner, Start
from bench.analysis.diagnosis.scan import DEPENDENT, Library
from bench.analysis.noise.likelihood import Gls, NoiseLattice, Point, Surface, gls
from bench.analysis.noise.probability import sized
from bench.analysis.noise.whitening import Ratios, Whitener
from bench.analysis.thresholds import BEYOND_DOUBT, TIE, WRONGLY_NAMED
from bench.base import Aside, FloatArray, shared

_E = TypeVar("_E", float, FloatArray)

_ALL = 1.0 - 1e-9  # of a square sum
_GROWS = 4.0  # gains in 2 ln L on the grid may grow to this many times themselves when refined
_DECADE = 16
_NULL_REACH = 12.0  # of -2 ln L: noise points tried for simulated nulls
_NULL_POINTS = 20
_LUCKY = 60.0  # of -2 ln L above the least: no simulated null and candidate is best at a noise point that is higher
_TAIL = 0.1  # of simulated nulls, for what a smaller share exceeds
_USUAL = 3.0  # evidence that a name needs however little chance reaches
_SLOW = 0.03
"""Share of the nulls that may exceed what a slow effect needs. They are drawn at every noise that the data allow beside
the effect, which overstates what chance reaches (M. J. Bayarri and J. O. Berger, JASA 95 (2000) 1127)."""


@dataclass(frozen=True, eq=False)
class Suspect:
    """One candidate after refinement; `excited` is False where the run cannot show it.

    What is computed from the fit is computed when it is asked for: most suspects are only ranked.
    """

    name: str
    effect: str
    """The effect that the candidate is a shape of."""
    evidence: float
    theta: Theta
    excited: bool
    charged: float
    """What the evidence was charged for a rare cause: without it, causes that fit equally are equal."""
    point: Point
    candidate: Candidate = field(repr=False)
    refiner: Refiner = field(repr=False)

    @property
    def ratios(self) -> Ratios:
        """Of the noise beside it."""
        return self.refiner.lattice.ratios(self.point)

    @cached_property
    def sigma2(self) -> float:
        """White variance of one mean beside it [(deg/h)^2]."""
        return self.refiner.sigma2(self.candidate, self.theta, self.point)

    @cached_property
    def parameters(self) -> dict[str, Interval]:
        """Nonlinear parameters with their 95 % intervals at the noise found."""
        return self.refiner.intervals(self.candidate, self.theta, self.point)

    @property
    def amplitudes(self) -> FloatArray:
        """Of its own columns (k,), none for an abscissa."""
        return self._fit.beta[self._first :]

    @cached_property
    def covariance(self) -> FloatArray:
        """Of the amplitudes (k, k), the uncertainty of the parameters included."""
        own = slice(self._first, None)
        return self.refiner.covariance(self.candidate, self.theta, self._fit.beta, self.point)[own, own]

    @property
    def deviations(self) -> FloatArray:
        """Standard deviations (k,) of the amplitudes."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def on_bound(self) -> bool:
        """Whether the search of a parameter ended at an end of its range: the data do not determine it."""
        return self.candidate.on_bound(self.theta)

    @property
    def sized(self) -> bool:
        """Whether the data know the size of its terms, or of its parameters where it moves the abscissa."""
        return self.candidate.kind == "abscissa" or sized(self.amplitudes, self.covariance) > 1.0

    @property
    def contribution(self) -> FloatArray:
        """What the candidate adds to the fitted bias (n,) [deg/h]."""
        if self.candidate.kind == "abscissa":
            return np.asarray((self._columns - self.refiner.problem.base) @ self._fit.beta)
        return np.asarray(self._columns[:, self._first :] @ self.amplitudes)

    @property
    def cumulative(self) -> FloatArray:
        """Gain in 2 ln L up to each row (n,), whitening being causal."""
        problem = self.refiner.problem
        before = gls(problem.base, problem.y, self.way, self.sigma2)
        return np.asarray(np.cumsum(before.residual**2 - self._fit.residual**2) / self.sigma2)

    @property
    def _first(self) -> int:
        """First of its own columns."""
        columns = self._columns if self.candidate.kind == "abscissa" else self.refiner.problem.base
        return int(columns.shape[1])

    @property
    def way(self) -> Whitener:
        """Of the fitted rows, at the noise beside it."""
        return self.refiner.lattice.way(self.point)

    @cached_property
    def _columns(self) -> FloatArray:
        return joint(self.refiner.problem, self.candidate, self.theta)

    @cached_property
    def _fit(self) -> Gls:
        return gls(self._columns, self.refiner.problem.y, self.way, self.sigma2)


@dataclass(frozen=True)
class Evidence:
    """All candidates, best first, and what chance reaches.

    `threshold` is the 98.5 % point of the best evidence in runs simulated without any effect, the candidate left out
    that chance favours most; `nulls` (runs,) is the best evidence of all candidates.
    """

    minus2logl: float
    point: Point
    ratios: Ratios
    sigma2: float
    suspects: tuple[Suspect, ...]
    threshold: float
    nulls: FloatArray
    luck: Mapping[str, float] = field(default_factory=dict)
    """What is taken off the evidence of candidates beside their parameters, by name: chance favours slow effects among
    slow noise, and without this all others would have to beat what ageing reaches by chance."""
    couples: Callable[[], list[Couple]] = field(default=list, repr=False)
    """Any two effects, the best first, as far as a grid tells; computed when it is asked for."""

    def each_once(self) -> list[Suspect]:
        """The best shape of each effect that the run excites, best first."""
        first: dict[str, Suspect] = {}
        for suspect in self.suspects:
            if suspect.excited:
                first.setdefault(suspect.effect, suspect)
        return list(first.values())

    def chance(self, evidence: float) -> float:
        """Share of simulated nulls whose best candidate reaches this evidence."""
        return float(np.mean(self.nulls >= evidence)) if len(self.nulls) else float("nan")


class Couple(NamedTuple):
    """Two candidates as they are on the grid, and their evidence together there."""

    one: Suspect
    other: Suspect
    evidence: float

    @property
    def effects(self) -> frozenset[str]:
        """Their effects."""
        return frozenset((self.one.effect, self.other.effect))


def weigh(  # noqa: PLR0913 - options of one search
    problem: Problem,
    candidates: Sequence[Candidate],
    nulls: int = 500,
    seed: int = 0,
    lattice: NoiseLattice | None = None,
    workers: int = 1,
    *,
    luck: Mapping[str, float] | None = None,
) -> Evidence:
    """The evidence of every candidate against the base; `lattice` may be an earlier one of the same records.

    `luck` of an earlier answer stands in where no `nulls` are drawn. The answer does not depend on the number of
    workers.
    """
    lattice = lattice or NoiseLattice(problem.records(), problem.interval_s)
    refiner = Refiner(problem, lattice)
    surface = refiner.alone
    columns = Aside(lambda: Library(problem, candidates), workers)
    best = surface.search()
    weighing = _Weighing(candidates, columns.answer(), refiner, surface, best, workers)
    suspects = weighing.suspects()
    # Without any evidence, and with so much, a fifth of the nulls is enough.
    doubt = 0.0 < max((s.evidence for s in suspects), default=0.0) < BEYOND_DOUBT
    top = max((s for s in suspects if s.excited), key=lambda s: s.evidence, default=None)
    each = weighing.chance(nulls if doubt else nulls // 5, seed, top) if nulls else np.empty((0, 0))
    threshold, luck = _bars(candidates, each) if nulls else (0.0, luck or {})
    suspects = [replace(s, evidence=s.evidence - luck.get(s.name, 0.0)) for s in suspects]
    chance = (each - np.array([[luck[c.name]] for c in candidates])).max(axis=0) if nulls else np.empty(0)
    ranked = tuple(sorted(suspects, key=lambda s: -s.evidence))
    height, sigma2 = surface.known[best]
    couples = partial(weighing.couples, luck, best if top is None else top.point)
    return Evidence(height, best, lattice.ratios(best), sigma2, ranked, threshold, chance, luck, couples)


def _bars(candidates: Sequence[Candidate], each: FloatArray) -> tuple[float, dict[str, float]]:
    """What evidence has to exceed, and what each candidate pays before, for evidence (candidates, runs) by chance.

    The one that chance favours most, ageing in a long run, has to exceed what it reaches itself, and not what the best
    of all others does.
    """
    reached = np.array([exceeded(own, _SLOW) for own in each])
    slow, own = int(np.argmax(reached)), np.maximum(reached, _USUAL)
    effects = [c.effect or c.name for c in candidates]
    others = (each - own[:, None] + _USUAL)[[effect != effects[slow] for effect in effects]]
    threshold = max(_USUAL, exceeded(others.max(axis=0), WRONGLY_NAMED)) if len(others) else _USUAL
    luck = {c.name: float(bar) - _USUAL for c, bar in zip(candidates, own, strict=True)}
    return threshold, luck | {candidates[slow].name: float(own[slow]) - threshold}


@dataclass(frozen=True, eq=False)
class _Scanned:
    """One candidate on its grid: `rough` is its best evidence there, `hope` what refinement may make of it."""

    candidate: Candidate
    grid: tuple[Start, ...]
    paid: float
    rough: float
    hope: float
    excited: bool


class _Reached(NamedTuple):
    """Where refinement ended."""

    theta: Theta
    point: Point
    evidence: float
    closely: bool


@dataclass(frozen=True, eq=False)
class _Weighing:
    """What the steps of `weigh` share; `best` is the noise point of the base, whose likelihood is `surface`."""

    candidates: Sequence[Candidate]
    library: Library
    refiner: Refiner
    surface: Surface
    best: Point
    workers: int

    def suspects(self) -> list[Suspect]:
        """Every candidate refined, the most promising first; one that cannot come near the best is refined coarsely."""
        order = _foremost(sorted(self._scan(), key=lambda each: -each.rough))
        several = [order[: self.workers], order[self.workers :]]
        parts = several if self.workers > 1 else [[each] for each in order]
        reached: list[_Reached] = []
        for part in parts:
            least = _least(reached)
            tasks = [partial(self._refined, each, each.hope >= least) for each in part]
            for each, own in zip(part, shared(tasks, self.workers), strict=True):
                # One worker would have known of all before it: the answer is the same for any number.
                needless = least <= each.hope < _least(reached)
                reached.append(self._refined(each, False) if needless else own)
        # Parameters between those of the grid may have shown more of one that was refined coarsely.
        least = _least(reached)
        pairs = list(enumerate(zip(order, reached, strict=True)))
        open_ = [(i, each) for i, (each, own) in pairs if not own.closely and _hope(own.evidence, each.paid) >= least]
        tasks = [partial(self._refined, each, True) for _, each in open_]
        for (i, _), own in zip(open_, shared(tasks, self.workers), strict=True):
            reached[i] = own
        return [self._suspect(*pair) for pair in zip(order, reached, strict=True)]

    def _scan(self) -> list[_Scanned]:
        problem, points = self.library.problem, _points_for_candidates(self.best)
        statics = [record.y[:, None] for record in problem.statics]
        scan = self.library.scan(self.surface.lattice, points, problem.y[:, None], statics, self.workers)
        paid = self.library.paid(self.candidates)
        rough = scan.base[0] - scan.values[:, 0] - paid
        scanned = []
        for index, candidate in enumerate(self.candidates):
            own = scan.which == index
            grid = self._anew(candidate, scan.starts(index, points))
            best = max(float(rough[own].max()), scan.base[0] - min(start.height for start in grid) - paid[own][0])
            hope = float(_hope(best, float(paid[own][0])))
            excited = bool(scan.excited[own].max() >= DEPENDENT)
            scanned.append(_Scanned(candidate, grid, float(paid[own][0]), best, hope, excited))
        return scanned

    def _anew(self, candidate: Candidate, grid: tuple[Start, ...]) -> tuple[Start, ...]:
        """The grid with the curve fitted anew where the abscissa moves so far that the scan says nothing."""
        if candidate.anew is None:
            return grid
        known = list(grid)
        for place, start in enumerate(grid):
            if candidate.anew(start.theta):
                exact = self.refiner.height(candidate, start.theta, self.best)
                known[place] = min(start, Start(start.theta, self.best, exact), key=lambda each: each.height)
        return tuple(known)

    def _refined(self, scanned: _Scanned, closely: bool) -> _Reached:
        theta, point, height = self.refiner.refine(scanned.candidate, scanned.grid, self.best, closely=closely)
        return _Reached(theta, point, self.surface.height(self.best) - height - scanned.paid, closely)

    def _suspect(self, scanned: _Scanned, reached: _Reached) -> Suspect:
        candidate = scanned.candidate
        return Suspect(
            name=candidate.name,
            effect=candidate.effect or candidate.name,
            evidence=reached.evidence,
            theta=reached.theta,
            excited=scanned.excited,
            charged=candidate.rarity * float(np.log(len(self.library.problem.y))),
            point=reached.point,
            candidate=candidate,
            refiner=self.refiner,
        )

    def couples(self, luck: Mapping[str, float], near: Point) -> list[Couple]:
        """What any two effects of one column explain together, at the noise of the base, `near`, less, and none that
        walks.

        A moved abscissa counts as a column with a size of its own, so that this is where to look, and no evidence. Two
        that move it are no couple: a lead and a lag undo each other. A parameter on its bound says that this is not
        the effect.
        """
        problem, names = self.library.problem, [c.effect or c.name for c in self.candidates]
        moves = np.array([c.kind == "abscissa" for c in self.candidates], dtype=bool)
        around = _points_for_candidates(self.best)
        less = [p for p in around if all(i <= b for i, b in zip(p, self.best, strict=True))]
        steady = [p for p in around if p[1] == around[0][1]]  # a walk is what effects are mostly taken for
        points = list(dict.fromkeys([self.best, near, max(less), max(steady)]))
        self.surface.visit(points)
        paid = np.full(len(names), np.inf)
        np.minimum.at(paid, [i for i, _ in self.library.entries], self.library.paid(self.candidates))
        paid += np.array([luck.get(candidate.name, 0.0) for candidate in self.candidates])
        stuck = np.array([self.candidates[i].on_bound(theta) for i, theta in self.library.entries], dtype=bool)
        most, place = np.full((len(names), len(names)), -np.inf), np.zeros((2, len(names), len(names)), dtype=np.int64)
        for point in points:
            height, sigma2 = self.surface.known[point]
            gain, where = self.library.couples(self.surface.lattice.way(point), problem.y, stuck)
            share = np.minimum(gain / (sigma2 * problem.rows), _ALL)
            reached = self.surface.height(self.best) - height - problem.rows * np.log1p(-share)
            better = (reached > most) & (gain > 0.0) & ~(moves[:, None] & moves)
            most, place = np.where(better, reached, most), np.where(better, [where, where.T], place)
        most -= paid[:, None] + paid
        found: dict[frozenset[str], tuple[float, int, int]] = {}
        for one, other in zip(*np.nonzero(np.isfinite(most)), strict=True):
            both, own = frozenset((names[one], names[other])), float(most[one, other])
            if len(both) == 2 and own > found.get(both, (-np.inf,))[0]:
                found[both] = own, int(place[0, one, other]), int(place[1, one, other])
        ranked = sorted(found.values(), key=lambda each: -each[0])
        return [Couple(self._on_grid(one, near), self._on_grid(other, near), own) for own, one, other in ranked]

    def _on_grid(self, entry: int, point: Point) -> Suspect:
        """An entry of the grid as a suspect without evidence of its own."""
        index, theta = self.library.entries[entry]
        scanned = _Scanned(self.candidates[index], (), 0.0, -np.inf, -np.inf, excited=True)
        return self._suspect(scanned, _Reached(theta, point, -np.inf, closely=False))

    def chance(self, runs: int, seed: int, top: Suspect | None) -> FloatArray:
        """Evidence of each candidate (candidates, runs) in runs of the fitted base and the noise beside the best."""
        problem, lattice = self.library.problem, self.surface.lattice
        surface, lowest = self.surface, self.best
        if top is not None:
            surface = self.refiner.surface(top.candidate, top.theta)
            surface.visit([top.point])
            lowest = surface.descend(top.point)
        region = surface.region(lowest, _NULL_REACH, step=_DECADE // 2)
        near = sorted(region, key=surface.height)[:_NULL_POINTS]
        # Less noise than the base has, as far as a candidate may get by chance.
        less = [point for point in _points_for_candidates(self.best) if point not in near]
        surface.visit(less)
        less = [point for point in less if surface.height(point) < surface.height(lowest) + _LUCKY]
        mean = problem.base @ gls(problem.base, problem.y, lattice.way(self.best)).beta
        run, *statics = drawn(surface, near, np.random.default_rng(seed), runs)
        scan = self.library.scan(lattice, [*near, *less], mean[:, None] + run, statics, self.workers)
        evidence = scan.base - scan.values - self.library.paid(self.candidates)[:, None]
        first = np.unique(scan.which, return_index=True)[1]
        return np.asarray(np.maximum.reduceat(evidence, first, axis=0))


def exceeded(values: FloatArray, share: float) -> float:
    """What a small share of such values (n,) exceeds, by the exponential tail of the largest tenth of them.

    The quantile of a few hundred values rests on the four or five largest. Source: J. Pickands, Ann. Stat. 3 (1975)
    119.
    """
    bound = float(np.quantile(values, 1.0 - _TAIL))
    beyond = values[values > bound]
    return bound + float(np.mean(beyond - bound)) * float(np.log(_TAIL / share)) if len(beyond) else bound


def _foremost(order: Sequence[_Scanned]) -> list[_Scanned]:
    """Of each effect the two most promising shapes, and the simplest; of those that move the abscissa these, which are
    mostly the other sign of the first, only where they may become better.
    """
    kept: list[_Scanned] = []
    for each in order:
        others = [e for e in kept if e.candidate.effect == each.candidate.effect != ""]
        simplest = each.candidate.name == each.candidate.effect
        further = not each.candidate.shift or each.hope > others[0].rough > 0.0 if others else True
        if further and (len(others) < 2 or simplest):
            kept.append(each)
    return kept


def _hope(evidence: _E, paid: _E) -> _E:
    """What refinement may make of evidence."""
    return _GROWS * (evidence + paid) - paid


def _least(reached: Sequence[_Reached]) -> float:
    """Evidence that a candidate has to come near to, beside those judged so far."""
    return max([0.0, *(each.evidence for each in reached)]) - TIE


def _points_for_candidates(best: Point) -> list[Point]:
    """Noise points a decade apart up to a decade above the base's: an effect explained leaves less noise, not more."""
    return [p for p in NoiseLattice.coarse(_DECADE) if all(i <= b + _DECADE for i, b in zip(p, best, strict=True))]


def drawn(surface: Surface, points: Sequence[Point], rng: np.random.Generator, runs: int) -> list[FloatArray]:
    """Noise of every record (n, runs); each run draws a level that the data allow, by its likelihood."""
    surface.visit(points)
    heights = np.array([surface.height(point) for point in points])
    share = np.exp(0.5 * (heights.min() - heights))
    counts = rng.multinomial(runs, share / share.sum())
    kept = [(point, int(count)) for point, count in zip(points, counts, strict=True) if count]
    parts = []
    for (point, count), ways in zip(kept, surface.lattice.at([point for point, _ in kept]), strict=True):
        deviation = np.sqrt(surface.known[point][1])
        parts.append([way.colour(rng.standard_normal((way.rows, count))) * deviation for way in ways])
    return [np.hstack(part) for part in zip(*parts, strict=True)]
