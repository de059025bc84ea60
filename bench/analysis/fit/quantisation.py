"""Coarse steps of a temperature sensor: detected in the data, judged by the error that they cause."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bench.analysis.fit.design import Bound
from bench.base import FloatArray
from bench.record import Dataset

_WORTH_SAYING = 0.1
"""Share of the fit's RMS above which the steps are worth a warning."""


def coarse_temperature(bound: Bound, beta: FloatArray, rms_dph: float, datasets: Sequence[Dataset]) -> tuple[str, ...]:
    """Warnings about coarse steps: of their error, slope * step / sqrt(12)."""
    texts = []
    for dataset in datasets:
        step = dataset.temperature_step
        if step == 0.0:
            continue
        error = step_error_dph(bound, beta, dataset)
        if error > _WORTH_SAYING * rms_dph:
            texts.append(
                f"{dataset.name}: the temperature sensor has steps of {step:.3g} degC; they cause {error:.3g} deg/h RMS"
            )
    return tuple(texts)


def step_error_dph(bound: Bound, beta: FloatArray, dataset: Dataset) -> float:
    """RMS error [deg/h] that the steps of the temperature sensor cause, 0 where its values look continuous."""
    step = dataset.temperature_step
    return float(_rms_slope(bound, beta, dataset, step)) * step / float(np.sqrt(12.0)) if step else 0.0


def _rms_slope(bound: Bound, beta: FloatArray, dataset: Dataset, step: float) -> FloatArray:
    """RMS slope of the fitted bias over one step of temperature [deg/h/degC]."""
    ends = []
    for shift in (-0.5, 0.5):
        shifted = dataset.with_channel("temperature", dataset.channel("temperature") + shift * step)
        ends.append(bound.columns(shifted) @ beta)
    slope: FloatArray = np.sqrt(np.nanmean((ends[1] - ends[0]) ** 2)) / step
    return slope
