"""Mean residual of each turn-on, and how far turn-ons scatter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bench.analysis.judging.quantities import turning
from bench.base import FloatArray, InputError
from bench.record import Dataset


@dataclass(frozen=True)
class TurnOn:
    """One turn-on of a unit in one run."""

    run: str
    number: int
    """Within the run, from 1."""
    mean_dph: float
    """Mean residual at rest, weighted by samples [deg/h]."""
    seconds: float
    """Time that stands behind it [s]."""


@dataclass(frozen=True)
class TurnOns:
    """All turn-ons of some runs."""

    each: tuple[TurnOn, ...]
    between_dph: float | None
    """Standard deviation of the means about their own mean [deg/h]; None: fewer than two turn-ons."""
    degrees_of_freedom: int
    """One less than there are turn-ons, 0 for none."""


def turn_ons(records: Sequence[Dataset], residuals: Sequence[FloatArray]) -> TurnOns:
    """Turn-ons of runs of one unit, with the residuals (n,) [deg/h] of each record; InputError where sizes differ.

    Each run begins with a turn-on of its own, and each power cycle in it with another one. The noise of a mean and what
    a model lacks at its temperatures are in the scatter as well: it is never smaller than that of the turn-ons alone.
    Rows in which a rate table turns the unit, and gaps, do not count.
    """
    each = []
    for record, residual in zip(records, residuals, strict=True):
        if residual.shape != record.time.shape:
            raise InputError(f"{record.name}: {residual.size} residuals for {len(record)} rows")
        weight = np.where(np.isfinite(residual) & ~turning(record), record.count("rate"), 0.0)
        for number in np.unique(record.turn_on[weight > 0.0]).tolist():
            rows = (record.turn_on == number) & (weight > 0.0)
            mean = float(np.average(residual[rows], weights=weight[rows]))
            each.append(TurnOn(record.name, number, mean, float(np.count_nonzero(rows) * record.interval_s)))
    means = [one.mean_dph for one in each]
    between = float(np.std(means, ddof=1)) if len(means) > 1 else None
    return TurnOns(tuple(each), between, max(len(means) - 1, 0))
