"""calibration.json: the delivered model with its covariance, the noise floor, the residual, and how far to trust it."""

from __future__ import annotations

from typing import Any, ClassVar, Literal

from pydantic import Field

from bench.record.records.stored import Record, Stored


class Said(Stored):
    """The verdict of the analysis in words."""

    verdict: str | None = None
    sentence: str = ""
    complete: bool | None = None
    admissible: bool | None = None
    """Whether all parts of the run may stand behind one calibration."""
    warnings: tuple[str, ...] = ()


class StoredQuantity(Stored):
    """A number of the run with its 95 % interval; null and a reason where it does not exist."""

    name: str
    unit: str | None = None
    meaning: str = ""
    value: float | None = None
    low: float | None = None
    high: float | None = None
    reason: str = ""


class Stretch(Stored):
    """A stretch of constant temperature that the noise was measured in; bench time [s]."""

    name: str
    from_s: float
    to_s: float


class NoiseCoefficient(Stored):
    """White, flicker or walk noise of the unit."""

    name: str
    unit: str | None = None
    value: float | None = None
    interval: tuple[float | None, ...] = ()
    determined: bool = True


class StoredNoise(Stored):
    """The noise floor of the run's means [deg/h], or the reason why there is none."""

    floor_dph: float | None = None
    reason: str = ""
    stretches: tuple[Stretch, ...] = ()
    coefficients: tuple[NoiseCoefficient, ...] = ()


class StoredHeldOut(Stored):
    """Error on data that the fit did not see."""

    by: str
    """blocks, segments or check."""
    rms_dph: float | None = None
    interval_dph: tuple[float | None, ...] = ()
    reason: str = ""


class StoredResidual(Stored):
    """Errors of the delivered model [deg/h]."""

    rms_dph: float | None = None
    interval_dph: tuple[float | None, ...] = ()
    held_out: tuple[StoredHeldOut, ...] = ()


class StoredEffect(Stored):
    """An effect of the model: its options, and what the fit settled (knots, scales)."""

    effect: str
    options: dict[str, Any] = Field(default_factory=dict)
    state: dict[str, Any] = Field(default_factory=dict)


class StoredModel(Stored):
    """A model as it was fitted."""

    name: str
    rows: str = "all"
    effects: tuple[StoredEffect, ...] = ()

    def description(self) -> dict[str, Any]:
        """As a model file has it."""
        return {"name": self.name, "rows": self.rows, "effects": [{e.effect: e.options} for e in self.effects]}


class Coefficient(Stored):
    """A coefficient or parameter with its standard uncertainty."""

    key: str
    unit: str | None = None
    value: float | None = None
    std: float | None = None


class Scaled(Stored):
    """What was solved for, with its joint covariance, and the matrix that turns it into the coefficients."""

    values: tuple[float, ...]
    parameters: tuple[str, ...] = ()
    covariance: tuple[tuple[float | None, ...], ...] | None = None
    to_coefficients: tuple[tuple[float | None, ...], ...] | None = None


class Validity(Stored):
    """Range of a channel in which the model holds."""

    low: float = Field(alias="from")
    high: float = Field(alias="to")
    unit: str = ""


class StoredWeights(Stored):
    """How the rows of the fit count: by the noise that it estimated, or by the samples behind each."""

    by: Literal["noise", "count"] = "count"
    reason: str = ""
    """Why not by the noise, where that was asked for."""


class StoredFit(Stored):
    """The fit of the delivered model."""

    model: StoredModel
    coefficients: tuple[Coefficient, ...] = ()
    parameters: tuple[Coefficient, ...] = ()
    scaled: Scaled | None = None
    weights: StoredWeights = Field(default_factory=StoredWeights)
    rms_dph: float | None = None
    condition: float | None = None
    rows: int | None = None
    interval_s: float | None = None
    runs: tuple[str, ...] = ()
    validity: dict[str, Validity] = Field(default_factory=dict)
    warnings: tuple[str, ...] = ()


class CalibrationRecord(Record):
    """What another program needs to compensate this unit, and to know how far to trust it."""

    FILE: ClassVar[str] = "calibration.json"
    TITLE: ClassVar[str] = "calibration"
    MADE_FROM: ClassVar[tuple[str, ...]] = ("manifest.json",)

    unit: str = ""
    run: str = ""
    profile: str = ""
    created: str = ""
    quantity: str = ""
    """What the model gives, and what to do with it."""
    software: dict[str, str] = Field(default_factory=dict)
    verdict: Said = Field(default_factory=Said)
    averaging_s: float = 30.0
    noise: StoredNoise = Field(default_factory=StoredNoise)
    residual: StoredResidual | None = None
    calibration: StoredFit | None = None
    """Null where no model could be fitted."""
    data: dict[str, str] = Field(default_factory=dict)
    """SHA-256 of the files that it rests on."""
    quantities: tuple[StoredQuantity, ...] | None = None
    """Absent in files of the first benches."""
    refusals: tuple[str, ...] = ()
    """Why it must not be delivered."""
