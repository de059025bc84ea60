"""The verdict in plain words: is the data complete, how far is the best model above the noise, what does it lack?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from bench.analysis.diagnosis.decision import bound_only
from bench.analysis.diagnosis.scores import Score
from bench.analysis.judging.completeness import Completeness
from bench.analysis.judging.diagnosed import Diagnosed
from bench.analysis.thresholds import ADEQUATE_RATIO
from bench.base import clock, listed, number

Word = Literal[
    "adequate", "missing_effect", "unknown_effect", "undecided", "model_error", "measured", "unproven", "partial",
    "no_data",
]  # fmt: skip
"""Words of the diagnosis; `model_error` without a diagnosis; `measured` where another command fits a model to the run;
the others where nothing is proven."""

_HEADLINES: dict[Word, str] = {
    "adequate": "Adequate",
    "missing_effect": "An effect is missing",
    "unknown_effect": "An unknown effect is missing",
    "undecided": "Not decided",
    "model_error": "The model leaves an error",
    "measured": "Measured",
    "unproven": "Not proven",
    "partial": "Partial run",
    "no_data": "No data",
}
_TONES: dict[Word, str] = {
    "adequate": "good",
    "missing_effect": "warn",
    "unknown_effect": "warn",
    "undecided": "warn",
    "model_error": "warn",
    "measured": "good",
    "unproven": "warn",
    "partial": "bad",
    "no_data": "bad",
}


@dataclass(frozen=True)
class RunVerdict:
    """`word` for programs; `headline`, `sentence` and `tone` (good, warn, bad) for people."""

    word: Word
    sentence: str
    missing: tuple[str, ...] = ()
    """Effects that the diagnosis names, each with those that the data cannot tell from it."""

    @property
    def headline(self) -> str:
        """A few words."""
        if self.word == "missing_effect" and self.missing:
            return f"Missing: {listed(self.missing)}"
        return _HEADLINES[self.word]

    @property
    def tone(self) -> str:
        """Colour of the verdict."""
        return _TONES[self.word]


def judge(done: Completeness, best: Score | None, floor_dph: float, reason: str, elsewhere: bool = False) -> RunVerdict:
    """Verdict of a run; `reason` says why it has no model, `elsewhere` that another command fits one."""
    if done.samples == 0:
        return RunVerdict("no_data", f"{_state(done)}: {reason or 'nothing was captured'}.")
    if elsewhere and done.ended:
        return RunVerdict("measured", f"{_state(done)}, {_losses(done)}; {reason}.")
    if best is None:
        word: Word = "unproven" if done.ended else "partial"
        return RunVerdict(word, f"{_state(done)}, {_losses(done)}; no model could be fitted: {reason}.")
    model, word = _model(best, floor_dph)
    return RunVerdict(word if done.ended else "partial", f"{_state(done)}, {_losses(done)}; {model}.")


def with_diagnosis(verdict: RunVerdict, diagnosed: Diagnosed, floor_dph: float) -> RunVerdict:
    """The verdict of a run with the diagnosis' own word, where the run allows one.

    A run that is not whole stays partial; "adequate" needs a proof on unseen data and a floor to compare it with.
    """
    answer = diagnosed.answer
    if answer is None:
        return verdict
    missing = tuple(" or ".join((one.effect, *_others(one.look_alikes))) for one in answer.named)
    name = answer.model.name
    steps = [rung.held_out_dph for rung in diagnosed.rungs if not rung.rival]
    if answer.verdict == "adequate":
        finding = f"{name} lacks no effect that this run could show"
    elif answer.verdict == "unknown_effect":
        finding = f"{name} lacks something that no effect of the catalogue explains"
    elif answer.verdict == "undecided":
        finding = _undecided(name, tuple(suspect.effect for suspect in answer.found), steps)
        if answer.resolution:
            finding = f"{name} leaves as much as what steps cause: {answer.resolution}"
    else:
        finding = f"{name} lacks {listed(missing)}"
        if len(missing) == 1:  # of several, each is proved beside the others
            proof = answer.named[0].proof
            change = f"from {number(proof.before_dph)} to {number(proof.after_dph)} deg/h"
            finding += f"; adding it lowers the error on {proof.unseen} {change}"
    no_floor = verdict.word in {"unproven", "undecided"} and answer.verdict in {"adequate", "undecided"}
    kept = verdict.word in {"partial", "no_data"} or no_floor
    sentence = f"{verdict.sentence.removesuffix('.')}; {finding}."
    return replace(verdict, word=verdict.word if kept else answer.verdict, sentence=sentence, missing=missing)


def _others(look_alikes: Sequence[str]) -> list[str]:
    """Look-alikes in a few words: the text of a formula is long, and the diagnosis has it."""
    return list(dict.fromkeys(name if name.isidentifier() else "a formula" for name in look_alikes))


def _undecided(name: str, suspected: tuple[str, ...], steps: list[float]) -> str:
    """A suspicion that unseen data do not bear out, or a slow cause that looks like the noise."""
    if not suspected:
        return f"{name} leaves a slow cause or the noise: this run cannot tell"
    if not np.all(np.isfinite(steps)):
        return f"{name} may lack {listed(suspected)}, which no unseen data could judge"
    change = f": the error there goes from {number(steps[0])} to {number(steps[-1])} deg/h" if len(steps) > 1 else ""
    return f"{name} may lack {listed(suspected)}, which unseen data do not bear out{change}"


def _model(best: Score, floor_dph: float) -> tuple[str, Word]:
    name, rms = best.model.name, best.held_out.rms_dph
    if not np.isfinite(rms):
        why = best.held_out.reason or "there is too little of it"
        return (
            f"{name} leaves {number(best.rms_dph)} deg/h on the data it was fitted to, no error on unseen data: {why}",
            "unproven",
        )
    if not np.isfinite(floor_dph):
        text = f"{name} leaves {number(rms)} deg/h on unseen data; the noise floor is not known"
        return text, "undecided"
    if bound_only(floor_dph, rms):
        return f"{name} leaves {number(rms)} deg/h on unseen data; the noise floor is an upper bound here", "adequate"
    ratio = rms / floor_dph
    text = f"{name} leaves {number(ratio, 2)} × the noise floor on unseen data"
    if spikes := best.held_out.spikes:
        ratio = best.held_out.plain_dph / floor_dph
        text += f" ({number(ratio, 2)} × without rows with spikes: {spikes})"
    return text, "adequate" if ratio <= ADEQUATE_RATIO else "model_error"


def _state(done: Completeness) -> str:
    if done.ended and "imported" in {done.state, done.cause}:
        return "Imported"
    if done.state == "done":
        failed = len(done.failed)
        whole = "Complete" if done.whole else "At its end"
        return whole if not failed else f"{failed} of {len(done.segments)} segments failed"
    when = f" after {clock(done.duration_s)}" if done.duration_s else ""
    if done.cause.startswith(done.state):
        return f"{done.cause[0].upper()}{done.cause[1:]}{when}"
    return f"{done.state.capitalize()}{when}{f' ({done.cause})' if done.cause else ''}"


def _losses(done: Completeness) -> str:
    if done.lost is None:
        return "frame losses not counted"
    frames = replace(done, losses={**done.losses, "invalid": 0}).lost
    text = f"{frames} frames lost or damaged" if frames else "no frame lost"
    return text if not done.left_out_share else f"{text}, {done.left_out_share:.2%} of the data left out as not valid"
