"""A formula that a search found, with its numbers."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bench.analysis.diagnosis.blocks import Formula
from bench.analysis.diagnosis.candidates import Theta
from bench.analysis.effects.expression import Expression
from bench.analysis.noise.likelihood import Point
from bench.analysis.noise.probability import sized
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
    amplitudes: FloatArray
    covariance: FloatArray
    """Of the amplitudes (k, k)."""
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

    @property
    def on_bound(self) -> tuple[str, ...]:
        """Parameters whose search ended at an end of their range."""
        pairs = zip(self.formula.parameters, self.theta, strict=True)
        return tuple(parameter.name for parameter, value in pairs if parameter.on_bound(value))

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Those of them that are not next to nothing: a lag that is shorter than the rows is determined."""
        given = zip(self.formula.parameters, self.theta, self.formula.vanishing, strict=True)
        nothing = {p.name for p, value, vanishing in given if vanishing and 2.0 * value < p.low + p.high}
        return tuple(name for name in self.on_bound if name not in nothing)

    @property
    def sized(self) -> bool:
        """Whether the data know its size."""
        return sized(self.amplitudes, self.covariance) > 1.0

    @property
    def period_s(self) -> float:
        """After which it repeats [s]: 0 where it does not depend on the time, infinite where it never repeats."""
        first, *others = [block.text for block in (*self.formula.blocks, self.formula.along) if block]
        periodic = re.match(r"sin\(\d\*pi\*time/|\(1 \+ tanh\(\(sin\(2\*pi\*\(time ", first)
        if any(re.search(r"\btime\b", text) for text in (others if periodic else (first, *others))):
            return np.inf
        return self.theta[self.formula.names.index("period_s")] if periodic else 0.0

    def amplitude_entries(self, amplitude: str = "k") -> list[tuple[str, float, float, str]]:
        """Name, value, standard deviation and unit of each amplitude."""
        deviations = np.sqrt(np.diag(self.covariance))
        rows = zip(self.formula.amplitudes, self.amplitudes.tolist(), deviations.tolist(), strict=True)
        return [(f"{amplitude}{end}", value, std, unit) for (end, unit), value, std in rows]

    def halves(self) -> FloatArray:
        """Gain up to the middle of the rows, and up to the end."""
        return np.array([self.gains[len(self.gains) // 2], self.gains[-1]])


AMPLITUDES = "kmq"
"""Of the terms of one answer, in their order."""


def together(parts: Sequence[FoundFormula]) -> tuple[str, Expression, Theta]:
    """All terms as one: in words with the numbers that were found, as an effect, and its parameters."""
    texts, formulas = [], []
    bounds: dict[str, Sequence[float]] = {}
    for part, amplitude in zip(parts, AMPLITUDES, strict=False):
        near = part.formula.near(part.theta, amplitude)
        formula, own = near.formula, dict(near.bounds)
        for name in part.formula.names:
            if name in bounds:
                formula = re.sub(rf"\b{name}\b", f"{name}_{amplitude}", formula)
                own[f"{name}_{amplitude}"] = own.pop(name)
        bounds |= own
        formulas.append(formula)
        texts.append(part.formula.text(numbers(part.theta), amplitude))
    theta = tuple(value for part in parts for value in part.theta)
    return " + ".join(texts), Expression(" + ".join(formulas), bounds), theta


def numbers(theta: Theta) -> list[str]:
    """Parameters as a formula shows them."""
    return [f"{value:.4g}" if abs(value) < 1e3 else f"{value:.6g}" for value in theta]


def alike(one: FloatArray, other: FloatArray, least: float) -> bool:
    """Whether two whitened columns (n,) have at least this correlation."""
    return float(one @ other) ** 2 > least**2 * float(one @ one) * float(other @ other)
