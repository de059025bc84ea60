"""Reasons why a run must not be judged at all, even if its numbers are within the limits."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from bench.analysis.diagnosis.compare import Score
from bench.analysis.fit.quantisation import step_error_dph
from bench.analysis.judging.branches import branch_gap
from bench.analysis.judging.stored import objections_to
from bench.analysis.thresholds import LEAST_BRANCH_S, MOST_EXTRAPOLATED, MOST_LOOP_RATIO, MOST_STEP_SHARE
from bench.base import clock, number

if TYPE_CHECKING:
    from bench.analysis.judging.analysis import Analysis


def refusals(analysis: Analysis) -> tuple[str, ...]:
    """Reasons, one line each, the gravest first; none for a run that may be judged."""
    return (*_of_run(analysis), *_of_model(analysis))


def _of_run(analysis: Analysis) -> Iterator[str]:
    done = analysis.done
    if not done.ended:
        failed = f", {len(done.failed)} of its segments failed" if done.failed else ""
        yield f"the run is not complete: {done.state}{f' ({done.cause})' if done.cause else ''}{failed}"
    for name in done.altered:
        yield f"{name} is not the file that was recorded"
    if not analysis.admissible:
        yield "its parts must not stand behind one calibration: the gap between them is not bridged"
    for direction, seconds in (("heating", done.heating_s), ("cooling", done.cooling_s)):
        if done.samples and seconds < LEAST_BRANCH_S:
            yield f"only {clock(seconds)} of {direction}: a gap between the branches cannot be seen"


def _of_model(analysis: Analysis) -> Iterator[str]:
    best, data = analysis.best, analysis.dataset
    if best is None or data is None:
        yield f"no model could be fitted: {analysis.verdict.sentence}"
        return
    name, held_out = best.model.name, best.held_out
    if not np.isfinite(held_out.rms_dph):
        yield f"'{name}' has no error on unseen data: {held_out.reason}"
    if best.model.rows not in {"all", "bins"}:
        yield f"'{name}' was fitted to a part of the rows ({best.model.rows}): the other branch is not covered"
    if held_out.out_of_range > MOST_EXTRAPOLATED:
        yield f"{held_out.out_of_range:.0%} of the unseen data lie outside the range that '{name}' was fitted to"
    yield from objections_to(best.fit, data)
    step_dph = step_error_dph(best.fit.bound, best.fit.beta, data)
    if step_dph > MOST_STEP_SHARE * held_out.rms_dph:
        yield (
            f"the temperature sensor has steps of {number(data.temperature_step)} degC: {number(step_dph)} of the "
            f"{number(held_out.rms_dph)} deg/h come from them"
        )
    yield from _branches(analysis, best)


def _branches(analysis: Analysis, best: Score) -> Iterator[str]:
    data, floor_dph = analysis.dataset, analysis.floor.floor_dph
    if data is None or not np.isfinite(floor_dph):
        return
    whole, left = branch_gap(data), branch_gap(data, analysis.residual())
    if whole and left and abs(left[0]) > max(MOST_LOOP_RATIO * floor_dph, 0.5 * abs(whole[0])):
        yield (
            f"'{best.model.name}' leaves a gap of {number(abs(left[0]))} deg/h between heating and cooling at "
            f"{left[1]:.0f} degC, {number(abs(left[0]) / floor_dph, 2)} x the noise floor: it lacks an effect "
            "with memory"
        )
