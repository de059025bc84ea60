"""From evidence to a verdict: effects one after the other, judged again together, and what remains after them.

The threshold is what chance reaches in runs simulated from the model and its noise alone. After each effect the probes
run again: what they still find is not explained.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice

import numpy as np

from bench.analysis.diagnosis.answer import VerdictWord
from bench.analysis.diagnosis.borne import Borne
from bench.analysis.diagnosis.candidates import Candidate
from bench.analysis.diagnosis.evidence import Evidence, Suspect, weigh
from bench.analysis.diagnosis.held_out import acts, settled, unseen, with_suspect
from bench.analysis.diagnosis.offer import Offer
from bench.analysis.diagnosis.probes import Examination, Finding, examine
from bench.analysis.diagnosis.proof import prove
from bench.analysis.diagnosis.suspects import Layout
from bench.analysis.effects.base import Effect
from bench.analysis.noise.likelihood import NoiseLattice, Point, Surface
from bench.analysis.thresholds import (
    FORMULA_EVIDENCE,
    FURTHER_EVIDENCE,
    FURTHER_LEAST,
    FURTHER_SHARE,
    FURTHER_SLOW,
    PROVED_FALL,
    TIE,
)
from bench.record import Dataset

MOST_EFFECTS = 3
_NULLS = 300
RULED_OUT = FORMULA_EVIDENCE
"""Evidence of runs and check runs together by which an effect lies below another one that it is not: that of the check
runs knows the parameters as the runs have them, and not how well."""
_OUTWEIGHED = 2.0 * FORMULA_EVIDENCE
"""Evidence of the run that check runs may outweigh."""
_LEADERS = 5
"""Effects that the check runs are asked about."""
_HIDING = 3  # that are tried as one of two which hide each other
_MINOR = 0.15
"""What remains may be this share of the evidence explained: real effects follow textbook equations about so well."""
_NOISE = "noise"


@dataclass(frozen=True, eq=False)
class FoundEffect:
    """One effect found: the layout without it, the evidence of all candidates there, and its own."""

    layout: Layout
    evidence: Evidence
    suspect: Suspect
    effect: Effect
    alike: tuple[str, ...] = ()
    """Effects that the check runs, to which it owes its place, bear as well."""

    @property
    def name(self) -> str:
        """The effect's name in models."""
        return self.effect.name


@dataclass(frozen=True, eq=False)
class Explanation:
    """What was found and what remains. `first` judges all candidates beside the model as it is, `last` beside all that
    was found.
    """

    first: Evidence
    before: Examination
    steps: tuple[FoundEffect, ...]
    layout: Layout
    last: Evidence
    after: Examination
    threshold: float

    @property
    def drifts(self) -> bool:
        """The run's noise is not the isothermal run's, its white part having been levelled."""
        return any(f.name == _NOISE for f in self.after.alarms)

    @property
    def left(self) -> tuple[Finding, ...]:
        """Alarms that remain beside what was found."""
        return tuple(f for f in self.after.alarms if f.name != _NOISE)

    @property
    def word(self) -> VerdictWord:
        """The verdict."""
        if not self.left and not self.drifts:
            return "missing_effect" if self.steps else "adequate"
        explained = sum(step.suspect.evidence for step in self.steps)
        rest = max((f.statistic - f.rank for f in self.after.alarms if f.name != _NOISE or self.drifts), default=0.0)
        return "missing_effect" if self.steps and rest < _MINOR * explained else "unknown_effect"


