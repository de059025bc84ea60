"""job.json of `bench calibrate`: what every step of a calibration left behind."""

from __future__ import annotations

from pathlib import Path
from typing import Any, ClassVar, Self

from pydantic import Field

from bench.base import InputError
from bench.record.records.chain import ChainRecord
from bench.record.records.stored import Record, Stored


class StoredCase(Stored):
    """One thing that a step judged; `failure` is empty where it passed."""

    name: str
    failure: str = ""
    skipped: bool = False
    text: str = ""


class StoredStep(Stored):
    """A step that was begun."""

    state: str
    """begun, done, failed or void."""
    attempts: int = 1
    began: str = ""
    ended: str | None = None
    sentence: str = ""
    verdict: str | None = None
    facts: dict[str, Any] = Field(default_factory=dict)
    """What later steps need of it."""
    cases: tuple[StoredCase, ...] = ()
    hold: str | None = None
    """Why a person has to decide."""
    stop: str | None = None
    """Why the job ends here."""
    released: str | None = None


class Release(Stored):
    """A person let a held job go on."""

    utc: str
    reason: str
    held: str = ""


class JobRecord(Record):
    """A calibration of one unit by one plan, written whole at each boundary of a step."""

    FILE: ClassVar[str] = "job.json"
    TITLE: ClassVar[str] = "job"
    ADVICE: ClassVar[str] = "restore it, or move its folder away and calibrate anew"

    MISSING: ClassVar[str] = "job.json is missing; restore it, or move the folder away and calibrate anew"

    format: int = 2
    unit: str
    plan: str
    digest: str
    """SHA-256 of the plan and everything that it names."""
    bench: str = ""
    created: str
    state: str
    """running, held, failed or ended."""
    verdict: str | None = None
    sentence: str = ""
    exit_code: int | None = None
    ended: str | None = None
    releases: tuple[Release, ...] = ()
    epochs: dict[str, int] = Field(default_factory=dict)
    """How often a step was begun from nothing."""
    steps: dict[str, StoredStep] = Field(default_factory=dict)

    @classmethod
    def find(cls, folder: Path | str, name: str | None = None) -> Self | None:
        """The record in a folder; InputError, too, where the list that proves it is gone: it may be another job's."""
        record = super().find(folder, name)
        if record is not None and record.format == cls._newest() and not Path(folder, ChainRecord.FILE).is_file():
            raise InputError(
                f"cannot be proven, {ChainRecord.FILE} beside it is missing; {cls.ADVICE}", f"{folder}/{cls.FILE}"
            )
        return record
