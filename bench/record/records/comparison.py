"""compare.json: the models of the run's report side by side."""

from __future__ import annotations

from typing import ClassVar

from pydantic import Field

from bench.record.records.calibration import Coefficient, StoredHeldOut, StoredWeights
from bench.record.records.stored import Record, Stored


class SegmentError(Stored):
    """Error of a model in one segment of a run."""

    name: str
    run: str = ""
    rms_dph: float | None = None
    floor_ratio: float | None = None


class CountedModel(Stored):
    """Errors [deg/h] of the same model with rows that count by the samples behind each, not by their noise."""

    rms_dph: float | None = None
    held_out_rms_dph: float | None = None


class ComparedModel(Stored):
    """Errors of a model on the data that it was fitted to and on data that it did not see [deg/h]."""

    name: str
    effects: tuple[str, ...] = ()
    rows: str = "all"
    rms_dph: float | None = None
    fitted_rms_dph: float | None = None
    rms_interval_dph: tuple[float | None, ...] = ()
    held_out_rms_dph: float | None = None
    held_out_by: str = ""
    held_out: tuple[StoredHeldOut, ...] = ()
    segments: tuple[SegmentError, ...] = ()
    weights: StoredWeights = Field(default_factory=StoredWeights)
    counted: CountedModel | None = None
    """Null where the rows of the model itself count by their samples."""
    parameters: tuple[Coefficient, ...] = ()
    warnings: tuple[str, ...] = ()


class RefusedModel(Stored):
    """A model that could not be fitted."""

    name: str
    reason: str = ""


class ComparisonRecord(Record):
    """The comparison of the report."""

    FILE: ClassVar[str] = "compare.json"
    TITLE: ClassVar[str] = "comparison"
    MADE_FROM: ClassVar[tuple[str, ...]] = ("manifest.json",)

    runs: tuple[str, ...] = ()
    check: tuple[str, ...] = ()
    static: str | None = None
    """The isothermal run that noise and floor were read from, too."""
    diagnosed: bool = False
    """The report asked for a diagnosis, made or not; a later one takes its place in diagnosis.json."""
    floor_dph: float | None = None
    interval_s: float | None = None
    models: tuple[ComparedModel, ...] = ()
    refused: tuple[RefusedModel, ...] = ()
    left_out: tuple[str, ...] = ()
    """What of the runs no fit and no error has, a sentence for each stretch."""
    verdict: str | None = None

    def best(self) -> ComparedModel | None:
        """The model with the least error on unseen data; None where no model has one."""
        proven = [(model.held_out_rms_dph, model) for model in self.models if model.held_out_rms_dph is not None]
        return min(proven, key=lambda pair: pair[0], default=(0.0, None))[1]
