"""A formula that a search found, with its numbers."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from bench.analysis.diagnosis.blocks import Formula
from bench.analysis.diagnosis.candidates import Theta
from bench.analysis.effects.expression import Expression
from bench.analysis.noise.likelihood import Point
from bench.base import FloatArray


@dataclass(frozen=True, eq=False)
class FoundFormula:
    """A formula with its parameters, refined, its evidence, and its noise point.

    `contribution` (n,) is what it adds to the fitted bias [deg/h]; `white` (n,) its column, whitened, beside the model.
    """

    formula: Formula
    theta: Theta
    evidence: float
    point: Point
    sigma2: float
    amplitudes: FloatArray
    deviations: FloatArray
    contribution: FloatArray
    white: FloatArray
    gains: FloatArray
    """Gain in 2 ln L up to each row (n,)."""

    @property
    def effect(self) -> Expression:
        """What a model takes: bounds about the values that were found, so that a fit begins there."""
        return self.formula.near(self.theta)

    @property
    def text(self) -> str:
        """The formula with the numbers that were found."""
        return self.formula.text(numbers(self.theta))

    def beside(self, first: FoundFormula) -> str:
        """Both, with the numbers that were found."""
        return f"{first.text} + {self.formula.text(numbers(self.theta), 'm')}"

    @property
    def on_bound(self) -> bool:
        """Whether the search of a parameter ended at an end of its range."""
        return any(p.on_bound(value) for p, value in zip(self.formula.parameters, self.theta, strict=True))

    def amplitude_entries(self, amplitude: str = "k") -> list[tuple[str, float, float, str]]:
        """Name, value, standard deviation and unit of each amplitude."""
        rows = zip(self.formula.amplitudes, self.amplitudes.tolist(), self.deviations.tolist(), strict=True)
        return [(f"{amplitude}{end}", value, std, unit) for (end, unit), value, std in rows]

    def halves(self) -> FloatArray:
        """Gain up to the middle of the rows, and up to the end."""
        return np.array([self.gains[len(self.gains) // 2], self.gains[-1]])

    def with_(self, other: FoundFormula) -> tuple[Expression, Theta]:
        """Both as one effect, and its parameters."""
        mine, theirs = self.effect, other.formula.near(other.theta, "m")
        text, bounds = theirs.formula, dict(theirs.bounds)
        for name in other.formula.names:
            if name in mine.bounds:
                text = re.sub(rf"\b{name}\b", f"{name}_m", text)
                bounds[f"{name}_m"] = bounds.pop(name)
        return Expression(f"{mine.formula} + {text}", {**mine.bounds, **bounds}), (*self.theta, *other.theta)


def numbers(theta: Theta) -> list[str]:
    """Parameters as a formula shows them."""
    return [f"{value:.4g}" if abs(value) < 1e3 else f"{value:.6g}" for value in theta]
