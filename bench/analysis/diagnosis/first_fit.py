"""The fit that a diagnosis begins with: its curve is fine enough."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from bench.analysis.effects.base import Effect
from bench.analysis.effects.model import Model
from bench.analysis.effects.spline import Spline
from bench.analysis.fit.fitting import Fit, fit_model
from bench.analysis.thresholds import LEAST_INTERVALS
from bench.base import InputError
from bench.record import Dataset


def first_fit(model: Model, runs: Sequence[Dataset]) -> tuple[Fit, list[str]]:
    """The fit to diagnose, with enough intervals in an automatic spline, and the note that says so."""
    fit = fit_model(model, runs, covariance="none", weights="count")
    finer = tuple(map(_finer, model.effects, fit.model.effects))
    if finer == model.effects:
        return fit, []
    try:
        fit = fit_model(replace(model, effects=finer), runs, covariance="none", weights="count")
    except InputError:  # too few rows in one of the intervals
        return fit, []
    text = (
        f"the automatic spline chose fewer than {LEAST_INTERVALS} intervals; the diagnosis used {LEAST_INTERVALS}, "
        "because the misfit of a coarse curve looks like an effect"
    )
    return fit, [text]


def _finer(asked: Effect, chosen: Effect) -> Effect:
    coarse = isinstance(chosen, Spline) and int(chosen.intervals) < LEAST_INTERVALS
    return Spline(LEAST_INTERVALS, asked.ends) if coarse and isinstance(asked, Spline) and asked.choices() else asked