@dataclass(frozen=True, eq=False)
class Search:
    """Everything that the steps of one diagnosis share."""

    offer: Offer
    lattice: NoiseLattice
    check: Sequence[Dataset] = ()
    seed: int = 0
    workers: int = 1
    threshold: float = 0.0
    luck: Mapping[str, float] = field(default_factory=dict)
    known: dict[frozenset[Effect], Evidence] = field(default_factory=dict, repr=False)

    def explain(self, layout: Layout) -> Explanation:
        """Effects one after the other while they beat chance, then judged again together."""
        first = weigh(layout.problem, self.offer.candidates(layout), _NULLS, self.seed, self.lattice, self.workers)
        before = self._examine(layout, layout, first)
        search = replace(self, threshold=first.threshold, luck=first.luck)
        steps = search.forward(layout, first)
        steps = search.together(layout, first, steps)
        if len(steps) > 1:
            steps = search.again(layout, steps)
        last_layout = with_found(layout, steps)
        if len(steps) > 1:
            last_layout = last_layout.settled(self.lattice.way(steps[0].suspect.point), len(last_layout.theta))
        last = search.weigh(last_layout) if steps else first
        after = self._examine(last_layout, layout, last) if steps else before
        return Explanation(first, before, steps, last_layout, last, after, first.threshold)

    def weigh(self, layout: Layout) -> Evidence:
        """Evidence of all candidates beside a layout, without simulating chance again; the same effects once only.

        Their parameters may have moved a little since: the slopes in the base follow that.
        """
        key = frozenset(layout.rows.model.effects)
        if key not in self.known:
            candidates = self.offer.candidates(layout)
            self.known[key] = weigh(
                layout.problem, candidates, 0, self.seed, self.lattice, self.workers, luck=self.luck
            )
        return self.known[key]

    def _examine(self, layout: Layout, seen: Layout, evidence: Evidence) -> Examination:
        """The probes of `seen` beside a layout, at the noise of the restricted likelihood: tests, not a comparison."""
        surface = Surface.of(layout.problem.records(), self.lattice, restricted=True)
        surface.visit([evidence.point])
        return examine(layout.problem, seen.probes(), self.lattice, surface.descend(evidence.point))

    def forward(self, layout: Layout, evidence: Evidence, found: Sequence[FoundEffect] = ()) -> tuple[FoundEffect, ...]:
        """The best effect beside those `found`, the best beside it, and so on while it beats chance."""
        steps = list(found)
        while len(steps) < MOST_EFFECTS:
            best = self._next(layout, evidence, steps)
            if best is None:
                break
            steps.append(best)
            layout = with_found(layout, steps[-1:])
            evidence = self.weigh(layout)
        return tuple(steps)

    def together(self, layout: Layout, evidence: Evidence, steps: tuple[FoundEffect, ...]) -> tuple[FoundEffect, ...]:
        """The `steps`, or two effects and what is best beside them, where these explain more.

        Two effects may hide each other, or leave together what a third one resembles; and the parameters of one may lie
        elsewhere beside the other. Those that promise most on the grid are refined beside each other.
        """
        better: tuple[FoundEffect, ...] = ()
        had, stuck = {step.suspect.effect for step in steps}, any(step.suspect.on_bound for step in steps)
        least = self._explained(layout, evidence, steps) + TIE if steps else self.threshold + FURTHER_EVIDENCE
        couples = evidence.couples()
        hopes = [each for each in couples if (stuck if each.effects == had else each.evidence > least)]
        for hope in hopes[:_HIDING]:
            one, other = (hope.one, hope.other) if hope.other.effect in had else (hope.other, hope.one)
            first = FoundEffect(layout, evidence, one, self.offer.effects[one.name])
            second = self._beside(layout, first, other.effect)
            first = self._beside(layout, second, one.effect)
            total = self._explained(layout, evidence, (second, first))
            if total > least:
                better, least = (second, first), total
        if not better:
            return steps
        self.known.clear()  # what is known was weighed beside other parameters
        beside = with_found(layout, better)
        return self.forward(beside, self.weigh(beside), better)

    def _beside(self, layout: Layout, other: FoundEffect, effect: str) -> FoundEffect:
        """The best shape of an effect beside another one at its parameters."""
        layout = with_found(layout, (other,))
        self.known.pop(frozenset(layout.rows.model.effects), None)
        evidence = self.weigh(layout)
        best = next(one for one in evidence.suspects if one.effect == effect)
        return FoundEffect(layout, evidence, best, self.offer.effects[best.name])

    def _explained(self, layout: Layout, evidence: Evidence, steps: Sequence[FoundEffect]) -> float:
        """Evidence of some effects together, their parameters moved to where they fit best."""
        point = steps[-1].suspect.point
        moved = with_found(layout, steps)
        moved = moved.settled(self.lattice.way(point), len(moved.theta))
        columns, base = moved.fixed(len(layout.theta)), layout.problem.base.shape[1]
        both = Candidate("together", lambda _: columns, kind="abscissa")
        surface = evidence.suspects[0].refiner.surface(both, ())
        surface.visit(points := [evidence.point, point])
        least = surface.height(surface.descend(min(points, key=surface.height)))
        paid = both.paid(base, columns.shape[1]) + sum(step.suspect.candidate.paid(0, 0) for step in steps)
        lucky = sum(self.luck.get(step.suspect.name, 0.0) for step in steps)
        return evidence.minus2logl - least - paid * float(np.log(len(layout.problem.y))) - lucky

    def _next(
        self, layout: Layout, evidence: Evidence, others: Sequence[FoundEffect], dropped: Sequence[str] = ()
    ) -> FoundEffect | None:
        """The effect that beats chance beside `others`, by the run or by the run and the check runs together.

        Beside others unseen data must not contradict it: of two effects that the run cannot tell apart one may make up
        for what the other does too much.
        """
        near = [one for one in evidence.each_once() if not (others and one.effect in dropped)][:_LEADERS]
        bar = max(self.threshold, self._further(near[0], others)) if near and others else self.threshold
        alike: tuple[str, ...] = ()
        enough = [one for one in near if one.evidence > bar]
        if others:
            sound = (one for one in enough if not self._contradicted(layout, evidence.point, one, bar))
            first = [*islice(sound, 1)]
            enough = [*first, *(one for one in sound if self.check and one.evidence >= first[0].evidence - TIE)]
        elif dropped and enough:  # of effects of which each contradicts the others the check runs have a say, too
            enough = [enough[int(np.argmax(self._total(layout, evidence.point, enough)))]]
        if not enough:
            enough = self._borne(layout, evidence.point, near)
            alike = tuple(one.effect for one in enough[1:])
        if not enough or _rounded(layout, enough[0]):
            return None
        best = self._chosen(layout, evidence, enough, alone=not others)
        return FoundEffect(layout, evidence, best, self.offer.effects[best.name], alike)

    def _chosen(self, layout: Layout, evidence: Evidence, enough: Sequence[Suspect], *, alone: bool) -> Suspect:
        """Of those that have enough evidence the best one; with check runs that can show it, of the rivals that these
        do not rule out. Beside others, not `alone`, only what the run does not tell from the best is a rival.

        A parameter on its bound says that this is not the effect; one that no data tell from it may be.
        """
        tied = [one for one in enough if one.evidence >= enough[0].evidence - TIE]
        best = next((one for one in tied if not one.on_bound), enough[0])
        known = told(layout, self.offer, self.check, evidence) if self.check and (alone or len(tied) > 1) else []
        rivals = [
            (one, own) for one, own in known
            if not one.on_bound and (alone or one in tied) and (one is best or own > self.threshold)
        ]  # fmt: skip
        if best not in [one for one, _ in rivals]:
            return best
        most = max(own for _, own in rivals)
        return next(one for one, own in rivals if own > most - RULED_OUT)

    def _further(self, suspect: Suspect, others: Sequence[FoundEffect]) -> float:
        """Evidence that it needs beside others: what their equations leave is a share of what they explain.

        What begins at a place, such as a jump, describes a part of any such rest.
        """
        most, effect = self._most(suspect), self.offer.effects[suspect.name]
        if any(parameter.change_point for parameter in effect.parameters):
            return most
        left = FURTHER_SHARE * sum(other.suspect.evidence for other in others)
        return min(max(left, FURTHER_LEAST), most)

    def _most(self, suspect: Suspect) -> float:
        """Most evidence that it needs beside others."""
        effect = self.offer.effects[suspect.name]
        return FURTHER_EVIDENCE if effect.needs or effect.parameters or effect.moves_abscissa else FURTHER_SLOW

    def _borne(self, layout: Layout, point: Point, leaders: Sequence[Suspect]) -> list[Suspect]:
        """The leaders of which the run and the check runs together tell enough, and no other one more, where the error
        on the check runs does not rise.

        Not a second one that moves the abscissa: a lead and a lag that undo each other fit a check run by little.
        """
        if not self.check:
            return []
        if any(effect.moves_abscissa for effect in layout.rows.model.effects):
            leaders = [leader for leader in leaders if not self.offer.effects[leader.name].moves_abscissa]
        leaders = [leader for leader in leaders if leader.sized and _acts_again(layout, self.offer, self.check, leader)]
        total = self._total(layout, point, leaders)
        least = max((*total, TIE + max(self.threshold, FORMULA_EVIDENCE))) - TIE
        return [
            leader for leader, own in zip(leaders, total, strict=True) if own > least and self._falls(layout, leader)
        ]

    def _falls(self, layout: Layout, leader: Suspect) -> bool:
        """Whether the error on the check runs does not rise with it: what follows their slow noise may do both."""
        after = with_suspect(layout, self.offer.effects[leader.name], leader, self.check).left
        before = settled(layout, leader.way, self.check).left
        return prove(before, after).fall >= 0.0

    def _contradicted(self, layout: Layout, point: Point, leader: Suspect, bar: float) -> bool:
        """Whether the check runs take so much from its evidence or, without, legs that are left out speak against it.

        These do of two effects that move the abscissa, a lead and a lag that undo each other, where the error rises by
        as much as it has to fall for a proof.
        """
        if self.check:
            most = self._most(leader)  # which the check runs must leave to what has it
            return self._total(layout, point, [leader])[0] <= max(bar, most if leader.evidence > most else 0.0)
        effect = self.offer.effects[leader.name]
        if not effect.moves_abscissa or not any(other.moves_abscissa for other in layout.rows.model.effects):
            return False
        both = layout.adding(effect, leader.theta)
        after = unseen(both.rows, both.theta, ()).left
        return prove(unseen(layout.rows, layout.theta, (), like=after).left, after).fall <= -PROVED_FALL

    def _total(self, layout: Layout, point: Point, leaders: Sequence[Suspect]) -> list[float]:
        return _total(layout, self.offer, self.check, point, leaders)

    def again(self, layout: Layout, steps: tuple[FoundEffect, ...]) -> tuple[FoundEffect, ...]:
        """Each effect judged beside all others: kept, replaced by a better one, or dropped if the others suffice.

        What was judged beside one that is dropped afterwards is judged once more.
        """
        current, dropped = list(steps), list[str]()
        for step in steps:
            current = self._anew(layout, current, step, dropped)
        for step in tuple(current) if dropped else ():
            current = self._anew(layout, current, step, dropped)
        return tuple(sorted(current, key=lambda s: -s.suspect.evidence))

    def _anew(
        self, layout: Layout, current: list[FoundEffect], step: FoundEffect, dropped: list[str]
    ) -> list[FoundEffect]:
        """The effects with what is best in the place of one of them; `dropped` gains it where nothing is needed."""
        others = [s for s in current if s is not step]
        without = with_found(layout, others)
        best = self._next(without, self.weigh(without), others, dropped)
        if best is None:
            dropped.append(step.suspect.effect)
            return others
        return [*others, best]


