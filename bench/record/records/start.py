"""start.json of the page's server: a run, or a calibration, that was started from the page."""

from __future__ import annotations

from typing import Any, ClassVar

from pydantic import Field

from bench.record.records.stored import Record


class StartRecord(Record):
    """Who started what, with which process, and the runs that it made."""

    FILE: ClassVar[str] = "start.json"
    TITLE: ClassVar[str] = "start"
    CHAINED: ClassVar[bool] = False
    ADVICE: ClassVar[str] = "remove its folder: the runs themselves are not in it"

    start: str
    """Name of the start."""
    digest: str = ""
    """Of a calibration: that of its job; empty for a run."""
    digests: tuple[str, ...] = ()
    """Of calibrations that were started together: those of the jobs, in the order of the units."""
    plan: str = ""
    station: str | None = None
    equipment: tuple[str, ...] = ()
    """What it uses, by address."""
    units: tuple[str, ...] = ()
    models: tuple[str, ...] = ()
    limits: str | None = None
    who: dict[str, Any] = Field(default_factory=dict)
    started: str
    resumes: str = ""
    """Id of the run that it goes on with; empty for a new one."""
    runs: tuple[str, ...] = ()
    """Ids of the runs that its process made."""
    waiting: tuple[str, ...] = ()
    """Arguments of `bench`, while it waits for its equipment."""
    files: dict[str, str] = Field(default_factory=dict)
    """SHA-256 of each file that it was asked for with, by path."""
    turn: str = ""
    """Its place among those that wait, by which they sort; empty: by its name, which sorts by time."""
    not_before: str | None = None
    """Time before which it does not begin, ISO 8601; null: as soon as its equipment is free."""
    pid: int | None = None
    """Null until the process is there."""
