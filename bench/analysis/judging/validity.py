"""Reasons why a run must not be judged at all, even if its numbers are within the limits."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from bench.analysis.diagnosis.scores import Score
from bench.analysis.fit.quantisation import step_error_dph
from bench.analysis.judging.branches import branch_gap
from bench.analysis.judging.cautions import short_branches, unproven
from bench.analysis.judging.limits import Limits
from bench.analysis.judging.stored import objections_to
from bench.analysis.thresholds import MOST_LOOP_RATIO, MOST_STEP_SHARE
from bench.base import number

if TYPE_CHECKING:
    from bench.analysis.judging.analysis import Analysis

OF_ALL_ROWS = frozenset({"all", "bins"})
"""Rows of the models that may be delivered; the others are fitted to a part of them."""


def refusals(analysis: Analysis, limits: Limits | None = None) -> tuple[str, ...]:
    """Reasons, one line each, the gravest first; none for a run that may be judged, by `limits` where there are any."""
    return (*_of_run(analysis, limits), *_of_model(analysis))


def _of_run(analysis: Analysis, limits: Limits | None) -> Iterator[str]:
    done = analysis.done
    if not done.ended:
        failed = f", {len(done.failed)} of its segments failed" if done.failed else ""
        yield f"the run is not complete: {done.state}{f' ({done.cause})' if done.cause else ''}{failed}"
    yield from done.lacking(() if limits is None else limits.quantities)
    yield from analysis.others
    if not all(gap.admissible for gap in analysis.gaps):
        yield "its parts must not be used for one calibration: nothing shows that they agree"
    yield from short_branches(done)


def _of_model(analysis: Analysis) -> Iterator[str]:
    best, data = analysis.best, analysis.dataset
    if best is None or data is None:
        yield f"no model could be fitted: {analysis.verdict.sentence}"
        return
    yield from unproven(best)
    if best.model.rows not in OF_ALL_ROWS:
        yield f"'{best.model.name}' was fitted to only a part of the rows ({best.model.rows})"
    yield from objections_to(best.fit, data)
    step_dph = step_error_dph(best.fit.bound, best.fit.beta, data)
    if step_dph > MOST_STEP_SHARE * best.held_out.rms_dph:
        yield (
            f"the temperature sensor has steps of {number(data.temperature_step)} degC: {number(step_dph)} of the "
            f"{number(best.held_out.rms_dph)} deg/h come from them"
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
