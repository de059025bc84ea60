"""The answer of a diagnosis: verdict, where the model fails, suspects best first, and what the run could not show."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import isfinite, nan
from typing import Any, Literal

from bench.analysis.diagnosis.candidates import Theta
from bench.analysis.diagnosis.described import DescribedFormula
from bench.analysis.diagnosis.kernel import Kernel
from bench.analysis.diagnosis.proof import Proof
from bench.analysis.diagnosis.surface import ResidualSurface
from bench.analysis.effects.model import Model, shell_text
from bench.analysis.thresholds import BEYOND_DOUBT
from bench.base import CHANNELS, FloatArray, finite, number, with_uncertainty

VerdictWord = Literal["adequate", "missing_effect", "unknown_effect", "undecided"]
"""`missing_effect`: unseen data prove what is named; `undecided`: suspected without proof, or a slow cause or noise."""


_UNEVEN = 2.0  # one side of an interval over the other, from which a standard deviation misleads


@dataclass(frozen=True)
class Place:
    """Where a model fails: a range of a channel (or of time, of dT/dt), how large and how certain.

    `rms_dph` is the residual's RMS there, `misfit_dph` the RMS of the systematic part, `p` the chance of it.
    """

    channel: str
    low: float
    high: float
    rms_dph: float
    floor_ratio: float
    misfit_dph: float
    p: float
    note: str = ""

    @property
    def unit(self) -> str:
        """Of the range's ends."""
        return "degC/min" if self.channel == "dT_dt" else CHANNELS[self.channel].unit

    def to_json(self) -> dict[str, Any]:
        """An entry of `where`."""
        return {
            "channel": self.channel,
            "from": finite(self.low),
            "to": finite(self.high),
            "unit": self.unit,
            "rms_dph": finite(self.rms_dph),
            "floor_ratio": finite(self.floor_ratio),
            "misfit_dph": finite(self.misfit_dph),
            "p": self.p,
            "note": self.note,
        }


@dataclass(frozen=True)
class Value:
    """A fitted number with its unit, standard deviation and, for a nonlinear parameter, 95 % interval."""

    value: float
    unit: str
    std: float
    interval: tuple[float, float] | None = None
    at_bound: bool = False
    """The search ended at an end of its range: the data do not determine the value."""

    @property
    def words(self) -> str:
        """The value with its standard deviation, or with its 95 % interval where one side is twice the other."""
        if self.at_bound:
            return f"{number(self.value)} {self.unit}".rstrip() + " on its bound: not determined"
        size, deviation = with_uncertainty(self.value, self.std)
        text = f"{size} +- {deviation} {self.unit}"
        if self.interval is not None:
            low, high = self.interval
            below, above = self.value - low, high - self.value
            if max(below, above) > _UNEVEN * min(below, above):
                text = f"{number(self.value, 2)} [{number(low, 2)} ... {number(high, 2)}] {self.unit}"
        return text.rstrip()

    def to_json(self) -> dict[str, Any]:
        """An entry of `parameters`."""
        entry = {"value": finite(self.value), "unit": self.unit, "std": finite(self.std)}
        if self.interval is None:
            return entry
        return entry | {"interval": [finite(end) for end in self.interval], "at_bound": self.at_bound}


