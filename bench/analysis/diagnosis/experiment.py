"""The next experiment: the profile that best tells apart the effects that the runs so far cannot.

Each rival, as fitted, is assumed to be the truth in turn. D is the gap in 2 ln L by which it would then beat another
rival, with all free parameters fitted again, over all runs so far and the proposed run. The profile with the largest D
for the worst pair wins. Minor loops win where their D is large enough, because they decide most thermal ties even if
none of the rivals is the truth. They are also proposed where the evidence is too weak to trust the fitted effects.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import permutations
from typing import Any

import numpy as np

from bench.analysis.diagnosis.answer import Diagnosis
from bench.analysis.diagnosis.candidates import Candidate, Problem, Theta
from bench.analysis.diagnosis.evidence import weigh
from bench.analysis.diagnosis.limits import expected_gap, probability
from bench.analysis.diagnosis.plan import (
    ChamberLimits,
    Plan,
    chamber_limits,
    exciting,
    minor_loops,
    plans,
    standing_still,
)
from bench.analysis.diagnosis.prediction import predicted_record
from bench.analysis.diagnosis.suspects import Layout, isothermal, offer
from bench.analysis.effects import registry as effects
from bench.analysis.effects.base import Effect
from bench.analysis.fit import design
from bench.analysis.fit.fitting import fit_model
from bench.analysis.fit.solve import one_blas_thread
from bench.analysis.noise.likelihood import NoiseLattice, Point, gls
from bench.analysis.thresholds import WEAK_EVIDENCE
from bench.base import FloatArray, finite
from bench.record import Dataset

_PREDICTABLE = {"time", "temperature", "chamber_temperature", "chamber_setpoint"}
_PLENTY = 60.0
"""Expected gap that is enough even if the fitted amplitudes are half too large."""
_POINTS = 10  # grid points of a rival's parameter; refined continuously afterwards


@dataclass(frozen=True)
class Rival:
    """One of the effects that the runs cannot tell apart, with the parameters and the evidence found for it."""

    name: str
    effect: Effect
    theta: Theta
    evidence: float


@dataclass(frozen=True)
class NoiseLevel:
    """NoiseLevel that the runs showed: lattice point, and the white variance of one mean [(deg/h)^2]."""

    point: Point
    sigma2: float


@dataclass(frozen=True)
class Proposal:
    """A run to do next. `predicted_*` are the expected gaps D of the pair that is hardest to tell apart, NaN where
    nothing was predicted; `probability_*` are what they give for a decision.
    """

    separates: tuple[str, ...]
    why: str
    predicted_before: float
    predicted_after: float
    duration_min: float
    profile_name: str
    profile_yaml: str

    @property
    def probability_before(self) -> float:
        """Probability that the runs so far decide."""
        return probability(self.predicted_before) if np.isfinite(self.predicted_before) else np.nan

    @property
    def probability_after(self) -> float:
        """Probability that all runs decide, this one included."""
        return probability(self.predicted_after) if np.isfinite(self.predicted_after) else np.nan

    def to_json(self, profile: str) -> dict[str, Any]:
        """The `next_experiment` of `bench diagnose --json`, written to the path `profile`."""
        numbers = {
            "predicted_before": self.predicted_before,
            "predicted_after": self.predicted_after,
            "probability_before": self.probability_before,
            "probability_after": self.probability_after,
        }
        known = {key: finite(value) for key, value in numbers.items()}
        return {"profile": profile, "separates": list(self.separates), "why": self.why,
                "duration_min": self.duration_min, **known}  # fmt: skip


def next_experiment(
    diagnosis: Diagnosis,
    runs: Sequence[Dataset],
    *,
    static: Dataset | None = None,
    limits: ChamberLimits | None = None,
) -> Proposal | None:
    """The run that decides what a diagnosis of these runs left open; None where it left nothing open.

    Of several effects found it takes the first that has look-alikes. The rivals are fitted here again, beside
    everything else that was found.
    """
    open_ = next((suspect for suspect in diagnosis.found if suspect.look_alikes), None)
    if open_ is None:
        return _telling(diagnosis, limits or chamber_limits(runs)) if diagnosis.verdict == "undecided" else None
    tied = (open_.effect, *open_.look_alikes)
    base = replace(open_.model, effects=open_.model.effects[:-1])
    with one_blas_thread():
        fitted = fit_model(base, runs, covariance="none")
        rows = design.fit_rows(fitted.model, tuple(runs), [np.isfinite(r) for r in fitted.residuals])
        statics = () if static is None else (isothermal(static, runs[0].interval_s),)
        layout = Layout(rows, np.array(list(fitted.theta.values())), statics)
        layout, offered = offer(layout, [effects.make(name) for name in tied])
        evidence = weigh(layout.problem, offered.candidates(layout), nulls=0)
        best = {name: next((s for s in evidence.suspects if s.effect == name), None) for name in tied}
        rivals = [Rival(name, offered.effects[s.name], s.theta, s.evidence) for name, s in best.items() if s]
        noise = NoiseLevel(evidence.suspects[0].point, evidence.suspects[0].sigma2)
        return propose(layout, rivals, noise, limits)


def _telling(diagnosis: Diagnosis, limits: ChamberLimits) -> Proposal:
    """The run that would tell what is not decided: noise that stands still, or data that no fit has seen."""
    names = tuple(suspect.effect for suspect in diagnosis.found)
    if not names and not diagnosis.static:
        plan, why = standing_still(limits), "it shows the unit's own noise, from which a slow cause then stands out"
        return _proposal(plan, limits, ("a slow cause", "noise"), f"{why}; give it as --static", (np.nan, np.nan))
    what = f"whether {' and '.join(names)} {'is' if len(names) == 1 else 'are'} missing" if names else "a slow cause"
    why = f"it shows on data that no fit has seen {what}: give it as --check"
    return _proposal(minor_loops(limits), limits, names or ("a slow cause", "noise"), why, (np.nan, np.nan))


def propose(
    layout: Layout, rivals: Sequence[Rival], noise: NoiseLevel, limits: ChamberLimits | None = None
) -> Proposal | None:
    """The run that tells these rivals apart, best first in `rivals`; None where all are one family.

    `limits` are what the chamber can do; by default the range that the runs visited and the rates that they showed.
    """
    families = [rival.effect.family for rival in rivals]
    if len(set(families)) < 2:
        return None
    records = layout.rows.records
    limits = limits or chamber_limits(records)
    names = tuple(rival.name for rival in rivals)
    channels = sorted({c for rival in rivals for c in rival.effect.needs if c not in _PREDICTABLE})
    if channels:
        plan, why = exciting(limits, channels, names)
        return _proposal(plan, limits, names, why, (np.nan, np.nan))
    if max(rival.evidence for rival in rivals) < WEAK_EVIDENCE:
        why = (
            f"the evidence is too weak (at most {max(r.evidence for r in rivals):.0f}, {WEAK_EVIDENCE:.0f} wanted) to "
            "design a run for these effects; minor loops with reversals decide most thermal ties for any cause"
        )
        return _proposal(minor_loops(limits), limits, names, why, (np.nan, np.nan))
    return _designed(layout, rivals, noise, limits)


def _designed(layout: Layout, rivals: Sequence[Rival], noise: NoiseLevel, limits: ChamberLimits) -> Proposal:
    rated = Design(layout, rivals, noise)
    before = rated.worst(None)
    scored = [(rated.worst(plan), plan) for plan in plans(limits)]
    usual = minor_loops(limits).name
    standard = [pair for pair in scored if pair[1].name == usual and pair[0] >= _PLENTY]
    best = standard[0] if standard else max(scored, key=lambda pair: pair[0])
    after, plan = best
    names = tuple(rival.name for rival in rivals)
    choice = "the usual one, and sufficient" if standard else "the best"
    why = (
        f"{plan.reason}. Of {len(scored)} profiles tried on the fitted effects it is {choice}: the expected gap "
        f"of the two that are hardest to tell apart rises from {before:.0f} to {after:.0f}, and the probability of a "
        f"decision from {probability(before):.0%} to {probability(after):.0%}"
    )
    return _proposal(plan, limits, names, why, (before, after))


def _proposal(
    plan: Plan, limits: ChamberLimits, names: tuple[str, ...], why: str, predicted: tuple[float, float]
) -> Proposal:
    text = plan.to_yaml(limits, f"Tells apart: {', '.join(names)}. {why}.")
    return Proposal(names, why, *predicted, plan.duration_s / 60.0, plan.name, text)


class Design:
    """Rivals as fitted to the runs so far, and their predictions for any plan."""

    def __init__(self, layout: Layout, rivals: Sequence[Rival], noise: NoiseLevel) -> None:
        self._layout, self._rivals, self._noise = layout, rivals, noise
        self._base = layout.rows.bind(layout.theta, trial=True)[0]
        self._beta = gls_of(layout.problem, layout.problem.base, noise.point)

    def worst(self, plan: Plan | None) -> float:
        """D of the pair of families that is hardest to tell apart, over the runs so far and then the plan's."""
        stacked = self._layout if plan is None else self._with(plan)
        problem = stacked.problem
        known = len(self._layout.problem.y)
        lattice = NoiseLattice(replace(problem, statics=()).records(), problem.interval_s)
        candidates = [replace(stacked.candidate(r.effect, r.name), points=_POINTS) for r in self._rivals]
        means = [self._mean(problem, c, r, known) for c, r in zip(candidates, self._rivals, strict=True)]
        gaps = [
            expected_gap(problem, means[i], candidates[j], lattice, self._noise.point, self._noise.sigma2)
            for i, j in permutations(range(len(candidates)), 2)
            if self._rivals[i].effect.family != self._rivals[j].effect.family
        ]
        return min(gaps)

    def _mean(self, problem: Problem, candidate: Candidate, rival: Rival, known: int) -> FloatArray:
        """Bias over all rows (n,) [deg/h] if this rival, as fitted to the known rows, is the truth."""
        own = candidate.columns(rival.theta)
        columns = own if candidate.kind == "abscissa" else np.column_stack([problem.base, own])
        beta = gls_of(self._layout.problem, columns[:known], self._noise.point)
        return np.asarray(columns @ beta)

    def _with(self, plan: Plan) -> Layout:
        """The layout with the planned run as one more record, its bias as the present model predicts it."""
        records = self._layout.rows.records
        planned = predicted_record(records, plan.setpoint(), records[0].interval_s)
        bias = self._base.columns(planned) @ self._beta[: self._base.columns(planned).shape[1]]
        planned = planned.with_channel("rate", bias)
        rows = design.FitRows(
            self._layout.rows.model, (*records, planned), (*self._layout.rows.masks, np.ones(len(planned), dtype=bool))
        )
        return replace(self._layout, rows=rows)


def gls_of(problem: Problem, columns: FloatArray, point: Point) -> FloatArray:
    """Coefficients (p,) of columns over the run's rows at this noise; zero for a column without a value there."""
    lattice = NoiseLattice(problem.records()[:1], problem.interval_s)
    return gls(columns, problem.y, lattice.at([point])[0][0]).beta
