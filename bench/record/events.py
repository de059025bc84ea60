"""`events.jsonl` of a run folder, and logs of the same form: an event a line, written and read here."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from bench.record.files import write_atomically

EVENTS = "events.jsonl"


class Events(NamedTuple):
    """What a log says: `t_s` (bench time [s]), `kind`, `text` and the facts of each event, by name."""

    sound: list[dict[str, Any]]
    damaged: int
    """Lines that could not be read; the last line of a process that was killed may be torn."""


def read_events(path: Path) -> Events:
    """All events of a log in its order; none where there is no such file."""
    try:
        lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    except FileNotFoundError:
        return Events([], 0)
    events = [event for line in lines if line.strip() and (event := _event(line)) is not None]
    return Events(events, sum(bool(line.strip()) for line in lines) - len(events))


def _event(line: str) -> dict[str, Any] | None:
    try:
        event = json.loads(line)
    except (ValueError, RecursionError):
        return None
    return event if isinstance(event, dict) else None


def write_events(path: Path, events: Iterable[Mapping[str, Any]]) -> None:
    """Replace the log; ValueError where a number is not finite, OSError."""
    lines = (json.dumps(event, allow_nan=False) for event in events)
    write_atomically(path, "".join(f"{line}\n" for line in lines).encode())
