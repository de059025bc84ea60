"""The calibration of a unit whose run ended early: its rows, and what its lot says of the rest."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from bench.analysis.diagnosis.scores import HeldOut, Score
from bench.analysis.fit.design import FitRows, fit_rows
from bench.analysis.fit.fitting import Fit
from bench.analysis.judging.calibration import calibration
from bench.analysis.judging.prior import Expected, Prior
from bench.analysis.noise.floor import Floor
from bench.base import FloatArray, number
from bench.record import Dataset, Manifest


def completed(prior: Prior, lot: str, record: Dataset, manifest: Manifest) -> tuple[Expected, dict[str, Any]]:
    """The error to be expected of it, and the content of its calibration.json."""
    found = prior.expected(record)
    fit = _fit(prior, record, found)
    left_out = HeldOut("units", found.error_dph)
    score = Score(fit.model, fit, fit.rms_dph, (np.nan, np.nan), left_out, left_out, left_out, ())
    text = (
        f"{fit.model.name} by the run and lot {lot}: {number(found.error_dph)} deg/h RMS expected over the lot's whole "
        f"run (95 %: {number(found.low_dph)} to {number(found.high_dph)})"
    )
    answer = {"verdict": "model_error", "sentence": text, "complete": True, "admissible": True, "warnings": []}
    return found, calibration(manifest, record.interval_s, score, Floor(reason="the lot stands for the rest"), answer)


def _fit(prior: Prior, record: Dataset, found: Expected) -> Fit:
    """The posterior in the columns that the unit's own rows have: least squares to its curve over both runs."""
    rows = fit_rows(prior.fit.model, (record,))
    bound, columns = rows.bind(_parameters(prior, rows, found.amplitudes))
    both = (record, prior.records[0])
    own = np.concatenate([bound.columns(one) for one in both])
    lots = np.concatenate([prior.columns(one) for one in both])
    usable = np.isfinite(own).all(axis=1) & np.isfinite(lots).all(axis=1)
    onto = np.linalg.lstsq(own[usable], lots[usable], rcond=None)[0]
    beta = onto @ found.amplitudes
    size = beta.size + len(rows.parameters)
    covariance = np.full((size, size), np.nan)
    covariance[: beta.size, : beta.size] = onto @ found.covariance @ onto.T
    residual = rows.y - columns @ beta
    return replace(
        prior.fit,
        bound=bound,
        beta=beta,
        covariance=covariance,
        rms_dph=float(np.sqrt(np.average(residual**2, weights=rows.weights))),
        condition=float(np.linalg.cond(columns)),
        rows=rows.y.size,
        interval_s=record.interval_s,
        runs=(record.name,),
        validity=rows.validity(),
        residuals=rows.scatter(residual),
    )


def _parameters(prior: Prior, rows: FitRows, amplitudes: FloatArray) -> FloatArray:
    """The unit's nonlinear parameters (m,), within their ranges."""
    moved = prior.parameters(amplitudes)
    pairs = zip(moved, rows.parameters, strict=True)
    return np.array([min(max(value, parameter.low), parameter.high) for value, parameter in pairs])
