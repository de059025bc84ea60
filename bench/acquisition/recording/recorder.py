"""Records a live run: chamber readings, events and what is needed to decode the frames, crash-safe.

Everything goes into append-only journals first (`drivers.journal`); `assemble` makes the tables of the run folder
from them, after the run, or later from what a killed run left.
"""

from __future__ import annotations

import contextlib
import json
import math
import struct
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

from bench.record import Begun, RunFolder
from drivers.chamber import ChamberReading, Write
from drivers.clock import Clock
from drivers.journal import JournalWriter, Kind
from drivers.rate_table import TableArray
from drivers.registers import Value

READING = np.dtype(
    [
        (name, "<f8")
        for name in ("t_s", "temperature", "setpoint", "working_setpoint", "power", "on", "alarm", "compressor")
    ]
)
"""One chamber reading in the journal; NaN where the controller does not tell."""

_ROW = struct.Struct(f"<{len(READING.names or ())}d")

INSTRUMENT = np.dtype([("t_s", "<f8"), ("channel", "S32"), ("value", "<f8")])
"""One value of an instrument in the journal, in the unit of its channel."""
InstrumentArray = np.ndarray[Any, np.dtype[np.void]]

BENCH_JOURNAL = "bench.gtbj"
SYNC_INTERVAL_S = 1.0


class Recorder:
    """Writes the bench's own journal and keeps all journals of the run on the disk, once a second of wall time.

    A run with several units has a run folder, and a journal in it, for each: `others` are those after the first, each
    with its meta. Everything goes into all of them until a unit leaves. Everything but `close` raises OSError when the
    disk does not take it.
    """

    def __init__(
        self,
        run: RunFolder,
        clock: Clock,
        meta: Begun,
        *others: tuple[RunFolder, Begun],
        heard: Callable[[Mapping[str, Any]], None] = lambda event: None,
    ) -> None:
        """`heard` is called with the content of each event, and must not wait."""
        folders = ((run, meta), *others)
        self.run = run
        self.runs = tuple(folder for folder, _ in folders)
        self._clock, self._heard = clock, heard
        self._journals = {folder: JournalWriter(folder.journal / BENCH_JOURNAL) for folder in self.runs}
        self._shared: list[JournalWriter] = []
        self._held_back: list[tuple[bytes, float, int]] | None = None  # payload, bench time [s], wall time [ns]
        self._synced_wall_s = time.monotonic()
        for folder, content in folders:
            self._append_json(Kind.META, content.content(), folder)
        self.sync()

    def keep_synced(self, writer: JournalWriter) -> None:
        """Sync this journal together with our own."""
        self._shared.append(writer)

    def event(self, kind: str, text: str, **facts: Any) -> None:
        """Record something that happened, with its numbers."""
        content = self._event(kind, text, facts)
        self._heard(content)
        if self._held_back is None:
            self._append_json(Kind.EVENT, content)
        else:
            self._held_back.append((_json(content), self._clock.now(), time.time_ns()))

    def hold_back(self) -> None:
        """Keep events in memory until `write_held`: what makes equipment safe must not fail for a full disk."""
        self._held_back = []

    def write_held(self) -> None:
        """Record the events that were held back, with the times at which they happened, and hold back no more."""
        held, self._held_back = self._held_back or [], None
        for payload, t_s, wall_ns in held:
            for journal in self._journals.values():
                journal.append(Kind.EVENT, payload, 1, t_s, wall_ns)

    def leave(self, run: RunFolder, text: str, **facts: Any) -> None:
        """The last event of a run folder whose unit leaves; nothing more is recorded there."""
        self._append_json(Kind.EVENT, self._event("end", text, facts), run)
        self._journals.pop(run).close()

    def _event(self, kind: str, text: str, facts: Mapping[str, Any]) -> dict[str, Any]:
        utc = self._clock.utc().isoformat(timespec="milliseconds")
        return {"t_s": round(self._clock.now(), 3), "utc": utc, "kind": kind, "text": text, **facts}

    def reading(self, reading: ChamberReading) -> None:
        """Record what the chamber said."""
        told = {**vars(reading), "alarm": bool(reading.alarm)}
        row = (math.nan if told[name] is None else told[name] for name in READING.names or ())
        self._append(Kind.READING, _ROW.pack(*row), reading.t_s)

    def table(self, readings: TableArray) -> None:
        """Record what the encoder of the rate table said, (n,)."""
        self._append(Kind.TABLE, readings.tobytes(), float(readings["t_s"][-1]))

    def instrument(self, readings: InstrumentArray) -> None:
        """Record what an instrument measured, INSTRUMENT records (n,)."""
        self._append(Kind.INSTRUMENT, readings.tobytes(), float(readings["t_s"][-1]))

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
        for writer in self._writers():
            writer.sync()

    def close(self) -> None:
        """Sync and close all journals; a disk that refuses has been told by `sync` before."""
        for writer in self._writers():
            with contextlib.suppress(OSError):
                writer.close()

    def _writers(self) -> Iterator[JournalWriter]:
        yield from self._journals.values()
        yield from self._shared

    def _append_json(self, kind: Kind, content: Mapping[str, Any], run: RunFolder | None = None) -> None:
        self._append(kind, _json(content), self._clock.now(), run)

    def _append(self, kind: Kind, payload: bytes, t_s: float, run: RunFolder | None = None) -> None:
        wall_ns = time.time_ns()
        for journal in self._journals.values() if run is None else (self._journals[run],):
            journal.append(kind, payload, 1, t_s, wall_ns)


def _json(content: Mapping[str, Any]) -> bytes:
    return json.dumps(content, allow_nan=False).encode()


def _text(value: Value) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)
