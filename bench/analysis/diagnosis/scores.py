"""Errors of models side by side, as numbers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.analysis.effects.model import Model
from bench.analysis.fit.fitting import Fit
from bench.analysis.thresholds import SHAPE_ALONE
from bench.base import finite, number


@dataclass(frozen=True)
class SegmentScore:
    """Error of one segment of one run [deg/h] and its ratio to the floor."""

    run: str
    name: str
    rms_dph: float
    floor_ratio: float


@dataclass(frozen=True)
class HeldOut:
    """Error on rows that the fit did not see [deg/h] with its 95 % interval; `reason` where there is none."""

    by: str
    rms_dph: float = np.nan
    interval_dph: tuple[float, float] = (np.nan, np.nan)
    peak_dph: float = np.nan
    """Greatest absolute error of a row, also of those that were left out as disturbed."""
    out_of_range: float = 0.0
    """Share of the rows that lie outside the range of the rows that were fitted."""
    reason: str = ""
    shape_dph: float = np.nan
    """RMS on check runs beside a constant of each and its jump, at temperatures that were fitted: what a proof
    compares.
    """
    spikes: int = 0
    """Rows that stand out of what is left around them: they count in all errors but `shape_dph` and `plain_dph`."""
    plain_dph: float = np.nan
    """RMS without those rows."""


@dataclass(frozen=True)
class Counted:
    """Errors [deg/h] of the same model with rows that count by their samples, not by their noise."""

    rms_dph: float
    held_out: HeldOut


@dataclass(frozen=True, eq=False)
class Score:
    """One model: its fit, its error over all rows of the same runs, on rows left out, and in every segment [deg/h].

    `rms_dph` is over all rows also for a model that was fitted to one branch; `fit.rms_dph` is over the fitted ones.
    """

    model: Model
    fit: Fit
    rms_dph: float
    interval_dph: tuple[float, float]
    held_out: HeldOut
    """By check run where there is one, else by blocks."""
    by_blocks: HeldOut
    by_segments: HeldOut
    segments: tuple[SegmentScore, ...]
    counted: Counted | None = None
    """None where the rows of the model itself count by their samples."""


@dataclass(frozen=True, eq=False)
class Comparison:
    """Scores of all models that could be fitted; `refused` says why the others could not."""

    runs: tuple[str, ...]
    check: tuple[str, ...]
    floor_dph: float
    interval_s: float
    scores: tuple[Score, ...]
    refused: tuple[tuple[str, str], ...] = ()
    left_out: tuple[str, ...] = ()
    """A sentence for each stretch of the runs that no fit and no error has, and for each jump of a check run that
    no `shape_dph` has.
    """

    @property
    def warnings(self) -> tuple[str, ...]:
        """What is to be known of the runs, and of each model."""
        each = ((score.model.name, text) for score in self.scores for text in score.fit.warnings)
        return (*self.left_out, *(f"{name}: {text}" for name, text in each if text not in self.left_out))

    @property
    def by_counts(self) -> str:
        """Errors of the models with rows that count by their samples alone, one line; empty where none differ."""
        both = [(score.model.name, score.counted) for score in self.scores if score.counted is not None]
        parts = [f"{name} {number(one.rms_dph)}, {number(one.held_out.rms_dph)}" for name, one in both]
        listed = "; ".join(parts)
        return f"rows weighted by their samples, not their noise, in-sample and held-out: {listed}" if parts else ""

    @property
    def constants(self) -> str:
        """Errors of the models without the constants of the check runs, one line; empty where these hardly matter."""
        held = [(score.model.name, score.held_out) for score in self.scores]
        if not any(one.by == "check" and one.shape_dph < SHAPE_ALONE * one.rms_dph for _, one in held):
            return ""
        listed = "; ".join(f"{name} {number(one.shape_dph)}" for name, one in held)
        return f"held-out without a constant of each check run, such as its turn-on bias: {listed}"

    @property
    def spikes(self) -> str:
        """Errors of the models without rows with spikes, one line; empty where there are none."""
        held = [(score.model.name, score.held_out) for score in self.scores if score.held_out.spikes]
        if not held:
            return ""
        listed = "; ".join(f"{name} {number(one.plain_dph)}" for name, one in held)
        most = max(one.spikes for _, one in held)
        return f"held-out without rows with spikes ({most}), which no model describes: {listed}"

    def to_json(self) -> dict[str, Any]:
        """The object of `bench compare --json`; null where a number does not exist."""
        return {
            "runs": list(self.runs),
            "check": list(self.check),
            "floor_dph": finite(self.floor_dph),
            "interval_s": self.interval_s,
            "models": [_score_json(score) for score in self.scores],
            "refused": [{"name": name, "reason": reason} for name, reason in self.refused],
            "left_out": list(self.left_out),
        }


def _score_json(score: Score) -> dict[str, Any]:
    return {
        "name": score.model.name,
        "effects": [effect.name for effect in score.model.effects],
        "rows": score.model.rows,
        "rms_dph": finite(score.rms_dph),
        "fitted_rms_dph": finite(score.fit.rms_dph),
        "rms_interval_dph": [finite(end) for end in score.interval_dph],
        "held_out_rms_dph": finite(score.held_out.rms_dph),
        "held_out_by": score.held_out.by,
        "held_out": [_held_out_json(part) for part in _distinct(score)],
        "segments": [
            {"name": s.name, "run": s.run, "rms_dph": finite(s.rms_dph), "floor_ratio": finite(s.floor_ratio)}
            for s in score.segments
        ],
        "weights": score.fit.weights_json(),
        "counted": None
        if score.counted is None
        else {"rms_dph": finite(score.counted.rms_dph), "held_out_rms_dph": finite(score.counted.held_out.rms_dph)},
        "parameters": score.fit.to_json()["parameters"],
        "warnings": list(score.fit.warnings),
    }


def _distinct(score: Score) -> list[HeldOut]:
    first = [score.held_out] if score.held_out.by == "check" else []
    return [*first, score.by_blocks, score.by_segments]


def _held_out_json(part: HeldOut) -> dict[str, Any]:
    return {
        "by": part.by,
        "rms_dph": finite(part.rms_dph),
        "interval_dph": [finite(end) for end in part.interval_dph],
        "peak_dph": finite(part.peak_dph),
        "spikes": part.spikes,
        "plain_rms_dph": finite(part.plain_dph),
        "out_of_range": finite(part.out_of_range),
        "reason": part.reason,
    }
