"""Improve a model unattended: diagnose, add the missing effect or formula, prove it on unseen data, until none pays."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import inf, isfinite
from typing import Any, Literal

from bench.analysis.diagnosis.answer import Diagnosis, SuspectedEffect
from bench.analysis.diagnosis.compare import checked
from bench.analysis.diagnosis.described import DescribedFormula
from bench.analysis.diagnosis.diagnose import diagnose
from bench.analysis.effects import registry as effects
from bench.analysis.effects.base import Effect
from bench.analysis.effects.model import Model, effect_from
from bench.analysis.fit.fitting import fit_model
from bench.analysis.fit.own_jumps import with_own_jump
from bench.analysis.fit.solve import one_blas_thread
from bench.analysis.thresholds import PAYS
from bench.base import InputError, finite
from bench.record import Dataset

MOST_STEPS = 6

Action = Literal["added", "refused", "stopped"]


@dataclass(frozen=True, eq=False)
class Decision:
    """One decision: an effect added or refused, or the end of the walk; errors on unseen data [deg/h], of a step as a
    proof compares them: without a constant of each check run.
    """

    action: Action
    effect: str
    model: Model
    """The model after the step."""
    before_dph: float
    after_dph: float
    sentence: str
    diagnosis: Diagnosis
    """Of the model before the step."""
    formula: str = ""
    """The formula, where the effect is an expression."""

    def to_json(self) -> dict[str, Any]:
        """An entry of `steps`."""
        return {
            "action": self.action,
            "effect": self.effect or None,
            "formula": self.formula or None,
            "model": self.model.name,
            "before_dph": finite(self.before_dph),
            "after_dph": finite(self.after_dph),
            "sentence": self.sentence,
            "verdict": self.diagnosis.verdict,
        }


@dataclass(frozen=True, eq=False)
class Improvement:
    """All steps of a walk; the last one says why it ended."""

    steps: tuple[Decision, ...]

    @property
    def model(self) -> Model:
        """The model that the walk ended with."""
        return self.steps[-1].model

    @property
    def diagnosis(self) -> Diagnosis:
        """Diagnosis of that model."""
        return self.steps[-1].diagnosis

    def to_json(self) -> dict[str, Any]:
        """The object of `bench improve --json`."""
        return {
            "steps": [step.to_json() for step in self.steps],
            "model": self.model.name,
            "effects": [effect.name for effect in self.model.effects],
            **{key: value for key, value in self.diagnosis.to_json().items() if key not in {"model"}},
        }


def add_effect(model: Model, what: str, options: Mapping[str, Any] | None = None) -> Model:
    """The model with one more effect, as `bench add` writes it: a name, a formula, or a line of YAML.

    Raises InputError: an unknown effect or option, or an effect that the model has already.
    """
    more = effects.make(what, options) if options else effect_from(what)
    if any(effect == more if more.name == "expression" else effect.name == more.name for effect in model.effects):
        raise InputError(f"model '{model.name}' has '{what}' already")
    return model.adding(more)


def improve(  # noqa: PLR0913 - options of one command, by keyword
    runs: Sequence[Dataset],
    check: Sequence[Dataset],
    model: Model,
    *,
    static: Dataset | None = None,
    candidates: Sequence[Effect] | None = None,
    floor_dph: float | None = None,
    formulas: bool = True,
) -> Improvement:
    """Walk from a model to one that lacks nothing that these runs can show, one effect at a time.

    An effect is added if the evidence names it and the error falls on the check runs (without, on blocks left out);
    one that does not pay is refused, and what the data cannot tell from it is tried in its place. Where no effect of
    the catalogue explains the error, the best formula is tried in the same way, unless `formulas` is False. What is
    added lowers the error on check runs also where the model is fitted anew with it, as every command will.
    """
    steps: list[Decision] = []
    kept = partial(_fitted_anew, runs, tuple(with_own_jump(run, runs) for run in check))
    while True:
        lacking = None if candidates is None else [c for c in candidates if c.name not in _names(model)]
        answer = diagnose(runs, model, check=check, static=static, candidates=lacking, floor_dph=floor_dph)
        model = answer.model
        tried = _tried(answer, formulas, kept) if len(steps) < MOST_STEPS else []
        steps += tried
        if not tried or tried[-1].action != "added":
            return Improvement((*steps, _end(answer, bool(tried))))
        model = tried[-1].model


def _names(model: Model) -> set[str]:
    return {effect.name for effect in model.effects}


def _walks(answer: Diagnosis) -> bool:
    """Whether something was found to try; of an unknown misfit, what unseen data prove or what is nearest to it."""
    known = answer.verdict != "unknown_effect" or bool(answer.nearest)
    return bool(answer.found) if known else any(suspect.proof.proved for suspect in answer.found)


def _tried(answer: Diagnosis, formulas: bool, kept: Callable[[Decision], Decision]) -> list[Decision]:
    """The strongest effect found, or the first of its look-alikes that pays, or the best formula where the catalogue
    does not explain the error; every refusal is a step. Where another effect does much better on unseen data, or
    nothing determines the strongest, the one that leaves least there comes first.
    """
    if formulas and answer.formulas and answer.verdict == "unknown_effect":
        return [kept(_with_formula(answer, answer.formulas[0]))]
    if not _walks(answer):
        return []
    strongest = next((suspect for suspect in answer.found if suspect.proof.proved), answer.found[0])
    wanted = [strongest, *(s for s in answer.suspects if s.effect in strongest.look_alikes)]
    if strongest.proof.doubt:
        wanted.sort(key=lambda s: _compared(s)[1] if s.scored else inf)
    steps: list[Decision] = []
    for suspect in wanted:
        steps.append(kept(_step(answer, suspect)))
        if steps[-1].action == "added":
            break
    return steps


def _fitted_anew(runs: Sequence[Dataset], check: Sequence[Dataset], step: Decision) -> Decision:
    """The step, refused where the model that is fitted anew with it does not leave less on the check runs: parameters
    that the runs hardly determine may move away from where the diagnosis found them.
    """
    if step.action != "added" or not check:
        return step
    with one_blas_thread():
        before, after = (
            checked(fit_model(model, runs), tuple(check)).shape_dph for model in (step.diagnosis.model, step.model)
        )
    if not after >= before * (1.0 - PAYS):
        return step
    text = f"{step.formula or step.effect} refused: fitted anew with it, the model leaves {after:.4f} deg/h on unseen "
    text += f"data, where the diagnosis finds {step.after_dph:.4f}, and {before:.4f} without it"
    return replace(
        step, action="refused", model=step.diagnosis.model, before_dph=before, after_dph=after, sentence=text
    )


def _compared(one: SuspectedEffect | DescribedFormula) -> tuple[float, float]:
    """Error on unseen data without it and with it [deg/h]; a turn-on bias of a check run speaks neither for it nor
    against it.
    """
    if one.proof.by == "check":
        return one.proof.before_dph, one.proof.after_dph
    return one.held_out_before_dph, one.held_out_rms_dph


def _with_formula(answer: Diagnosis, formula: DescribedFormula) -> Decision:
    """The formula, with the effects that it was found beside; without check runs it has to be proved."""
    before, after = _compared(formula)
    proved = bool(answer.check or formula.proof.proved)
    pays = proved and after < before * (1.0 - PAYS)
    beside = f" beside {', '.join(formula.beside)}" if formula.beside else ""
    text = f"formula {formula.formula}{beside} {'added' if pays else 'refused'}: {formula.weighed}, "
    text += _fall(answer, before, after) if proved else formula.proof.words
    model = formula.model if pays else answer.model
    return Decision("added" if pays else "refused", "expression", model, before, after, text, answer, formula.formula)


def _fall(answer: Diagnosis, before: float, after: float) -> str:
    floor = f" (noise floor {answer.floor_dph:.4f})" if isfinite(answer.floor_dph) else ""
    return f"the error on unseen data changes from {before:.4f} to {after:.4f} deg/h{floor}"


def _step(answer: Diagnosis, suspect: SuspectedEffect) -> Decision:
    before, after = _compared(suspect)
    pays = after < before * (1.0 - PAYS)
    fall = _fall(answer, before, after)
    if suspect.reason:
        text = f"{suspect.effect} refused: {suspect.reason}"
    elif not suspect.scored:
        text = (
            f"{suspect.effect} refused: no unseen data is left to prove it; record a second run and give it as --check"
        )
    elif pays:
        text = f"{suspect.effect} added: evidence {suspect.evidence:.0f}, {fall}"
    else:
        text = f"{suspect.effect} refused: it does not lower the error enough ({fall}), "
        text += f"although its evidence is {suspect.evidence:.0f}"
    effect = suspect.model.effects[-1]
    model = answer.model.adding(effect) if pays else answer.model
    return Decision("added" if pays else "refused", suspect.effect, model, before, after, text, answer)


def _end(answer: Diagnosis, refused: bool) -> Decision:
    """Why the walk ends here."""
    if _walks(answer):
        text = (
            "No further effect lowers the error on unseen data."
            if refused
            else f"The limit of {MOST_STEPS} steps is reached."
        )
        text = f"{text} {answer.sentence}"
    else:
        text = answer.sentence
    held_out = answer.held_out_rms_dph
    return Decision("stopped", "", answer.model, held_out, held_out, text, answer)
