"""The fit that a diagnosis begins with: a curve fine enough, to rows that nothing disturbed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bench.analysis.diagnosis.held_out import without
from bench.analysis.effects.base import Effect
from bench.analysis.effects.model import Model
from bench.analysis.effects.spline import Spline
from bench.analysis.fit.fitting import Fit, fit_model
from bench.analysis.noise.spikes import regular
from bench.base import InputError, number
from bench.record import Dataset

_MOST_DISTURBED = 6  # stretches of all runs that are left out
_LEAST_INTERVALS = 12
"""Automatic splines get at least these: with fewer, the misfit of the curve looks like an effect."""


def first_fit(model: Model, runs: tuple[Dataset, ...]) -> tuple[tuple[Dataset, ...], Fit, list[str]]:
    """The runs without stretches that stand out of what the model leaves, its fit to them, and the notes of both.

    The worst one at a time: a curve that follows it in part stands out elsewhere.
    """
    disturbed = list[str]()
    while True:
        fit, finer = _fitted(model, runs)
        each = zip(runs, fit.residuals, strict=True)
        found = [(one, place) for place, own in enumerate(each) for one in regular(*own)[1]]
        if not found or len(disturbed) == _MOST_DISTURBED:
            return runs, fit, [*finer, *disturbed]
        (first, end, height), place = max(found, key=lambda each: abs(each[0].height))
        run, rows = runs[place], np.arange(len(runs[place]))
        text = f"{run.name} from {run.time[first]:.0f} to {run.time[end - 1]:.0f} s stands out by {number(height)} "
        text += (
            "deg/h, and no channel moves with it: left out here, while a fit, a comparison and a calibration have it"
        )
        disturbed.append(f"{text} until these rows are taken out of the log")
        runs = (*runs[:place], without(run, (rows >= first) & (rows < end)), *runs[place + 1 :])


def _fitted(model: Model, runs: Sequence[Dataset]) -> tuple[Fit, list[str]]:
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
        f"the automatic spline chose fewer than {_LEAST_INTERVALS} intervals; the diagnosis used {_LEAST_INTERVALS}, "
        "because the misfit of a coarse curve looks like an effect"
    )
    return fit, [text]


def _finer(asked: Effect, chosen: Effect) -> Effect:
    coarse = isinstance(chosen, Spline) and int(chosen.intervals) < _LEAST_INTERVALS
    return Spline(_LEAST_INTERVALS, asked.ends) if coarse and isinstance(asked, Spline) and asked.choices() else asked
