"""Counts of the table: whether the hidden effect was found, named, left in a tie, distinguished."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from bench.analysis.effects.registry import make
from bench.mystery.hidden import HIDDEN

Result = dict[str, Any]


def family(effect: str) -> str:
    """Family of an effect of the library."""
    return make(effect).family


def hidden_families(result: Result) -> set[str]:
    """Families of the hidden mechanisms that the library covers."""
    names = [HIDDEN[name].effect for name in result["hidden"]]
    return {family(name) for name in names if name}


def inside(results: Iterable[Result]) -> list[Result]:
    """Results in which the library covers all hidden mechanisms."""
    return [r for r in results if all(HIDDEN[name].effect for name in r["hidden"])]


def named(result: Result) -> bool:
    """The first of the effects found belongs to the hidden family."""
    return bool(result["found"]) and family(result["found"][0]) in hidden_families(result)


def tie(result: Result) -> bool:
    """The truth is among the effects found or their declared look-alikes."""
    return bool({family(n) for n in (*result["found"], *result["alike"])} & hidden_families(result))


def unknown(result: Result) -> bool:
    """The bench reports that an unknown effect is missing."""
    return bool(result["verdict"] == "unknown_effect")


def first(result: Result) -> bool:
    """The best suspect is right, found or not."""
    return bool(result["suspects"]) and family(result["suspects"][0]["effect"]) in hidden_families(result)


def in_three(result: Result) -> bool:
    """The truth is among the best three suspects, or in the tie."""
    return bool({family(s["effect"]) for s in result["suspects"][:3]} & hidden_families(result)) or tie(result)


def both(result: Result) -> bool:
    """All hidden mechanisms were found."""
    return hidden_families(result) <= {family(name) for name in result["found"]}


def tied(second: Iterable[Result]) -> list[Result]:
    """Units that the first run left undecided and that have a second run."""
    return [r for r in second if r["tied"] and "after" in r]


def decided(result: Result, key: str) -> bool:
    """The families are distinguished correctly."""
    return not result[key]["tied"] and named({**result, **result[key]})
