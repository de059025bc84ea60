"""How far heating and cooling part: the first sign of an effect with memory."""

from __future__ import annotations

import numpy as np

from bench.base import FloatArray
from bench.record import Dataset

_BIN_DEGC = 2.5
_LEAST_ROWS = 2


def branch_gap(dataset: Dataset, values: FloatArray | None = None) -> tuple[float, float] | None:
    """Largest heating less cooling difference of the bias at one temperature: (gap [deg/h], at [degC]).

    `values` (n,) [deg/h] stand in for the bias, such as a residual.

    Compared are medians over 2.5 degC; None where no temperature was passed in both directions.
    """
    temperature, bias = dataset.channel("temperature"), dataset.bias if values is None else values
    present = np.isfinite(temperature) & np.isfinite(bias)
    where = np.floor(np.where(present, temperature, 0.0) / _BIN_DEGC)
    gaps = []
    for cell in np.unique(where[present]):
        up, down = (bias[present & (where == cell) & (dataset.direction == sign)] for sign in (1, -1))
        if min(up.size, down.size) >= _LEAST_ROWS:
            gaps.append((float(np.median(up) - np.median(down)), float((cell + 0.5) * _BIN_DEGC)))
    return max(gaps, key=lambda pair: abs(pair[0]), default=None)
