"""A curve in a terminal, drawn with braille characters."""

from __future__ import annotations

import numpy as np

from bench.base import FloatArray

_WIDTH = 60
_DOTS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]])


def plot(x: FloatArray, y: FloatArray, x_unit: str, y_unit: str, *, height: int = 8, logarithmic: bool = False) -> str:
    """Points (n,) as text of 60 by `height` characters, with the ranges of both axes."""
    width = _WIDTH
    known = np.isfinite(x) & np.isfinite(y)
    x, y = x[known], y[known]
    across, up = (np.log10(x), np.log10(y)) if logarithmic else (x, y)
    column = np.round(_share(across) * (2 * width - 1)).astype(int)
    row = np.round((1 - _share(up)) * (4 * height - 1)).astype(int)
    cells = np.zeros((height, width), dtype=int)
    np.bitwise_or.at(cells, (row // 4, column // 2), _DOTS[row % 4, column % 2])
    labels = [f"{y.max():>8.3g} ", *[" " * 9] * (height - 2), f"{y.min():>8.3g} "]
    lines = [label + "".join(chr(0x2800 + cell) for cell in line) for label, line in zip(labels, cells, strict=True)]
    foot = f"{x.min():.3g} {x_unit}"
    return "\n".join([*lines, f"{y_unit:>8} {foot}{f'{x.max():.3g} {x_unit}':>{width - len(foot)}}"])


def _share(values: FloatArray) -> FloatArray:
    """Position of each value between the least and the greatest, 0 to 1."""
    span = float(values.max() - values.min())
    share: FloatArray = (values - values.min()) / (span or 1.0)
    return share
