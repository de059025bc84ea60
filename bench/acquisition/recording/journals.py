"""What the journals of a run say: meta, events and readings of the bench, frames of a bus, the watchdog's last words.

Units in one chamber have a run folder each. The journal of a bus that several are on is one file with a name in each
folder; where the file system has no such links, a folder fetches its copy from the first one.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bench.acquisition.recording.recorder import BENCH_JOURNAL, INSTRUMENT, READING
from bench.base import InputError, NotResumableError
from bench.record import (
    MANIFEST,
    Begun,
    ExecutedSegment,
    GyroKind,
    RunFolder,
    copy_whole,
    read_events,
    share_again,
)
from drivers.journal import Damage, FrameArray, Kind, read_blocks
from drivers.packing import pack
from drivers.rate_table import TABLE

WATCHDOG = "watchdog.jsonl"
"""Events of the watchdog, one JSON object a line, in the run folder."""
KILLED = "the bench was killed"

BEFORE_S = 0.1
"""Units are silent for longer than this before their power comes on [s]; stamps of frames and events differ by less."""

Readings = np.ndarray[Any, np.dtype[np.void]]


@dataclass(frozen=True)
class BenchJournal:
    """What the bench's own journal says."""

    meta: Begun
    events: list[dict[str, Any]]
    readings: Readings
    table: Readings
    """Encoder of the rate table."""
    instruments: Readings
    """Values of the instruments of the station."""
    watchdog: list[dict[str, Any]]
    """What the watchdog did after the bench was killed."""

    def end(self) -> dict[str, Any] | None:
        """The event that ended the run; None when the bench was killed before."""
        return next((event for event in reversed(self.events) if event["kind"] == "end"), None)

    def outcome(self) -> dict[str, Any]:
        """How the run ended; of a bench that was killed the watchdog may tell what became of the equipment."""
        if end := self.end():
            return {"state": end["state"], "cause": end["text"]}
        cause = f"{KILLED}; recovered from its journals"
        if not self.watchdog:
            return {"state": "aborted", "cause": cause}
        failed = [event["text"] for event in self.watchdog if event.get("ok") is False]
        if not failed:
            return {"state": "aborted", "cause": f"{cause}; made safe by the watchdog"}
        return {"state": "failed", "cause": f"{cause}; SAFE STATE NOT VERIFIED by the watchdog: {'; '.join(failed)}"}

    def sound_until_ns(self) -> int | None:
        """Bench time [ns] of the last frame that belongs to the unit, where it left a run of several."""
        until_s = (self.end() or {}).get("sound_until_s")
        return None if until_s is None else round(until_s * 1e9)

    def power_ons_ns(self) -> list[int]:
        """Bench times [ns] just before the units were switched on again on purpose: nothing comes then."""
        switched = (event for event in self.events if event["kind"] == "power" and event["on"])
        return [round((event["t_s"] - BEFORE_S) * 1e9) for event in switched]

    @property
    def gyro(self) -> GyroKind:
        """How the frames of this part are decoded."""
        if self.meta.gyro is None:
            raise InputError(f"the journal of run {self.meta.run} does not say how the unit's frames are decoded")
        return self.meta.gyro

    def segments(self) -> list[ExecutedSegment]:
        """Executed segments; one that a kill cut off, or that the unit left, ends with the last reading."""
        done = [event for event in self.events if event["kind"] == "segment" and event["phase"] == "end"]
        started = [event for event in self.events if event["kind"] == "segment" and event["phase"] == "start"]
        segments = [dict(event["segment"]) for event in done]
        if len(started) > len(done):
            to_s = float(self.readings["t_s"][-1]) if len(self.readings) else started[-1]["t_s"]
            end = self.end()
            cut = {"to_s": to_s, "outcome": "interrupted", "reason": end["text"] if end else KILLED}
            segments.append({**started[-1]["segment"], **cut})
        return [
            ExecutedSegment.model_validate({**segment, "settled": segment["outcome"] in ("done", "ended")})
            for segment in segments
        ]


def read_bench(run: RunFolder, damage: Damage) -> BenchJournal:
    """Meta, events and readings; NotResumableError when the journal is missing or holds no meta block."""
    path = run.journal / BENCH_JOURNAL
    meta: Begun | None = None
    events: list[dict[str, Any]] = []
    rows: list[bytes] = []
    turned: list[bytes] = []
    measured: list[bytes] = []
    if path.exists():
        for block in read_blocks(path, damage):
            if block.kind is Kind.META:
                meta = Begun.model_validate_json(block.payload)
            elif block.kind is Kind.EVENT:
                events.append(json.loads(block.payload))
            elif block.kind is Kind.READING:
                rows.append(block.payload)
            elif block.kind is Kind.TABLE:
                turned.append(block.payload)
            elif block.kind is Kind.INSTRUMENT:
                measured.append(block.payload)
    if meta is None:
        raise NotResumableError("not a run folder: no manifest and no readable journal", run.path)
    fetch(run, meta, Path(WATCHDOG))
    readings, table = np.frombuffer(b"".join(rows), READING), np.frombuffer(b"".join(turned), TABLE)
    instruments = np.frombuffer(b"".join(measured), INSTRUMENT)
    return BenchJournal(meta, events, readings, table, instruments, _read_watchdog(run.path / WATCHDOG))


def _read_watchdog(path: Path) -> list[dict[str, Any]]:
    """Events that the watchdog left, if any; its last line may be torn."""
    events = []
    for event in read_events(path).sound:
        with contextlib.suppress(ValueError, KeyError, TypeError):
            events.append({"kind": "watchdog", "text": "", **event, "t_s": float(event["t_s"])})
    return events


def fetch(run: RunFolder, meta: Begun, name: Path) -> None:
    """Copy a file that units in the same chamber share and another one's folder holds, where there is no link to it."""
    if (run.path / name).exists():
        return
    for companion in meta.companions:
        source = run.path / companion.run / name
        if source.exists():
            copy_whole(source, run.path / name)
            return


def pack_journals(run: RunFolder, meta: Begun) -> None:
    """Pack the journals of one part of a run that has ended; those that units in one chamber share stay one file."""
    for path in sorted(run.journal.glob("*.gtbj")):
        name = path.relative_to(run.path)
        shared = [
            other
            for companion in meta.companions
            if (other := run.path / companion.run / name).exists()
            and other.samefile(path)
            and not (run.path / companion.run / MANIFEST).exists()  # it lists the file as it is
        ]
        if pack(path):
            for other in shared:
                share_again(path, other)


def bus_blocks(
    source: Path, damage: Damage, events: list[dict[str, Any]], until_ns: int | None = None
) -> Iterator[FrameArray]:
    """Frames of a bus in blocks, up to a bench time [ns]; what its capture had to say goes into `events`."""
    for block in read_blocks(source, damage) if source.exists() else ():
        if block.kind is Kind.FRAMES:
            frames = block.frames()
            yield frames if until_ns is None else frames[frames["t_ns"] <= until_ns]
        elif block.kind is Kind.EVENT and (until_ns is None or block.t_s * 1e9 <= until_ns):
            events.append({"t_s": round(block.t_s, 3), **json.loads(block.payload)})
