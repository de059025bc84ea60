"""What a next experiment has to tell apart: effects and formulas as found."""

from __future__ import annotations

from dataclasses import dataclass

from bench.analysis.diagnosis.candidates import Theta
from bench.analysis.effects.base import Effect
from bench.analysis.effects.expression import Expression


@dataclass(frozen=True)
class Rival:
    """An effect or a formula that the runs cannot tell from others, with its parameters and evidence as found."""

    name: str
    effect: Effect
    theta: Theta
    evidence: float
    tied: bool = True
    """Whether it may be the cause by what is known; else a run must not make it one."""

    @property
    def family(self) -> str:
        """The cause: each formula is one of its own."""
        return self.name if isinstance(self.effect, Expression) else self.effect.family
