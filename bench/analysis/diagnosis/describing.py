"""What was found where the catalogue ends: a formula that can be added, in words, with what else fits as well."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bench.analysis.diagnosis.borne import Borne
from bench.analysis.diagnosis.candidates import orthonormal, outside
from bench.analysis.diagnosis.described import DescribedFormula
from bench.analysis.diagnosis.evidence import Suspect
from bench.analysis.diagnosis.formulas import FormulaSearch
from bench.analysis.diagnosis.found_formula import AMPLITUDES, FoundFormula, alike, together
from bench.analysis.diagnosis.held_out import Unseen, settled, unseen
from bench.analysis.diagnosis.physics import physics_of
from bench.analysis.diagnosis.probes import examine
from bench.analysis.diagnosis.proof import Proof, prove
from bench.analysis.diagnosis.ranges import UNCATALOGUED
from bench.analysis.diagnosis.rivals import Rival
from bench.analysis.diagnosis.suspects import Layout
from bench.analysis.diagnosis.verdict import Explanation, with_found
from bench.analysis.effects.model import entry_text
from bench.analysis.noise.likelihood import Gls, NoiseLattice, Point, Surface, gls
from bench.analysis.noise.probability import sized
from bench.analysis.thresholds import EXPLAINED_RATIO, FORMULA_EVIDENCE, PROVED_CHOSEN, TIE
from bench.base import Aside, FloatArray
from bench.record import Dataset

_MOST = 5
_IN_RUN = 0.25  # of the evidence of the fitted runs, against that of check runs
_MOST_TERMS = 3
_ALIKE = 0.97  # correlation of whitened columns beside the model: these data cannot tell the two apart
_ACTS = 0.9  # of its square sum: the range of temperature where it acts
_ONE_PLACE = 0.1  # of the gain: less than this on either half of the legs is not seen twice
_IMPLAUSIBLE = 1.0  # of the spread of the bias over the run: a term larger than that cancels something
_PERIODS = 5.0  # of a sine in one run: of fewer, a leg left out lies on the way between two others


@dataclass(frozen=True, eq=False)
class Description:
    """Formulas, best first, and whether they explain the data better than the effects of the catalogue did.

    One that explains more than an effect does, and not enough to replace it, or as much as several effects together,
    has their names among its equivalents.
    """

    formulas: tuple[DescribedFormula, ...] = ()
    replaces: bool = False


@dataclass(frozen=True, eq=False)
class _Ranked:
    """A formula that a search found: the layout and the error with it, what check runs say, and what is like it."""

    one: FoundFormula
    after: Layout
    scored: Unseen
    borne: float
    alike: tuple[FoundFormula, ...] = ()

    @property
    def total(self) -> float:
        """Evidence of the fitted runs and of the check runs."""
        return self.one.evidence + self.borne


@dataclass(frozen=True, eq=False)
class Describer:
    """Searches formulas and describes them; `check` are the runs that no fit sees, `floor_dph` the noise floor."""

    lattice: NoiseLattice
    check: Sequence[Dataset]
    floor_dph: float
    seed: int = 0
    workers: int = 1

    def describe(self, layout: Layout, explained: Explanation) -> Description:
        """Formulas beside the model alone, or beside the effects that were found where they leave more."""
        if not explained.steps:
            found = self._search(layout, explained.first.point)
            borne = self._borne(layout, found, explained)
            return Description(self._answer(layout, self._ranked(layout, found, borne), borne))
        # Both searches are made at once, by half of the workers each.
        half = replace(self, workers=max(1, self.workers // 2))
        further = Aside(lambda: half._search(explained.layout, explained.last.point), self.workers)
        with contextlib.closing(further):
            found = half._search(layout, explained.first.point)
            return self._beside(layout, explained, found, further)

    def better(self, layout: Layout, explained: Explanation) -> Description:
        """Formulas that explain more than the effects that were found do, which leave no more than the noise.

        In the place of one effect a formula needs the evidence that any formula needs; with less it is told beside it.
        One that explains as much as several effects is told beside them: one cause is likelier than several.
        """
        found = self._search(layout, explained.first.point, near=_gain(layout, explained) - FORMULA_EVIDENCE)
        borne = self._borne(layout, found, explained)
        plain = self._ranked(layout, found, borne)
        named, more = self._named(layout, explained, plain, borne)
        if more and (len(explained.steps) > 1 or plain[0].total > named + FORMULA_EVIDENCE):
            return Description(self._answer(layout, plain, borne), replaces=True)
        return self._tied(layout, explained, plain, named)

    def _tied(self, layout: Layout, explained: Explanation, plain: Sequence[_Ranked], named: float) -> Description:
        """The best formula that explains more than the effect found and is not the same, or as much as several."""
        first, *others = explained.steps
        # Effects do not pay for having been chosen from a list, as a formula does: of several each would have to.
        least = named - TIE * len(explained.steps) if others else named
        ahead = [each for each in plain if each.total > least]
        unlike = [each for each in ahead if others or not self._writes(layout, first.suspect, each)]
        if not unlike:
            return Description()
        best = self._listed(layout, unlike)[0]
        names = " + ".join(step.name for step in explained.steps)
        return Description((replace(best, equivalent=(names, *best.equivalent)),))

    def _writes(self, layout: Layout, suspect: Suspect, each: _Ranked) -> bool:
        """Whether a formula is an effect in another way: beside the model these data cannot tell the two apart."""
        way = self.lattice.way(each.one.point)
        own = outside(orthonormal(way.apply(layout.problem.base)), way.apply(suspect.contribution))
        return alike(own, each.one.white, _ALIKE)

    def _borne(self, layout: Layout, found: Sequence[FoundFormula], explained: Explanation) -> Borne:
        return Borne(self.check, layout.problem.statics, found[0].point if found else explained.last.point)

    def _beside(
        self,
        layout: Layout,
        explained: Explanation,
        found: Sequence[FoundFormula],
        further: Aside[tuple[FoundFormula, ...]],
    ) -> Description:
        """What was `found` beside the model alone against the effects, and against the formulas beside the effects."""
        borne = self._borne(layout, found, explained)
        plain = self._ranked(layout, found, borne)
        named, better = self._named(layout, explained, plain, borne)
        terms = self._terms(layout, plain, borne) if better else []
        open_ = not better or self._left(layout, terms[-1])[1]
        beside = self._ranked(explained.layout, further.answer(), borne) if open_ else []
        further_terms = self._terms(explained.layout, beside, borne) if better else []
        if better:  # … unless the effects with formulas beside them explain more
            both = named + sum(each.total for each in further_terms)
            if not beside or both < sum(each.total for each in terms) + TIE:
                return Description(self._answer(layout, plain, borne, terms=terms), replaces=True)
        stuck = any(step.suspect.on_bound for step in explained.steps)
        if stuck and not beside and (instead := self._instead(layout, explained, borne)):
            return Description(instead, replaces=True)
        if (beside or not stuck) and (fewer := self._fewer(layout, explained, beside, borne)):
            return Description(fewer, replaces=True)
        least = named - (FORMULA_EVIDENCE if stuck else TIE)
        if not beside and plain and plain[0].total > least:
            # No better than the effects, and no worse: it stands for one that is not determined, or tells another part.
            more = explained.word == "unknown_effect" and self._says_more(plain[0].one, explained.layout)
            if stuck or more:
                return Description(self._listed(layout, plain), replaces=stuck)
        if not beside:
            return self._tied(layout, explained, plain, named)
        names = tuple(step.name for step in explained.steps)
        return Description(self._answer(explained.layout, beside, borne, names, further_terms))

    def _instead(self, layout: Layout, explained: Explanation, borne: Borne) -> tuple[DescribedFormula, ...]:
        """Formulas beside the effects that are determined, where they explain as much as those on their bounds do."""
        steps = [step for step in explained.steps if not step.suspect.on_bound]
        if not steps:
            return ()
        least = max(step.suspect.evidence for step in explained.steps if step.suspect.on_bound) - FORMULA_EVIDENCE
        others = with_found(layout, steps)
        ranked = self._ranked(others, self._search(others), borne)
        if not ranked or ranked[0].total <= least:
            return ()
        return self._answer(others, ranked, borne, tuple(step.name for step in steps))

    def _fewer(
        self, layout: Layout, explained: Explanation, beside: Sequence[_Ranked], borne: Borne
    ) -> tuple[DescribedFormula, ...]:
        """Formulas beside the first of several effects, where one explains as much as the rest with what fits `beside`
        all, or where all leave more than the noise on the check runs, and these prove one against the rest: that stood
        for what no effect is.
        """
        steps, found = explained.steps, explained.layout
        if len(steps) < 2 or not (beside or self.check):
            return ()
        left = beside[0].scored.left if beside else unseen(found.rows, found.theta, self.check).left
        if not beside and not (left.by == "check" and left.rms_dph > EXPLAINED_RATIO * self.floor_dph):
            return ()
        way = self.lattice.way(explained.last.point)
        for count in range(1, len(steps)):
            others = with_found(layout, steps[:count])
            others = others.settled(way, len(others.theta))
            ranked = self._ranked(others, self._search(others), borne)
            least = sum(step.suspect.evidence for step in steps[count:])
            if not ranked or ranked[0].total <= least:
                continue
            best = ranked[0]
            as_much = bool(beside) and best.one.evidence > least + beside[0].one.evidence - TIE
            proved = left.by == "check" and prove(left, best.scored.left).falls
            if proved or (as_much and borne.gain(left, best.scored.left) > -TIE):
                return self._answer(others, ranked, borne, tuple(step.name for step in steps[:count]))
        return ()

    def _search(
        self, layout: Layout, best: Point | None = None, first: FoundFormula | None = None, near: float = -np.inf
    ) -> tuple[FoundFormula, ...]:
        search = FormulaSearch(layout, self.lattice, self.seed, best, self.workers, first)
        return search.search(0.0 if self.check else FORMULA_EVIDENCE, near)

    def _ranked(
        self, layout: Layout, found: Sequence[FoundFormula], borne: Borne, count: int | None = None
    ) -> list[_Ranked]:
        """What a search found that all evidence bears, best first, without what cannot be told from a better one.

        The first `count` parameters of the layout, those of its effects, follow what is found.
        """
        if not found:
            return []
        ranked, count = list[_Ranked](), len(layout.theta) if count is None else count
        before = settled(layout, self.lattice.way(found[0].point), self.check, count=count)
        for one in found:
            if not one.sized or (not self.check and one.evidence <= FORMULA_EVIDENCE):
                continue
            after = layout.adding(one.effect, one.theta).settled(self.lattice.way(one.point), count)
            scored = self._scored(after, len(one.amplitudes))
            each = _Ranked(one, after, scored, borne.gain(before.left, scored.left))
            if each.total > FORMULA_EVIDENCE:
                ranked.append(each)
        ranked.sort(key=lambda each: -each.total)
        leaders: list[_Ranked] = []
        for each in ranked:
            near = next(
                (i for i, leader in enumerate(leaders) if alike(leader.one.white, each.one.white, _ALIKE)), None
            )
            if near is None:
                leaders.append(each)
            elif each.one.formula != leaders[near].one.formula:
                leaders[near] = _simpler(leaders[near], each, layout)
        return _judged(leaders)

    def _scored(self, after: Layout, own: int) -> Unseen:
        """A layout with a formula of `own` amplitudes on unseen data; only what is left out of the run needs slopes."""
        return unseen(after.rows, after.theta, self.check, own, slopes=None if self.check else after.slopes)

    def _answer(
        self,
        layout: Layout,
        ranked: Sequence[_Ranked],
        borne: Borne,
        names: tuple[str, ...] = (),
        terms: Sequence[_Ranked] = (),
    ) -> tuple[DescribedFormula, ...]:
        """The best formula with the further `terms` beside it, then single formulas; terms are searched without any."""
        if not ranked:
            return ()
        kept = self._told(layout, [*(terms or self._terms(layout, ranked, borne))])
        longer = [self._described(layout, kept, (), names)] if len(kept) > 1 else []
        return (*longer, *self._listed(layout, ranked, names))[:_MOST]

    def _terms(self, layout: Layout, ranked: Sequence[_Ranked], borne: Borne) -> list[_Ranked]:
        """The best formula, and more terms beside it while something is left and they pay."""
        terms = list(ranked[:1])
        while terms and len(terms) < _MOST_TERMS:
            last = terms[-1]
            point, open_ = self._left(layout, last)
            found = self._search(last.after, point, terms[0].one) if open_ else ()
            further = self._ranked(last.after, found, borne, len(layout.theta))
            if not further:
                break
            terms.append(further[0])
        return terms

    def _left(self, layout: Layout, last: _Ranked) -> tuple[Point, bool]:
        """The noise beside a formula, and whether probes, or the error on check runs, say that more is missing."""
        problem = last.after.problem
        surface = Surface.of(problem.records(), self.lattice, restricted=True)
        surface.visit([last.one.point])
        point = surface.descend(last.one.point)
        if last.scored.left.by == "check" and last.scored.left.rms_dph > EXPLAINED_RATIO * self.floor_dph:
            return point, True
        return point, bool(examine(problem, layout.probes(), self.lattice, point).alarms)

    def _says_more(self, one: FoundFormula, named: Layout) -> bool:
        """Whether a formula gains beside the effects found, too; else it only writes them in a shorter way."""
        way = self.lattice.way(one.point)
        basis = orthonormal(way.apply(named.problem.base))
        further, left = outside(basis, one.white), outside(basis, way.apply(named.problem.y))
        size = float(further @ further)
        if size < 1e-9 * float(one.white @ one.white):
            return False
        sigma2 = float(left @ left) / (len(left) - basis.shape[1])
        return bool(float(further @ left) ** 2 > TIE * size * sigma2)

    def _named(
        self, layout: Layout, explained: Explanation, plain: Sequence[_Ranked], borne: Borne
    ) -> tuple[float, bool]:
        """Evidence of all effects found together, beside the model alone, and whether the best formula beside it alone
        has more.
        """
        before, after = (unseen(each.rows, each.theta, self.check).left for each in (layout, explained.layout))
        own = borne.gain(before, after)
        named = _gain(layout, explained) + own
        if not plain or plain[0].total <= named + TIE:
            return named, False
        best = plain[0]
        other = best.borne > own + TIE or not UNCATALOGUED.isdisjoint(best.one.effect.needs)
        return named, other or self._says_more(best.one, explained.layout)

    def _listed(
        self, layout: Layout, ranked: Sequence[_Ranked], beside: tuple[str, ...] = ()
    ) -> tuple[DescribedFormula, ...]:
        tied = [each.one for each in ranked[1:] if abs(each.total - ranked[0].total) <= TIE]
        listed = []
        for rank, each in enumerate(ranked[:_MOST]):
            equivalent = tuple({one.text: one for one in (*(tied if rank == 0 else ()), *each.alike)}.values())
            listed.append(self._described(layout, (each,), equivalent, beside))
        return tuple(listed)

    def _told(self, layout: Layout, terms: list[_Ranked]) -> list[_Ranked]:
        """The terms that the others do not make needless: whose size is beyond chance beside them, as they are.

        They are left out one at a time: of two that resemble each other neither has a size beside the other.
        """
        while len(terms) > 1:
            fit, own, _ = self._joint(layout, terms)
            worth = [sized(fit.beta[rows], fit.covariance[np.ix_(rows, rows)]) for rows in own]
            least = int(np.argmin(worth))
            if worth[least] > 1.0:
                break
            terms = [*terms[:least], *terms[least + 1 :]]
        return terms

    def _joint(self, layout: Layout, terms: Sequence[_Ranked]) -> tuple[Gls, list[list[int]], Layout]:
        """The fit of all terms at the parameters of each, the coefficients of each term, and the layout with them."""
        parts = [term.one for term in terms]
        _, effect, theta = together(parts)
        after, known = layout.adding(effect, theta), [name for name, _ in effect.amplitudes]
        end = after.rows.bind(after.theta, trial=True)[1].shape[1]
        columns = np.column_stack([layout.problem.base, after.problem.base[:, end - len(known) : end]])
        first = columns.shape[1] - len(known)
        own = [
            [first + known.index(entry[0]) for entry in part.amplitude_entries(name)]
            for part, name in zip(parts, AMPLITUDES, strict=False)
        ]
        return gls(columns, layout.problem.y, self.lattice.way(parts[-1].point)), own, after

    def _sized(
        self, layout: Layout, terms: Sequence[_Ranked]
    ) -> tuple[list[tuple[str, float, float, str]], FloatArray]:
        """Name, value, standard deviation and unit of each amplitude, of several terms as they are together; and what
        the terms add to the fitted bias (n,) [deg/h].
        """
        parts = [term.one for term in terms]
        pairs = zip(parts, AMPLITUDES, strict=False)
        entries = [entry for part, name in pairs for entry in part.amplitude_entries(name)]
        if len(parts) == 1:
            return entries, parts[0].contribution
        fit, own, after = self._joint(layout, terms)
        order, first = [row for rows in own for row in rows], layout.problem.base.shape[1]
        way = self.lattice.way(parts[-1].point)
        # With the slopes along the parameters behind the columns.
        at = after.rows.bind(after.theta, trial=True)[1].shape[1] - len(fit.beta)
        deviations = np.sqrt(np.diag(gls(after.problem.base, layout.problem.y, way).covariance))
        sizes = [
            (e[0], float(fit.beta[i]), float(deviations[at + i]), e[3]) for e, i in zip(entries, order, strict=True)
        ]
        end = at + len(fit.beta)
        return sizes, after.problem.base[:, at + first : end] @ fit.beta[first:]

    def _described(
        self, layout: Layout, terms: Sequence[_Ranked], equivalent: tuple[FoundFormula, ...], beside: tuple[str, ...]
    ) -> DescribedFormula:
        parts = [term.one for term in terms]
        text, effect, theta = together(parts)
        way, count = self.lattice.way(parts[-1].point), len(layout.theta)
        amplitudes, contribution = self._sized(layout, terms)
        after, scored = terms[0].after, terms[0].scored
        if len(terms) > 1:
            after = layout.adding(effect, theta).settled(way, count)
            scored = self._scored(after, sum(len(part.amplitudes) for part in parts))
        before = settled(layout, way, self.check, scored.left)
        return DescribedFormula(
            formula=text,
            expression=entry_text(effect),
            words=", and ".join(part.formula.words for part in parts),
            like="; ".join(dict.fromkeys(filter(None, (physics_of(layout, part) for part in parts)))),
            evidence=sum(part.evidence for part in parts),
            borne=sum(term.borne for term in terms),
            held_out_before_dph=before.rms_dph,
            held_out_rms_dph=scored.rms_dph,
            proof=_doubted(prove(before.left, scored.left), layout, parts),
            size_dph=float(np.std(contribution)),
            amplitudes=tuple(amplitudes),
            acts=_acts(layout.temperature, contribution),
            caution=_caution(layout, parts, contribution),
            equivalent=tuple(one.text for one in equivalent),
            rivals=tuple(Rival(one.text, one.effect, one.theta, one.evidence) for one in (*parts[:1], *equivalent)),
            point=parts[-1].point,
            beside=beside,
            model=after.rows.model,
            contribution=layout.rows.scatter(contribution),
            residuals=scored.residuals,
        )


def _gain(layout: Layout, explained: Explanation) -> float:
    """Evidence that the fitted runs have of all effects found together, beside the model alone."""
    more = explained.layout.problem.base.shape[1] - layout.problem.base.shape[1]
    gain = explained.first.minus2logl - explained.last.minus2logl
    return float(gain - more * np.log(len(layout.problem.y)))


def _simpler(first: _Ranked, other: _Ranked, layout: Layout) -> _Ranked:
    """The first of two that resemble each other, or the other where it is simpler and no evidence tells them apart.

    A parameter on its bound is needless where little speaks for it, and so is a size that cancels a part of the model.
    What is the same with a parameter more, which its words tell last, is no other cause.
    """
    cancels = _cancels(layout, first.one.contribution) and not _cancels(layout, other.one.contribution)
    least = first.total - (FORMULA_EVIDENCE if first.one.on_bound or cancels else TIE)
    if other.total > least and (cancels or len(other.one.theta) < len(first.one.theta)):
        kept, rest = other, first.one
    else:
        kept, rest = first, other.one
    more = () if rest.formula.words.startswith(kept.one.formula.words) else (rest,)
    return replace(kept, alike=(*first.alike, *more))


def _judged(ranked: list[_Ranked]) -> list[_Ranked]:
    """The same, with the one first that check runs prove against all others: more evidence of the fitted runs, which
    counts less here, may be that of what happened in them alone. A factor is needless without which no evidence tells
    the formula from the best.
    """
    if not ranked:
        return ranked
    near = (each for each in ranked if each.total > ranked[0].total - TIE)
    best = next((each for each in near if each.one.formula.within(ranked[0].one.formula)), ranked[0])
    for each in ranked if best.scored.left.by == "check" else ():
        ahead = each.borne - best.borne + _IN_RUN * min(0.0, each.one.evidence - best.one.evidence)
        if ahead > TIE and prove(best.scored.left, each.scored.left).falls:
            best = each
    return [best, *(each for each in ranked if each is not best)]


def _doubted(proof: Proof, layout: Layout, parts: Sequence[FoundFormula]) -> Proof:
    """What depends on the time since the start of the only run is interpolated into a leg left out: no proof of it. So
    is, into a part of a leg, what does not repeat within it. Nor is what is not determined, as for named effects.
    """
    stuck = next((name for part in parts for name in part.undetermined), "")
    if stuck:
        return replace(proof, doubt=f"{stuck} is on its bound: not determined")
    if proof.by == "check":
        return proof
    if not proof.falls_by(0.0, PROVED_CHOSEN):
        return replace(proof, doubt="the best of many formulas may do that by chance")
    if len(layout.rows.time) > 1:
        return proof
    span_s = float(np.ptp(layout.rows.time[0]))
    if all(part.period_s < span_s / _PERIODS for part in parts) and (proof.by == "legs" or all(map(_repeats, parts))):
        return proof
    return replace(proof, doubt="only another run can tell whether it repeats")


def _repeats(one: FoundFormula) -> bool:
    """Whether it is periodic, over whatever it is, with as many periods as a sine over time has to have."""
    changes = int(np.count_nonzero(np.diff(np.signbit(one.contribution))))
    periodic = any(word in block.text for block in one.formula.blocks for word in ("sin(", "sawtooth("))
    return periodic and changes >= 2 * _PERIODS


def _acts(temperature: FloatArray, contribution: FloatArray) -> tuple[float, float]:
    """Range of temperature [degC] that holds most of the term's square sum."""
    order = np.argsort(temperature, kind="stable")
    share = np.cumsum((contribution[order] - np.median(contribution)) ** 2)
    share /= max(float(share[-1]), 1e-300)
    tail = 0.5 * (1.0 - _ACTS)
    low, high = np.searchsorted(share, [tail, 1.0 - tail])
    return float(temperature[order[low]]), float(temperature[order[min(int(high), len(order) - 1)]])


def _caution(layout: Layout, parts: Sequence[FoundFormula], contribution: FloatArray) -> str:
    """Why the formula may not be what it looks like; empty where nothing speaks against it."""
    words = []
    if _cancels(layout, contribution):
        words.append("its size is larger than the whole spread of the bias: it cancels a part of the model")
    gains = np.diff(parts[0].halves(), prepend=0.0)
    if gains.sum() > 0.0 and gains.min() < _ONE_PLACE * gains.sum():
        words.append("only one half of the run shows it: suspected until a second run repeats it")
    return "; ".join(words)


def _cancels(layout: Layout, contribution: FloatArray) -> bool:
    """Whether a term is larger than the whole spread of the bias."""
    return float(np.ptp(contribution)) > _IMPLAUSIBLE * float(np.ptp(layout.problem.y))
