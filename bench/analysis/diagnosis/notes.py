"""Notes beside an answer: what is in its errors and in its floor that is no error of the model."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bench.analysis.diagnosis.answer import Diagnosis
from bench.analysis.diagnosis.candidates import Problem
from bench.analysis.diagnosis.decision import bound_only
from bench.analysis.diagnosis.held_out import Unseen
from bench.analysis.diagnosis.pieces import pauses
from bench.analysis.diagnosis.suspects import Layout
from bench.analysis.effects import registry as effects
from bench.analysis.effects.base import Effect, options_of
from bench.analysis.effects.catalogue import suspected
from bench.analysis.fit.fitting import Fit
from bench.analysis.thresholds import SHAPE_ALONE
from bench.base import listed, number
from bench.record import Dataset

_UNLIKE = 5.0  # of the error in the fitted rows: a check run with more is more likely a wrong one
_SLOW = 2.0  # times its white part: most of a noise floor is slow
_SWITCHING = 0.02  # variance within means, of 0.25 at most
_UNSTEADY = 0.05  # of a channel's variance: a size comes out too small by about as much, by more beside slow noise
_SETTLES = ("thermal_lag", "thermometer_lag", "creep")  # effects whose state at the start of a run is taken as settled
_OUTSIDE = 0.02  # of a check run: more of it at temperatures that were not fitted is worth a note


def differ(base: Unseen, rms_dph: float) -> bool:
    """Whether the fitted runs differ by constants that are worth a note."""
    return bool(base.above_dph and base.apart_dph < SHAPE_ALONE * rms_dph)


def constants(base: Unseen, rms_dph: float, runs: Sequence[Dataset]) -> tuple[str, ...]:
    """The note that the fitted runs differ by constants, where they do."""
    if not differ(base, rms_dph):
        return ()
    above = [f"{run.name} {mean:+.3g}" for run, mean in zip(runs[1:], base.above_dph, strict=True)]
    text = f"the fitted runs differ by constants, such as their turn-on biases, from {runs[0].name}"
    return (f"{text}: {listed(above)} deg/h",)


def of_runs(runs: Sequence[Dataset], fit: Fit) -> tuple[str, ...]:
    """Notes of what was left out of the runs, and of what these cannot tell: across a pause, where a compressor
    switches, of the model's parameters.
    """
    return (*_outliers(runs), *_pauses(runs), *switching(runs), *_on_bounds(fit))


def of_answer(answer: Diagnosis) -> tuple[str, ...]:
    """Notes of what an answer leaves open: options that were not tried, and a start that had not settled."""
    open_ = answer.verdict in {"unknown_effect", "undecided"}
    tried = suspected()
    other = [effect for effect in answer.model.effects if open_ and effect.name in tried and _odd(effect)]
    notes = [
        f"the model has {effect.name} with options of its own, others were not tried: diagnose a model without it, too"
        for effect in other
    ]
    memory = next((one.effect for one in answer.found if one.effect in _SETTLES), "")
    if memory and any(one.effect == "warm_up" for one in answer.found):
        text = f"a part that had not settled when the run began looks like warm_up beside {memory}"
        notes.append(f"{text}: let a run begin with a soak")
    return tuple(notes)


def _odd(effect: Effect) -> bool:
    """Whether it has options that no shape of the catalogue has."""
    return options_of(effect) not in [options_of(shape) for shape in effects.make(effect.name).shapes()]


def _on_bounds(fit: Fit) -> tuple[str, ...]:
    """A note for each parameter of the model that lies on an end of its range."""
    why = "not determined, or the effect has a wrong option"
    return tuple(f"{key} of the model is on its bound, {number(fit.theta[key])}: {why}" for key in fit.on_bound)


def _outliers(runs: Sequence[Dataset]) -> tuple[str, ...]:
    """How many readings of a channel were left out, as they stand out."""
    return tuple(
        f"{run.name}: {count} readings of channel '{name}' stand out of all others, and were left out"
        for run in runs for name, count in run.outliers.items()
    )  # fmt: skip


def _pauses(runs: Sequence[Dataset]) -> tuple[str, ...]:
    """The note that a run pauses, for each that does."""
    longest = [(run.name, max(lasted_s for _, lasted_s in found)) for run in runs if (found := pauses(run))]
    return tuple(
        f"{name} has no data for {gap_s / 60.0:.0f} min: what has a memory is not known after that, so that up to half "
        "an hour is left out there; a unit that was switched off has another turn-on bias: import the parts as runs of "
        "their own"
        for name, gap_s in longest
    )


def switching(runs: Sequence[Dataset]) -> tuple[str, ...]:
    """The note that the compressor of one of the runs switches within their means, where it mostly does."""
    for run in runs:
        on = run.channels.get("compressor", np.zeros(0))
        on = np.clip(on[np.isfinite(on)], 0.0, 1.0)  # the share of each mean: what is between 0 and 1 switched in it
        if on.size and np.mean(on * (1.0 - on)) > max(float(np.var(on)), _SWITCHING):
            text = f"the compressor switches within the means of {run.interval_s:g} s"
            return (f"{text}: an effect that follows it so fast is averaged away, and not seen here",)
    return ()


def of_channels(layout: Layout, answer: Diagnosis) -> tuple[str, ...]:
    """A note for each channel of what is named that changes much from row to row, as noise and coarse steps do."""
    best = answer.leading
    named = [one.effect for one in answer.found]
    needs = {channel for name in named for channel in effects.make(name).needs}
    needs |= set(best.model.effects[-1].needs) if best else set()
    notes = []
    for name in sorted((needs & set(layout.further)) - {"compressor"}):
        values = layout.stacked([run.channel(name) for run in layout.rows.records])
        share = float(np.mean(np.diff(values, 2) ** 2)) / 6.0 / max(float(np.var(layout.beyond(values))), 1e-300)
        if share > _UNSTEADY:
            notes.append(
                f"{100.0 * min(share, 1.0):.0f} % of what channel '{name}' does beside the model changes from row to "
                "row: if that is noise or steps of its own, sizes of what acts through it are too small, and a lag "
                "that smooths it looks like a memory"
            )
    return tuple(notes)


def of_check(base: Unseen, improved: Unseen, rms_dph: float, check: Sequence[Dataset] = ()) -> tuple[str, ...]:
    """Notes of what is in the error on the check runs beside what a proof compares, where that matters."""
    notes = []
    if base.outside > _OUTSIDE:
        notes.append(
            f"{100.0 * base.outside:.0f} % of the check run is at temperatures that were not fitted: they are in the "
            "held-out error and prove nothing"
        )
    parts = [("of the held-out error", base), ("of that with what was found", improved)]
    apart = [
        f"{which} {number(own.constant_dph)} deg/h"
        for which, own in parts[: 1 if improved is base else 2]
        if own.shape_dph < SHAPE_ALONE * np.hypot(own.shape_dph, own.constant_dph)
    ]
    if apart and not any(run.jump for run in check):  # which has its own note
        text = f"{listed(apart)} is a constant of the check run, such as its turn-on bias"
        notes.append(f"{text}; what an effect or a formula lowers is stated without it")
    if base.left.by == "check" and base.left.rms_dph > _UNLIKE * rms_dph:
        text = f"the check run's error is {base.left.rms_dph / rms_dph:.2g} x that of the fitted run"
        notes.append(f"{text}: is it of this unit, in the same units?")
    return tuple(notes)


def slow_floor(problem: Problem, floor_dph: float) -> tuple[str, ...]:
    """A note where most of the noise of the isothermal run is slow: a cause that acts there, too, looks like it."""
    white_dph = float(np.sqrt(problem.statics[0].fast_variance(problem.interval_s))) if problem.statics else np.nan
    if not floor_dph > _SLOW * white_dph:
        return ()
    text = f"most of the noise floor is slow, its white part is {number(white_dph)} deg/h"
    return (f"{text}: a cause that no channel records looks the same where it acts in the isothermal run, too",)


def bound_notes(floor_dph: float, left_dph: float) -> tuple[str, ...]:
    """A note where the noise floor is an upper bound only."""
    if not bound_only(floor_dph, left_dph):
        return ()
    return (
        f"the error on unseen data falls to {number(left_dph)} deg/h, below the noise floor, which is an upper bound "
        "here: what it is read from is short, or has a part of what is missing",
    )