@dataclass(frozen=True, eq=False)
class SuspectedEffect:
    """An effect that may be missing, judged beside what was found before it.

    `removes` is the share of the excess variance over the floor that adding it removes on data that the fit did not
    see (NaN where there is no excess); `chance` how often runs without any effect reach this evidence; `legs` the gain
    in 2 ln L that each segment holds, at the noise left beside the effect. `model` is the model with it added; `reason`
    says why that could not be fitted.
    """

    effect: str
    options: Mapping[str, Any]
    found: bool
    evidence: float
    chance: float
    held_out_before_dph: float
    held_out_rms_dph: float
    removes: float
    parameters: Mapping[str, Value]
    look_alikes: tuple[str, ...]
    legs: tuple[tuple[str, float], ...]
    model: Model
    theta: Theta
    shape: tuple[FloatArray, ...] = field(default=(), repr=False)
    """What it adds to the fitted bias of each run (n,) [deg/h]; NaN in rows that were not fitted."""
    reason: str = ""
    proof: Proof = field(default_factory=Proof)

    @property
    def proved(self) -> bool | None:
        """Whether the error on unseen data falls with it, by enough and significantly; None: nothing could judge it."""
        return self.proof.proved

    @property
    def added(self) -> str:
        """What `bench add` takes."""
        return next((shell_text(e) for e in reversed(self.model.effects) if e.name == self.effect), self.effect)

    @property
    def scored(self) -> bool:
        """Whether there is an error on unseen data without it and with it."""
        return isfinite(self.held_out_before_dph) and isfinite(self.held_out_rms_dph)

    def to_json(self) -> dict[str, Any]:
        """An entry of `suspects`."""
        return {
            "effect": self.effect,
            "options": dict(self.options),
            "found": self.found,
            "held_out_before_dph": finite(self.held_out_before_dph),
            "held_out_rms_dph": finite(self.held_out_rms_dph),
            "removes": finite(self.removes),
            "evidence": finite(self.evidence),
            "chance": finite(self.chance),
            "parameters": {name: value.to_json() for name, value in self.parameters.items()},
            "look_alikes": list(self.look_alikes),
            "legs": [{"segment": name, "gain": finite(gain)} for name, gain in self.legs],
            "reason": self.reason,
            "proved": self.proved,
            "proof": self.proof.to_json(),
        }