def told(layout: Layout, offer: Offer, check: Sequence[Dataset], evidence: Evidence) -> list[tuple[Suspect, float]]:
    """Effects that the run alone does not tell from the best one, and the next ones that check runs may bear more,
    where these can show them; each with its evidence by the run and the check runs together.
    """
    ranked = evidence.each_once()
    least = ranked[0].evidence if ranked else 0.0
    near = [
        one for number, one in enumerate(ranked)
        if one.evidence + one.charged >= least - (_OUTWEIGHED if number < _LEADERS else TIE)
        and _acts_again(layout, offer, check, one)
    ]  # fmt: skip
    return list(zip(near, _total(layout, offer, check, evidence.point, near), strict=True))


def _total(
    layout: Layout, offer: Offer, check: Sequence[Dataset], point: Point, leaders: Sequence[Suspect]
) -> list[float]:
    """Evidence of each leader by the run and the check runs together; of what no check run can show, by the run."""
    if not leaders:
        return []
    borne, found = Borne(check, layout.problem.statics, point), []
    before = settled(layout, leaders[0].refiner.lattice.way(point), check).left
    for leader in leaders:
        after = with_suspect(layout, offer.effects[leader.name], leader, check).left
        again = _acts_again(layout, offer, check, leader)
        found.append(leader.evidence + (borne.gain(before, after) if again else 0.0))
    return found


def _acts_again(layout: Layout, offer: Offer, check: Sequence[Dataset], leader: Suspect) -> bool:
    """Whether a check run can show it."""
    effect = layout.prepared(offer.effects[leader.name])
    return acts(effect, {p.name: value for p, value in zip(effect.parameters, leader.theta, strict=True)}, check)


def with_found(layout: Layout, steps: Sequence[FoundEffect]) -> Layout:
    """The layout with these effects at the parameters that each was found with."""
    for step in steps:
        layout = layout.adding(step.effect, step.suspect.theta)
    return layout


def _rounded(layout: Layout, suspect: Suspect) -> bool:
    """Whether the steps of thermometer or output may cause what the suspect explains."""
    return layout.resolution.hides(layout.beyond(suspect.contribution))
