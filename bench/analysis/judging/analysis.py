"""A run folder judged: floor, ladder of models, diagnosis of the best, verdict; written as JSON beside the data."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from bench.analysis.diagnosis.scores import Comparison, Score
from bench.analysis.judging.completeness import Completeness
from bench.analysis.judging.diagnosed import Diagnosed
from bench.analysis.judging.joints import Joint
from bench.analysis.judging.limits import Judgement
from bench.analysis.judging.quantities import turning
from bench.analysis.judging.verdict import RunVerdict
from bench.analysis.noise.floor import Floor
from bench.analysis.thresholds import MOST_LEFT_OUT
from bench.base import FloatArray, InputError, finite
from bench.record import Dataset, Manifest, RunFolder

NEXT_PROFILE = "next.yaml"
"""Profile of the run that would tell suspects apart, in the run folder."""
LIMITS_YAML = "limits.yaml"
"""The limits of a run as they were given, in the run folder."""


@dataclass(frozen=True, eq=False)
class Analysis:
    """What a report says. `dataset`, `comparison` and `best` are None where the run does not allow them."""

    run: RunFolder
    manifest: Manifest
    interval_s: float
    done: Completeness
    floor: Floor
    verdict: RunVerdict
    dataset: Dataset | None = None
    comparison: Comparison | None = None
    best: Score | None = None
    bias_span_dph: float = np.nan
    """Highest less lowest mean of the bias over the run [deg/h]."""
    uncompensated_dph: float = np.nan
    """RMS of the bias about its mean: the error of a unit without compensation [deg/h]."""
    gaps: tuple[Joint, ...] = ()
    """Gaps between the parts of a run whose bench was killed and which went on."""
    warnings: tuple[str, ...] = ()
    static: str | None = None
    """The isothermal run that noise and floor are read from, too."""
    others: tuple[str, ...] = ()
    """What further runs, held out or isothermal, lack so badly that nothing may rest on them."""
    inertial: bool = False
    """Whether the unit is calibrated as a whole, by `bench imu`: there is nothing to fit here."""
    diagnosed: Diagnosed = field(default_factory=Diagnosed)
    judgement: Judgement | None = None
    """Against limits, where some were given."""

    @property
    def held_out_ratio(self) -> float:
        """Held-out error of the best model over the noise floor."""
        return self.best.held_out.rms_dph / self.floor.floor_dph if self.best else np.nan

    @property
    def uncompensated(self) -> str:
        """What `uncompensated_dph` is of."""
        turned = self.dataset is not None and bool(np.any(turning(self.dataset)))
        return "no compensation, at rest" if turned else "no compensation"

    @property
    def improvement(self) -> float:
        """Error without compensation over held-out error of the best model."""
        return self.uncompensated_dph / self.best.held_out.rms_dph if self.best else np.nan

    @property
    def within_limits(self) -> bool:
        """The limits' verdict; without limits: the run is whole and its own calibration, if any, is proven."""
        if self.judgement is not None:
            return self.judgement.verdict.within
        proven = self.inertial or (self.best is not None and bool(np.isfinite(self.best.held_out.rms_dph)))
        whole = self.done.whole and not self.done.lost and not self.others
        return whole and not any(self.done.lacking()) and proven and self.admissible

    @property
    def admissible(self) -> bool:
        """All parts of the run may stand behind one calibration, and hardly anything of it was left out."""
        return all(gap.admissible for gap in self.gaps) and self.done.left_out_share <= MOST_LEFT_OUT

    def residual(self) -> FloatArray:
        """Measured less modelled bias of the best model (n,) [deg/h]."""
        if self.dataset is None or self.best is None:
            raise InputError("no model was fitted, so there is no residual", self.run.path)
        residual: FloatArray = self.dataset.bias - self.best.fit.predict(self.dataset).bias
        return residual

    def to_json(self) -> dict[str, Any]:
        """What `bench run --json` answers about the data; null where a number does not exist."""
        best = self.best
        return {
            "run": str(self.run.path),
            "verdict": self.verdict.word,
            "sentence": self.verdict.sentence,
            "complete": self.done.whole,
            "model": best.model.name if best else None,
            "rms_dph": finite(best.rms_dph) if best else None,
            "held_out_rms_dph": finite(best.held_out.rms_dph) if best else None,
            "held_out_by": best.held_out.by if best else None,
            "floor_dph": finite(self.floor.floor_dph),
            "bias_span_dph": finite(self.bias_span_dph),
            "uncompensated_rms_dph": finite(self.uncompensated_dph),
            "samples": self.done.samples,
            "missing_samples": self.done.missing,
            "losses": dict(self.done.losses),
            "left_out": [entry.content() for entry in self.done.left_out],
            "admissible": self.admissible,
            "gaps": [gap.to_json() for gap in self.gaps],
            "warnings": list(self.warnings),
            "diagnosis": self.diagnosed.to_json(),
            **({"limits": self.judgement.to_json()} if self.judgement else {}),
        }
