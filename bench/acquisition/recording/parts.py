"""The parts of a run whose bench was started more than once for it, and what can be known of the gaps between them.

A unit that kept its power went on counting samples while nobody listened: the counter of the first frame after the gap
is then where the unit's clock before the gap says that it should be. A unit that was switched off starts to count anew,
and its turn-on bias may be another one.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from bench.acquisition.recording.journals import BenchJournal
from bench.acquisition.recording.recorder import BENCH_JOURNAL
from bench.record import ExecutedSegment, RunFolder
from drivers.journal import Kind, read_blocks
from drivers.samples import SampleClock

Power = Literal["kept", "lost", "unknown"]

HOST_S = 0.5
"""The calendar clock that bridges the gap is taken to be this good [s] …"""
HOST_PPM = 100.0
"""… and it, or the unit's clock, to run this wrong [ppm]."""
_DECISIVE = 0.05
"""A counter whose allowed error is a larger share of its range than this agrees by chance too often."""


@dataclass(frozen=True)
class Counted:
    """What one part tells of the unit's sample counter."""

    samples: int
    resets: int
    clock: SampleClock
    bits: int


def power(before: Counted, after: Counted, gap_s: float) -> tuple[Power, float | None]:
    """Whether the unit kept its power over a gap, and how far its counter is from where it should be then [s]."""
    if not before.samples or not after.samples or before.resets or not before.bits:
        return "unknown", None
    interval_s, allowed_s = before.clock.interval_s, HOST_S + HOST_PPM * 1e-6 * gap_s
    whole = 1 << before.bits
    start_s = float(before.clock.time(0))
    slope_s = (float(before.clock.time(whole)) - start_s) / whole
    expected = round((float(after.clock.time(0)) - start_s) / slope_s)
    off_s = ((-expected + whole // 2) % whole - whole // 2) * interval_s
    if allowed_s > _DECISIVE * whole * interval_s:
        return "unknown", off_s
    return ("kept" if abs(off_s) <= allowed_s else "lost"), off_s


def describe(journals: Sequence[BenchJournal], counted: Sequence[Counted]) -> list[dict[str, Any]]:
    """An entry of the manifest for each part; those after the first tell the gap before them."""
    entries: list[dict[str, Any]] = []
    for number, journal in enumerate(journals, 1):
        times = journal.readings["t_s"]
        entry: dict[str, Any] = {
            "part": number,
            "from_s": float(times[0]) if len(times) else None,
            "to_s": float(times[-1]) if len(times) else None,
            **journal.outcome(),
            "versions": journal.meta.versions,
        }
        gap = next((event for event in journal.events if event["kind"] == "gap"), None)
        if number > 1 and gap is not None:
            kept, off_s = power(counted[number - 2], counted[number - 1], gap["duration_s"])
            facts = {key: value for key, value in gap.items() if key not in {"kind", "utc", "t_s"}}
            entry["gap"] = {**facts, "unit_power": kept, "counter_off_s": None if off_s is None else round(off_s, 3)}
        entries.append(entry)
    return entries


def recorded(run: RunFolder) -> list[RunFolder]:
    """The parts that hold a record: a bench that was killed while it opened a further one has left nothing there."""
    first, *others = run.parts()
    return [first, *(part for part in others if _has_meta(part.journal / BENCH_JOURNAL))]


def _has_meta(path: Path) -> bool:
    return path.exists() and any(block.kind is Kind.META for block in itertools.islice(read_blocks(path), 1))


def apart(journals: Sequence[BenchJournal]) -> list[BenchJournal]:
    """The same, each with the events of its own watchdog only: they share a file."""
    starts = [journal.events[0]["t_s"] if journal.events else 0.0 for journal in journals]
    ends = [*starts[1:], math.inf]
    return [
        replace(journal, watchdog=[event for event in journal.watchdog if start <= event["t_s"] < end])
        for journal, start, end in zip(journals, [-math.inf, *starts[1:]], ends, strict=True)
    ]


def segments(journals: Sequence[BenchJournal]) -> list[ExecutedSegment]:
    """Executed segments of all parts, numbered through, each with its turn-on."""
    together = [segment for journal in journals for segment in journal.segments()]
    turn_ons = itertools.accumulate((segment.kind == "power_cycle" for segment in together), initial=1)
    next(turn_ons)
    return [
        segment.model_copy(update={"index": index, "turn_on": number})
        for index, (segment, number) in enumerate(zip(together, turn_ons, strict=True))
    ]


def turn_ons_after(
    segments: Sequence[ExecutedSegment], journals: Sequence[BenchJournal], counted: Sequence[Counted]
) -> list[ExecutedSegment]:
    """The same segments; where the unit lost its power over the gap between two parts, another turn-on begins."""
    lost_s = [
        part["from_s"] or 0.0 for part in describe(journals, counted) if part.get("gap", {}).get("unit_power") == "lost"
    ]
    return [
        segment.model_copy(update={"turn_on": segment.turn_on + sum(segment.to_s > at_s for at_s in lost_s)})
        for segment in segments
    ]
