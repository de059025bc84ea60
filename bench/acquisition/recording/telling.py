"""What was left out of a run, told: entries of the manifest, and events."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.acquisition.recording.tables import Grid
from bench.acquisition.recording.validity import AIR, Cleaner
from bench.base import FloatArray

MOST_TOLD = 20
"""Stretches of one reason that are listed, and told as events of their own."""


@dataclass(frozen=True)
class _Stretch:
    why: str
    channel: str
    from_s: float
    to_s: float
    samples: int
    duration_s: float


@dataclass(frozen=True)
class Found:
    """What was left out of one part of a run."""

    spells: tuple[_Stretch, ...]
    nulled: int
    """Rate samples that would have been taken for valid."""

    @classmethod
    def of(cls, cleaner: Cleaner, grid: Grid) -> Found:
        """With bench times; stretches without a sample are none."""
        interval_s, found = grid.clock.interval_s, []
        for spell, samples in zip(cleaner.spells, cleaner.samples, strict=True):
            if samples:
                from_s, to_s = (round(float(t), 3) for t in grid.clock.time(np.array([spell.first, spell.end])))
                found.append(_Stretch(spell.why, spell.channel, from_s, to_s, samples, round(samples * interval_s, 3)))
        return cls((*found, *_air(grid)), cleaner.nulled)


def _air(grid: Grid) -> Iterator[_Stretch]:
    """Readings of the chamber's air that cannot be."""
    t_s: FloatArray = grid.readings["t_s"]
    rows = np.flatnonzero(~grid.sound_air & np.isfinite(grid.readings["temperature"]))
    for part in np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1) if len(rows) else ():
        from_s, to_s = float(t_s[part[0]]), float(t_s[min(part[-1] + 1, len(t_s) - 1)])
        length_s = round(to_s - from_s, 3)
        yield _Stretch("air of the chamber jumps", AIR, round(from_s, 3), round(to_s, 3), len(part), length_s)


def left_out(found: Sequence[Found]) -> list[dict[str, Any]]:
    """By reason, the longest first."""
    by_reason: dict[tuple[str, str], list[_Stretch]] = {}
    for stretch in (stretch for one in found for stretch in one.spells):
        by_reason.setdefault((stretch.why, stretch.channel), []).append(stretch)
    entries = [
        {
            "why": why,
            "channel": channel,
            "from_s": stretches[0].from_s,
            "to_s": stretches[-1].to_s,
            "samples": sum(stretch.samples for stretch in stretches),
            "duration_s": round(sum(stretch.duration_s for stretch in stretches), 3),
            "spans": [[stretch.from_s, stretch.to_s] for stretch in stretches[:MOST_TOLD]],
        }
        for (why, channel), stretches in by_reason.items()
    ]
    return sorted(entries, key=lambda entry: (-float(str(entry["duration_s"])), str(entry["why"])))


def told(found: Sequence[Found]) -> Iterator[dict[str, Any]]:
    """An event for each stretch, of each reason the first ones."""
    counts: dict[str, int] = {}
    for stretch in (stretch for one in found for stretch in one.spells):
        counts[stretch.why] = counts.get(stretch.why, 0) + 1
        if counts[stretch.why] <= MOST_TOLD:
            what = "readings" if stretch.channel == AIR else "samples"
            text = f"{stretch.why}: {stretch.samples} {what} left out, {stretch.from_s:.1f} to {stretch.to_s:.1f} s"
            yield {"t_s": stretch.from_s, "kind": "left_out", "text": text, "why": stretch.why, "to_s": stretch.to_s}
