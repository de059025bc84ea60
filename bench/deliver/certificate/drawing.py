"""Figures for print as plain data: axes with ticks, dots and lines in the unit square; the template only draws.

Colours are names that the template knows: accent, warm, grey, ink.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.base import FloatArray
from bench.deliver.report.plotting import thin

_DIGITS = 4
_STEPS = (1.0, 2.0, 2.5, 5.0, 10.0)


@dataclass(frozen=True)
class Axis:
    """A range with round ticks; `log` by decades."""

    label: str
    low: float
    high: float
    log: bool = False

    @classmethod
    def around(cls, label: str, *values: FloatArray, log: bool = False, margin: float = 0.04) -> Axis:
        """An axis that shows all values."""
        shown = np.concatenate([np.ravel(value) for value in values])
        shown = shown[np.isfinite(shown) & ((shown > 0) | (not log))]
        low, high = (float(shown.min()), float(shown.max())) if shown.size else (0.1, 1.0)
        if log:
            low, high = float(np.log10(low)), float(np.log10(high))
        room = margin * (high - low) or 0.5 * abs(high) or 1.0
        low, high = low - room, high + room
        return cls(label, 10.0**low if log else low, 10.0**high if log else high, log)

    def place(self, values: FloatArray) -> FloatArray:
        """Positions of values, 0 at the low end and 1 at the high one."""
        low, high, shown = self.low, self.high, values
        if self.log:
            low, high, shown = float(np.log10(low)), float(np.log10(high)), np.log10(values)
        placed: FloatArray = (shown - low) / (high - low)
        return placed

    def to_json(self) -> dict[str, Any]:
        """Label and ticks: position and text."""
        ticks = self._decades() if self.log else self._round()
        places = self.place(np.array(ticks, dtype=np.float64))
        return {
            "label": self.label,
            "ticks": [
                {"at": round(place, 5), "text": f"{tick:.6g}".replace("-", "−")}
                for place, tick in zip(places.tolist(), ticks, strict=True)
            ],
        }

    def _round(self, most: int = 7) -> list[float]:
        size = 10.0 ** np.floor(np.log10((self.high - self.low) / most))
        step = next(size * s for s in _STEPS if (self.high - self.low) / (size * s) <= most)
        return [float(step * i) for i in range(int(np.ceil(self.low / step)), int(np.floor(self.high / step)) + 1)]

    def _decades(self) -> list[float]:
        first, last = int(np.floor(np.log10(self.low))), int(np.ceil(np.log10(self.high)))
        digits = (1, 2, 5) if last - first <= 3 else (1,)
        ticks = [d * 10.0**k for k in range(first, last + 1) for d in digits]
        return [tick for tick in ticks if self.low <= tick <= self.high]


def dots(x: FloatArray, y: FloatArray, axes: tuple[Axis, Axis], colour: str, name: str = "") -> dict[str, Any]:
    """Separate points."""
    return {"kind": "dots", "colour": colour, "name": name, "points": _points(x, y, axes)}


def line(
    x: FloatArray, y: FloatArray, axes: tuple[Axis, Axis], colour: str, name: str = "", dashed: bool = False
) -> dict[str, Any]:
    """A line through points; NaN breaks it."""
    present = np.isfinite(x) & np.isfinite(y)
    pieces = np.split(np.arange(x.size), np.flatnonzero(~present))
    kept = [rows[present[rows]] for rows in pieces]
    runs = [_points(x[rows], y[rows], axes) for rows in kept if rows.size > 1]
    return {"kind": "line", "colour": colour, "name": name, "dashed": dashed, "runs": [r for r in runs if len(r) > 1]}


def band(low: float, high: float, axis: Axis, name: str = "") -> dict[str, Any]:
    """A pale horizontal band."""
    ends = np.clip(axis.place(np.array([low, high])), 0.0, 1.0)
    return {"kind": "band", "colour": "grey", "name": name, "from": float(ends[0]), "to": float(ends[1])}


def figure(axes: tuple[Axis, Axis], series: Iterable[dict[str, Any]], words: str) -> dict[str, Any]:
    """A figure with its text alternative."""
    return {"x": axes[0].to_json(), "y": axes[1].to_json(), "series": list(series), "alt": words}


def _points(x: FloatArray, y: FloatArray, axes: tuple[Axis, Axis]) -> Sequence[list[float]]:
    rows = thin(y, 900)
    u, v = axes[0].place(x[rows]), axes[1].place(y[rows])
    inside = np.isfinite(u) & np.isfinite(v) & (u >= 0) & (u <= 1) & (v >= 0) & (v <= 1)
    pairs: list[list[float]] = np.round(np.column_stack([u, v])[inside], _DIGITS).tolist()
    return pairs
