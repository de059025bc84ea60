"""Mechanisms that neither the catalogue nor the grammar of formulas holds, group by group as they were written."""

from __future__ import annotations

from inspect import isfunction, signature
from types import ModuleType

from benchmarks.mechanisms import (
    blind,
    causes,
    first,
    fourth,
    gyros,
    likely,
    machines,
    second,
    solids,
    textbooks,
    third,
)
from benchmarks.mechanisms.world import Truth

GROUPS = (first, second, third, fourth, textbooks, solids, machines, gyros, blind, likely, causes)


def truths(module: ModuleType) -> dict[str, Truth]:
    """The mechanisms of one group."""
    return {
        name: truth
        for name, truth in vars(module).items()
        if isfunction(truth) and truth.__module__ == module.__name__ and [*signature(truth).parameters] == ["w", "rng"]
    }


TRUTHS = {name: truth for module in GROUPS for name, truth in truths(module).items()}
"""In the order in which they were written."""
