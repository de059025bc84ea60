"""The suspects of a diagnosis: what was found, then its rivals, each refitted and scored on unseen data."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from bench.analysis.diagnosis.answer import SuspectedEffect, Value
from bench.analysis.diagnosis.evidence import Evidence, Suspect
from bench.analysis.diagnosis.held_out import removed, settled, with_suspect
from bench.analysis.diagnosis.offer import Offer
from bench.analysis.diagnosis.proof import LeftOut, prove
from bench.analysis.diagnosis.suspects import Layout
from bench.analysis.diagnosis.verdict import RULED_OUT, Explanation, told
from bench.analysis.effects.base import Effect, options_of
from bench.analysis.thresholds import PREFERRED_DEVIATIONS, PREFERRED_FALL, TIE
from bench.base import FloatArray, number
from bench.record import Dataset

_RIVALS = 4
_ALL_TERMS = 3
"""Coefficients of an effect that are listed; an effect with more of them, such as a spline, lists none."""
_WITHIN = 3.92  # standard deviations in a 95 % interval


@dataclass(frozen=True, eq=False)
class Ranking:
    """Scores suspects of one explanation."""

    explained: Explanation
    offer: Offer
    check: tuple[Dataset, ...]
    floor_dph: float
    _known: dict[int, dict[str, float]] = field(default_factory=dict, repr=False)

    def suspects(self) -> tuple[SuspectedEffect, ...]:
        """What was found, strongest first, then what comes next in evidence."""
        steps = self.explained.steps
        named = {step.name for step in steps}
        listed = _beside_stuck([self._scored(s.layout, s.evidence, s.suspect, True, s.alike) for s in steps])
        layout, evidence = (
            (steps[0].layout, steps[0].evidence) if steps else (self.explained.layout, self.explained.first)
        )
        rivals = [s for s in evidence.each_once() if s.effect not in named]
        listed += [self._scored(layout, evidence, s, False) for s in rivals[:_RIVALS]]
        return tuple(listed)

    def _scored(
        self, layout: Layout, evidence: Evidence, suspect: Suspect, found: bool, alike: tuple[str, ...] = ()
    ) -> SuspectedEffect:
        effect = self.offer.effects[suspect.name]
        after = layout.adding(effect, suspect.theta)
        scored = with_suspect(layout, effect, suspect, self.check)
        before = settled(layout, suspect.way, self.check, scored.left)
        proof = prove(before.left, scored.left)
        alike, values = alike or self._look_alikes(layout, evidence, suspect), _values(layout, effect, suspect)
        if found:
            better = self._preferred(layout, evidence, suspect, scored.left)
            alike = tuple(dict.fromkeys([*better, *alike]))
            once = effect.by_clock and proof.by != "check" and len(layout.rows.records) == 1
            proof = replace(proof, doubt=_doubt(better, values, alike if once else ()))
        return SuspectedEffect(
            effect=effect.name,
            options=options_of(effect),
            found=found,
            evidence=suspect.evidence,
            chance=self.explained.first.chance(suspect.evidence),
            held_out_before_dph=before.rms_dph,
            held_out_rms_dph=scored.rms_dph,
            removes=removed(proof.before_dph, proof.after_dph, self.floor_dph),
            parameters=values,
            look_alikes=alike,
            legs=tuple(_legs(layout, suspect.cumulative)),
            model=after.rows.model,
            theta=suspect.theta,
            shape=layout.rows.scatter(suspect.contribution),
            reason=scored.reason,
            proof=proof,
        )

    def _preferred(self, layout: Layout, evidence: Evidence, found: Suspect, left: LeftOut) -> dict[str, float]:
        """Errors on unseen data [deg/h] of effects in the place of one found, where they are much less; least first.

        The evidence is of the rows that were fitted. What fits them better and predicts others worse is not proved.
        """
        rivals = [s for s in evidence.each_once() if s.effect != found.effect and s.evidence > self.explained.threshold]
        scored = [with_suspect(layout, self.offer.effects[rival.name], rival, self.check, left) for rival in rivals]
        proofs = [(rival.effect, prove(left, own.left)) for rival, own in zip(rivals, scored, strict=True)]
        better = [
            (name, proof.after_dph) for name, proof in proofs if proof.falls_by(PREFERRED_FALL, PREFERRED_DEVIATIONS)
        ]
        return dict(sorted(better, key=lambda pair: pair[1]))

    def _look_alikes(self, layout: Layout, evidence: Evidence, suspect: Suspect) -> tuple[str, ...]:
        """Names within the tie of the best, if the suspect is within it, too, and the best beats chance: by the run,
        or by the run and the check runs together.
        """
        ranked = evidence.each_once()
        if not ranked or ranked[0].evidence <= self.explained.threshold:
            return ()
        names = [s.effect for s in ranked if s.evidence + s.charged >= ranked[0].evidence - TIE]
        known = self._told(layout, evidence) if self.check else {}
        if suspect.effect in known:  # a check run can show it
            least = max(known.values()) - RULED_OUT
            names = [one.effect for one in ranked if known.get(one.effect, -np.inf) + one.charged > least]
        if suspect.effect not in names:
            return ()
        own = self.offer.effects[suspect.name]
        if own.shared and len(own.amplitudes) == 1:  # no run tells it from what has this term and further ones
            names = [s.effect for s in ranked if s.effect in names and self.offer.effects[s.name].shared != own.shared]
        return tuple(name for name in names if name != suspect.effect)

    def _told(self, layout: Layout, evidence: Evidence) -> dict[str, float]:
        """Evidence of each effect that check runs have a say in, by the runs and these together; worked out once."""
        if id(evidence) not in self._known:
            known = told(layout, self.offer, self.check, evidence)
            self._known[id(evidence)] = {one.effect: own for one, own in known}
        return self._known[id(evidence)]


def _beside_stuck(found: list[SuspectedEffect]) -> list[SuspectedEffect]:
    """The effects found, strongest first. One that was judged beside a stronger one that is not determined is not
    proved: it may only make up for the wrong law of that one.
    """
    for place, stuck in enumerate(found):
        if any(value.at_bound for value in stuck.parameters.values()):
            doubt = f"beside {stuck.effect}, which is not determined"
            later = [replace(s, proof=replace(s.proof, doubt=s.proof.doubt or doubt)) for s in found[place + 1 :]]
            return [*found[: place + 1], *later]
    return found


def _doubt(better: Mapping[str, float], values: Mapping[str, Value], alike: Sequence[str]) -> str:
    """Why a fall of the error does not prove an effect.

    `better` are errors [deg/h] with others in its place. What depends on time alone is interpolated into a leg left out
    of the only run, what is `alike` may not be.
    """
    if better:
        name, error = next(iter(better.items()))
        return f"with {name} in its place to {number(error)} deg/h"
    stuck = next((name for name, value in values.items() if value.at_bound), "")
    if stuck:
        return f"{stuck} is on its bound: not determined"
    return f"only another run can tell it from {alike[0]}" if alike else ""


def _values(layout: Layout, effect: Effect, suspect: Suspect) -> dict[str, Value]:
    """Nonlinear parameters and amplitudes in their units."""
    searched = {p.name: p for p in effect.parameters}
    values = {
        name: Value(p.value, p.unit, (p.high - p.low) / _WITHIN, (p.low, p.high), searched[name].on_bound(p.value))
        for name, p in suspect.parameters.items()
    }
    form = layout.prepared(effect).physical()
    if effect.moves_abscissa or len(form.labels) > _ALL_TERMS:
        return values
    matrix = form.matrix[:, 1:]
    numbers = matrix @ suspect.amplitudes
    deviations = np.sqrt(matrix**2 @ suspect.deviations**2)
    rows = zip(form.labels, form.units, numbers.tolist(), deviations.tolist(), strict=True)
    return values | {label: Value(value, unit, std) for label, unit, value, std in rows}


def _legs(layout: Layout, cumulative: FloatArray) -> Iterator[tuple[str, float]]:
    """What each segment adds to the evidence, in order of time."""
    gains = np.diff(cumulative, prepend=0.0)
    at = 0
    for record, mask in zip(layout.rows.records, layout.rows.masks, strict=True):
        segment = record.segment[mask]
        own = gains[at : at + len(segment)]
        at += len(segment)
        names = {s.index: s.name for s in record.segments}
        for index in dict.fromkeys(segment.tolist()):
            yield names.get(index, "outside segments"), float(own[segment == index].sum())
