"""Error of a model on data that its fit did not see: check runs, or blocks left out where there are none."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from bench.analysis.diagnosis.evidence import Suspect
from bench.analysis.diagnosis.pieces import after_pauses
from bench.analysis.diagnosis.proof import LeftOut, left_out_of, visited_again, within, without_states
from bench.analysis.diagnosis.suspects import Layout
from bench.analysis.effects.base import Effect, Theta
from bench.analysis.fit.design import Bound, FitRows
from bench.analysis.fit.disturbances import without
from bench.analysis.fit.fitting import Fit
from bench.analysis.fit.solve import Solution, left_out, solve
from bench.analysis.noise.whitening import Whitener
from bench.analysis.thresholds import MOST_CONDITION
from bench.base import FloatArray, InputError, despike
from bench.record import Dataset


@dataclass(frozen=True, eq=False)
class Unseen:
    """Least squares at given nonlinear parameters, scored.

    `rms_dph` is on unseen rows, `shape_dph` the same where each run has a constant of its own (the turn-on bias is not
    part of the model), at temperatures that were fitted. What each run has for itself in a model, such as a state in
    which it began, is fitted to check runs. `residuals` (n,) of each fitted run [deg/h]; with such
    constants their RMS is `apart_dph`, and each further run lies `above_dph` over the first. Of check runs `outside`
    (0 to 1) is at temperatures that were not fitted, and elsewhere they differ by `constant_dph`. `left` is what a
    proof compares. `reason` says why there is nothing.
    """

    rms_dph: float = np.nan
    shape_dph: float = np.nan
    residuals: tuple[FloatArray, ...] = ()
    above_dph: tuple[float, ...] = ()
    apart_dph: float = np.nan
    constant_dph: float = 0.0
    outside: float = 0.0
    reason: str = ""
    left: LeftOut = field(default_factory=LeftOut)

    @property
    def judged_dph(self) -> float:
        """Error that is judged beside the noise floor: of check runs what a proof compares, else `shape_dph`."""
        return self.left.rms_dph if self.left.by == "check" else self.shape_dph


def unseen(
    rows: FitRows,
    theta: FloatArray,
    check: Sequence[Dataset],
    own: int = 0,
    like: LeftOut | None = None,
    slopes: FloatArray | None = None,
) -> Unseen:
    """Score a model on the check runs or, without, on 20 contiguous blocks, each predicted from all others.

    `own` columns, the last ones, belong to the effect that is to be proved: it decides what can be left out. With
    `like` the same is left out as there. With the `slopes` (n, m) along parameters these are fitted anew, linearised,
    to what is not left out.
    """
    try:
        bound, columns = rows.bind(theta)
        solution = solve(columns, rows.y, rows.weights)
        if solution.condition > MOST_CONDITION:
            return Unseen(reason=f"model '{rows.model.name}' is not determined by these rows")
        residuals = tuple(_residual(bound, record, solution.beta) for record in rows.records)
        apart = _apart(rows, columns) if len(rows.records) > 1 else solution
        above = tuple(apart.beta[: len(rows.records) - 1].tolist())
        apart_dph = float(np.sqrt(apart.rss / np.sum(rows.weights)))
        if not check:
            scores = _of_blocks(rows, solution, apart)
            columns, solution = np.hstack([_constants(rows), columns]), apart  # a turn-on bias proves nothing
            for slope in () if slopes is None else slopes.T:
                more = np.column_stack([slope, columns])
                if (free := solve(more, rows.y, rows.weights)).condition <= MOST_CONDITION:  # else it is one of them
                    columns, solution = more, free
            return Unseen(*scores, residuals, above, apart_dph, left=left_out_of(rows, solution, own, like))
        left = [_residual(bound, record, solution.beta) for record in check]
        states = [bound.states(record) for record in check]
    except InputError as error:
        return Unseen(reason=str(error), left=LeftOut(reason=str(error)))
    weights = [record.count("rate") for record in check]
    left = [without_states(*each) for each in zip(left, states, weights, strict=True)]
    visited = [r[m] for r, m in zip((x.channel("temperature") for x in rows.records), rows.masks, strict=True)]
    proof = replace(visited_again(np.concatenate(visited), check, left, weights), states=tuple(states))
    return Unseen(_rms(left, weights), proof.rms_dph, residuals, above, apart_dph, *_of_check(left, proof), left=proof)


def settled(
    layout: Layout, way: Whitener, check: Sequence[Dataset], like: LeftOut | None = None, count: int | None = None
) -> Unseen:
    """The model of a layout with its first `count` parameters, or all, moved to where they fit, scored as by `unseen`.

    This is what a layout with more is to be compared with: there these parameters have moved, too.
    """
    moved = layout.settled(way, len(layout.theta) if count is None else count)
    return unseen(moved.rows, moved.theta, check, like=like)


def with_suspect(
    layout: Layout, effect: Effect, suspect: Suspect, check: Sequence[Dataset], like: LeftOut | None = None
) -> Unseen:
    """The model of a layout with a suspect, an `effect` at its parameters, scored as by `unseen`."""
    after = layout.adding(effect, suspect.theta).settled(suspect.way, len(layout.theta))
    return unseen(after.rows, after.theta, check, 0 if effect.moves_abscissa else len(suspect.amplitudes), like)


def removed(before_dph: float, after_dph: float, floor_dph: float) -> float:
    """Share 0..1 of the excess variance over the floor that is gone; NaN where there was no excess or no number."""
    excess = before_dph**2 - floor_dph**2
    if not excess > 0.0 or not np.isfinite(after_dph):
        return np.nan
    return float(np.clip((before_dph**2 - after_dph**2) / excess, 0.0, 1.0))


def acts(effect: Effect, theta: Theta, check: Sequence[Dataset]) -> bool:
    """Whether a prepared effect moves in any check run: a jump that happened once does not."""
    able = [run for run in check if all(channel in run.channels for channel in effect.needs)]
    return effect.moves_abscissa or any(bool(np.ptp(effect.columns(run, theta), axis=0).any()) for run in able)


def without_spikes(fit: Fit, check: Dataset) -> Dataset:
    """A check run without the means that stand out of what the fit leaves: as in the fitted runs, they are no error of
    a model.
    """
    try:
        left = _residual(fit.bound, check, fit.beta)
    except InputError:  # which every score of this run will tell
        return check
    return without(check, np.isfinite(left) & ~despike(left))


def without_pauses(check: Dataset) -> Dataset:
    """A check run without the rows after its pauses, as the fitted runs."""
    return without(check, after_pauses(check))


def _residual(bound: Bound, record: Dataset, beta: FloatArray) -> FloatArray:
    left: FloatArray = record.bias - bound.columns(record) @ beta
    return left


def _apart(rows: FitRows, columns: FloatArray) -> Solution:
    """The fit with a constant for each further run."""
    return solve(np.hstack([_constants(rows), columns]), rows.y, rows.weights)


def _constants(rows: FitRows) -> FloatArray:
    """A column (n, runs - 1) for each further run, 1 in its rows."""
    run = np.repeat(np.arange(len(rows.masks)), [int(mask.sum()) for mask in rows.masks])
    return np.asarray(run[:, None] == np.arange(1, len(rows.masks)), dtype=np.float64)


def _of_blocks(rows: FitRows, solution: Solution, apart: Solution) -> tuple[float, float]:
    """RMS [deg/h] of the rows of each block, predicted from all others: of all of them; and, with constants `apart`, of
    those that lie within the temperatures of the others.
    """
    blocks = rows.blocks()
    whole = left_out(solution, rows.weights, blocks)
    shape = whole if apart is solution else left_out(apart, rows.weights, blocks)
    inside = LeftOut(residual=np.where(within(rows, blocks), shape, np.nan), weights=rows.weights)
    return _rms([whole], [rows.weights]) if np.isfinite(whole).all() else np.nan, inside.rms_dph


def _of_check(left: Sequence[FloatArray], proof: LeftOut) -> tuple[float, float]:
    """Constant of the check runs at temperatures that were fitted [deg/h], and the share of them elsewhere."""
    if proof.residual is None or proof.weights is None:
        return 0.0, 1.0
    whole, inside = np.concatenate(list(left)), np.isfinite(proof.residual)
    square = float(np.average(whole[inside] ** 2, weights=proof.weights[inside]))
    share = float(proof.weights[inside].sum() / proof.weights[np.isfinite(whole)].sum())
    return float(np.sqrt(max(square - proof.rms_dph**2, 0.0))), 1.0 - share


def _rms(residuals: Sequence[FloatArray], weights: Sequence[FloatArray]) -> float:
    residual, weight = np.concatenate(list(residuals)), np.concatenate(list(weights))
    present = np.isfinite(residual)
    return float(np.sqrt(np.average(residual[present] ** 2, weights=weight[present])))
