"""The verdict in plain words."""

from __future__ import annotations

import numpy as np

from bench.analysis.diagnosis.answer import Diagnosis, Place, SuspectedEffect
from bench.analysis.diagnosis.decision import ON_UNSEEN
from bench.analysis.diagnosis.described import sentence as formula_sentence
from bench.analysis.thresholds import ADEQUATE_RATIO, NAMED_FALL, NEAREST_RATIO
from bench.base import capital, ends, listed, number

_LACKS = "The model lacks something that no effect of the catalogue explains"
UNSEEN = "not to be seen here: the model takes it in"
"""Of an effect that the run would not show at any size."""


def sentence(answer: Diagnosis, drifts: bool, why: str = "", apart_dph: float = np.nan) -> str:
    """What an engineer reads first; `why` says why the verdict is not decided.

    `apart_dph` is the residual beside a constant of each fitted run, NaN where these hardly differ.
    """
    formulas = [formula_sentence(answer.formulas[0])] if answer.formulas else []
    if answer.verdict != "unknown_effect":
        return " ".join([_verdict(answer, why, apart_dph), *formulas, *_left(answer)])
    lacks, near = _unknown(answer, drifts)
    if formulas and not answer.formulas[0].beside:
        # What describes it comes before what does not, and what does not even lower the error is of no use.
        near = near if any(suspect.proof.falls for suspect in answer.found) else []
        return " ".join([lacks, *formulas, *_left(answer), *near])
    return " ".join([lacks, *near, *formulas, *_left(answer)])


def _left(answer: Diagnosis) -> list[str]:
    """That what is proved leaves more than the noise on unseen data: there may be something else beside it."""
    if not answer.floor_ratio > ADEQUATE_RATIO:
        return []
    return [f"{capital(ON_UNSEEN)} still {number(answer.floor_ratio, 2)} x the noise floor: add it and diagnose again."]


def _verdict(answer: Diagnosis, why: str, apart_dph: float) -> str:
    left = f"{number(answer.rms_dph)} deg/h RMS"
    if np.isfinite(apart_dph):
        left = f"{number(apart_dph)} deg/h RMS beside a constant of each run"
    if answer.verdict == "adequate":
        noise = f" {capital(answer.noise_finding)}." if answer.noise_finding else ""
        return (
            f"These data show no missing effect: the residual ({left}, noise floor {number(answer.floor_dph)}) is "
            f"noise.{noise}{_slow(answer)}"
        )
    if answer.verdict == "missing_effect":
        return _missing(answer)
    return _suspected(answer) if answer.found else _undecided(answer, why, left)


def ranking_reason(answer: Diagnosis) -> str:
    """Why a suspect with more evidence stands below one with less, or one with little was found; else empty."""
    weak = [suspect.effect for suspect in answer.found if suspect.evidence <= answer.threshold]
    if weak and answer.check:
        return f"the evidence of {listed(weak)} is that of the fitted run; with the check run's it is enough"
    least = min((suspect.evidence for suspect in answer.found), default=np.inf)
    others = [s.effect for s in answer.suspects if not s.found and s.evidence > least]
    if not others:
        return ""
    strongest, weakest = answer.found[0].effect, min(answer.found, key=lambda suspect: suspect.evidence).effect
    if len(answer.found) == 1:
        return ""
    return (
        f"the evidence of {weakest} is what it adds beside {strongest}; that of {listed(others)} is without "
        f"{strongest}, which explains most of the same"
    )


def made_from(answer: Diagnosis) -> str:
    """The runs that a diagnosis was made from: together with other runs the answer may differ."""
    static = f"the isothermal run {answer.static}" if answer.static else "no isothermal run"
    proof = f"checked on {listed(answer.check)}" if answer.check else "checked on blocks left out"
    return f"made from {listed(answer.runs)} with {static}, {proof}"


def _missing(answer: Diagnosis) -> str:
    named = answer.named
    doubtful = [suspect for suspect in answer.found if suspect not in named]
    parts = [f"Missing: {listed([_named(suspect) for suspect in named])}."]
    for suspect in named:
        parts += [_proof(suspect), *_alike(suspect)]
    for suspect in doubtful:
        parts += [f"Suspected, not proved: {_named(suspect)}; {suspect.proof.words}.", *_alike(suspect)]
    return " ".join([*parts, *_further(answer)])


def _suspected(answer: Diagnosis) -> str:
    """Effects that the evidence names and unseen data do not prove; where these do not change, no name comes first."""
    names = listed([_named(suspect) for suspect in answer.found])
    parts = [f"Suspected, not proved: {names}."]
    if answer.contradicted:
        parts = [
            f"The check run contradicts this run, which shows {names}: something changed between the two, or a cause "
            "that no channel records looks like it here."
        ]
    elif all(suspect.proof.fall <= NAMED_FALL for suspect in answer.found):
        parts = [f"A slow cause or the noise: this run cannot tell. It looks like {names}."]
    for suspect in answer.found:
        words = f"adding it was not possible: {suspect.reason}" if suspect.reason else suspect.proof.words
        parts += [f"{suspect.effect}: {words}.", *_alike(suspect)]
    if not answer.check:
        parts.append("Record another run and give it as --check before adding anything.")
    return " ".join([*parts, *_further(answer)])


