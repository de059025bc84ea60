"""Records a live run: chamber readings, events and what is needed to decode the frames, crash-safe.

Everything goes into append-only journals first (`drivers.journal`); `bench.assemble` makes the tables of the run
folder from them, after the run, or later from what a killed run left.
"""

from __future__ import annotations

import contextlib
import json
import math
import time
from collections.abc import Mapping
from typing import Any

import numpy as np

from bench.store import RunFolder
from drivers.chamber import ChamberReading, Write
from drivers.clock import Clock
from drivers.journal import JournalWriter, Kind
from drivers.registers import Value

READING = np.dtype(
    [
        (name, "<f8")
        for name in ("t_s", "temperature", "setpoint", "working_setpoint", "power", "on", "alarm", "compressor")
    ]
)
"""One chamber reading in the journal; NaN where the controller does not tell."""

BENCH_JOURNAL = "bench.gtbj"
SYNC_INTERVAL_S = 1.0


class Recorder:
    """Writes the bench's own journal and keeps all journals of the run on the disk, once a second of wall time.

    Everything but `close` raises OSError when the disk does not take it.
    """

    def __init__(self, run: RunFolder, clock: Clock, meta: Mapping[str, Any]) -> None:
        self.run = run
        self._clock = clock
        self._journal = JournalWriter(run.journal / BENCH_JOURNAL)
        self._others: list[JournalWriter] = []
        self._synced_wall_s = time.monotonic()
        self._append_json(Kind.META, meta)
        self.sync()

    def keep_synced(self, writer: JournalWriter) -> None:
        """Sync this journal together with our own."""
        self._others.append(writer)

    def event(self, kind: str, text: str, **facts: Any) -> None:
        """Record something that happened, with its numbers."""
        now_s = self._clock.now()
        utc = self._clock.utc().isoformat(timespec="milliseconds")
        self._append_json(Kind.EVENT, {"t_s": round(now_s, 3), "utc": utc, "kind": kind, "text": text, **facts})

    def reading(self, reading: ChamberReading) -> None:
        """Record what the chamber said."""
        row = np.zeros(1, READING)
        for name in READING.names or ():
            value = getattr(reading, name)
            row[name] = math.nan if value is None else float(bool(value) if name == "alarm" else value)
        self._journal.append(Kind.READING, row.tobytes(), 1, reading.t_s, time.time_ns())

    def write(self, write: Write) -> None:
        """Record a register of the chamber that was written, and what it reads back."""
        text = f"{write.register}: {_text(write.old)} -> {_text(write.read_back)}"
        self.event("write", text, register=write.register, value=write.new)

    def tick(self) -> None:
        """Call at every tick: forces the journals to the disk when a second of wall time has passed."""
        if time.monotonic() - self._synced_wall_s >= SYNC_INTERVAL_S:
            self.sync()

    def sync(self) -> None:
        """Force all journals to the disk now."""
        self._synced_wall_s = time.monotonic()
        for writer in (self._journal, *self._others):
            writer.sync()

    def close(self) -> None:
        """Sync and close all journals; a disk that refuses has been told by `sync` before."""
        for writer in (self._journal, *self._others):
            with contextlib.suppress(OSError):
                writer.close()

    def _append_json(self, kind: Kind, content: Mapping[str, Any]) -> None:
        payload = json.dumps(content, allow_nan=False).encode()
        self._journal.append(kind, payload, 1, self._clock.now(), time.time_ns())


def _text(value: Value) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)
