"""Journals → tables of the run folder: `data.parquet`, `means.parquet`, `events.jsonl`, `manifest.json`.

The same code finishes a run and recovers a killed one: it needs nothing but the journals. Rows of `data.parquet` are
ticks of the unit's sample counter; a chamber reading stands on the tick nearest to it; what was not sampled is null.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bench.acquisition.recording import parts as parted
from bench.acquisition.recording.journals import BenchJournal, bus_blocks, fetch, pack_journals, read_bench
from bench.acquisition.recording.parts import Counted
from bench.acquisition.recording.tables import Grid, write_data
from bench.acquisition.recording.telling import Found, left_out, told
from bench.acquisition.recording.validity import LAG_MIN, MARGIN_DEGC, Cleaner, Spell, Validity
from bench.record import EVENTS, LAYOUT, ExecutedSegment, GyroKind, Manifest, RunFolder, write_events, write_means
from drivers.frames import joined
from drivers.gyro import GyroBlock, GyroDecoder, SampleClock
from drivers.journal import Damage, FrameArray

FRAMES_AT_ONCE = 1 << 15


@dataclass(frozen=True)
class Decoded:
    """A decoder that has seen all frames of a run, and the clock it found; live, or from the journal."""

    decoder: GyroDecoder
    clock: SampleClock


@dataclass
class _Part:
    """One part of a run, ready to be written."""

    run: RunFolder
    journal: BenchJournal
    seen: Decoded

    def blocks(self, decoder: GyroDecoder, damage: Damage, bus_events: list[dict[str, Any]]) -> Iterator[GyroBlock]:
        """What `decoder` makes of its frames."""
        source = self.run.journal / f"{self.journal.gyro.bus}.gtbj"
        frames = bus_blocks(source, damage, bus_events, self.journal.sound_until_ns())
        return _decoded(decoder, _joined(frames), self.journal.power_ons_ns())

    def decoder(self) -> GyroDecoder:
        """A decoder that has seen nothing yet."""
        return decoder_of(self.run.path, self.journal.gyro)

    def grid(self, segments: Sequence[ExecutedSegment]) -> Grid:
        """Where readings of chamber and table can be placed: no sample, no clock to place them on."""
        kept = None if self.seen.decoder.samples else 0
        journal = self.journal
        sources = journal.readings[:kept], journal.table[:kept], journal.instruments[:kept]
        return Grid(*sources, segments, self.seen.clock)

    def counted(self) -> Counted:
        """What it tells of the unit's counter."""
        decoder = self.seen.decoder
        return Counted(decoder.samples, decoder.restarts, self.seen.clock, decoder.counter_bits)


def assemble(run: RunFolder, live: Decoded | None = None, *, keep: bool = False) -> Manifest:
    """Make the tables and the manifest of a run from the journals of all its parts; returns the manifest.

    `live` saves a pass over the frames of the last part when they were decoded already. The journals are packed, unless
    `keep` says to leave them as they are. InputError when there is nothing to make a run from, OSError when the disk
    does not take the tables.
    """
    damage = Damage()
    bus_events: list[dict[str, Any]] = []
    folders = parted.recorded(run)
    parts = [_part(part, live if part == folders[-1] else None, damage) for part in folders]
    journals = parted.apart([part.journal for part in parts])
    first, last = journals[0], journals[-1]
    segments = parted.segments(journals)
    rows, decoders, found = _tables(run, parts, segments, damage, bus_events)
    write_means(run.data, run.means)
    events = [event for journal in journals for event in (*journal.events, *journal.watchdog)]
    capture, news = _capture(bus_events)
    events = sorted((*events, *news, *told(found)), key=lambda event: float(event["t_s"]))
    write_events(run.path / EVENTS, events)
    if not keep:
        for part in parts:
            pack_journals(part.run, part.journal.meta)
    seen = max((part.seen for part in parts), key=lambda seen: seen.decoder.samples)
    losses = [decoder.losses.as_dict() for decoder in decoders]
    identities = [identity for decoder in decoders if (identity := decoder.identity) is not None]
    readings = np.concatenate([journal.readings for journal in journals])
    content = {
        **first.meta.content(),
        **last.outcome(),
        "sample_rate_hz": round(1 / seen.decoder.interval_s),
        "rate_step_dph": seen.decoder.rate_step_dph,
        "unit_clock": asdict(seen.clock.estimate()) if seen.decoder.samples else None,
        "capture": capture,
        "unit_identity": asdict(identities[-1]) if identities else None,
        "rows": rows,
        "duration_s": float(readings["t_s"][-1]) if len(readings) else 0.0,
        "segments": parted.turn_ons_after(segments, journals, [part.counted() for part in parts]),
        "losses": {
            **{name: sum(loss[name] for loss in losses) for name in losses[0]},
            "invalid": sum(loss["invalid"] for loss in losses) + sum(one.nulled for one in found),
            "journal_damaged_bytes": damage.skipped_bytes + damage.torn_bytes,
        },
        **({"left_out": left_out(found)} if any(one.spells for one in found) else {}),
        **({"parts": parted.describe(journals, [part.counted() for part in parts])} if len(parts) > 1 else {}),
        "files": run.hashes(),
    }
    manifest = Manifest.model_validate(content)
    manifest.write(run.path)
    return manifest


