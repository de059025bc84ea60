"""What a diagnosis leaves in doubt, and what the plan says to it: nothing of it is shipped in silence."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from bench.base import bound
from bench.commands.calibration.job import Case
from bench.commands.calibration.plan import Action, Policy
from bench.record import DiagnosisRecord, Verdict

_DOUBTED = {"missing_effect", "unknown_effect", "undecided"}


@dataclass(frozen=True)
class Doubt:
    """One doubt, by the key of the policy, and its sentence."""

    kind: str
    sentence: str


def doubts(diagnosis: DiagnosisRecord | None, reason: str, added: Sequence[Mapping[str, Any]]) -> Iterator[Doubt]:
    """Doubts of diagnosis.json (None and a `reason` without one), and of effects `added` to the model on the way."""
    if diagnosis is None:
        yield Doubt("undiagnosed", f"not diagnosed: {reason or 'no diagnosis was made'}")
    elif diagnosis.verdict in _DOUBTED:
        yield Doubt(diagnosis.verdict, diagnosis.sentence)
    missing = [] if diagnosis is None else [suspect for suspect in diagnosis.suspects if suspect.found]
    yield from (_tie("is missing", s.effect, s.look_alikes) for s in missing if s.look_alikes)
    yield from (_tie("was added", str(e["effect"]), e["look_alikes"]) for e in added if e["look_alikes"])


def _tie(what: str, effect: str, look_alikes: Sequence[str]) -> Doubt:
    rivals = ", ".join(look_alikes)
    return Doubt("tie", f"{effect} {what}, these data cannot tell it from {rivals}")


def decided(found: Iterable[Doubt], policy: Policy) -> tuple[tuple[Case, ...], str, str]:
    """A case for each kind of doubt, and why to hold and why to stop, empty where not."""
    by_kind: dict[str, list[str]] = {kind: [] for kind in Policy.model_fields if kind != "marginal"}
    for doubt in found:
        by_kind[doubt.kind].append(doubt.sentence)
    cases, why = [], {"ship": "", "hold": "", "stop": ""}
    for kind, sentences in by_kind.items():
        action: Action = getattr(policy, kind)
        text = "; ".join(sentences)
        if not sentences:
            cases.append(Case(kind))
            continue
        failure = "" if action == "ship" else action
        cases.append(Case(kind, failure, text=f"{text} (policy: {action})"))
        why[action] = f"{why[action]}; {text}" if why[action] else text
    return tuple(cases), why["hold"], why["stop"]


def judged(content: Mapping[str, Any]) -> tuple[Case, ...]:
    """A case for each limit of a judgement (limits.json)."""
    cases = [Case(f"refusal {i + 1}", "INVALID", text=text) for i, text in enumerate(content["refusals"])]
    for result in content["results"]:
        word = result["verdict"]
        unit = "" if result["unit"] == "1" else f" {result['unit']}"
        value = result["reason"] if result["value"] is None else f"{result['value']:.6g}{unit}"
        text = f"{word or 'not measured'}: {value}, limits {bound(result['lower'])} to {bound(result['upper'])}{unit}"
        cases.append(Case(result["name"], "" if word is None or Verdict(word).within else word, word is None, text))
    return tuple(cases)


def verdict_of(word: str, policy: Policy, what: str) -> tuple[str, str]:
    """Why a verdict against limits holds a job and why it stops it."""
    if word == "MARGINAL" and policy.marginal != "ship":
        text = f"{what} is MARGINAL"
        return (text, "") if policy.marginal == "hold" else ("", text)
    return ("", f"{what} is {word}") if word in {"FAIL", "INVALID"} else ("", "")
