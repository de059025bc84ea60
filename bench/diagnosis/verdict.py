"""From evidence to a verdict: effects one after the other, judged again together, and what remains after them.

The threshold is what chance reaches in runs simulated from the model and its noise alone. After each effect the probes
are asked again: what they still see is not explained, whatever the name.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from bench.channels import FloatArray
from bench.diagnosis.answer import VerdictWord
from bench.diagnosis.evidence import TIE, Evidence, Suspect, weigh
from bench.diagnosis.probes import Examination, Finding, examine, noise_test
from bench.diagnosis.suspects import Layout, Offer
from bench.effects.base import Effect
from bench.likelihood import NoiseLattice, Point

MOST_EFFECTS = 3
_NULLS = 500
_MINOR = 0.1
"""What remains may be this share of the evidence explained: real effects follow textbook equations about so well."""
_NOISE = "noise"
_BINS = 6  # of temperature, for the white noise


@dataclass(frozen=True, eq=False)
class Step:
    """One effect found: the layout without it, the evidence of all candidates there, and its own."""

    layout: Layout
    evidence: Evidence
    suspect: Suspect
    effect: Effect

    @property
    def name(self) -> str:
        """The effect's name in models."""
        return self.effect.name

    @property
    def ties(self) -> tuple[str, ...]:
        """Other effects that this data does not tell from it."""
        best = self.suspect.evidence
        names = (s.name for s in self.evidence.suspects if s.excited and s.evidence >= best - TIE)
        return tuple(dict.fromkeys(n for n in map(effect_name, names) if n != self.name))


@dataclass(frozen=True, eq=False)
class Explanation:
    """What was found and what is left. `first` judges all candidates beside the model as it is, `last` beside all that
    was found.
    """

    first: Evidence
    before: Examination
    steps: tuple[Step, ...]
    layout: Layout
    last: Evidence
    after: Examination
    threshold: float
    noise: str = ""
    drifts: bool = False
    """The run's slow noise is larger than the isothermal run's."""

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


def effect_name(candidate: str) -> str:
    """Name of the effect that a candidate is a shape of."""
    return candidate.split(" ", 1)[0]


@dataclass(frozen=True, eq=False)
class Search:
    """Everything that the steps of one diagnosis share."""

    offer: Offer
    lattice: NoiseLattice
    seed: int = 0
    threshold: float = 0.0
    known: dict[frozenset[Effect], Evidence] = field(default_factory=dict, repr=False)

    def explain(self, layout: Layout) -> Explanation:
        """Effects one after the other while they beat chance, then judged again together."""
        first = weigh(layout.problem, self.offer.candidates(layout), _NULLS, self.seed, self.lattice)
        before = examine(layout.problem, layout.probes(), self.lattice, first.point)
        search = replace(self, threshold=first.threshold)
        steps = search.forward(layout, first)
        if len(steps) > 1:
            steps = search.again(layout, steps)
        last_layout = _with(layout, steps)
        last = search.weigh(last_layout) if steps else first
        after = examine(last_layout.problem, layout.probes(), self.lattice, last.point) if steps else before
        noise, drifts = _noise(last_layout, after, self.lattice, last.point)
        return Explanation(first, before, steps, last_layout, last, after, first.threshold, noise, drifts)

    def weigh(self, layout: Layout) -> Evidence:
        """Evidence of all candidates beside a layout, without simulating chance again; the same effects once only.

        Their parameters may have moved a little since: the slopes in the base follow that.
        """
        key = frozenset(layout.rows.model.effects)
        if key not in self.known:
            self.known[key] = weigh(layout.problem, self.offer.candidates(layout), 0, self.seed, self.lattice)
        return self.known[key]

    def forward(self, layout: Layout, evidence: Evidence) -> tuple[Step, ...]:
        """The best effect, the best beside it, and so on while it beats chance."""
        steps: list[Step] = []
        while len(steps) < MOST_EFFECTS:
            best = _best(evidence)
            if best is None or best.evidence <= self.threshold:
                break
            steps.append(Step(layout, evidence, best, self.offer.effects[best.name]))
            layout = _with(layout, steps[-1:])
            evidence = self.weigh(layout)
        return tuple(steps)

    def again(self, layout: Layout, steps: tuple[Step, ...]) -> tuple[Step, ...]:
        """Each effect judged beside all others: kept, replaced by a better one, or dropped if the others suffice."""
        current = list(steps)
        for step in steps:
            others = [s for s in current if s is not step]
            without = _with(layout, others)
            evidence = self.weigh(without)
            best = _best(evidence)
            current = others
            if best is not None and best.evidence > self.threshold:
                current.append(Step(without, evidence, best, self.offer.effects[best.name]))
        return tuple(sorted(current, key=lambda s: -s.suspect.evidence))


def _with(layout: Layout, steps: Sequence[Step]) -> Layout:
    for step in steps:
        layout = layout.adding(step.effect, step.suspect.theta)
    return layout


def _best(evidence: Evidence) -> Suspect | None:
    return next((s for s in evidence.suspects if s.excited), None)


def _noise(layout: Layout, after: Examination, lattice: NoiseLattice, point: Point) -> tuple[str, bool]:
    """What is found about the noise, and whether it is slow noise that the isothermal record does not have.

    White noise that grows with temperature makes a run noisier, too: the test is made again with the white noise of the
    run taken from its neighbouring rows, by temperature.
    """
    finding = next((f for f in after.findings if f.name == _NOISE), None)
    if finding is None or finding.p >= after.level:
        return "", False
    problem = layout.problem
    scale = _white(layout)
    levelled = replace(problem, white=scale * (1.0 if problem.white is None else problem.white))
    fresh = NoiseLattice(levelled.records(), problem.interval_s)
    again = noise_test(levelled, levelled.base, fresh, point)
    low, high = np.sqrt([scale.min(), scale.max()])
    if again.p >= after.level:
        return f"white noise of the run is {low:.2f} to {high:.2f} of the isothermal run's, by temperature", False
    return f"the run drifts more than the isothermal run (p {again.p:.1g}): a cause that no channel records", True


def _white(layout: Layout) -> FloatArray:
    """White variance of the run (n,) relative to the isothermal record's, from differences of neighbouring rows."""
    problem = layout.problem
    residual = layout.beyond(problem.y)
    near = np.flatnonzero(np.diff(problem.time_s) < 1.5 * problem.interval_s)
    square = np.diff(residual)[near] ** 2
    still = np.concatenate([np.diff(r.y)[np.diff(r.time_s) < 1.5 * problem.interval_s] for r in problem.statics])
    temperature = layout.temperature
    edges = np.quantile(temperature[near], np.linspace(0.0, 1.0, _BINS + 1))
    which = np.clip(np.searchsorted(edges, temperature[near]) - 1, 0, _BINS - 1)
    mean = [float(np.mean(square[which == i])) if np.any(which == i) else np.nan for i in range(_BINS)]
    filled = np.where(np.isfinite(mean), mean, np.mean(square))
    return np.asarray(np.interp(temperature, 0.5 * (edges[1:] + edges[:-1]), filled) / np.mean(still**2))
