"""Where a model fails, which physical effect is missing, and what this run could not have shown.

The evidence names an effect, unseen data proves it, and the probes run again after each effect. The modules `evidence`,
`probes` and `verdict` describe the method.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bench.analysis.diagnosis.answer import Detectable, Diagnosis, Place
from bench.analysis.diagnosis.decision import DRIFTS, Decision, bound_only, decide, with_formulas
from bench.analysis.diagnosis.described import DescribedFormula
from bench.analysis.diagnosis.describing import Describer
from bench.analysis.diagnosis.evidence import Evidence
from bench.analysis.diagnosis.first_fit import first_fit
from bench.analysis.diagnosis.held_out import Unseen, unseen, without_pauses, without_spikes
from bench.analysis.diagnosis.kernel import kernel_of
from bench.analysis.diagnosis.levelling import levelled
from bench.analysis.diagnosis.limits import Smallest, smallest
from bench.analysis.diagnosis.needless import needless
from bench.analysis.diagnosis.notes import (
    bound_notes,
    constants,
    differ,
    of_answer,
    of_channels,
    of_check,
    of_runs,
    slow_floor,
)
from bench.analysis.diagnosis.offer import Offer, catalogued, offer
from bench.analysis.diagnosis.pieces import after_pauses
from bench.analysis.diagnosis.places import places, steps_places
from bench.analysis.diagnosis.ranking import Ranking
from bench.analysis.diagnosis.sentences import sentence
from bench.analysis.diagnosis.sisters import sister_records
from bench.analysis.diagnosis.slow import structure
from bench.analysis.diagnosis.still import Still
from bench.analysis.diagnosis.surface import RATE_OF_TEMPERATURE, ResidualSurface, channels_of, residual_surface
from bench.analysis.diagnosis.suspects import Layout, resolved
from bench.analysis.diagnosis.verdict import Explanation, Search
from bench.analysis.effects.base import Effect
from bench.analysis.effects.model import Model
from bench.analysis.fit.design import fit_rows
from bench.analysis.fit.disturbances import left_out_words, undisturbed
from bench.analysis.fit.fitting import Fit, refuse_stuck, refuse_unfit
from bench.analysis.fit.own_jumps import jump_words, with_own_jump
from bench.analysis.fit.solve import one_blas_thread
from bench.analysis.noise.estimate import Noise, profile_noise
from bench.analysis.noise.floor import noise_floor
from bench.analysis.noise.likelihood import NoiseLattice, Record
from bench.analysis.thresholds import (
    ADEQUATE_RATIO,
    EXPLAINED_RATIO,
    FORMULA_EVIDENCE,
    LEAST_DIAGNOSED_ROWS,
    NAMED_FALL,
    NEAREST_RATIO,
    PROVED_FALL,
    TIE,
)
from bench.base import FloatArray, InputError, despike, number, usual_workers
from bench.record import Dataset, refuse_mixed, refuse_twice

SISTERS_ALONE = "isothermal runs of sister units are compared with one of the unit itself; name it (--static)"
_CERTAIN = 3.0 * FORMULA_EVIDENCE  # evidence of a formula that chance never reached
_LESS = 0.9  # of the noise floor: effects found that take less out of it are not in the isothermal run
_UNMOVED = "the run does not change what this effect acts on: its terms look like those of the model"


def diagnose(  # noqa: PLR0913 - options of one command, by keyword
    runs: Sequence[Dataset],
    model: Model,
    *,
    check: Sequence[Dataset] = (),
    static: Dataset | None = None,
    sisters: Sequence[Dataset] = (),
    candidates: Sequence[Effect] | None = None,
    floor_dph: float | None = None,
    surface: Sequence[str] = (),
    seed: int = 0,
    workers: int | None = None,
) -> Diagnosis:
    """Diagnose a model on runs of one unit; `candidates` replace the effects of the catalogue that the model lacks.

    `check` are runs that no fit sees; `static` is a run at constant temperature that tells the noise, `sisters`
    are such runs of units like this one, and tell how it drifts. `floor_dph` is
    the noise floor of these means, read from finer rows (NaN: not known); None reads it from these rows. `surface` are
    two channels over which what is left is shown in cells. `workers` processes share the work, by default those of
    `usual_workers`; the answer is the same for any number.
    Raises InputError: no run, runs of several units, a run given twice, sisters without `static`, a rate that is the
    same in every row, or the model cannot be fitted.
    """
    if sisters and static is None:
        raise InputError(SISTERS_ALONE)
    own = () if static is None else (static,)
    refuse_mixed((*runs, *check, *own))
    refuse_twice((*sisters, *own))
    for record in (*own, *sisters):
        refuse_stuck(record)
    refuse_unfit(check)
    runs, check = (tuple(map(undisturbed, some)) for some in (runs, check))
    with one_blas_thread():
        case = _Case.of(runs, model, static, candidates, floor_dph, sisters)
        if surface:
            channels_of(case.layout, surface)
        check = [without_pauses(run) for run in check]
        unspiked = tuple(without_spikes(case.fit, run) for run in check)
        lost = sum(
            int(np.isnan(new.bias).sum() - np.isnan(run.bias).sum()) for new, run in zip(unspiked, check, strict=True)
        )
        spiked = (f"rows with spikes in the check runs, left out: {lost}",) if lost else ()
        unspiked = tuple(with_own_jump(run, runs) for run in unspiked)
        case = replace(case, notes=(*case.notes, *left_out_words((*runs, *check)), *spiked, *jump_words(unspiked)))
        answer = case.diagnosis(unspiked, seed, usual_workers() if workers is None else workers)
        return case.shown(answer, surface)


@dataclass(frozen=True, eq=False)
class _Case:
    """Runs and model ready for the search."""

    fit: Fit
    layout: Layout
    offer: Offer
    floor_dph: float
    noise: str
    notes: tuple[str, ...]
    static: Dataset | None = None
    sisters: tuple[str, ...] = ()

    @classmethod
    def of(
        cls,
        runs: tuple[Dataset, ...],
        model: Model,
        static: Dataset | None,
        wanted: Sequence[Effect] | None,
        floor_dph: float | None,
        sisters: Sequence[Dataset] = (),
    ) -> _Case:
        notes = []
        if model.rows != "all":
            notes.append(f"the model is meant for '{model.rows}' rows; for the diagnosis it was fitted to all rows")
        if len({round(run.interval_s, 6) for run in runs}) > 1:
            raise InputError("the runs are averaged over different intervals; load them with the same one")
        fit, fitting = first_fit(replace(model, rows="all"), runs)
        notes += fitting
        plain = [despike(r) for r in fit.residuals]
        kept = [own & ~after_pauses(run) for own, run in zip(plain, runs, strict=True)]
        count, interval_s = sum(int(np.isfinite(r).sum()) for r in fit.residuals), runs[0].interval_s
        if count < LEAST_DIAGNOSED_ROWS:
            text = f"{count} means over {interval_s:g} s are too few to diagnose"
            raise InputError(f"{text}, at least {LEAST_DIAGNOSED_ROWS} are needed: record more")
        spikes = sum(int((np.isfinite(r) & ~own).sum()) for r, own in zip(fit.residuals, plain, strict=True))
        if spikes:
            notes.append(f"rows with spikes, left out: {spikes}")
        if static is None:
            notes.append(
                "without an isothermal run (--static) slow changes that no channel records look like the unit's own "
                "noise"
            )
        still, others = None if static is None else Still.of(static, runs[0].interval_s), tuple[Record, ...]()
        if sisters and still is not None:
            others, left_out = sister_records(still.record, sisters, runs[0].interval_s)
            notes += left_out
        rows = fit_rows(fit.model, runs, kept)
        layout = Layout(rows, np.array(list(fit.theta.values())), still, others)
        layout, offered = offer(layout, catalogued(fit.model, runs) if wanted is None else wanted, fit.residuals)
        notes += offered.notes
        layout, noise = levelled(layout)
        floor = floor_dph
        if floor is None or not np.isfinite(floor):
            found = noise_floor(runs, runs[0].interval_s, static, intervals=False)
            floor = found.floor_dph if floor is None else floor
            if static is not None and found.reason:
                notes.append(f"the isothermal run {static.name} does not tell the noise floor: {found.reason}")
        layout = resolved(layout, floor)
        if steps := layout.resolution.words():
            notes.append(f"{steps}: no effect smaller than that is named")
        names = tuple(sister.name for sister in sisters)
        return cls(fit, layout, offered, floor, noise, tuple(notes), static, names)

    @cached_property
    def lattice(self) -> NoiseLattice:
        """The whiteners of the runs and of the isothermal run, which all parts of the answer share."""
        return NoiseLattice(self.layout.problem.records(), self.layout.problem.interval_s)

    def diagnosis(self, check: tuple[Dataset, ...], seed: int, workers: int = 1) -> Diagnosis:
        """The answer."""
        explained = Search(self.offer, self.lattice, check, seed, workers).explain(self.layout)
        runs = self.layout.rows.records
        base = unseen(self.layout.rows, self.layout.theta, check)
        floor_dph, floor_note = self._floor(explained)
        noise = DRIFTS if explained.drifts else self.noise
        if self.static is not None and explained.word == "adequate":
            floor_dph, slow_noise = self._slow_noise(explained, base, floor_dph)
            noise = slow_noise or noise
        ranking = Ranking(explained, self.offer, check, floor_dph)
        own = sum(len(step.suspect.amplitudes) for step in explained.steps if not step.effect.moves_abscissa)
        improved = unseen(explained.layout.rows, explained.layout.theta, check, own) if explained.steps else base
        suspects = ranking.suspects()
        slow = structure(self.layout) if explained.word == "adequate" else ""
        expected_dph = self._expected(floor_dph)
        if explained.steps:  # what the steps of the values cause is no effect that is missing beside those
            expected_dph = float(np.hypot(expected_dph, self.layout.resolution.repeats_dph))
        decision = decide(explained, suspects, base, improved, expected_dph, slow)
        steps = self._steps(explained, base) if decision.word in {"unknown_effect", "undecided"} else ""
        if steps:
            decision = Decision("undecided", False)
        answer = Diagnosis(
            verdict=decision.word,
            proved=decision.proved,
            nearest=decision.nearest,
            sentence="",
            runs=tuple(run.name for run in runs),
            check=tuple(run.name for run in check),
            floor_dph=floor_dph,
            rms_dph=self.fit.rms_dph,
            held_out_rms_dph=base.rms_dph,
            held_out_by="check" if check else "blocks",
            where=self._where(explained, base, floor_dph),
            suspects=suspects,
            unexplained=self._unexplained(explained, improved, floor_dph),
            threshold=explained.threshold,
            not_excited=self._not_excited(explained),
            smallest_detectable=self._detectable(explained),
            noise_finding=self.noise if steps else noise,
            resolution=steps,
            notes=(
                *self.notes,
                *floor_note,
                *constants(base, self.fit.rms_dph, runs),
                *of_runs(runs, self.fit),
                *needless(self.fit, self.layout, check, base.left),
                *of_check(base, improved, self.fit.rms_dph, check),
                *(slow_floor(self.layout.problem, floor_dph) if decision.word == "adequate" else ()),
            ),
            model=self.fit.model,
            improved=explained.layout.rows.model,
            residuals=base.residuals,
            unexplained_residuals=improved.residuals,
            static="" if self.static is None else self.static.name,
            sisters=self.sisters,
        )
        describer = Describer(self.lattice, check, floor_dph, seed, workers)
        formulas, instead = self._formulas(explained, improved, describer, answer)
        answer = with_formulas(answer, formulas, self._expected(floor_dph), instead=instead)
        left_dph = improved.rms_dph if answer.leading is None else answer.leading.held_out_rms_dph
        notes = answer.notes if floor_note else (*answer.notes, *bound_notes(floor_dph, left_dph))
        answer = replace(answer, notes=(*notes, *of_channels(self.layout, answer), *of_answer(answer)))
        apart_dph = base.apart_dph if differ(base, self.fit.rms_dph) else np.nan
        return replace(answer, sentence=sentence(answer, explained.drifts, decision.why, apart_dph))

    def shown(self, answer: Diagnosis, channels: Sequence[str] = ()) -> Diagnosis:
        """The answer with pictures of what nothing describes: the memory, and cells over two channels."""
        described = any(formula.proof.proved for formula in answer.formulas) or answer.resolution
        if answer.verdict in {"unknown_effect", "undecided"} and not described:
            answer = replace(answer, kernel=kernel_of(self.layout, self.lattice))
            channels = channels or ("temperature", RATE_OF_TEMPERATURE)
        return replace(answer, surface=self._surface(channels)) if channels else answer

    def _surface(self, channels: Sequence[str]) -> ResidualSurface:
        problem, records = self.layout.problem, self.layout.rows.records
        noise = noise_floor(records, problem.interval_s, self.static, intervals=False).noise
        if noise is None:
            noise = profile_noise(problem.base, problem.y, problem.time_s, problem.statics, problem.interval_s).noise
        residual = self.layout.stacked(self.fit.residuals)
        return residual_surface(self.layout, residual, channels, noise)

    def _floor(self, explained: Explanation) -> tuple[float, tuple[str, ...]]:
        """The noise floor [deg/h], without what the effects found move in the isothermal run, and the note of that.

        `bench noise` and `bench compare` know of no effects: they state the floor with them.
        """
        problem, before = explained.layout.problem, self.layout.problem.statics
        if not before or problem.statics[0].X.shape == before[0].X.shape:
            return self.floor_dph, ()
        floor_dph = self._together_dph(explained.last)
        if not floor_dph < _LESS * self.floor_dph:
            return self.floor_dph, ()
        text = f"the isothermal run has a part of the effects found: its noise floor is {number(self.floor_dph)} deg/h "
        return floor_dph, (f"{text}with them and {number(floor_dph)} without, as stated here",)

    def _together_dph(self, evidence: Evidence) -> float:
        """The noise floor [deg/h] of the run and its isothermal runs together, beside a model."""
        interval_s = self.layout.problem.interval_s
        noise = Noise.of(evidence.ratios, evidence.sigma2, interval_s)
        return noise.std_of_means(interval_s, float(np.ptp(self.layout.rows.time[0])))

    def _slow_noise(self, explained: Explanation, base: Unseen, floor_dph: float) -> tuple[float, str]:
        """The noise floor [deg/h] where no effect was found and the run's noise is not unlike that of the isothermal
        run, and the finding about it.

        An isothermal run is shorter than the run and leaves its slow noise open: where the error is more than its floor
        allows, and not as much as noise never is, both runs together tell the noise.
        """
        ratio = max(base.judged_dph, base.apart_dph) / self._expected(floor_dph)
        together_dph = self._together_dph(explained.first)
        if not ADEQUATE_RATIO < ratio <= NEAREST_RATIO or together_dph <= floor_dph:
            return floor_dph, ""
        text = f"the noise floor of the isothermal run alone is {number(floor_dph)} deg/h, with the slow noise of this "
        text += f"run {number(together_dph)}, as stated here: a slow cause that no channel records looks the same"
        return together_dph, text

    def _steps(self, explained: Explanation, base: Unseen) -> str:
        """What the steps of output and thermometer cause, where that is as much as what is left; empty where it is not,
        or where effects were found.
        """
        steps, left_dph = self.layout.resolution, base.judged_dph
        return steps.words() if not explained.steps and steps.explains(left_dph, self.floor_dph) else ""

    def _expected(self, floor_dph: float) -> float:
        """The noise floor of the run [deg/h], where its white noise was found to differ from the isothermal run's."""
        if self.layout.white is None:
            return floor_dph
        still = self.layout.problem.statics[0]
        white = min(still.fast_variance(self.layout.problem.interval_s), floor_dph**2)
        return float(np.sqrt(floor_dph**2 + white * (float(np.mean(self.layout.white)) - 1.0)))

    def _formulas(
        self, explained: Explanation, improved: Unseen, describer: Describer, answer: Diagnosis
    ) -> tuple[tuple[DescribedFormula, ...], bool]:
        """What the catalogue does not hold; where its effects bring the error down to the noise, and that is known well
        enough to tell, only what explains more than they do.

        Only what is `borne_out`, and whether the best explains more than the effects.
        """
        small = improved.shape_dph <= EXPLAINED_RATIO * describer.floor_dph
        known = not bound_only(describer.floor_dph, improved.rms_dph)
        enough = explained.word == "missing_effect" and bool(answer.proved) and small and known
        if answer.resolution:  # they look like many things
            return (), False
        found = describer.better(self.layout, explained) if enough else describer.describe(self.layout, explained)
        kept = tuple(one for one in found.formulas if borne_out(one) and not self._rounded(one))
        return proved_first(kept), bool(kept) and found.replaces and kept[0] is found.formulas[0]

    def _rounded(self, one: DescribedFormula) -> bool:
        """Whether the steps of thermometer or output may cause what a formula explains."""
        return self.layout.resolution.hides(self.layout.beyond(self.layout.stacked(one.contribution)))

    def _where(self, explained: Explanation, base: Unseen, floor_dph: float) -> tuple[Place, ...]:
        seen = explained.before.places if explained.steps else explained.before.alarms
        alarms = [f for f in seen if f.name != "noise"]
        found = places(self.layout, alarms, self._stacked(base), floor_dph)
        return (*found, *steps_places(self.layout, self._stacked(base), floor_dph))

    def _unexplained(self, explained: Explanation, improved: Unseen, floor_dph: float) -> tuple[Place, ...]:
        # Of the shape that is left, the effects found take in a part, too.
        return places(explained.layout, explained.left, self._stacked(improved), floor_dph)

    def _stacked(self, scored: Unseen) -> FloatArray:
        return self.layout.stacked(scored.residuals or self.fit.residuals)

    def _not_excited(self, explained: Explanation) -> dict[str, str]:
        hidden = {s.effect: _UNMOVED for s in explained.first.suspects if not s.excited}
        shown = {s.effect for s in explained.first.suspects if s.excited}
        return dict(self.offer.refused) | {name: why for name, why in hidden.items() if name not in shown}

    def _detectable(self, explained: Explanation) -> tuple[Detectable, ...]:
        """The smallest size of each effect, of its first shape at usual parameters, that this run would have shown."""
        listed, found = [], {step.name for step in explained.steps}
        # What would have to be larger than all that the output moved is taken in by the model's curve.
        most = max(float(np.std(self.layout.problem.y)), 10.0 * float(np.sqrt(explained.first.sigma2)))
        for candidate in self.offer.candidates(self.layout):
            effect = self.offer.effects[candidate.name]
            if candidate.name != candidate.effect:
                continue
            theta = tuple(p.start for p in candidate.parameters)
            first = explained.first
            limit = smallest(self.layout.problem, candidate, theta, self.lattice, first.point, first.sigma2)
            if limit.rms_dph > most:
                if candidate.effect in found:
                    continue
                limit = Smallest(())
            names = [p.name for p in candidate.parameters]
            moved = candidate.kind == "abscissa"
            unit = candidate.parameters[0].unit if moved else self.layout.prepared(effect).physical().units[0]
            amplitude = (limit.theta[0] if limit.theta else np.inf) if moved else limit.amplitude
            at = {} if moved else dict(zip(names, limit.theta, strict=False))
            listed.append(Detectable(effect.name, limit.rms_dph, amplitude, unit, at))
        return tuple(listed)


