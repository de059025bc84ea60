"""A formula for what the catalogue does not hold, as an answer: its numbers, its words, its sentence."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from bench.analysis.diagnosis.proof import Proof
from bench.analysis.diagnosis.rivals import Rival
from bench.analysis.effects.model import Model, shell_text
from bench.base import FloatArray, finite, with_uncertainty

if TYPE_CHECKING:
    from bench.analysis.noise.likelihood import Point


@dataclass(frozen=True, eq=False)
class DescribedFormula:
    """A formula that lowers the error, with its numbers.

    `expression` is what `bench add` takes; `equivalent` are formulas that these data cannot tell from it;
    `contribution` is what it adds to the fitted bias of each run (n,) [deg/h].
    """

    formula: str
    expression: str
    words: str
    like: str
    evidence: float
    borne: float
    """What check runs add to the evidence; 0 without any."""
    held_out_before_dph: float
    held_out_rms_dph: float
    proof: Proof
    size_dph: float
    amplitudes: tuple[tuple[str, float, float, str], ...]
    acts: tuple[float, float]
    caution: str
    equivalent: tuple[str, ...]
    beside: tuple[str, ...]
    model: Model
    contribution: tuple[FloatArray, ...] = field(default=(), repr=False)
    residuals: tuple[FloatArray, ...] = field(default=(), repr=False)
    """What is left of each run (n,) with it in the model [deg/h]."""
    rivals: tuple[Rival, ...] = field(default=(), repr=False)
    """What a run has to tell apart: the formula, and those that are equivalent."""
    point: Point = (0, 0)
    """The most likely noise with it."""

    @property
    def weighed(self) -> str:
        """Its evidence in words: that of the fitted runs, and that of the check runs."""
        return f"evidence {self.evidence:.0f}" + (f" and {self.borne:.0f} from the check run" if self.borne else "")

    @property
    def added(self) -> str:
        """What `bench add` takes: the effects that it stands beside, then the formula."""
        own = {effect.name: shell_text(effect) for effect in self.model.effects}
        return " ".join([*(own.get(name, name) for name in self.beside), f"'{self.expression}'"])

    def to_json(self) -> dict[str, Any]:
        """An entry of `formulas`."""
        return {
            "formula": self.formula,
            "expression": self.expression,
            "evidence": finite(self.evidence),
            "check_evidence": finite(self.borne),
            "held_out_before_dph": finite(self.held_out_before_dph),
            "held_out_rms_dph": finite(self.held_out_rms_dph),
            "proved": self.proof.proved,
            "proof": self.proof.to_json(),
            "equivalent": list(self.equivalent),
            "words": self.words,
            "like": self.like,
            "rms_dph": finite(self.size_dph),
            "amplitudes": [
                {"name": n, "value": finite(v), "std": finite(s), "unit": u} for n, v, s, u in self.amplitudes
            ],
            "acts_degc": [finite(end) for end in self.acts],
            "caution": self.caution,
            "beside": list(self.beside),
        }


def sentence(best: DescribedFormula) -> str:
    """What an engineer reads about the best formula."""
    sizes = ", ".join(
        f"{name} = {' +- '.join(with_uncertainty(value, std))} {unit}" for name, value, std, unit in best.amplitudes
    )
    like = f", {best.like}" if best.like else ""
    beside = f" beside {', '.join(best.beside)}" if best.beside else ""
    text = f"A formula that fits{beside}: {best.formula} ({best.words}{like}; {sizes}; {best.weighed})."
    unjudged = best.proof.falls is None
    text += f" No unseen data can judge it: {best.proof.unjudged}." if unjudged else f" With it {best.proof.words}."
    if best.equivalent:
        text += f" These data cannot tell it from {' or '.join(best.equivalent[:2])}."
    return text + (f" Caution: {best.caution}." if best.caution else "")
