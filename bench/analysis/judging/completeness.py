"""Whether the run reached its end and its data are complete, from manifest and tables, before any model."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from bench.analysis.thresholds import LONGEST_GAP_S, MOST_LEFT_OUT, MOST_MISSING_PPM
from bench.base import InputError, clock, finite, number
from bench.record import Capture, Dataset, ExecutedSegment, LeftOut, Manifest, RunFolder, SampleFile, UnitClock, use

SAMPLES = ("lost", "slow_lost")
CAUSES = ("corrupt", "late", "invalid")
DAMAGED_BYTES = "journal_damaged_bytes"
LOST = (*SAMPLES, *CAUSES, DAMAGED_BYTES)
"""Loss counters that mean data are missing; the others (repeated, out of order) cost nothing."""

RESUMED = " (resumed)"
"""Ends the name of a segment that continues an earlier one."""
_GAP = 2.0
"""Neighbours further apart than this many intervals have a gap between them."""


@dataclass(frozen=True)
class Completeness:
    """What of the run is there. `missing` counts unit samples [1], None where the sampling rate is not known."""

    state: str = "unknown"
    cause: str = ""
    duration_s: float = 0.0
    samples: int = 0
    missing: int | None = None
    gaps_s: tuple[tuple[float, float], ...] = ()
    losses: Mapping[str, int] = field(default_factory=dict)
    segments: tuple[ExecutedSegment, ...] = ()
    temperature: tuple[float, float] | None = None
    heating_s: float = 0.0
    cooling_s: float = 0.0
    unit_clock: UnitClock | None = None
    capture: Capture | None = None
    left_out: tuple[LeftOut, ...] = ()
    """What of the record is no measurement, by reason."""
    between_s: tuple[tuple[float, float], ...] = ()
    """Gaps between the parts of a resumed run, which are judged by themselves."""
    rate_hz: float | None = None

    @property
    def failed(self) -> tuple[ExecutedSegment, ...]:
        """Segments that did not reach their goal; the stretches that were found in an imported record had none."""
        planned = ((i, s) for i, s in enumerate(self.segments) if s.outcome != "detected")
        return tuple(s for i, s in planned if (not s.settled or s.outcome == "timeout") and not self._went_on(i))

    def _went_on(self, index: int) -> bool:
        """A segment that was held, or cut off with the bench, and continued by a later one."""
        segment = self.segments[index]
        base = segment.name.split(RESUMED)[0]
        later = (other.name for other in self.segments[index + 1 :])
        return segment.outcome in {"held", "interrupted"} and any(n.startswith(base + RESUMED) for n in later)

    @property
    def ended(self) -> bool:
        """Whether the run or the import reached its end and every segment its goal."""
        return self.state in {"done", "imported"} and not self.failed

    @property
    def left_out_share(self) -> float:
        """Share of the rate samples, or of the chamber's readings, that were left out because they are not valid."""
        invalid = int(self.losses.get("invalid") or 0)
        rate = invalid / (self.samples + invalid) if invalid else 0.0
        air_s = sum(entry.duration_s for entry in self.left_out if entry.channel == "chamber_temperature")
        return max(rate, air_s / self.duration_s if air_s and self.duration_s else 0.0)

    @property
    def whole(self) -> bool:
        """Whether the run reached its end and nothing of it had to be left out as not valid."""
        return self.ended and not self.left_out_share

    @property
    def lost(self) -> int | None:
        """Frames that were lost or damaged; None where they were not counted."""
        if not self.losses:
            return None
        count = {key: int(self.losses.get(key) or 0) for key in LOST}
        # A corrupt frame is also a lost sample: counted once.
        samples = sum(count[key] for key in SAMPLES)
        return samples or max(*(count[key] for key in CAUSES), min(count[DAMAGED_BYTES], 1))

    @property
    def missing_ppm(self) -> float:
        """Share of samples that are missing, whatever took them, without the gaps between parts; NaN: not known."""
        if not self.samples:
            return np.nan
        known = [count for count in (self.lost, self.unplanned) if count is not None]
        missing = max(known, default=np.nan)
        return 1e6 * missing / (self.samples + missing)

    @property
    def unplanned(self) -> int | None:
        """Samples missing between the first and the last, without the gaps between parts and those without power."""
        between = sum(b - a for a, b in self.between_s) * (self.rate_hz or 0.0)
        return None if self.missing is None else max(0, self.missing - round(between))

    @property
    def longest_gap_s(self) -> float:
        """Longest stretch without a sample [s] that is not between two parts."""
        own = [b - a for a, b in self.gaps_s if not any(a < end and start < b for start, end in self.between_s)]
        return max(own, default=0.0)

    def lacking(self, limited: Iterable[str] = ()) -> Iterator[str]:
        """Why too much is missing for any verdict, by the default limits of what is not `limited` by others."""
        if "samples_missing_ppm" not in limited and self.missing_ppm > MOST_MISSING_PPM:
            share, most = f"{1e-4 * self.missing_ppm:.1f} %", f"{1e-4 * MOST_MISSING_PPM:g} %"
            yield f"{share} of the samples are missing, at most {most} may be"
        if self.left_out_share > MOST_LEFT_OUT:
            why = ", ".join(f"{entry.why} ({number(entry.duration_s)} s)" for entry in self.left_out)
            yield (
                f"{self.left_out_share:.1%} of its data are no measurements, {MOST_LEFT_OUT:.0%} allowed: "
                f"{why or 'marked by the unit'}"
            )
        if "longest_gap_s" not in limited and self.longest_gap_s > LONGEST_GAP_S:
            longest, most = clock(self.longest_gap_s), f"{LONGEST_GAP_S:g} s"
            yield f"there is no sample for {longest}, at most {most} may pass without one"

    def counts(self) -> dict[str, float | None]:
        """What is there and what is not, for programs; null where it was not counted."""
        return {
            "samples": self.samples,
            "lost": self.lost,
            "missing": self.unplanned,
            "missing_ppm": finite(self.missing_ppm),
            "longest_gap_s": self.longest_gap_s if self.samples else None,
            "left_out": int(self.losses.get("invalid") or 0),
            "left_out_share": self.left_out_share,
        }

    @property
    def counted(self) -> str:
        """The same in words."""
        lost = "losses not counted" if self.lost is None else f"{self.lost} lost"
        missing = "" if self.unplanned is None else f", {self.unplanned} missing"
        gap = f", longest gap {number(self.longest_gap_s)} s" if self.samples else ""
        return f"{self.samples} samples, {lost}{missing}, {self.losses.get('invalid') or 0} left out as invalid{gap}"