@dataclass(frozen=True)
class Detectable:
    """The smallest effect that the run would have shown; infinite (JSON null) where the model takes any size in."""

    effect: str
    rms_dph: float
    amplitude: float
    unit: str
    parameters: Mapping[str, float]

    @property
    def seen(self) -> bool:
        """Whether the run would have shown it at some size."""
        return isfinite(self.rms_dph)

    def to_json(self) -> dict[str, Any]:
        """An entry of `smallest_detectable`."""
        return {
            "effect": self.effect,
            "rms_dph": finite(self.rms_dph),
            "amplitude": finite(self.amplitude),
            "unit": self.unit,
            "parameters": dict(self.parameters),
        }


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """What `bench diagnose` answers. `residuals` and `unexplained_residuals` are (n,) [deg/h] of each run.

    `model` is the model that was diagnosed, its automatic options settled; `improved` the same with what was found.
    """

    verdict: VerdictWord
    sentence: str
    runs: tuple[str, ...]
    check: tuple[str, ...]
    floor_dph: float
    rms_dph: float
    held_out_rms_dph: float
    held_out_by: str
    where: tuple[Place, ...]
    suspects: tuple[SuspectedEffect, ...]
    unexplained: tuple[Place, ...]
    threshold: float
    not_excited: Mapping[str, str]
    smallest_detectable: tuple[Detectable, ...]
    noise_finding: str
    notes: tuple[str, ...]
    model: Model
    improved: Model
    residuals: tuple[FloatArray, ...] = field(default=(), repr=False)
    unexplained_residuals: tuple[FloatArray, ...] = field(default=(), repr=False)
    next_experiment: Mapping[str, Any] | None = None
    static: str = ""
    """Name of the isothermal run that tells the noise; empty without."""
    sisters: tuple[str, ...] = ()
    formulas: tuple[DescribedFormula, ...] = ()
    """What the catalogue does not hold, best first."""
    kernel: Kernel | None = None
    """The memory of what is left, where neither an effect nor a formula that is proved describes it."""
    surface: ResidualSurface | None = None
    """What is left over two channels, where that was asked for or what is left is not described."""
    proved: bool | None = None
    """Whether unseen data bear the verdict out; None where none could judge it."""
    nearest: str = ""
    """Effect that lowers the error on a check run and leaves much more than the noise there: not the cause."""
    resolution: str = ""
    """What the steps of output and thermometer cause, where that is as much as what is left; else empty."""

    @property
    def found(self) -> tuple[SuspectedEffect, ...]:
        """Effects that are missing by the evidence, strongest first."""
        return tuple(suspect for suspect in self.suspects if suspect.found)

    @property
    def named(self) -> tuple[SuspectedEffect, ...]:
        """Effects found that unseen data prove: what "missing" says."""
        return tuple(s for s in self.found if s.proved) if self.verdict == "missing_effect" else ()

    @property
    def contradicted(self) -> bool:
        """Whether check runs speak clearly against the strongest effect found, which this run shows beyond doubt."""
        if not self.found or self.found[0].proof.by != "check":
            return False
        return self.found[0].evidence >= BEYOND_DOUBT and self.found[0].proof.rises

    @property
    def tied(self) -> bool:
        """Whether the effects found stand, and these data cannot tell them from the best formula."""
        if not self.formulas or self.verdict == "unknown_effect":
            return False
        return " + ".join(s.effect for s in self.found) in self.formulas[0].equivalent

    @property
    def leading(self) -> DescribedFormula | None:
        """The best formula, where it is the answer and does not only stand beside the effects found."""
        return self.formulas[0] if self.formulas and not self.tied else None

    @property
    def floor_ratio(self) -> float:
        """Error on unseen data with what they prove, over the noise floor; NaN where they prove nothing."""
        proofs = [one.proof for one in (self.leading, *self.named) if one is not None and one.proof.proved]
        return proofs[0].after_dph / self.floor_dph if proofs else nan

    @property
    def added(self) -> str:
        """What `bench add` takes to make the model better: the best formula, else the effects found; empty without.

        Nothing that unseen data contradict, and no effect that is only the nearest to what is missing; beside what the
        catalogue does not explain, what unseen data prove.
        """
        if self.leading is not None:
            return self.leading.added if self.leading.proof.falls is not False else ""
        if self.verdict == "unknown_effect":
            return " ".join(s.added for s in self.found if s.proved and not self.nearest)
        return " ".join(s.added for s in self.found if s.proof.falls is not False)

    def following(self, runs: Sequence[str], check: Sequence[str], model: str, better: str) -> tuple[str, ...]:
        """Commands that add what is missing to the model, as the file `better`, and show both beside each other."""
        if not self.added:
            return ()
        unseen = [word for run in check for word in ("--check", run)]
        compared = ["bench", "compare", *runs, *unseen, "--model", model, "--model", better]
        return f"bench add {self.added} {shlex.join(['--model', model, '--out', better])}", shlex.join(compared)

    @property
    def mark(self) -> str:
        """What the mark of the suspects that were found says."""
        return "* is nearest to what is missing" if self.nearest else "* belongs to the explanation"

    def to_json(self) -> dict[str, Any]:
        """The object of `bench diagnose --json`; null where a number does not exist."""
        return {
            "verdict": self.verdict,
            "proved": self.proved,
            "nearest": self.nearest or None,
            "contradicted": self.contradicted,
            "sentence": self.sentence,
            "runs": list(self.runs),
            "check": list(self.check),
            "static": self.static or None,
            "sisters": list(self.sisters),
            "model": self.model.name,
            "floor_dph": finite(self.floor_dph),
            "rms_dph": finite(self.rms_dph),
            "held_out_rms_dph": finite(self.held_out_rms_dph),
            "held_out_by": self.held_out_by,
            "floor_ratio": finite(self.floor_ratio),
            "where": [place.to_json() for place in self.where],
            "suspects": [suspect.to_json() for suspect in self.suspects],
            "formulas": [formula.to_json() for formula in self.formulas],
            "kernel": None if self.kernel is None else self.kernel.to_json(),
            "surface": None if self.surface is None else self.surface.to_json(),
            "next_experiment": None if self.next_experiment is None else dict(self.next_experiment),
            "unexplained": [place.to_json() for place in self.unexplained],
            "threshold": finite(self.threshold),
            "not_excited": [{"effect": name, "reason": why} for name, why in self.not_excited.items()],
            "smallest_detectable": [limit.to_json() for limit in self.smallest_detectable],
            "noise_finding": self.noise_finding or None,
            "resolution": self.resolution or None,
            "notes": list(self.notes),
        }
