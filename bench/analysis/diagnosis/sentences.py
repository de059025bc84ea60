"""The verdict in plain words."""

from __future__ import annotations

import numpy as np

from bench.analysis.diagnosis.answer import Diagnosis, Place, SuspectedEffect, Value
from bench.analysis.diagnosis.described import sentence as formula_sentence
from bench.base import listed, number, with_uncertainty

UNSEEN = "not to be seen here: the model takes it in"
"""Of an effect that the run would not show at any size."""


def sentence(answer: Diagnosis, drifts: bool) -> str:
    """What an engineer reads first."""
    formulas = [formula_sentence(answer.formulas[0], answer.held_out_by)] if answer.formulas else []
    return " ".join([_verdict(answer, drifts), *formulas])


def _verdict(answer: Diagnosis, drifts: bool) -> str:
    if answer.verdict == "adequate":
        noise = f" {_capital(answer.noise_finding)}." if answer.noise_finding else ""
        return f"This data shows no missing effect: the residual {_remains(answer)}.{noise}"
    if answer.verdict == "missing_effect":
        return _missing(answer)
    return _unknown(answer, drifts)


def made_from(answer: Diagnosis) -> str:
    """The runs that a diagnosis was made from: together with other runs the answer may differ."""
    static = f"the isothermal run {answer.static}" if answer.static else "no isothermal run"
    proof = f"checked on {listed(answer.check)}" if answer.check else "checked on blocks left out"
    return f"made from {listed(answer.runs)} with {static}, {proof}"


def _missing(answer: Diagnosis) -> str:
    missing = answer.found
    parts = [f"Missing: {listed([_named(suspect) for suspect in missing])}."]
    bare = [suspect.effect for suspect in missing if not suspect.reason and not suspect.scored]
    for suspect in missing:
        parts += [] if suspect.effect in bare else [_proof(suspect, answer)]
        if suspect.look_alikes:
            parts.append(f"This data cannot tell {suspect.effect} from {' or '.join(suspect.look_alikes)}.")
    if bare:
        parts.append(f"No unseen data is left to prove {listed(bare)}: record a second run and give it as --check.")
    if len(missing) > 1:
        parts.append(
            "Where several effects are missing, about four of five diagnoses name all of them: prove each one."
        )
    if answer.unexplained:
        parts.append(f"A small misfit remains {_where(answer.unexplained[0])}.")
    return " ".join(parts)


def _proof(suspect: SuspectedEffect, answer: Diagnosis) -> str:
    """How the error changes on data that the fit did not see."""
    before, after = suspect.held_out_before_dph, suspect.held_out_rms_dph
    if suspect.reason:
        return f"Adding {suspect.effect} was not possible: {suspect.reason}."
    unseen = "the check run" if answer.held_out_by == "check" else "blocks left out"
    if after >= before:
        return (
            f"This is not proved: with {suspect.effect} the error on {unseen} changes from {number(before)} to "
            f"{number(after)} deg/h; record another run before adding it."
        )
    share = f", {100 * suspect.removes:.0f} % of the excess variance" if np.isfinite(suspect.removes) else ""
    return (
        f"Adding {suspect.effect} lowers the error on {unseen} from {number(before)} to {number(after)} deg/h{share}."
    )


def _unknown(answer: Diagnosis, drifts: bool) -> str:
    rest = answer.unexplained
    if drifts and not rest:
        return f"The model lacks something that the catalogue does not explain: {answer.noise_finding}."
    text = f"The model lacks something that no effect of the catalogue explains: a misfit {_where(rest[0])}."
    if answer.found:
        text += f" {answer.found[0].effect} explains a part of it."
    elif answer.suspects:
        text += f" The nearest effect of the catalogue is {answer.suspects[0].effect}, no better than chance."
    return text


def _named(suspect: SuspectedEffect) -> str:
    values = [_measured(name, value) for name, value in suspect.parameters.items()]
    return f"{suspect.effect} ({', '.join(values)})" if values else suspect.effect


def _measured(name: str, value: Value) -> str:
    size, deviation = with_uncertainty(value.value, value.std)
    if value.at_bound:
        return f"{name} {number(value.value)} {value.unit} on its bound: not determined"
    return f"{name} {size} +- {deviation} {value.unit}"


def _where(place: Place) -> str:
    note = f", {place.note}" if place.note else ""
    return (
        f"over {place.channel} from {place.low:.4g} to {place.high:.4g} {place.unit} ({number(place.misfit_dph)} "
        f"deg/h, p {place.p:.1g}{note})"
    )


def _remains(answer: Diagnosis) -> str:
    rms = f"({number(answer.rms_dph)} deg/h RMS"
    if np.isfinite(answer.floor_dph):
        return f"{rms}, noise floor {number(answer.floor_dph)}) is noise"
    return (
        f"{rms}) looks like noise, but no soak shows how large the unit's own noise is: record an isothermal run and "
        "give it as --static"
    )


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
