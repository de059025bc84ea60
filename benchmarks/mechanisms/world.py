"""What a mechanism outside the catalogue sees of its surroundings, and the operators that many of them share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bench.base import BoolArray, FloatArray


@dataclass(frozen=True, eq=False)
class World:
    """States (n,) of every second: case and air of the chamber [degC], its switches, and the unit's channels."""

    time: FloatArray
    case: FloatArray
    air: FloatArray
    compressor: FloatArray
    heater: FloatArray
    quadrature: FloatArray
    drive: FloatArray
    frequency: FloatArray
    supply: FloatArray
    constant: Callable[[float], float] = float
    """A number of the unit: what it was in the unit's first run holds in all others."""


def constants(known: list[float]) -> Callable[[float], float]:
    """`World.constant` of a run: gives the numbers that are `known` of the unit in their order, and notes new ones."""
    given = iter(tuple(known))

    def constant(value: float) -> float:
        number = next(given, None)
        if number is None:
            known.append(number := float(value))
        return number

    return constant


Truth = Callable[[World, np.random.Generator], FloatArray]


def follows(source: FloatArray, tau_s: float) -> FloatArray:
    """A node that exchanges heat with a source, by small steps of its own balance."""
    node, level = np.empty(len(source)), float(source[0])
    share = 1.0 / tau_s
    for second, value in enumerate(source.tolist()):
        level += share * (value - level)
        node[second] = level
    return node


def unevenly(source: FloatArray, up_s: float, down_s: float, start: float | None = None) -> FloatArray:
    """A node that takes up and gives off with different time constants; it begins as the source does, or at `start`."""
    node, level = np.empty(len(source)), float(source[0]) if start is None else start
    for second, value in enumerate(source.tolist()):
        level += (value - level) / (up_s if value > level else down_s)
        node[second] = level
    return node


def dragged(source: FloatArray, play: float) -> FloatArray:
    """What a source drags along once it has gone through the play on either side."""
    moved, at = np.empty(len(source)), float(source[0])
    for second, value in enumerate(source.tolist()):
        at = min(max(at, value - play), value + play)
        moved[second] = at
    return moved


def switched(source: FloatArray, on_below: float, off_above: float) -> BoolArray:
    """A switch that is off at first: on below one value of the source, and off again above a higher one."""
    states, on = np.empty(len(source), dtype=bool), False
    for second, value in enumerate(source.tolist()):
        states[second] = on = value < (off_above if on else on_below)
    return states


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """A number whose logarithm is uniform."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))
