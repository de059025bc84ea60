"""Where the equipment's events, written registers and readings go: into the journals of a run, once there is a run.

Equipment is opened and identified before a run folder exists. What happens until then is told by the errors it raises.
"""

from __future__ import annotations

from typing import Any, Protocol

from bench.acquisition.recording.recorder import InstrumentArray
from drivers.chamber import Write
from drivers.rate_table import TableArray


class Journal(Protocol):
    """What a recorder takes from the equipment."""

    def event(self, kind: str, text: str, **facts: Any) -> None:
        """Something that happened, with its numbers."""

    def write(self, write: Write) -> None:
        """A register of the chamber that was written."""

    def table(self, readings: TableArray) -> None:
        """Readings of the rate table's encoder (n,)."""

    def instrument(self, readings: InstrumentArray) -> None:
        """What an instrument measured (n,)."""


class Records:
    """A journal that passes everything on to that of the run; before there is one, nothing is kept."""

    def __init__(self) -> None:
        self._journal: Journal | None = None

    def begin(self, journal: Journal) -> None:
        """From now on everything is recorded here."""
        self._journal = journal

    def event(self, kind: str, text: str, **facts: Any) -> None:
        """Something that happened, with its numbers."""
        if self._journal is not None:
            self._journal.event(kind, text, **facts)

    def write(self, write: Write) -> None:
        """A register of the chamber that was written."""
        if self._journal is not None:
            self._journal.write(write)

    def table(self, readings: TableArray) -> None:
        """Readings of the rate table's encoder (n,)."""
        if self._journal is not None:
            self._journal.table(readings)

    def instrument(self, readings: InstrumentArray) -> None:
        """What an instrument measured (n,)."""
        if self._journal is not None:
            self._journal.instrument(readings)