def _alike(suspect: SuspectedEffect) -> list[str]:
    alike = suspect.look_alikes
    return [f"These data cannot tell {suspect.effect} from {' or '.join(alike)}."] if alike else []


def _further(answer: Diagnosis) -> list[str]:
    several = "Where several effects are missing, about nine of ten diagnoses name all of them: prove each one."
    rest = [f"A small misfit remains {_where(place)}." for place in answer.unexplained[:1]]
    return [*([several] if len(answer.found) > 1 else []), *rest]


def _proof(suspect: SuspectedEffect) -> str:
    """How the error falls on data that the fit did not see."""
    proof = suspect.proof
    share = f", {100 * suspect.removes:.0f} % of the excess variance" if np.isfinite(suspect.removes) else ""
    return (
        f"Adding {suspect.effect} lowers the error on {proof.unseen} from {number(proof.before_dph)} to "
        f"{number(proof.after_dph)} deg/h{share}."
    )


def _undecided(answer: Diagnosis, why: str, left: str) -> str:
    """What remains may be a slow cause, or the noise; or the run is at its noise, and check runs are not; or it is what
    the steps of the recorded values cause.
    """
    if answer.check and answer.rms_dph <= ADEQUATE_RATIO * answer.floor_dph and why.startswith(ON_UNSEEN):
        return (
            f"The check run shows what this run does not: the residual of this run ({left}, noise floor "
            f"{number(answer.floor_dph)}) is noise, and {why}. Diagnose both together: name the check run beside the "
            "run, not as --check."
        )
    if answer.resolution:
        return (
            f"What is left ({left}, noise floor {number(answer.floor_dph)}) is as large as what steps cause: "
            f"{answer.resolution}. Record it with finer steps: no other run shows what they hide."
        )
    ask = "record an isothermal run and give it as --static" if not answer.static else "record the run that is proposed"
    return (
        f"A slow cause or the noise: this run cannot tell. The residual ({left}, noise floor "
        f"{number(answer.floor_dph)}) fits no effect of the catalogue, and {why}: {ask}."
    )


def _slow(answer: Diagnosis) -> str:
    """What an adequate verdict cannot say without an isothermal run."""
    if answer.static:
        return ""
    return " A slow cause that no channel records cannot be told from the noise without an isothermal run (--static)."


def _unknown(answer: Diagnosis, drifts: bool) -> tuple[str, list[str]]:
    """That the model lacks something, and what of the catalogue comes near to it."""
    rest = answer.unexplained
    if drifts and not rest and answer.noise_finding:
        known = f"Beside {listed([_named(suspect) for suspect in answer.found])} the" if answer.found else "The"
        proofs = [
            _proof(suspect) if suspect.proof.falls else f"{suspect.effect}: {suspect.proof.words}."
            for suspect in answer.found
            if suspect.scored
        ]
        return f"{known} model lacks something that the catalogue does not explain: {answer.noise_finding}.", proofs
    if answer.nearest:
        return f"{_LACKS}.", [_nearest(answer)]
    place = f": a misfit {_where(rest[0])}" if rest else ""
    near = []
    if answer.found:
        near = [f"{_named(answer.found[0])} explains a part of it."]
    elif answer.suspects and not answer.formulas:
        near = [f"The nearest effect of the catalogue is {answer.suspects[0].effect}, no better than chance."]
    return f"{_LACKS}{place}.", near


def _nearest(answer: Diagnosis) -> str:
    """The catalogue's best entry leaves much more than the noise on unseen data."""
    first = next(suspect for suspect in answer.found if suspect.effect == answer.nearest)
    name, proof = _named(first), first.proof
    if proof.falls is None:
        return f"The nearest entry of the catalogue is {name}: no unseen data can judge it: {proof.unjudged}."
    scale, much = 1.0, "deg/h"
    if proof.after_dph > NEAREST_RATIO * answer.floor_dph:
        scale, much = answer.floor_dph, "x the noise floor"
    before, after = number(proof.before_dph / scale, 2), number(proof.after_dph / scale, 2)
    return (
        f"The nearest entry of the catalogue is {name}: with it the error on {proof.unseen} changes from "
        f"{before} to {after} {much}, so it behaves like that and is something else, or not all."
    )


def _named(suspect: SuspectedEffect) -> str:
    chosen = [f"{name}: {value}" for name, value in suspect.options.items() if isinstance(value, str)]
    values = [*chosen, *(f"{name} {value.words}" for name, value in suspect.parameters.items())]
    return f"{suspect.effect} ({', '.join(values)})" if values else suspect.effect


def _where(place: Place) -> str:
    note = f", {place.note}" if place.note else ""
    low, high = ends(place.low, place.high)
    size = f"{number(place.misfit_dph)} deg/h, p {place.p:.1g}{note}"
    return f"over {place.channel} from {low} to {high} {place.unit} ({size})"
