"""Jumps of the bias that a check run has for itself: no fitted run can know them, and no proof counts them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from bench.analysis.effects.bias_jump import BiasJump
from bench.analysis.fit.disturbances import Curve, undisturbed
from bench.analysis.fit.solve import one_blas_thread
from bench.analysis.noise.spikes import causes, moves, sharp
from bench.base import FloatArray, deviation, number
from bench.record import Dataset, Jump

_MOST_SHARP = 2  # changes of the run: a jump that returns has two
_FADING_S = tuple(np.geomspace(60.0, 7200.0, 15).tolist())
_SETTLED = 5  # rows: a run may begin with a transient
_PLAIN = 40.0  # gain in 2 ln L that a jump needs, and a further parameter of it
_FURTHER = 15.0
_HIGH = 4.0  # robust deviations of what is left: slow noise alone gains as much over many rows
_PARTS = np.arange(-1.5, 1.6, 0.25)  # of a row, from the one before which the rate changes
_NEAR = 0.1  # of a row, and of how long it lasts


def with_own_jump(check: Dataset, fitted: Sequence[Dataset]) -> Dataset:
    """A check run with the `jump` that it has and no fitted run has anything like; as it is where there is none.

    A jump changes the rate sharply where no channel moves, and no other sharp change is left beside it.
    """
    if not (check.has("rate") and check.has("temperature")):
        return check
    check = undisturbed(check)
    with one_blas_thread():
        rows = _sharp((curve := Curve(check)).left())
        if (
            not 0 < len(rows) <= _MOST_SHARP
            or rows[0] < _SETTLED
            or any(_sharp(Curve(undisturbed(run)).left()).size for run in fitted)
        ):
            return check
        if any(moves(channel, row - 1) for channel in causes(check) for row in rows.tolist()):
            return check
        found = _best(curve, [float(check.time[row]) for row in rows])
    return check if found is None else replace(check, jump=found)


def own_jump(record: Dataset) -> FloatArray:
    """What each row has of the jump of a record (n, k), and how that changes with its time and how long it lasts, which
    what is missing in the model makes uncertain; no column where there is none.
    """
    if (jump := record.jump) is None:
        return np.empty((len(record), 0))
    near = [jump._replace(at_h=jump.at_h + _NEAR * record.interval_s / 3600.0)]
    near += [jump._replace(lasts_s=jump.lasts_s * (1.0 + _NEAR))] if jump.lasts_s else []
    own = _column(record, jump)
    return np.hstack([own, *(_column(record, other) - own for other in near)])


def jump_words(checks: Sequence[Dataset]) -> tuple[str, ...]:
    """A sentence for each jump of these check runs."""
    return tuple(
        f"{run.name} jumps by {number(run.jump.height_dph)} deg/h at {run.jump.at_h:.2f} h{_then(run.jump)}, while no "
        "channel moves, and no fitted run jumps: the held-out error has it, and what an effect or a formula lowers is "
        "stated without it"
        for run in checks if run.jump
    )  # fmt: skip


def _then(jump: Jump) -> str:
    if jump.then == "fades":
        return f" and fades with a time constant of {jump.lasts_s / 60.0:.1f} min"
    return f" and returns after {jump.lasts_s / 60.0:.1f} min" if jump.then == "returns" else " and stays there"


_sharp = partial(sharp, beside_slow=True)


def _column(run: Dataset, jump: Jump) -> FloatArray:
    theta = {"at_h": jump.at_h, "tau_s": jump.lasts_s, "lasts_s": jump.lasts_s}
    return BiasJump(then=jump.then).columns(run, theta)


def _best(curve: Curve, at_s: Sequence[float]) -> Jump | None:
    """The plainest jump at these times of the run of a curve that leaves no sharp change; None: there is none."""
    run = curve.run
    plain = np.column_stack([curve.columns(), run.dT_dt])  # the commonest of what else moves the bias
    known = np.isfinite(run.bias) & np.isfinite(plain).all(axis=1)
    base, y = np.linalg.qr(plain[known])[0], run.bias[known]

    def fitted(jump: Jump) -> tuple[float, FloatArray]:
        """Height of the jump beside the base, and what both leave (m,)."""
        column = _column(run, jump)[known, 0]
        column -= base @ (base.T @ column)
        size = float(column @ column)
        height = 0.0 if size < 1e-9 else float(column @ rest) / size
        return height, rest - column * height

    def misfit(jump: Jump) -> float:
        return len(y) * float(np.log(np.sum(fitted(jump)[1] ** 2)))

    rest, best = y - base @ (base.T @ y), None
    least = len(y) * float(np.log(rest @ rest)) - _PLAIN
    parts_s = (_PARTS * run.interval_s).tolist()
    begins_h = [(t + part_s) / 3600.0 for t in at_s for part_s in parts_s]
    apart_s = np.diff(at_s).tolist()
    lasts_s = {"stays": [0.0], "fades": _FADING_S, "returns": [t + part_s for t in apart_s for part_s in parts_s]}
    for then, each in lasts_s.items():
        tried = [Jump(float(at_h), then, lasting_s, 0.0) for at_h in begins_h for lasting_s in each]
        one = min(tried, key=misfit, default=None)
        further = _FURTHER if then != "stays" else 0.0
        if one is not None and misfit(one) + further < least:
            best, least = one, misfit(one) + further
    if best is None:
        return None
    height, left = fitted(best)
    after = np.full(len(run), np.nan)
    after[known] = left
    if _sharp(after).size or abs(height) < _HIGH * deviation(left):
        return None
    return best._replace(height_dph=height)
