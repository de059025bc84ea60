"""One case of the campaign: record, diagnose, and run the peers."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from importlib.util import find_spec
from typing import Any

import numpy as np

from bench.analysis.diagnosis.answer import Diagnosis
from bench.analysis.diagnosis.diagnose import diagnose
from bench.analysis.diagnosis.experiment import next_experiment
from bench.analysis.effects import registry as effects
from bench.analysis.effects.model import Model
from bench.analysis.fit.fitting import fit_model
from bench.mystery.hidden import HIDDEN
from bench.record.dataset import Dataset
from benchmarks import cases, peers

MODEL = Model("spline", (effects.make("spline", {"intervals": 8}),))
_CHECKED = 1.0
"""Least strength at which the models are tried on an unseen run, of every fourth seed: it takes as long to simulate as
the first."""
_PEERS = ("sysidentpy", "pysindy")  # of the extra "peers"; without them a case is the bench's alone
_CHECK, _AGAIN, _SECOND, _STILL = 1, 2, 3, 4  # numbers of the runs of one unit


def run(kind: str, hidden: tuple[str, ...], strength: float, seed: int, profile: str) -> dict[str, Any]:
    """All data of one case for the table."""
    case = cases.case(hidden, strength, seed, profile, MODEL)
    still = case.run(cases.STATIC, _STILL)
    first = case.run(profile)
    if kind == "second":
        return _second(case, first, still)
    tried = kind == "single" and strength >= _CHECKED and seed % 4 == 2
    unseen = [case.run(cases.LOOPS, _CHECK)] if tried else []
    began = time.process_time()
    found = diagnose([first], MODEL, check=unseen, static=still)
    result = {"processor_s": round(time.process_time() - began, 2), **_content(found)}
    if unseen:
        result |= _held_out(case, first, unseen[0], found)
    if all(map(find_spec, _PEERS)):
        given = peers.shelf(first, MODEL)
        for name, choice in (("frols", peers.frols(given)), ("stlsq", peers.stlsq(given))):
            result[name] = {"ranking": choice.ranking[:3], "score": choice.score, "default": choice.default}
    return result


def _content(found: Diagnosis) -> dict[str, Any]:
    listed = [
        {"effect": s.effect, "found": s.found, "evidence": round(s.evidence, 2), "alike": s.look_alikes}
        for s in found.suspects
    ]
    return {
        "verdict": found.verdict,
        "proved": found.proved,
        "formula": next((formula.formula for formula in found.formulas), ""),
        "found": [s.effect for s in found.found],
        "alike": sorted({name for s in found.found for name in s.look_alikes}),
        "suspects": listed,
        "threshold": round(found.threshold, 2),
        "unexplained": [(place.channel, place.p) for place in found.unexplained][:3],
        "noise": found.noise_finding,
        "sentence": found.sentence,
    }


def _held_out(case: cases.Case, first: Dataset, check: Dataset, found: Diagnosis) -> dict[str, Any]:
    """RMS on the unseen run over its realised noise: current model, named effects, rival, truth."""
    noise = cases.rms(case.noise(cases.LOOPS, _CHECK))
    named = [s for s in found.suspects if s.found]
    rival = next((s for s in found.suspects if not s.found), None)
    names = {HIDDEN[name].effect for name in case.hidden}
    numbers = {
        "held_base": found.held_out_rms_dph,
        "held_named": _error(found.improved, first, check) if named else np.nan,
        "held_rival": rival.held_out_rms_dph if rival else np.nan,
        "held_true": np.nan if None in names else _error(_true(sorted(map(str, names)), first), first, check),
    }
    return {key: round(value / noise, 4) if np.isfinite(value) else None for key, value in numbers.items()}


def _true(names: Sequence[str], first: Dataset) -> Model:
    model = MODEL
    for name in names:
        model = model.adding(effects.make(name).suited([first]))
    return model


def _error(model: Model, first: Dataset, check: Dataset) -> float:
    """RMS on the check run of a model fitted to the first, without the constant between two days."""
    left = check.bias - fit_model(model, first, covariance="none").predict(check).bias
    return cases.rms(left - np.nanmean(left))


def _second(case: cases.Case, first: Dataset, still: Dataset) -> dict[str, Any]:
    """After the run that the bench proposes, and after the first run again: whether the families are distinguished."""
    before = diagnose([first], MODEL, static=still)
    result = {**_content(before), "tied": _tied(before)}
    if not result["tied"]:
        return result
    proposal = next_experiment(before, [first], static=still)
    if proposal is None:
        return result
    result |= {"proposed": proposal.profile_name, "predicted": [proposal.predicted_before, proposal.predicted_after]}
    for name, profile, number in (("after", proposal.profile_yaml, _SECOND), ("repeated", case_profile(first), _AGAIN)):
        second = case.run(profile, number)
        both = diagnose([first, replace(second, name=f"{second.name} {number}")], MODEL, static=still)
        result[name] = {**_content(both), "tied": _tied(both)}
    result["predicted"] = [round(x, 1) if np.isfinite(x) else None for x in result["predicted"]]
    return result


def case_profile(first: Dataset) -> str:
    """Name of the shipped profile that the first run followed."""
    return first.name


def _tied(found: Diagnosis) -> list[str]:
    """Families that the result leaves open: one if it is decided, empty if nothing was found."""
    named = {s.effect for s in found.found[:1]} | set(found.found[0].look_alikes if found.found else ())
    return sorted({family(name) for name in named} if len(named) > 1 else ())


def family(name: str) -> str:
    """The cause that a name of the catalogue stands for; each formula is one of its own."""
    return effects.make(name).family if name.isidentifier() else name
