"""until.json: whether a run could end early, by which figures, and what an audit showed of them."""

from __future__ import annotations

from typing import ClassVar

from bench.record.records.stored import Record


class UntilRecord(Record):
    """How the last look at a run with `until` ended; errors in deg/h RMS over the lot's whole run."""

    FILE: ClassVar[str] = "until.json"
    TITLE: ClassVar[str] = "until"
    MADE_FROM: ClassVar[tuple[str, ...]] = ("manifest.json",)
    ADVICE: ClassVar[str] = "restore it; only the run itself can write it"

    lot: str
    """Name of the run folder of the lot."""
    limit_dph: float
    outcome: str
    """stopped; audit: it could have stopped; unlike: the unit is unlike its lot; whole: the limit was not met."""
    at_s: float
    """When the decision fell, since the first look at the unit."""
    whole_s: float
    """Duration of the lot's whole runs."""
    error_dph: float
    """Expected then …"""
    low_dph: float
    high_dph: float
    """… with its 95 % interval."""
    seen: float
    """Share of the lot's cells of temperature in which the unit was."""
    level: float | None = None
    """Likeness to the lot, as shares of its limits; null where it was not looked at."""
    shape: float | None = None
    actual_dph: float | None = None
    """Of an audit: what the calibration of that moment leaves of the whole run."""
