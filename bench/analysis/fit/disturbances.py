"""Short stretches of a run in which it was disturbed: no model is fitted to them, and none is judged by them.

Which these are depends on the run alone, so that every model, and every command, leaves out the same rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from weakref import WeakKeyDictionary

import numpy as np

from bench.analysis.effects.model import Model
from bench.analysis.effects.spline import Spline
from bench.analysis.fit.design import fit_rows
from bench.analysis.fit.parameters import choose
from bench.analysis.fit.solve import one_blas_thread, solve
from bench.analysis.noise.spikes import stretches
from bench.analysis.thresholds import LEAST_INTERVALS
from bench.base import BoolArray, FloatArray, InputError, number
from bench.record import DEFAULT_INTERVAL_S, Dataset, Disturbance

_MOST = 6  # stretches of a run that are left out: what comes more often is no accident
_known: WeakKeyDictionary[Dataset, Dataset] = WeakKeyDictionary()


def undisturbed(run: Dataset) -> Dataset:
    """The run without the rate of the stretches that stand out of a curve over temperature (see `stretches`).

    The worst one at a time: a curve that follows it in part stands out elsewhere. `disturbed` of the answer says which.
    """
    if run.disturbed is not None or not (run.has("rate") and run.has("temperature")):
        return run
    if (known := _known.get(run)) is not None:
        return known
    left = means = run.average(max(DEFAULT_INTERVAL_S, run.interval_s))  # the same rows, however long a row is
    half_s, found = means.interval_s / 2.0, list[Disturbance]()
    with one_blas_thread():
        while some := stretches(left, (curve := Curve(left)).left(), curve.left if curve.rows else None):
            if len(found) == _MOST:
                found.clear()
                break
            first, end, height = max(some, key=lambda one: abs(one.height))
            found.append(Disturbance(float(means.time[first]) - half_s, float(means.time[end - 1]) + half_s, height))
            left = without(left, _rows(left, found[-1:]))
    _known[run] = answer = replace(without(run, _rows(run, found)), disturbed=tuple(sorted(found)))
    return answer


def left_out_words(runs: Sequence[Dataset]) -> tuple[str, ...]:
    """A sentence for each stretch that was left out of these runs."""
    return tuple(
        f"{run.name} from {one.from_s:.0f} to {one.to_s:.0f} s stands out by {number(one.height_dph)} deg/h, and no "
        "channel moves with it: left out of every fit, and of the errors"
        for run in runs for one in run.disturbed or ()
    )  # fmt: skip


def without(run: Dataset, rows: BoolArray) -> Dataset:
    """A run without the rate of some rows (n,)."""
    return run.with_channel("rate", np.where(rows, np.nan, run.channel("rate"))) if rows.any() else run


def _rows(run: Dataset, some: Sequence[Disturbance]) -> BoolArray:
    """Rows (n,) of a run that lie in one of these stretches."""
    inside = np.zeros(len(run), dtype=bool)
    for one in some:
        inside |= (run.time > one.from_s) & (run.time < one.to_s)
    return inside


class Curve:
    """A fine curve over temperature through a run; through one at one temperature, none."""

    def __init__(self, run: Dataset) -> None:
        self.run, self.rows = run, None
        for curve in (Spline(), Spline(LEAST_INTERVALS)):  # the automatic one may be too coarse
            try:
                rows = choose(fit_rows(Model("curve", (curve,)), (run,)))
                rows.bind(rows.start())
            except InputError:
                return
            self.rows, chosen = rows, rows.model.effects[0]
            if isinstance(chosen, Spline) and int(chosen.intervals) >= LEAST_INTERVALS:
                return

    def columns(self) -> FloatArray:
        """Its columns (n, k) with a constant; the constant alone where it is none."""
        if self.rows is None:
            return np.ones((len(self.run), 1))
        return self.rows.bind(self.rows.start())[0].columns(self.run)

    def left(self, out: BoolArray | None = None) -> FloatArray:
        """What it leaves of the bias (n,) [deg/h], fitted without some rows (n,); the bias itself where it is none."""
        if self.rows is None:
            return self.run.bias
        (mask,) = self.rows.masks
        rows = self.rows if out is None else replace(self.rows, masks=(mask & ~out,))
        try:
            bound, columns = rows.bind(rows.start())
        except InputError:  # nothing else is at these temperatures
            return self.left()
        return np.asarray(self.run.bias - bound.columns(self.run) @ solve(columns, rows.y, rows.weights).beta)
