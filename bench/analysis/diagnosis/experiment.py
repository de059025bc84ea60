"""The next experiment: the profile that best tells apart the effects that the runs so far cannot.

Each rival is assumed to be the truth in turn, at sizes, parameters and noise drawn from what the runs so far leave
open (`discrimination`). The shortest profile that decides with near certainty wins; without one, the most probable. The
library's best are tried repeated up to the time budget, too. Where even three such runs would not decide, the answer
says so. A verdict that names nothing and does not rule out a slow cause gets a run that would tell.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal

import numpy as np

from bench.analysis.diagnosis.answer import Diagnosis
from bench.analysis.diagnosis.described import DescribedFormula
from bench.analysis.diagnosis.discrimination import Discrimination, Expected
from bench.analysis.diagnosis.evidence import weigh
from bench.analysis.diagnosis.offer import catalogued, offer, without_gaps
from bench.analysis.diagnosis.plan import (
    ChamberLimits,
    Plan,
    chamber_limits,
    exciting,
    faster,
    isothermal_plan,
    minor_loops,
    plans,
    repetitions,
)
from bench.analysis.diagnosis.rivals import Rival
from bench.analysis.diagnosis.still import Still
from bench.analysis.diagnosis.suspects import Layout
from bench.analysis.effects import registry as effects
from bench.analysis.effects.base import Effect
from bench.analysis.effects.model import Model
from bench.analysis.fit import design
from bench.analysis.fit.fitting import fit_model
from bench.analysis.fit.solve import one_blas_thread
from bench.analysis.noise.likelihood import Point
from bench.analysis.thresholds import TIE
from bench.base import InputError, finite, listed, shared, usual_workers
from bench.record import Dataset

_PREDICTABLE = {"time", "temperature", "chamber_temperature", "chamber_setpoint"}
_ENOUGH = 0.97
"""Probability of a decision beyond which the shorter run is better."""
_HOPELESS = 0.5
"""Probability of a decision after `_MOST_RUNS` runs below which the answer is that none can be had."""
_MOST_RUNS = 3
_FAR_MORE_RUNS = 20  # faster profiles that do not decide after so many are not looked at closely
_MOST_RIVALS = 4  # formulas, the best first
_NEAR = 2.0 * TIE  # evidence below the best within which an effect that is not tied may be tied after one more run
_CHECK = "`bench check` tells how long a chamber takes that cannot follow"
_CLOSELY = 4  # profiles of the library that are tried repeated and at every noise


Use = Literal["run", "check", "static", "by_hand"]
"""What the proposed run is to the next diagnosis: one more run, a check run, or the isothermal run; "by_hand": one more
run, in which somebody has to move what the chamber does not."""


@dataclass(frozen=True)
class Proposal:
    """A run to do next. `predicted_*` are the expected gaps D of the pair that is hardest to tell apart, NaN where
    nothing was predicted; `probability_*` are what they give for a decision. `duration_min` holds for a chamber that
    keeps up the rates that the runs showed (`Plan.expected_s`).
    """

    separates: tuple[str, ...]
    why: str
    predicted_before: float
    predicted_after: float
    duration_min: float
    profile_name: str
    profile_yaml: str
    expected: tuple[float, float] = (np.nan, np.nan)
    """Probability that the runs so far decide, and that they do with this one."""
    after_repeats: float = np.nan
    """Probability that they do after three of it."""
    decides: bool = True
    """False where no profile within the limits can tell."""
    use: Use = "run"
    channels: tuple[str, ...] = ()
    """What somebody has to move."""
    faster: tuple[float, float] | None = None
    """Most heating and cooling [degC/min], where the runs did not show so fast a chamber."""

    @property
    def probability_before(self) -> float:
        """Probability that the runs so far decide."""
        return self.expected[0]

    @property
    def probability_after(self) -> float:
        """Probability that all runs decide, this one included."""
        return self.expected[1]

    def to_json(self, profile: str) -> dict[str, Any]:
        """The `next_experiment` of `bench diagnose --json`, written to the path `profile`."""
        numbers = {
            "predicted_before": self.predicted_before,
            "predicted_after": self.predicted_after,
            "probability_before": self.probability_before,
            "probability_after": self.probability_after,
            "probability_after_repeats": self.after_repeats,
        }
        known = {key: finite(value) for key, value in numbers.items()}
        return {"profile": profile, "separates": list(self.separates), "why": self.why,
                "duration_min": self.duration_min, "decides": self.decides, "use": self.use,
                "channels": list(self.channels), "faster_degc_per_min": self.faster, **known}  # fmt: skip


def next_experiment(
    diagnosis: Diagnosis,
    runs: Sequence[Dataset],
    *,
    check: Sequence[Dataset] = (),
    static: Dataset | None = None,
    limits: ChamberLimits | None = None,
) -> Proposal | None:
    """The run that decides what a diagnosis of these runs left open; None where it left nothing open.

    Of several effects found it takes the first that has look-alikes. The rivals are fitted here again, beside
    everything else that was found. Where a proved formula stands in their place, it is the formulas that are open.
    What the `check` runs tell is known, too. Where steps of the recorded values cause what is left, no run tells more.
    """
    best = diagnosis.leading
    described = best if best and best.proof.proved and not best.beside else None
    open_ = next((suspect for suspect in diagnosis.found if suspect.look_alikes and not described), None)
    if open_ is None:
        unknown = diagnosis.verdict == "unknown_effect" and (described is not None or not diagnosis.found)
        open_word = (diagnosis.verdict == "undecided" and not diagnosis.resolution) or unknown
        try:
            if described and unknown:
                return _between(described, (*runs, *check), static, limits)
            return _telling(diagnosis, limits or chamber_limits(runs), static) if open_word else None
        except InputError:  # no temperature, or one that stands still: nothing says what the chamber can do
            return None
    tied = (open_.effect, *open_.look_alikes)
    with one_blas_thread():
        try:
            base = replace(open_.model, effects=open_.model.effects[:-1])
            layout = _layout(base, (*runs, *check), static)
        except InputError:  # nothing was found before it, or these rows do not determine that: nothing can be predicted
            return None
        known = {effect.name: effect for effect in catalogued(base, runs)}
        formula = {best.formula: best.model.effects[-1] for best in diagnosis.formulas[:1]}
        wanted = {name: formula.get(name) or known.get(name) or effects.make(name) for name in tied}
        wanted |= {name: effect for name, effect in known.items() if name not in wanted and not _moved(effect)}
        layout, offered = offer(layout, list(wanted.values()))
        evidence = weigh(layout.problem, offered.candidates(layout), nulls=0)
        found = {suspect.effect: suspect for suspect in reversed(evidence.suspects)}  # the best shape of each
        least = evidence.suspects[0].evidence - _NEAR
        rivals = [
            Rival(name, offered.effects[s.name], s.theta, s.evidence, name in tied)
            for name, effect in wanted.items()
            if (s := found.get(effect.name)) and (name in tied or s.evidence + s.charged > least)
        ]
        return propose(layout, rivals, evidence.suspects[0].point, limits)


def _layout(model: Model, runs: Sequence[Dataset], static: Dataset | None) -> Layout:
    """The model fitted to the runs."""
    fitted = fit_model(model, runs, covariance="none", weights="count")
    rows = design.fit_rows(fitted.model, tuple(runs), [np.isfinite(r) for r in fitted.residuals])
    still = None if static is None else Still.of(static, runs[0].interval_s)
    return Layout(rows, np.array(list(fitted.theta.values())), still)


def _between(
    best: DescribedFormula, runs: Sequence[Dataset], static: Dataset | None, limits: ChamberLimits | None
) -> Proposal | None:
    """The run that tells a proved formula from those that are equivalent and predict something else elsewhere; None
    without any.
    """
    if not best.equivalent:
        return None
    limits = limits or chamber_limits(runs)
    with one_blas_thread():
        layout = _layout(replace(best.model, effects=best.model.effects[:-1]), runs, static)
        layout = without_gaps(layout, {channel for rival in best.rivals for channel in rival.effect.needs})
        rivals = Discrimination(layout, best.rivals, best.point).unlike(minor_loops(limits), _MOST_RIVALS)
        return propose(layout, rivals, best.point, limits)


def _telling(diagnosis: Diagnosis, limits: ChamberLimits, static: Dataset | None) -> Proposal | None:
    """The run that tells what a misfit is that no effect explains; None where there is none."""
    word, names = str(diagnosis.verdict), [suspect.effect for suspect in diagnosis.found]
    if word == "undecided" and names:
        what = f"whether {' and '.join(names)} {'is' if len(names) == 1 else 'are'} missing"
        why = f"it shows on data that no fit has seen {what}: give it as --check"
        return _proposal(minor_loops(limits), limits, tuple(names), why, use="check")
    if word == "undecided" and static is None:
        why = (
            "an isothermal run shows the unit's own slow noise: given as --static, what the run drifts beyond it has a "
            "cause"
        )
        return _proposal(isothermal_plan(limits), limits, ("a slow cause", "noise"), why, use="static")
    if word in {"undecided", "unknown_effect"}:
        why = (
            "reversals and rests at many temperatures: what repeats with temperature, its rate or its history has a "
            "thermal cause; what does not repeat follows time or something that is not recorded"
        )
        separates = ("a slow cause", "noise") if word == "undecided" else ("a thermal cause", "another cause")
        return _proposal(minor_loops(limits), limits, separates, why)
    return None


def propose(
    layout: Layout, rivals: Sequence[Rival], noise: Point, limits: ChamberLimits | None = None
) -> Proposal | None:
    """The run that tells these rivals apart, best first in `rivals`; None where all are one family. `noise` is a point
    of the lattice.

    Where a thermal one is the best, and others of another family are thermal, too, the run tells these apart: a run in
    which somebody moves a channel by hand is for what stays open then.
    `limits` are what the chamber can do; by default the range that the runs visited and the rates that they showed, or
    faster ones where these decide nothing.
    """
    tied = [rival for rival in rivals if rival.tied]
    if len({rival.family for rival in tied}) < 2:
        return None
    records = layout.rows.records
    shown = limits or chamber_limits(records)
    moved = {rival.name: _moved(rival.effect) for rival in tied}
    if not moved[tied[0].name] and len({rival.family for rival in tied if not moved[rival.name]}) > 1:
        # What the chamber can tell comes first: nobody has to be there.
        thermal = [rival for rival in rivals if not moved.get(rival.name)]
        rated = Discrimination(layout, thermal, noise)
        found = _designed(rated, thermal, shown, _roughly(rated, shown))
        if limits is None and not found.decides:
            quick = faster(shown)
            roughly, before = _roughly(rated, quick), rated.expected(None, roughly=True)
            if max(one.after(before, _FAR_MORE_RUNS).probability for one, _ in roughly) >= _HOPELESS:
                more = f"; {quick.rates}, faster than these runs: {_CHECK}"
                other = _designed(rated, thermal, quick, roughly, more)
                rates = quick.heating_degc_per_min, quick.cooling_degc_per_min
                found = replace(other, faster=rates) if other.decides else found
        return _leaving_open(found, [name for name in moved if moved[name]])
    channels = sorted({channel for needed in moved.values() for channel in needed})
    plan, why = exciting(shown, channels, tuple(moved))
    return replace(_proposal(plan, shown, tuple(moved), why, use="by_hand"), channels=tuple(channels))


def _moved(effect: Effect) -> list[str]:
    """Channels that an effect needs and the chamber does not move."""
    return sorted(set(effect.needs) - _PREDICTABLE)


def _leaving_open(proposal: Proposal, others: Sequence[str]) -> Proposal:
    """The same, said not to judge `others`."""
    if not others:
        return proposal
    left = f"{listed(others)} stay{'s' * (len(others) == 1)} open: the chamber does not move what is needed to tell"
    return replace(proposal, why=f"{proposal.why}; {left}")


def _roughly(rated: Discrimination, limits: ChamberLimits) -> list[tuple[Expected, Plan]]:
    """What each plan of the library promises, by few parameters of the rivals at the likeliest noise."""
    library = plans(limits)
    promised = shared([partial(rated.expected, plan, roughly=True) for plan in library], usual_workers())
    return list(zip(promised, library, strict=True))


def _designed(
    rated: Discrimination,
    rivals: Sequence[Rival],
    limits: ChamberLimits,
    roughly: Sequence[tuple[Expected, Plan]],
    more: str = "",
) -> Proposal:
    """The run that tells these rivals apart, of the plans that promise most `roughly`; `more` is said of it, too."""
    before, foremost = rated.expected(None), sorted(roughly, key=lambda pair: -pair[0].probability)
    longer = [again for _, plan in foremost[:_CLOSELY] for again in repetitions(plan, limits)]
    closely = shared([partial(rated.expected, plan) for plan in longer], usual_workers())
    scored = list(zip(closely, longer, strict=True))
    most = max(after.probability for after, _ in scored)
    enough = [pair for pair in scored if pair[0].probability >= min(_ENOUGH, most)]
    after, plan = min(enough, key=lambda pair: pair[1].expected_s)
    names = tuple(rival.name for rival in rivals if rival.tied)
    often = after.after(before, _MOST_RUNS).probability
    tried = len(roughly) + len(longer) - _CLOSELY
    promise = (
        f"with a probability of {100 * after.probability:.0f} %, if one of them alone is the cause "
        f"({100 * before.probability:.0f} % without it"
    )
    if often < _HOPELESS:
        why = (
            f"no profile within the limits of the chamber and {limits.budget_min / 60.0:g} h can tell {listed(names)} "
            f"apart: the best of {tried} tried decides with a probability of {100 * after.probability:.0f} %, and "
            f"{_MOST_RUNS} such runs with {100 * often:.0f} %"
        )
    elif before.probability >= _ENOUGH:
        why = (
            f"if one of {listed(names)} alone were the cause, the runs so far would tell them apart with a probability "
            f"of {100 * before.probability:.0f} %: several of them, or another cause, may be at work; {plan.reason}"
        )
    elif after.probability >= _ENOUGH:
        why = f"{plan.reason}. Of {tried} profiles tried it is the shortest that decides: {promise})"
    else:
        why = f"{plan.reason}. Of {tried} profiles tried it is the best: it decides {promise}, {100 * often:.0f} % "
        why += f"after {_MOST_RUNS} such runs); diagnose all runs together after it"
    found = _proposal(plan, limits, names, f"{why}{more}", (before.gap, after.gap))
    return replace(
        found, expected=(before.probability, after.probability), after_repeats=often, decides=often >= _HOPELESS
    )


def _proposal(
    plan: Plan,
    limits: ChamberLimits,
    names: tuple[str, ...],
    why: str,
    predicted: tuple[float, float] = (np.nan, np.nan),
    use: Use = "run",
) -> Proposal:
    text = plan.to_yaml(limits, f"Tells apart: {', '.join(names)}; {why}.")
    return Proposal(names, why, *predicted, plan.expected_s / 60.0, plan.name, text, use=use)
