"""diagnosis.json: where the model fails, which effect is missing, which experiment would tell."""

from __future__ import annotations

from typing import Any, ClassVar

from pydantic import Field

from bench.record.records.stored import Record, Stored


class StoredPlace(Stored):
    """A range of a channel in which the error is above the noise."""

    channel: str
    low: float | None = Field(default=None, alias="from")
    high: float | None = Field(default=None, alias="to")
    rms_dph: float | None = None
    floor_ratio: float | None = None
    misfit_dph: float | None = None
    p: float | None = None
    note: str = ""


class StoredSuspect(Stored):
    """An effect that may be missing."""

    effect: str
    options: dict[str, Any] = Field(default_factory=dict)
    found: bool = False
    held_out_before_dph: float | None = None
    held_out_rms_dph: float | None = None
    removes: float | None = None
    evidence: float | None = None
    chance: float | None = None
    parameters: dict[str, dict[str, Any]] = Field(default_factory=dict)
    look_alikes: tuple[str, ...] = ()
    legs: tuple[dict[str, Any], ...] = ()
    reason: str = ""
    proved: bool | None = None
    proof: dict[str, Any] | None = None


class DiagnosisRecord(Record):
    """The answer of a diagnosis."""

    FILE: ClassVar[str] = "diagnosis.json"
    TITLE: ClassVar[str] = "diagnosis"
    MADE_FROM: ClassVar[tuple[str, ...]] = ("manifest.json",)
    ADVICE: ClassVar[str] = "make it again with `bench report` or `bench diagnose`"
    BEFORE: ClassVar[str] = "diagnosis-before.json"
    """Where one is kept that knew more runs than its successor."""

    verdict: str
    proved: bool | None = None
    nearest: str | None = None
    contradicted: bool = False
    """Whether check runs speak clearly against what the fitted runs show beyond doubt."""
    sentence: str = ""
    runs: tuple[str, ...] = ()
    check: tuple[str, ...] = ()
    static: str | None = None
    sisters: tuple[str, ...] = ()
    """Isothermal runs of units like this one."""
    model: str = ""
    floor_dph: float | None = None
    rms_dph: float | None = None
    held_out_rms_dph: float | None = None
    held_out_by: str = ""
    floor_ratio: float | None = None
    """Error on unseen data with what they prove, over the noise floor."""
    where: tuple[StoredPlace, ...] = ()
    suspects: tuple[StoredSuspect, ...] = ()
    formulas: tuple[dict[str, Any], ...] = ()
    kernel: dict[str, Any] | None = None
    """Response to a change of temperature over the lag, where nothing shorter describes what is left."""
    surface: dict[str, Any] | None = None
    """Cells of what is left over two channels."""
    next_experiment: dict[str, Any] | None = None
    unexplained: tuple[StoredPlace, ...] = ()
    threshold: float | None = None
    not_excited: tuple[dict[str, str], ...] = ()
    smallest_detectable: tuple[dict[str, Any], ...] = ()
    noise_finding: str | None = None
    resolution: str | None = None
    """What the steps of output and thermometer cause, where that is as much as what is left."""
    notes: tuple[str, ...] = ()
    profile: str | None = None
    """File of the next experiment, in answers of older benches."""

    @property
    def lacks(self) -> tuple[str, ...]:
        """Effects that are missing and that unseen data prove, by name."""
        proved = (one.effect for one in self.suspects if one.found and one.proved)
        return tuple(sorted(proved)) if self.verdict == "missing_effect" else ()

    def everything(self) -> set[str]:
        """Names of all runs behind it."""
        return {*self.runs, *self.check, *self.sisters, *filter(None, [self.static])}
