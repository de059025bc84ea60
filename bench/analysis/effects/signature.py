"""The contribution of an effect to the example run, for `bench effects show` and the documentation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.analysis.effects.example import example
from bench.analysis.effects.registry import make
from bench.base import FloatArray


@dataclass(frozen=True)
class Signature:
    """What an effect adds to the bias of the example run, with a peak of 1 deg/h: three arrays (n,)."""

    time_s: FloatArray
    temperature: FloatArray
    contribution: FloatArray


def signature(name: str, options: Mapping[str, Any] | None = None) -> Signature:
    """Contribution of an effect with these options to the example run, nonlinear parameters at their start values.

    All amplitudes are alike in size; an effect that moves the abscissa is shown on a bent bias curve.
    """
    record = example()
    effect = make(name, options)
    choices = effect.choices()
    effect = choices[len(choices) // 3] if choices else effect
    effect = effect.suited([record]).prepare([record])
    theta = {parameter.name: parameter.start for parameter in effect.parameters}
    if effect.moves_abscissa:
        drawn = _bent(effect.abscissa(record, theta)) - _bent(record.channel("temperature"))
    else:
        columns = effect.columns(record, theta)
        columns = columns - np.nanmean(columns, axis=0) if effect.family == "static" else columns
        drawn = (columns / np.maximum(np.nanmax(np.abs(columns), axis=0), 1e-300)).sum(axis=1)
    peak = float(np.nanmax(np.abs(drawn)))
    return Signature(record.time, record.channel("temperature"), drawn / (peak or 1.0))


def _bent(temperature: FloatArray) -> FloatArray:
    return 0.02 * temperature + 3e-4 * (temperature - 20.0) ** 2
