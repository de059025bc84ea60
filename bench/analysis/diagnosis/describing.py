"""What was found where the catalogue ends: a formula that can be added, in words, with what else fits as well."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bench.analysis.diagnosis.candidates import orthonormal, outside
from bench.analysis.diagnosis.described import DescribedFormula
from bench.analysis.diagnosis.formulas import ALIKE, FormulaSearch
from bench.analysis.diagnosis.found_formula import FoundFormula
from bench.analysis.diagnosis.held_out import unseen
from bench.analysis.diagnosis.probes import examine
from bench.analysis.diagnosis.proof import prove
from bench.analysis.diagnosis.suspects import Layout
from bench.analysis.diagnosis.verdict import Explanation
from bench.analysis.effects.model import entry_text
from bench.analysis.noise.likelihood import NoiseLattice, Point, Surface
from bench.analysis.thresholds import FURTHER_EVIDENCE, TIE
from bench.base import FloatArray
from bench.record import Dataset

_MOST = 5
_ACTS = 0.9  # of its square sum: the range of temperature where it acts
_ONE_PLACE = 0.1  # of the gain: less than this on either half of the legs is not seen twice
_IMPLAUSIBLE = 1.0  # of the spread of the bias over the run: a term larger than that cancels something

_LIKE = (
    ("sin(2*pi*lag(temperature", "like an etalon whose path follows a part inside the unit"),
    ("sin(2*pi*temperature", "like an etalon: interference, optical or electrical, over temperature"),
    ("sin(2*pi*time", "like a disturbance with a period of its own: a beat, a control loop, a neighbour"),
    ("lowest(total(", "like a film that grows and dries: condensation, frost, outgassing"),
    ("highest(", "like stress that is lost whenever the unit is warmer than ever before"),
    ("lowest(", "like stress that is lost whenever the unit is colder than ever before"),
    ("exp(-total(", "like a loss that does not come back: moisture, gas, stress that heat takes out"),
    ("total(", "like an exposure that adds up: dose, creep, fatigue"),
    ("(compressor - delay(compressor", "like a shock at each start or stop of the compressor that settles"),
    ("lag(compressor", "like heat or vibration of the compressor that reaches the unit with a delay"),
    ("play(temperature", "like a hysteresis: a mount, a glue, a solder joint"),
    ("lag(dT_dt", "like a thermal memory: gradients in the unit that outlast the change of temperature"),
    ("lag(abs(dT_dt)", "like a stress or gradient that any change of temperature leaves, and that relaxes"),
    ("lag((chamber_temperature", "like a gradient from the air through the housing"),
    ("chamber_temperature", "like a gradient from the air through the housing"),
    ("quadrature", "like quadrature that leaks through the phase of the demodulation"),
    ("exp(-((temperature", "an effect of a part of the temperature range"),
    ("tanh((temperature", "an effect of a part of the temperature range"),
    ("drive", "like the amplitude of the drive: stiffness or damping that depends on it"),
    ("dT_dt**2", "like a gradient across the unit that grows faster than the rate of change"),
    ("exp(-time", "like a warm-up"),
)


@dataclass(frozen=True, eq=False)
class Description:
    """Formulas, best first, and whether they explain the data better than the effects of the catalogue did."""

    formulas: tuple[DescribedFormula, ...] = ()
    replaces: bool = False


@dataclass(frozen=True, eq=False)
class Describer:
    """Searches formulas and describes them; `check` are the runs that no fit sees."""

    lattice: NoiseLattice
    check: Sequence[Dataset]
    seed: int = 0
    workers: int = 1

    def describe(self, layout: Layout, explained: Explanation) -> Description:
        """Formulas beside the model alone, or beside the effects that were found where a misfit is left."""
        steps = explained.steps
        plain = self._search(layout, explained.first.point)
        found = plain.answer.found
        named = _joint(explained, layout) if steps else 0.0
        if found and (not steps or (found[0].evidence > named + TIE and not self._named(found[0], layout, explained))):
            listed = self._listed(plain, layout)
            return Description((*self._two(layout, plain), *listed)[:_MOST], bool(steps))
        if steps and (explained.left or explained.drifts):
            beside = self._search(explained.layout)
            listed = self._listed(beside, explained.layout, tuple(step.name for step in steps))
            if not listed and found and found[0].evidence > named - TIE and explained.word == "unknown_effect":
                return Description(self._listed(plain, layout))  # no better than the effects, and no worse
            return Description(listed)
        return Description()

    def _search(self, layout: Layout, best: Point | None = None, first: FoundFormula | None = None) -> FormulaSearch:
        return FormulaSearch(layout, self.lattice, self.seed, best, self.workers, first)

    def _named(self, one: FoundFormula, layout: Layout, explained: Explanation) -> bool:
        """Whether the effects found may contribute just what the formula does: it then writes them in a shorter way."""
        way = self.lattice.at([one.point])[0][0]
        model, longer = (way.apply(each.problem.base) for each in (layout, explained.layout))
        added = orthonormal(outside(orthonormal(model), longer))
        inside = added.T @ one.white
        return float(inside @ inside) > ALIKE**2 * float(one.white @ one.white)

    def _listed(
        self, search: FormulaSearch, layout: Layout, beside: tuple[str, ...] = ()
    ) -> tuple[DescribedFormula, ...]:
        found = search.answer
        best = found.found[0].evidence if found.found else 0.0
        tied = [one.text for one in found.found[1:] if one.evidence >= best - TIE]
        listed = []
        for rank, (one, alike) in enumerate(list(zip(found.found, found.alike, strict=True))[:_MOST]):
            equivalent = tuple(dict.fromkeys([*(tied if rank == 0 else []), *alike]))
            listed.append(self._described(layout, (one,), equivalent, beside))
        return tuple(listed)

    def _two(self, layout: Layout, plain: FormulaSearch) -> tuple[DescribedFormula, ...]:
        """The best formula and another beside it, where something is left beside the first; empty otherwise."""
        first = plain.answer.found[0]
        longer = layout.adding(first.effect, first.theta)
        surface = Surface.of(longer.problem.records(), self.lattice, restricted=True)
        surface.visit([first.point])
        left = examine(longer.problem, layout.probes(), self.lattice, surface.descend(first.point))
        if not any(finding.name != "noise" for finding in left.alarms):
            return ()
        second = next(iter(self._search(longer, first=first).answer.found), None)
        if second is None or second.evidence <= FURTHER_EVIDENCE:
            return ()
        return (self._described(layout, (first, second), (), ()),)

    def _described(
        self, layout: Layout, parts: Sequence[FoundFormula], equivalent: tuple[str, ...], beside: tuple[str, ...]
    ) -> DescribedFormula:
        first, *others = parts
        effect, theta = first.with_(others[0]) if others else (first.effect, first.theta)
        after = layout.adding(effect, theta)
        scored = unseen(after.rows, after.theta, self.check, sum(len(part.amplitudes) for part in parts))
        before = unseen(layout.rows, layout.theta, self.check, like=scored.left)
        contribution = np.sum([part.contribution for part in parts], axis=0)
        return DescribedFormula(
            formula=others[0].beside(first) if others else first.text,
            expression=entry_text(effect),
            words=", and ".join(part.formula.words for part in parts),
            like="; ".join(dict.fromkeys(filter(None, (_like(part.text) for part in parts)))),
            evidence=sum(part.evidence for part in parts),
            held_out_before_dph=before.rms_dph,
            held_out_rms_dph=scored.rms_dph,
            proof=prove(before.left, scored.left),
            size_dph=float(np.std(contribution)),
            amplitudes=tuple(
                entry for part, name in zip(parts, "km", strict=False) for entry in part.amplitude_entries(name)
            ),
            acts=_acts(layout.temperature, contribution),
            caution=_caution(layout, parts, contribution),
            equivalent=equivalent,
            beside=beside,
            model=after.rows.model,
            contribution=layout.rows.scatter(contribution),
            residuals=scored.residuals,
        )


def _joint(explained: Explanation, layout: Layout) -> float:
    """Evidence of all effects found together, beside the model alone."""
    more = explained.layout.problem.base.shape[1] - layout.problem.base.shape[1]
    gain = explained.first.minus2logl - explained.last.minus2logl
    return float(gain - more * np.log(len(layout.problem.y)))


def _like(text: str) -> str:
    """The physics of a recognised special case."""
    return next((words for part, words in _LIKE if part in text), "")


def _acts(temperature: FloatArray, contribution: FloatArray) -> tuple[float, float]:
    """Range of temperature [degC] that holds most of the term's square sum."""
    order = np.argsort(temperature, kind="stable")
    share = np.cumsum((contribution[order] - np.median(contribution)) ** 2)
    share /= max(float(share[-1]), 1e-300)
    tail = 0.5 * (1.0 - _ACTS)
    low, high = np.searchsorted(share, [tail, 1.0 - tail])
    return float(temperature[order[low]]), float(temperature[order[min(int(high), len(order) - 1)]])


def _caution(layout: Layout, parts: Sequence[FoundFormula], contribution: FloatArray) -> str:
    """Why the formula may not be what it looks like; empty where nothing speaks against it."""
    words = []
    if float(np.ptp(contribution)) > _IMPLAUSIBLE * float(np.ptp(layout.problem.y)):
        words.append("its size is larger than the whole spread of the bias: it cancels a part of the model")
    if any(part.on_bound for part in parts):
        words.append("a parameter is on the end of its range: not determined")
    gains = np.diff(parts[0].halves(), prepend=0.0)
    if gains.sum() > 0.0 and gains.min() < _ONE_PLACE * gains.sum():
        words.append("only one half of the run shows it: suspected until a second run repeats it")
    return "; ".join(words)
