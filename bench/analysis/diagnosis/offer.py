"""What may be missing in a model: effects whose channels the runs have, in the rows that have values of them."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations, product

import numpy as np

from bench.analysis.diagnosis.candidates import Candidate
from bench.analysis.diagnosis.suspects import CHANNELS, Layout
from bench.analysis.effects import registry as effects
from bench.analysis.effects.base import Effect
from bench.analysis.effects.bias_jump import BiasJump
from bench.analysis.effects.catalogue import suspected
from bench.analysis.effects.model import Model
from bench.analysis.noise.spikes import sharp
from bench.analysis.thresholds import LEAST_PRESENT
from bench.base import FloatArray, InputError
from bench.record import Dataset

_MOST_SHARP = 12  # sharp changes after which a jump is looked for that does not stay
_FADING_S = (100.0, 250.0, 600.0, 1500.0, 4000.0)


@dataclass(frozen=True, eq=False)
class Offer:
    """Effects that may be missing, by the name of their candidate, and why the others cannot be judged.

    Those of the names `alike` act in the isothermal run in the same size.
    """

    effects: Mapping[str, Effect]
    refused: Mapping[str, str]
    alike: frozenset[str] = frozenset()
    sharp_h: Mapping[str, Sequence[float]] = field(default_factory=dict)
    """Times [h] at which the runs change sharply, by their names."""
    notes: tuple[str, ...] = ()
    """How many rows are left out for gaps, and which channels have too many that no effect needs."""

    def candidates(self, layout: Layout) -> list[Candidate]:
        """All that the layout's model does not have yet."""
        have = {effect.name for effect in layout.rows.model.effects}
        lacking = [(name, effect) for name, effect in self.effects.items() if effect.name not in have]
        made = [layout.candidate(effect, name, name in self.alike) for name, effect in lacking]
        grids = {name: self.grid(effect) for name, effect in lacking if isinstance(effect, BiasJump)}
        return [replace(one, tried=grids.get(one.name) or one.tried) for one in made]

    def grid(self, jump: BiasJump) -> tuple[tuple[float, float], ...]:
        """When a jump that does not stay may have begun [h], and how fast it may fade, or how long last [s]."""
        at_h = [at for name, low, high in jump.own for at in self.sharp_h.get(name, ()) if low <= at <= high]
        if jump.then == "fades":
            return tuple(product(at_h, _FADING_S))
        ends = combinations(at_h, 2) if jump.then == "returns" else ()
        return tuple((begin, 3600.0 * (end - begin)) for begin, end in ends)


def catalogued(model: Model, records: Sequence[Dataset]) -> tuple[Effect, ...]:
    """Every effect of the catalogue that the model lacks, and a spline where its static curve is stiffer."""
    have = {effect.name for effect in model.effects}
    lacking = [name for name in suspected() if name not in have]
    curves = () if have & {"spline", "surface"} else _spline(records)
    return (*(effects.make(name) for name in lacking), *curves)


def _spline(records: Sequence[Dataset]) -> tuple[Effect, ...]:
    """The finest of a few splines that the rows can carry."""
    for intervals in (24, 12, 6):
        spline = effects.make("spline", {"intervals": intervals})
        try:
            spline.prepare(records).demand(records)
        except InputError:
            continue
        return (spline,)
    return ()


def offer(layout: Layout, wanted: Sequence[Effect], residuals: Sequence[FloatArray] = ()) -> tuple[Layout, Offer]:
    """Candidates for these effects, in all their shapes, and the layout without rows in which their channels have gaps.

    An effect whose channel is missing, constant or has many gaps is refused with the reason. Where `residuals` (n,) of
    the runs change sharply a jump may fade or return.
    """
    pairs = zip(layout.rows.records, residuals, strict=False)
    sharp_h = {run.name: (run.time[sharp(left)] / 3600.0).tolist() for run, left in pairs}
    open_ = Offer({}, {}, sharp_h={name: at for name, at in sharp_h.items() if len(at) <= _MOST_SHARP})
    taken: dict[str, Effect] = {}
    refused: dict[str, str] = {}
    alike: set[str] = set()
    needed = {channel for effect in wanted for channel in effect.needs}
    seen = {c for c in CHANNELS if all(c in record.channels for record in layout.rows.records)}
    absent = _absent(layout, sorted(needed | seen))
    for effect in wanted:
        reasons = [absent[channel] for channel in effect.needs if channel in absent]
        if reasons:
            refused[effect.name] = reasons[0]
            continue
        for i, shape in enumerate(effect.suited(layout.rows.records).shapes()):
            if isinstance(shape, BiasJump) and shape.then != "stays" and not open_.grid(shape):
                continue
            taken[effect.name if i == 0 else f"{effect.name} {i + 1}"] = shape
            if i == 0 and layout.still and shape.by_clock and not shape.parameters and len(shape.amplitudes) == 1:
                alike.add(name := f"{effect.name} in every run")
                taken[name] = shape
    ready = without_gaps(layout, {c for effect in taken.values() for c in effect.needs} | seen.difference(absent))
    for name, effect in list(taken.items()):
        try:
            ready.candidate(effect, name)
        except InputError as error:
            del taken[name]
            refused.setdefault(effect.name, str(error))
    gaps = len(layout.problem.y) - len(ready.problem.y)
    notes = [f"rows with gaps in a channel, left out: {gaps}"] if gaps else []
    notes += [absent[channel] for channel in sorted(seen - needed) if channel in absent]
    return ready, replace(open_, effects=taken, refused=refused, alike=frozenset(alike), notes=tuple(notes))


def without_gaps(layout: Layout, channels: Collection[str]) -> Layout:
    """The layout without rows in which one of these channels has a gap."""
    masks = tuple(
        mask & np.all([np.isfinite(r.channel(c)) for c in channels], axis=0) if channels else mask
        for r, mask in zip(layout.rows.records, layout.rows.masks, strict=True)
    )
    return replace(layout, rows=replace(layout.rows, masks=masks))


def _absent(layout: Layout, channels: Sequence[str]) -> dict[str, str]:
    """Why the rows do not allow some of the channels: they are missing or, alone or with those that have fewer, their
    gaps leave too few rows.
    """
    pairs = list(zip(layout.rows.records, layout.rows.masks, strict=True))
    reasons = {
        channel: f"{record.name} has no channel '{channel}'"
        for channel in channels for record, _ in reversed(pairs) if channel not in record.channels
    }  # fmt: skip
    known = {c: [np.isfinite(r.channels[c]) for r, _ in pairs] for c in channels if c not in reasons}
    alone = {c: [float(np.mean(own[m])) for own, (_, m) in zip(each, pairs, strict=True)] for c, each in known.items()}
    left = [mask for _, mask in pairs]
    for channel in sorted(known, key=lambda c: -min(alone[c])):
        together = [mask & own for mask, own in zip(left, known[channel], strict=True)]
        shares = [float(np.sum(rows) / np.sum(mask)) for rows, (_, mask) in zip(together, pairs, strict=True)]
        place = int(np.argmin(shares))
        if shares[place] >= LEAST_PRESENT:
            left = together
            continue
        own = alone[channel][place] < LEAST_PRESENT
        share, words = (alone[channel][place], "") if own else (shares[place], " beside those of other channels")
        reasons[channel] = (
            f"{pairs[place][0].name}: channel '{channel}' has values{words} in only {100 * share:.0f} % of the rows"
        )
    return reasons
