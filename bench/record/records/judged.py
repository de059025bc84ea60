"""limits.json and verification.json: a run against its limits, and a unit that corrected itself."""

from __future__ import annotations

from enum import StrEnum
from typing import Any, ClassVar

from pydantic import Field

from bench.record.records.calibration import StoredQuantity
from bench.record.records.manifest import UnitIdentity
from bench.record.records.stored import Record, Stored


class Verdict(StrEnum):
    """The words, best first."""

    PASS = "PASS"
    MARGINAL = "MARGINAL"
    FAIL = "FAIL"
    INVALID = "INVALID"

    @property
    def within(self) -> bool:
        """Whether the unit may go on."""
        return self in {Verdict.PASS, Verdict.MARGINAL}

    @property
    def judged(self) -> bool:
        """Whether this tells something of the unit: an invalid run neither passes nor rejects it."""
        return self is not Verdict.INVALID


class JudgedQuantity(StoredQuantity):
    """A quantity against its limit; `verdict` is null where it was neither measured nor required."""

    lower: float | None = None
    upper: float | None = None
    marginal: float | None = None
    required: bool = True
    expression: str | None = None
    """By which the limits compute it; null for a quantity of the bench."""
    why: str = ""
    """Why this limit."""
    verdict: Verdict | None = None


class Judged(Stored):
    """All limits applied."""

    name: str | None = None
    """Of the specification."""
    verdict: Verdict | None = None
    decision_rule: str = ""
    coverage_factor: float | None = None
    coverage_probability: float | None = None
    refusals: tuple[str, ...] = ()
    """Why the run must not be judged."""
    results: tuple[JudgedQuantity, ...] = ()


class LimitsRecord(Judged, Record):
    """The run's verdict against its limits."""

    FILE: ClassVar[str] = "limits.json"
    TITLE: ClassVar[str] = "judgement"
    MADE_FROM: ClassVar[tuple[str, ...]] = ("manifest.json", "calibration.json", "limits.yaml")
    ADVICE: ClassVar[str] = "make it again with `bench report --limits`"


class VerificationRecord(Record):
    """The verdict on a verification run."""

    FILE: ClassVar[str] = "verification.json"
    TITLE: ClassVar[str] = "verification"
    MADE_FROM: ClassVar[tuple[str, ...]] = ("manifest.json",)
    ADVICE: ClassVar[str] = "make it again with `bench verify`"

    unit: str = ""
    run: str = ""
    profile: str = ""
    created: str = ""
    verdict: Verdict
    before: dict[str, float] | None = None
    """Figures at rest of the raw output in the calibration run [deg/h] …"""
    after: dict[str, float] | None = None
    """… and of the unit's own output."""
    turning_before: dict[str, float] | None = None
    turning_after: dict[str, float] | None = None
    """The same where a rate table turned the unit."""
    turning_factor: float | None = None
    within_degc: tuple[float | None, ...] = ()
    """Temperatures of these figures."""
    rms_dph: float | None = None
    """Error of the whole run, which is judged."""
    rms_interval_dph: tuple[float | None, ...] = ()
    factor: float | None = None
    floor_dph: float | None = None
    over_floor: float | None = None
    unit_identity: UnitIdentity | None = None
    rule: str | None = None
    """Without limits: the rule that took their place."""
    refusals: tuple[str, ...] = ()
    limits: Judged | None = None
    data: dict[str, Any] | None = None
    """Samples of the run that are there, lost, missing and left out …"""
    calibration_data: dict[str, Any] | None = None
    """… and of the calibration run."""
    in_unit: dict[str, Any] = Field(default_factory=dict)
    """What was in the unit."""
    calibration_run: str | None = None
    quantities: tuple[StoredQuantity, ...] = ()

    @property
    def judged(self) -> Judged:
        """The limits applied; without limits the rule that took their place, as a judgement without quantities."""
        if self.limits is not None:
            return self.limits
        return Judged(verdict=self.verdict, decision_rule=self.rule or "", refusals=self.refusals)

    @property
    def sentence(self) -> str:
        """What the run found, in words."""
        if self.rms_dph is None:
            return ""
        ratio = "" if self.over_floor is None else f", {self.over_floor:.2f} x its noise floor"
        return f"{self.rms_dph:.4f} deg/h RMS of its own output{ratio}"