def borne_out(one: DescribedFormula) -> bool:
    """Whether a formula is told: the fitted runs do not speak against it, and unseen data prove it; or nothing else
    does, which are unseen data that contradict it and a caution, and the fitted runs are certain of it where its fall
    on unseen data may be chance; or the fitted runs have evidence of it and that of check runs is strong, while their
    error, which their slow noise moves, falls beyond what heads no answer.
    """
    proof = one.proof
    certain = one.evidence > _CERTAIN and proof.falls_by(PROVED_FALL, 0.0)
    strong = one.evidence > 0.0 and one.borne > FORMULA_EVIDENCE and proof.fall > NAMED_FALL
    whole = (proof.falls is not False or certain) and not one.caution
    return one.evidence > -TIE and (bool(proof.proved) or whole or strong)


def proved_first(formulas: tuple[DescribedFormula, ...]) -> tuple[DescribedFormula, ...]:
    """The same, with the first that unseen data prove in front, of those that no evidence tells from the best one."""
    known = [one.evidence + one.borne for one in formulas]
    tied = (one for one, evidence in zip(formulas, known, strict=True) if evidence > known[0] - TIE)
    first = next((one for one in tied if one.proof.proved is not False), None)
    return formulas if first is None else (first, *(one for one in formulas if one is not first))
