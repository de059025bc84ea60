"""What a next experiment has to tell apart: effects as found."""

from __future__ import annotations

from dataclasses import dataclass

from bench.analysis.diagnosis.candidates import Theta
from bench.analysis.effects.base import Effect


@dataclass(frozen=True)
class Rival:
    """One of the effects that the runs cannot tell apart, with the parameters and the evidence found for it."""

    name: str
    effect: Effect
    theta: Theta
    evidence: float
