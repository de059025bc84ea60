"""Mechanisms that neither the catalogue nor the grammar of formulas holds, group by group as they were written."""

from __future__ import annotations

from inspect import isfunction, signature

from benchmarks.mechanisms import blind, first, fourth, gyros, likely, machines, second, solids, textbooks, third
from benchmarks.mechanisms.world import Truth

TRUTHS: dict[str, Truth] = {
    name: truth
    for module in (first, second, third, fourth, textbooks, solids, machines, gyros, blind, likely)
    for name, truth in vars(module).items()
    if isfunction(truth) and truth.__module__ == module.__name__ and [*signature(truth).parameters] == ["w", "rng"]
}
"""In the order in which they were written."""
