"""One calibration for a lot of units, and what each unit loses by it.

Equation: y_i = X_i beta + X_i (beta_i - beta) + noise; the lot has one beta, fitted to all its units, and unit i would
have beta_i. Its error with the lot's calibration is that of beta fitted without it (leave one unit out). Nonlinear
parameters are those of the whole lot: with ten units and more, one unit hardly moves them.
Source: second source paper, which compensates several units by one set of coefficients; leave-one-out over units as in
P. Geladi, B. Kowalski, Anal. Chim. Acta 185 (1986) 1.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bench.analysis.diagnosis.scores import HeldOut, Score
from bench.analysis.effects.model import Model
from bench.analysis.fit.fitting import Fit, fit_model
from bench.analysis.judging.calibration import calibration
from bench.analysis.judging.likeness import Cells
from bench.analysis.noise.floor import Floor
from bench.base import FloatArray, InputError, number
from bench.record import Dataset, Manifest

LEAST = 3
"""Units of a lot."""
_OF_ONE_RUN = frozenset({"time", "compressor"})


@dataclass(frozen=True)
class UnitLoss:
    """Error of a unit [deg/h RMS]: by its own calibration (in-sample), and by that of the lot without it."""

    unit: str
    own_rms_dph: float
    lot_rms_dph: float
    levelled_rms_dph: float
    """By the lot's without it and a constant of its own."""


@dataclass(frozen=True, eq=False)
class Lot:
    """A fit to all units of a lot, the loss of each unit, and the cells that tell which unit is like it."""

    fit: Fit
    losses: tuple[UnitLoss, ...]
    cells: Cells
    table: FloatArray
    """Mean bias of each unit in each cell (n, 2 m) [deg/h]."""
    spread: FloatArray
    """Covariance (1 + k, ..) of the amplitudes of a further unit about those of the lot."""

    def calibration(self, manifest: Manifest, record: Dataset) -> dict[str, Any]:
        """Content of calibration.json; `record` holds all rows of the lot, as its run folder gives them back.

        The standard uncertainties are those for any unit of the lot: they contain how the units differ.
        """
        fit = fit_model(self.fit.model, record, covariance="sandwich")
        covariance, size = np.zeros_like(fit.covariance), fit.beta.size
        covariance[:size, :size] = self.spread
        covariance[size:, size:] = fit.covariance[size:, size:]
        fit = replace(fit, covariance=covariance, runs=self.fit.runs)
        errors = np.array([loss.lot_rms_dph for loss in self.losses])
        left_out = HeldOut("units", float(np.sqrt(np.mean(errors**2))))
        whole = fit.rms_dph, (np.nan, np.nan)
        score = Score(fit.model, fit, *whole, left_out, left_out, left_out, ())
        text = (
            f"{fit.model.name} for {len(self.losses)} units; a unit that is left out has {number(np.median(errors))} "
            f"deg/h RMS (median), 95 % of them at most {number(float(np.quantile(errors, 0.95)))}"
        )
        answer = {"verdict": "model_error", "sentence": text, "complete": True, "admissible": True, "warnings": []}
        return calibration(manifest, record.interval_s, score, Floor(reason="the units of a lot differ"), answer)


def calibrate_lot(model: Model, records: Sequence[Dataset]) -> Lot:
    """Fit a model to runs of several units. InputError: fewer than three units, or a model of one run only."""
    units = by_unit(records)
    if len(units) < LEAST:
        raise InputError(f"a lot has at least {LEAST} units, these runs are of {len(units)}: {', '.join(units)}")
    if own := sorted(_OF_ONE_RUN & set(model.needs)):
        raise InputError(f"model '{model.name}' needs {', '.join(own)}, which differs from run to run; leave it out")
    if model.rows != "all":
        raise InputError(f"model '{model.name}' is fitted to {model.rows}; a lot's is fitted to all rows")
    fit = fit_model(model, records, covariance="none")
    parts = [_reduced(fit, own) for own in units.values()]
    losses = tuple(_loss(unit, i, parts) for i, unit in enumerate(units))
    amplitudes = np.array([np.linalg.lstsq(part[:, :-1], part[:, -1], rcond=None)[0] for part in parts])
    spread = np.cov(amplitudes.T) * (1.0 + 1.0 / len(units))
    low = max(min(float(np.nanmin(r.channel("temperature"))) for r in own) for own in units.values())
    high = min(max(float(np.nanmax(r.channel("temperature"))) for r in own) for own in units.values())
    if not low < high:
        raise InputError("the units of this lot have no temperature in common")
    cells = Cells.over(low, high)
    return Lot(fit, losses, cells, np.array([cells.means(own) for own in units.values()]), spread)


def by_unit(records: Sequence[Dataset]) -> Mapping[str, list[Dataset]]:
    """Runs of each unit, in their order. InputError where a run does not say its unit."""
    units: dict[str, list[Dataset]] = {}
    for record in records:
        if not record.unit:
            raise InputError(f"{record.name}: the run does not say which unit it is of")
        units.setdefault(record.unit, []).append(record)
    return units


def _reduced(fit: Fit, records: Sequence[Dataset]) -> FloatArray:
    """Triangle (1 + k + 1, ..) of the columns and the bias of a unit, each row of means divided by the root of n."""
    rows = np.concatenate([np.column_stack([fit.bound.columns(record), record.bias]) for record in records])
    rows = rows[np.all(np.isfinite(rows), axis=1)]
    return np.asarray(np.linalg.qr(rows / np.sqrt(len(rows)), mode="r"))


def _loss(unit: str, index: int, parts: Sequence[FloatArray]) -> UnitLoss:
    own = parts[index]
    others = np.concatenate([part for i, part in enumerate(parts) if i != index])
    mine, lot = (np.linalg.lstsq(part[:, :-1], part[:, -1], rcond=None)[0] for part in (own, others))
    left = own[:, -1] - own[:, :-1] @ lot
    # The first column is the constant: its part of what is left is what a constant of the unit's own removes.
    constant = own[:, 0] / np.linalg.norm(own[:, 0])
    levelled = left - constant * float(constant @ left)
    errors = (float(np.linalg.norm(rest)) for rest in (own[:, -1] - own[:, :-1] @ mine, left, levelled))
    return UnitLoss(unit, *errors)