def completeness(run: RunFolder, manifest: Manifest, base: Dataset | None) -> Completeness:
    """Completeness of a run folder; `base` are its 1 s means, None without them.

    InputError where the tables are not those that were recorded.
    """
    use(run.path, run.means.name, run.data.name)
    known = Completeness(
        state=manifest.state,
        cause=manifest.cause,
        losses=manifest.losses,
        segments=manifest.segments,
        unit_clock=manifest.unit_clock,
        capture=manifest.capture,
        left_out=manifest.left_out,
        between_s=tuple(_between(manifest)),
        rate_hz=manifest.sample_rate_hz,
    )
    if base is None or len(base) == 0:
        return known
    samples, missing = _samples(run, base, manifest.sample_rate_hz)
    temperature = base.channel("temperature")
    return replace(
        known,
        duration_s=float(base.time[-1] - base.time[0]) + base.interval_s,
        samples=samples,
        missing=missing,
        gaps_s=_gaps(base, manifest),
        temperature=(float(np.nanmin(temperature)), float(np.nanmax(temperature))),
        heating_s=float(np.sum(base.direction > 0) * _each_s(base)),
        cooling_s=float(np.sum(base.direction < 0) * _each_s(base)),
    )


def _each_s(base: Dataset) -> float:
    """Time [s] for which a row stands whose slope is known: a log may have a temperature once a minute."""
    known = base.time[np.isfinite(base.dT_dt)]
    return max(base.interval_s, float(np.median(np.diff(known)))) if known.size > 1 else base.interval_s


def _samples(run: RunFolder, base: Dataset, rate_hz: float | None) -> tuple[int, int | None]:
    """Unit samples present, and missing between the first and the last of the 500 Hz table."""
    counted = int(base.count("rate").sum())
    try:
        with SampleFile(run.data) as table:
            first, last = (
                _edge(table, base.output, table.groups, 0),
                _edge(table, base.output, reversed(table.groups), -1),
            )
    except InputError:  # no table, or a damaged one: the means still say how many there are
        return counted, None
    if not rate_hz or first is None or last is None:
        return counted, None
    return counted, max(0, round((last - first) * rate_hz) + 1 - counted)


def _edge(table: SampleFile, output: str, groups: Iterable[int], end: int) -> float | None:
    """Time [s] of the first (0) or last (-1) sample of an output; reads one row group, seldom more."""
    for group in groups:
        rows = table.read(["time", output], [group])
        present = rows["time"][np.isfinite(rows[output])]
        if present.size:
            return float(present[end])
    return None


def _gaps(base: Dataset, manifest: Manifest) -> tuple[tuple[float, float], ...]:
    """Spans [s] without a single rate sample, also before the first and after the last of the segments.

    Not those in which the unit's power was off on purpose, nor the time between two samples of a slow log.
    """
    edge = 0.5 * base.interval_s
    usual_s = max(base.interval_s, 1.0 / manifest.sample_rate_hz if manifest.sample_rate_hz else 0.0)
    present = base.time[np.isfinite(base.channel("rate"))].tolist()
    if manifest.segments and present:
        ends = manifest.segments[0].from_s - edge, manifest.segments[-1].to_s + edge
        present = [*(ends[:1] if ends[0] < present[0] else ()), *present, *(ends[1:] if ends[1] > present[-1] else ())]
    spans = ((a + edge, b - edge) for a, b in pairwise(present) if b - a > _GAP * usual_s)
    planned = tuple((from_s - 2 * edge, to_s + 2 * edge) for from_s, to_s in _without_power(manifest))
    return tuple((a, b) for a, b in spans if not any(from_s <= a and b <= to_s for from_s, to_s in planned))


def _without_power(manifest: Manifest) -> Iterator[tuple[float, float]]:
    """Segments [s] in which the unit's power was off on purpose."""
    return ((segment.from_s, segment.to_s) for segment in manifest.segments if segment.kind == "power_cycle")


def _between(manifest: Manifest) -> Iterator[tuple[float, float]]:
    """Gaps [s] that are no loss: between parts whose ends are known, and while the unit's power was off on purpose."""
    yield from _without_power(manifest)
    for gap in (part.gap for part in manifest.parts):
        if gap is not None and gap.from_s is not None and gap.to_s is not None:
            yield gap.from_s, gap.to_s