def decoder_of(run: Path, gyro: GyroKind) -> GyroDecoder:
    """A decoder that has seen nothing yet, by the DBC in the run folder; older runs have none."""
    own = run / LAYOUT
    return GyroDecoder(str(own) if own.is_file() else gyro.layout or None, gyro.number, gyro.signals)


def _capture(said: Sequence[dict[str, Any]]) -> tuple[dict[str, Any] | None, list[dict[str, Any]]]:
    """How captures kept up with the bus, None where nobody says so; and what they said that is news."""
    behind_ms = [event["most_behind_ms"] for event in said if "most_behind_ms" in event]
    ends = [event for event in said if "behind_spells" in event]
    kept_up = {
        "most_behind_s": max(behind_ms, default=0) * 1e-3,
        "behind_spells": sum(event["behind_spells"] for event in ends),
        **{name: sum(event[name] for event in ends) for name in ("error_frames", "unreadable", "recoveries")},
    }
    return kept_up if behind_ms else None, [event for event in said if "no_news" not in event]


def _tables(
    run: RunFolder,
    parts: Sequence[_Part],
    segments: Sequence[ExecutedSegment],
    damage: Damage,
    bus_events: list[dict[str, Any]],
) -> tuple[int, list[GyroDecoder], list[Found]]:
    """Write `data.parquet`; its rows, the decoder of each part, and what was left out of it.

    What is not valid shows at the end only. A run in which something is not is written again without it.
    """
    grids = [part.grid(segments) for part in parts]
    decoders = [part.decoder() for part in parts]
    judges = [
        Validity(decoder, raw=part.journal.meta.purpose != "verification")
        for part, decoder in zip(parts, decoders, strict=True)
    ]
    streams = [
        _watched(part.blocks(decoder, damage, bus_events), judge)
        for part, decoder, judge in zip(parts, decoders, judges, strict=True)
    ]
    wires = [decoder.codes for decoder in decoders]  # the first output first
    rows = write_data(run.data, list(zip(streams, grids, strict=True)), wires)
    spells = [_spells(*each) for each in zip(parts, judges, grids, strict=True)]
    cleaners = [Cleaner(found) for found in spells]
    if any(spells):
        cleaned = [
            cleaner.clean(part.blocks(part.decoder(), Damage(), []))
            for part, cleaner in zip(parts, cleaners, strict=True)
        ]
        rows = write_data(run.data, list(zip(cleaned, grids, strict=True)), wires)
    found = [Found.of(cleaner, grid) for cleaner, grid in zip(cleaners, grids, strict=True)]
    return rows, decoders, found


def _watched(blocks: Iterator[GyroBlock], judge: Validity) -> Iterator[GyroBlock]:
    for block in blocks:
        judge.take(block)
        yield block


def _spells(part: _Part, judge: Validity, grid: Grid) -> list[Spell]:
    meta = part.journal.meta
    segments = part.journal.segments()
    ends = np.array([segments[0].from_s, segments[-1].to_s] if segments and len(grid.read_at) else [])
    window = grid.nearest(ends).tolist() or [0, 0]
    margin = MARGIN_DEGC if meta.unit_margin_degc is None else meta.unit_margin_degc
    lag = LAG_MIN if meta.unit_lag_min is None else meta.unit_lag_min
    return judge.close((window[0], window[1]), grid.air(), (margin, lag))


def _part(run: RunFolder, live: Decoded | None, damage: Damage) -> _Part:
    bench = read_bench(run, damage)
    gyro = bench.gyro
    source = run.journal / f"{gyro.bus}.gtbj"
    fetch(run, bench.meta, source.relative_to(run.path))
    if live is not None and not live.decoder.counter_bits:
        live = None  # what is counted by times of arrival depends on how the frames were cut into blocks
    return _Part(run, bench, live or _decode_all(run, source, bench))


def _decode_all(run: RunFolder, source: Path, bench: BenchJournal) -> Decoded:
    """A first pass over the frames: their losses and the unit's clock."""
    gyro, on_ns = bench.gyro, bench.power_ons_ns()
    decoder = decoder_of(run.path, gyro)
    clock = SampleClock(decoder.interval_s)
    for decoded in _decoded(decoder, _joined(bus_blocks(source, Damage(), [], bench.sound_until_ns())), on_ns):
        clock.add(decoded.index, decoded.t_ns)
    return Decoded(decoder, clock)


def _decoded(decoder: GyroDecoder, blocks: Iterable[FrameArray], power_ons_ns: Sequence[int]) -> Iterator[GyroBlock]:
    """What `decoder` makes of frames; it is told each time [ns] that the unit was switched on again on purpose."""
    due = list(power_ons_ns)
    for block in blocks:
        rest = block
        while due and len(rest) and rest["t_ns"][-1] >= due[0]:
            at = int(np.argmax(rest["t_ns"] >= due.pop(0)))
            if at:
                yield decoder.decode(rest[:at])
            decoder.power_on()
            rest = rest[at:]
        yield decoder.decode(rest)


def _joined(blocks: Iterable[FrameArray]) -> Iterator[FrameArray]:
    """The same frames in fewer, larger blocks: they decode several times faster."""
    waiting: list[FrameArray] = []
    count = 0
    for block in blocks:
        waiting.append(block)
        count += len(block)
        if count >= FRAMES_AT_ONCE:
            yield joined(waiting)
            waiting, count = [], 0
    if waiting:
        yield joined(waiting)
