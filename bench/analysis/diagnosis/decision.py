"""The word of a verdict: what the probes and the evidence say, as far as unseen data bear it out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import isfinite, isnan

import numpy as np

from bench.analysis.diagnosis.answer import Diagnosis, SuspectedEffect, VerdictWord
from bench.analysis.diagnosis.described import DescribedFormula
from bench.analysis.diagnosis.held_out import Unseen
from bench.analysis.diagnosis.verdict import Explanation
from bench.analysis.thresholds import (
    ADEQUATE_RATIO,
    EXPLAINED_RATIO,
    NEAREST_RATIO,
    PREFERRED_DEVIATIONS,
    PREFERRED_FALL,
)
from bench.base import FloatArray, number

ON_UNSEEN = "the error on unseen data is"
"""Begins the reason that unseen data show more than the noise."""
DRIFTS = "the run drifts more than the isothermal run, for a reason that no channel records"


@dataclass(frozen=True)
class Decision:
    """Word of the verdict, whether unseen data bear it out, and why it is not decided (empty where it is)."""

    word: VerdictWord
    proved: bool | None
    why: str = ""
    nearest: str = ""
    """Effect that lowers the error and leaves much more than the noise: like the cause, and not the cause."""


def decide(
    explained: Explanation,
    suspects: Sequence[SuspectedEffect],
    base: Unseen,
    improved: Unseen,
    floor_dph: float,
    slow: str,
) -> Decision:
    """The verdict; `slow` says what the residual shows at noise that is not free to swallow it, empty for nothing."""
    found = [suspect for suspect in suspects if suspect.found]
    proofs = [suspect.proved for suspect in found]
    some = None if not any(proved is not None for proved in proofs) else any(proofs)
    ratio = base.judged_dph / floor_dph
    # What stands out in the run and does not matter on unseen data leaves the effects what is missing.
    whole = improved.left.rms_dph <= EXPLAINED_RATIO * floor_dph
    if explained.word == "unknown_effect" and (explained.drifts or not (some and whole)):
        if explained.drifts and not (explained.left or found) and ratio <= ADEQUATE_RATIO:
            return Decision("undecided", None, DRIFTS)
        return Decision("unknown_effect", False if found and some is not None else None)
    if not found:
        return _nothing(ratio, base.apart_dph / floor_dph, slow or _borne_elsewhere(suspects), isnan(floor_dph))
    if some:
        if _leaves_more(improved.left.rms_dph, floor_dph, improved.residuals):
            nearest = next(suspect.effect for suspect in found if suspect.proved)
            return Decision("unknown_effect", False, nearest=nearest)
        return Decision("missing_effect", True)
    return Decision("undecided", some)


def _borne_elsewhere(suspects: Sequence[SuspectedEffect]) -> str:
    """That the check run's error falls by much with an effect of which the run itself shows nothing."""
    for one in suspects:
        if one.proof.by == "check" and one.proof.falls_by(PREFERRED_FALL, PREFERRED_DEVIATIONS):
            change = f"from {number(one.proof.before_dph)} to {number(one.proof.after_dph)} deg/h"
            return f"{one.effect}, which this run does not show, lowers the error on the check run {change}"
    return ""


def _nothing(ratio: float, apart: float, slow: str, no_floor: bool) -> Decision:
    """The verdict where nothing was found, by the error on unseen data and the residual beside constants, over the
    floor.
    """
    if ratio > ADEQUATE_RATIO:
        slow = slow or f"{ON_UNSEEN} {ratio:.2g} x the noise floor"
    elif apart > ADEQUATE_RATIO:
        slow = slow or f"the residual is {apart:.2g} x the noise floor"
    if not isfinite(ratio):
        slow = slow or ("no soak shows how large the noise is" if no_floor else "no error on unseen data is known")
    if slow:
        return Decision("undecided", False if isfinite(ratio) else None, slow)
    return Decision("adequate", True)


def _leaves_more(left_dph: float, floor_dph: float, residuals: Sequence[FloatArray]) -> bool:
    """Whether an explanation leaves so much on unseen data that it is not the cause, or not all of it.

    The yardstick is the floor or, where that is less or no floor is known, what is left in the fitted rows: a floor
    that is read from short soaks may be far too high, and these rows have their noise.
    """
    fitted_dph = float(np.sqrt(np.nanmean(np.concatenate(residuals) ** 2))) if residuals else np.nan
    return left_dph > NEAREST_RATIO * float(np.fmin(floor_dph, fitted_dph))


def with_formulas(
    answer: Diagnosis, formulas: tuple[DescribedFormula, ...], floor_dph: float, *, instead: bool
) -> Diagnosis:
    """The answer with the formulas that were found: beside one effect, or as what is missing, if need be in the place
    (`instead`) of the effects found.
    """
    answer = replace(answer, formulas=formulas)
    if not formulas:
        return answer
    if answer.tied and len(answer.found) == 1:
        first, *others = answer.suspects
        first = replace(first, look_alikes=(*first.look_alikes, formulas[0].formula))
        return replace(answer, suspects=(first, *others))
    if instead or answer.verdict in {"adequate", "undecided"}:
        beside = formulas[0].beside
        near = [suspect for suspect in answer.found if suspect.proved] or [
            suspect for suspect in answer.found if suspect.proof.falls is not False
        ]
        nearest = answer.nearest or (near[0].effect if near and not beside else "")
        if beside and nearest not in beside:
            nearest = ""
        stay = set(beside) or {one.effect for one in answer.found if one.proof.falls is not False} | {nearest}
        kept = tuple(replace(one, found=one.found and one.effect in stay) for one in answer.suspects)
        # What the effects left that a formula takes the place of beside others is not left any more.
        unexplained = () if instead and beside else answer.unexplained
        answer = replace(answer, verdict="unknown_effect", nearest=nearest, suspects=kept, unexplained=unexplained)
    if answer.verdict == "unknown_effect":
        answer = replace(answer, proved=explains(formulas[0], floor_dph))
    if answer.leading and answer.leading.proof.proved and answer.noise_finding == DRIFTS:
        answer = replace(answer, noise_finding="")  # measured without the formula
    return answer


def explains(formula: DescribedFormula, floor_dph: float) -> bool | None:
    """Whether unseen data bear a formula out as what is missing; None where none could judge it."""
    proof = formula.proof
    return proof.proved and not _leaves_more(proof.after_dph, floor_dph, formula.residuals)


def bound_only(floor_dph: float, left_dph: float) -> bool:
    """Whether the error on unseen data [deg/h] lies well below the noise floor, which is then an upper bound only."""
    return floor_dph > EXPLAINED_RATIO * left_dph
