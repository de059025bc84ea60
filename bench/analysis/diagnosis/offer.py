"""What may be missing in a model: effects whose channels the runs have, in the rows that have values of them."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bench.analysis.diagnosis.candidates import Candidate
from bench.analysis.diagnosis.suspects import CHANNELS, Layout
from bench.analysis.effects import registry as effects
from bench.analysis.effects.base import Effect
from bench.analysis.effects.catalogue import suspected
from bench.analysis.effects.model import Model
from bench.analysis.thresholds import LEAST_PRESENT
from bench.base import InputError
from bench.record import Dataset


@dataclass(frozen=True, eq=False)
class Offer:
    """Effects that may be missing, by the name of their candidate, and why the others cannot be judged.

    Those of the names `alike` act in the isothermal run in the same size.
    """

    effects: Mapping[str, Effect]
    refused: Mapping[str, str]
    alike: frozenset[str] = frozenset()
    notes: tuple[str, ...] = ()
    """How many rows are left out for gaps, and which channels have too many that no effect needs."""

    def candidates(self, layout: Layout) -> list[Candidate]:
        """All that the layout's model does not have yet."""
        have = {effect.name for effect in layout.rows.model.effects}
        return [layout.candidate(e, name, name in self.alike) for name, e in self.effects.items() if e.name not in have]


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


def offer(layout: Layout, wanted: Sequence[Effect]) -> tuple[Layout, Offer]:
    """Candidates for these effects, in all their shapes, and the layout without rows in which their channels have gaps.

    An effect whose channel is missing, constant or has many gaps is refused with the reason.
    """
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
    return ready, Offer(taken, refused, frozenset(alike), tuple(notes))


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
