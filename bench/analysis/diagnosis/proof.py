"""Whether unseen data prove an effect: the error there falls with it, by enough, and by more than noise could do, and
no other effect in its place does much better.

Unseen are the check runs, each about its own mean (the turn-on bias is not part of the model) and without a jump that
it has for itself, or whole legs of the runs left out in turn, a leg being all rows between two turning points of the
temperature. A leg without which nothing determines the effect cannot judge it: the legs are then cut, and their parts
left out.

With residuals r0 without and r1 with the effect and c = r0 - r1, the square sum falls by D = sum(c (c + 2 r1)). What
noise does to it has the variance 4 sum_ij c_i c_j gamma(i - j), gamma the autocovariance of r1, tapered: the comparison
of Diebold and Mariano, J. Bus. Econ. Stat. 13 (1995) 253, with the difference's known factor c kept fixed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import isfinite
from typing import Any

import numpy as np

from bench.analysis.diagnosis.pieces import legs_of
from bench.analysis.fit.design import FitRows
from bench.analysis.fit.own_jumps import own_jump
from bench.analysis.fit.solve import Solution, left_out
from bench.analysis.thresholds import PROVED_DEVIATIONS, PROVED_FALL
from bench.base import BoolArray, FloatArray, IntArray, finite, number
from bench.record import Dataset

_LEAST_LEGS = 3
_PARTS = 4  # of each leg, where a whole leg cannot be left out,
_LEAST_PARTS = 12  # … and of all legs together
_LEAST_SHARE = 0.1  # of the knowledge of an effect that must be left when a group is left out
_LONGEST_LAG = 0.1  # of the rows: correlation beyond is not told from chance


@dataclass(frozen=True, eq=False)
class LeftOut:
    """Residuals (n,) of rows that the fit did not see [deg/h], NaN where nothing is predicted, and what was left out.

    `weights` (n,) are the rows'; `reason` says why there is nothing.
    """

    by: str = ""
    residual: FloatArray | None = None
    weights: FloatArray | None = None
    reason: str = ""
    label: IntArray | None = None
    """Group (n,) that each row was left out with; None: check runs."""
    states: tuple[FloatArray, ...] = ()
    """Columns (n, k) of each check run whose amplitudes it has for itself: no prediction knows them."""

    @property
    def rms_dph(self) -> float:
        """RMS of what is predicted [deg/h]."""
        if self.residual is None or self.weights is None or not np.any(known := np.isfinite(self.residual)):
            return np.nan
        return float(np.sqrt(np.average(self.residual[known] ** 2, weights=self.weights[known])))


@dataclass(frozen=True)
class Proof:
    """The error on unseen data [deg/h] without and with an effect, and its fall in standard deviations of chance."""

    by: str = ""
    before_dph: float = np.nan
    after_dph: float = np.nan
    deviations: float = np.nan
    reason: str = ""
    """Why no unseen data could judge it."""
    doubt: str = ""
    """Why the fall does not prove this effect: another one would do better, or this one is not determined."""

    @property
    def fall(self) -> float:
        """Relative fall of the error; negative where it rises."""
        return 1.0 - self.after_dph / self.before_dph

    @property
    def falls(self) -> bool | None:
        """Whether the error falls by enough and significantly; None where no unseen data could judge it."""
        if not isfinite(self.fall) or not isfinite(self.deviations):
            return None
        return self.falls_by(PROVED_FALL, PROVED_DEVIATIONS)

    @property
    def rises(self) -> bool:
        """Whether the error rises as clearly as it has to fall for a proof."""
        return bool(self.fall <= -PROVED_FALL and self.deviations <= -PROVED_DEVIATIONS)

    @property
    def proved(self) -> bool | None:
        """Whether it falls, and nothing makes that doubtful; None as for `falls`."""
        return self.falls and not self.doubt

    def falls_by(self, share: float, deviations: float) -> bool:
        """Whether the error falls by this share and by so many standard deviations."""
        return bool(self.fall >= share and self.deviations >= deviations)

    @property
    def unseen(self) -> str:
        """The unseen data, in words."""
        return _UNSEEN.get(self.by, "unseen data")

    @property
    def unjudged(self) -> str:
        """Why no unseen data can judge it."""
        return self.reason or "no error on unseen data is known"

    @property
    def words(self) -> str:
        """The change of the error, and what it lacks of a proof."""
        if self.falls is None:
            return f"no unseen data can judge it: {self.unjudged}"
        change = f"the error on {self.unseen} changes from {number(self.before_dph)} to {number(self.after_dph)} deg/h"
        if self.falls:
            return f"{change}, but {self.doubt}" if self.doubt else change
        if self.fall < PROVED_FALL:
            return f"{change}, a fall of {100 * PROVED_FALL:.0f} % is needed"
        return f"{change}, which noise alone could do ({self.deviations:.1f} standard deviations)"

    def to_json(self) -> dict[str, Any]:
        """The `proof` of a suspect."""
        return {
            "by": self.by or None,
            "before_dph": finite(self.before_dph),
            "after_dph": finite(self.after_dph),
            "deviations": finite(self.deviations),
            "reason": self.reason,
            "doubt": self.doubt,
        }


_UNSEEN = {"check": "the check run", "legs": "legs left out", "parts of legs": "parts of legs left out"}


def prove(before: LeftOut, after: LeftOut) -> Proof:
    """The proof of what `after` has beside `before`, on the same rows."""
    before = beside_states(before, after)
    if after.residual is None or before.residual is None or after.weights is None:
        return Proof(reason=after.reason or before.reason)
    known = np.isfinite(before.residual) & np.isfinite(after.residual) & (after.weights > 0.0)
    r0, r1 = before.residual[known], after.residual[known]
    root = np.sqrt(after.weights[known])
    if r0.size < 3:
        return Proof(after.by, reason="too few rows are left to compare")
    total = float(np.sum(root**2))
    moved, left = root * (r0 - r1), root * r1
    fall = float(np.sum((root * r0) ** 2) - np.sum(left**2))
    chance = 2.0 * float(np.sqrt(_spread(moved, left)))
    first, last = (float(np.sqrt(np.sum((root * r) ** 2) / total)) for r in (r0, r1))
    return Proof(after.by, first, last, fall / chance if chance > 0.0 else 0.0)


def beside_states(before: LeftOut, after: LeftOut) -> LeftOut:
    """What is compared with `after`: the states in which the check runs began are free on both sides."""
    if before.residual is None or after.weights is None or not any(each.size for each in after.states):
        return before
    ends = np.cumsum([len(each) for each in after.states])[:-1]
    runs = zip(np.split(before.residual, ends), after.states, np.split(after.weights, ends), strict=True)
    left = []
    for residual, states, weights in runs:
        own, known = without_states(residual, states, weights), np.isfinite(residual)
        left.append(own - np.average(own[known], weights=weights[known]) if known.any() else own)
    return replace(before, residual=np.concatenate(left))


def without_states(residual: FloatArray, states: FloatArray, weights: FloatArray) -> FloatArray:
    """A residual (n,) without what columns (n, k) take in beside a constant, which stays in it; NaN stays NaN."""
    known = np.isfinite(residual)
    if not states.shape[1] or not known.any():
        return residual
    columns, root = np.column_stack([np.ones(len(states)), states])[known], np.sqrt(weights[known])
    size = np.linalg.lstsq(root[:, None] * columns, root * residual[known], rcond=None)[0]
    left: FloatArray = residual - states @ size[1:]
    return left


def _spread(moved: FloatArray, left: FloatArray) -> float:
    """Variance of sum(moved * noise): sum over lags of both autocovariances, tapered, at least that without lags."""
    size = len(moved)
    length = 2 * size
    own, noise = (np.fft.irfft(np.abs(np.fft.rfft(x, length)) ** 2, length)[:size] for x in (moved, left))
    longest = max(1, round(_LONGEST_LAG * size))
    taper = 1.0 - np.arange(longest) / longest
    both = taper * own[:longest] * noise[:longest] / size
    return float(max(both[0] + 2.0 * both[1:].sum(), both[0]))


def legs(rows: FitRows) -> IntArray:
    """Leg (rows,) of each row to fit: from one turning point of the temperature to the next, none across two runs."""
    labels, used = [], 0
    for record, mask in zip(rows.records, rows.masks, strict=True):
        own = legs_of(record.channel("temperature"))[mask]
        labels.append(used + own)
        used += int(own.max(initial=-1)) + 1
    return np.unique(np.concatenate(labels), return_inverse=True)[1].astype(np.int64)


def parts(label: IntArray, count: int = _PARTS) -> IntArray:
    """Each leg cut into equal contiguous parts."""
    cut = np.zeros_like(label)
    for leg in np.unique(label):
        own = np.flatnonzero(label == leg)
        cut[own] = count * leg + np.arange(own.size) * count // max(own.size, 1)
    return cut


def visited_again(
    fitted: FloatArray, check: Sequence[Dataset], left: Sequence[FloatArray], weights: Sequence[FloatArray]
) -> LeftOut:
    """Residuals `left` (n,) of check runs where they are at temperatures that were fitted, each about its own mean and
    without its jump.
    """
    low, high = float(np.min(fitted)), float(np.max(fitted))
    residuals = []
    for record, residual, weight in zip(check, left, weights, strict=True):
        temperature = record.channel("temperature")
        inside = np.isfinite(residual) & (temperature >= low) & (temperature <= high)
        if not np.any(inside):
            return LeftOut(reason=f"{record.name} is at no temperature that was fitted")
        alone = without_states(np.where(inside, residual, np.nan), own_jump(record), weight)
        residuals.append(alone - np.average(alone[inside], weights=weight[inside]))
    return LeftOut("check", np.concatenate(residuals), np.concatenate(weights))


def left_out_of(rows: FitRows, solution: Solution, own: int = 0, like: LeftOut | None = None) -> LeftOut:
    """Whole legs left out of a solution, or their parts where the last `own` columns need each of the legs.

    With `like` the same groups as there.
    """
    for by, label in _groups(rows) if like is None or like.label is None else [(like.by, like.label)]:
        if _share(solution, label, own) >= _LEAST_SHARE:
            residual = left_out(solution, rows.weights, label)
            return LeftOut(by, np.where(within(rows, label), residual, np.nan), rows.weights, label=label)
    return LeftOut(reason="a single part of the run determines it")


def _groups(rows: FitRows) -> list[tuple[str, IntArray]]:
    """What may be left out in turn, whole legs first."""
    whole = legs(rows)
    many = int(whole.max(initial=0)) + 1
    cut = parts(whole, max(_PARTS, -(-_LEAST_PARTS // many)))
    return [*([("legs", whole)] if many >= _LEAST_LEGS else []), ("parts of legs", cut)]


def _share(solution: Solution, label: IntArray, own: int) -> float:
    """Least share of what is known of the last `own` coefficients that is left when one group is left out."""
    if not own:
        return 1.0
    size, least = solution.q.shape[1], 1.0
    for group in np.unique(label):
        q = solution.q[label == group]
        values, vectors = np.linalg.eigh(np.eye(size) - q.T @ q)
        inverse = (vectors[-own:] ** 2 / np.maximum(values, 1e-12)).sum(axis=1)
        least = min(least, float(1.0 / inverse.max()))
    return least


def within(rows: FitRows, label: IntArray) -> BoolArray:
    """Rows (rows,) whose temperature lies within the range of the rows of all other groups: nothing is extrapolated."""
    pairs = zip(rows.records, rows.masks, strict=True)
    temperature = np.concatenate([record.channel("temperature")[mask] for record, mask in pairs])
    inside = np.zeros(len(label), dtype=bool)
    for group in np.unique(label):
        out = label == group
        rest = temperature[~out]
        inside[out] = (temperature[out] >= rest.min()) & (temperature[out] <= rest.max()) if rest.size else False
    return inside
