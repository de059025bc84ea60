"""Style of all figures: colours for every kind of colour vision, axes with units, no more points than pixels."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from datetime import datetime, timedelta
from itertools import pairwise
from typing import Any

import numpy as np
import plotly.graph_objects as go

from bench.base import FloatArray, IntArray

BLUE, ORANGE, GREEN, VERMILION, SKY, PURPLE, GREY = (
    "#0072B2", "#E69F00", "#009E73", "#D55E00", "#56B4E9", "#CC79A7", "#8A949D",
)  # fmt: skip
"""Palette of Okabe and Ito (2008), without its black and yellow, which are invisible on dark and on white."""

CYCLE = (BLUE, ORANGE, GREEN, VERMILION, SKY, PURPLE)
PASSAGE = ((0.0, "#3B78D8"), (0.35, "#8F63C4"), (0.7, "#D1567A"), (1.0, "#F0A23C"))
"""Colours of passing time: cold to warm, visible on white and on dark, also without red or green."""

SHADES = ((0.0, BLUE), (0.5, "rgba(138,148,157,0.18)"), (1.0, VERMILION))
"""Colours of a sign: blue and vermilion differ also for the colour-blind; zero is close to the background."""

DIRECTIONS: Mapping[int, tuple[str, str]] = {1: ("heating", VERMILION), -1: ("cooling", BLUE), 0: ("constant", GREY)}
MAX_POINTS = 2000
_PAUSE_H = 0.25
_PAUSE_STEPS = 5.0
FONT = 'system-ui, "Segoe UI", "Liberation Sans", "DejaVu Sans", sans-serif'

Plot = dict[str, Any]


def axis(title: str, **more: Any) -> dict[str, Any]:
    """An axis with its title (quantity and unit), a line and a light grid."""
    return {
        "title": {"text": title, "font": {"size": 13}, "standoff": 8},
        "exponentformat": "none",
        "showline": True,
        "ticks": "outside",
        "automargin": True,
        "zeroline": False,
        **more,
    }


def dates(moments: Collection[str], least: timedelta, **more: Any) -> dict[str, Any]:
    """An axis of dates [UTC], as long as `least`: a single moment by itself would get an axis of a second."""
    times = [datetime.fromisoformat(moment) for moment in moments]
    first, last = min(times), max(times)
    middle = first + (last - first) / 2
    range_ = [(middle + half).isoformat() for half in (-least / 2, least / 2)]
    return axis("UTC", type="date", tickangle=0, **({"range": range_} if last - first < least else {}), **more)


def plot(traces: Sequence[Any], layout: Mapping[str, Any], height: int = 420) -> Plot:
    """Traces and axes as JSON for the page; plotly checks every property name."""
    legend = {"orientation": "h", "x": 0, "y": 1.02, "yanchor": "bottom", "itemsizing": "constant"}
    whole = go.Layout(
        height=height,
        paper_bgcolor="rgba(0,0,0,0)",
        plot_bgcolor="rgba(0,0,0,0)",
        font={"size": 13, "family": FONT},
        hovermode="closest",
        modebar={"bgcolor": "rgba(0,0,0,0)", "color": GREY, "activecolor": BLUE},
        **{"legend": legend, "margin": {"l": 70, "r": 20, "t": 40, "b": 55}, **layout},
    )
    data = [trace.to_plotly_json() for trace in traces]
    # Without a template of its own a figure would get plotly's colours in a notebook.
    return {"data": plain(data), "layout": {**plain(whole.to_plotly_json()), "template": {}}}


def plain(value: Any) -> Any:
    """JSON types only; arrays to eight significant digits, gaps as null."""
    if isinstance(value, np.ndarray):
        numbers = value.dtype.kind == "f" and value.ndim == 1
        return _rounded(value) if numbers else [plain(item) for item in value.tolist()]
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, float):
        return float(f"{value:.8g}") if np.isfinite(value) else None
    return value


def _rounded(values: FloatArray) -> list[float | None]:
    """Eight significant digits of numbers (n,), gaps as null; all are written at once, in a third of the time."""
    found: list[float | None] = list(map(float, ("%.8g " * values.size % tuple(values.tolist())).split()))
    for gap in np.flatnonzero(~np.isfinite(values)):
        found[gap] = None
    return found


def thin(values: FloatArray, most: int = MAX_POINTS) -> IntArray:
    """Rows (k,) through which a line looks as through all n: first, lowest and highest row of equal pieces."""
    n = values.size
    if n <= most:
        return np.arange(n)
    borders = np.linspace(0, n, max(1, most // 3) + 1).astype(np.int64)
    rows: set[int] = {0, n - 1}
    for begin, end in pairwise(borders):
        piece = values[begin:end]
        rows.add(int(begin))
        if np.any(np.isfinite(piece)):
            rows |= {int(begin + np.nanargmin(piece)), int(begin + np.nanargmax(piece))}
    return np.array(sorted(rows), dtype=np.int64)


def line_trace(x: FloatArray, y: FloatArray, name: str, colour: str, **more: Any) -> go.Scatter:
    """A thinned line; gaps are not connected, except where most values have one on either side, as of a slow log."""
    rows = thin(y)
    known = np.isfinite(y)
    slow = 2 * np.count_nonzero(known[1:] & known[:-1]) < np.count_nonzero(known)
    style = {"color": colour, "width": more.pop("width", 1.6), "dash": more.pop("dash", "solid")}
    return go.Scatter(
        x=plain(x[rows]), y=plain(y[rows]), name=name, mode="lines", line=style, connectgaps=bool(slow), **more
    )


def time_trace(hours: FloatArray, y: FloatArray, name: str, colour: str, **more: Any) -> go.Scatter:
    """A thinned line over time [h], broken where a record pauses: by a quarter of an hour and five of its steps."""
    steps = np.diff(hours)
    pauses = np.flatnonzero(steps > max(_PAUSE_H, _PAUSE_STEPS * float(np.median([*steps, 0.0]))))
    parts = np.split(np.arange(hours.size), pauses + 1)
    rows = [part[thin(y[part], MAX_POINTS // len(parts))] for part in parts]
    ends = np.cumsum([len(own) for own in rows])[:-1]
    x, broken = (np.insert(values[np.concatenate(rows)], ends, np.nan) for values in (hours, y))
    return line_trace(x, broken, name, colour, **more)


def dot_trace(x: FloatArray, y: FloatArray, name: str, colour: str, **more: Any) -> go.Scatter:
    """Thinned points."""
    rows = thin(y)
    marker = {"color": colour, "size": more.pop("size", 4), "opacity": more.pop("opacity", 0.75)}
    return go.Scatter(x=plain(x[rows]), y=plain(y[rows]), name=name, mode="markers", marker=marker, **more)


def level_line(value: float, text: str, colour: str, yref: str = "y") -> tuple[dict[str, Any], dict[str, Any]]:
    """Shape and label of a horizontal line across the whole axis."""
    shape = {
        "type": "line", "xref": "x domain", "x0": 0, "x1": 1, "yref": yref, "y0": value, "y1": value,
        "line": {"color": colour, "dash": "dash", "width": 1.5},
    }  # fmt: skip
    label = {
        "xref": "x domain", "x": 1, "xanchor": "right", "yref": yref, "y": value, "yanchor": "bottom",
        "text": text, "showarrow": False, "font": {"color": colour, "size": 12},
    }  # fmt: skip
    return shape, label


def shade(low: float, high: float, colour: str, along: str = "x", **more: Any) -> dict[str, Any]:
    """A pale band from `low` to `high` along x (times) or y (values)."""
    other = "y" if along == "x" else "x"
    return {
        "type": "rect", "layer": "below", "line": {"width": 0}, "fillcolor": colour, "opacity": 0.15,
        f"{along}ref": along, f"{along}0": low, f"{along}1": high,
        f"{other}ref": f"{other} domain", f"{other}0": 0, f"{other}1": 1, **more,
    }  # fmt: skip


def log_axis(title: str, low: float, high: float) -> dict[str, Any]:
    """A logarithmic axis that shows `low` to `high`, with ticks at 1, 2 and 5 of each decade written out."""
    first, last = int(np.floor(np.log10(low))), int(np.ceil(np.log10(high)))
    digits = (1, 2, 5) if last - first <= 3 else (1,)
    ticks = [digit * 10.0**decade for decade in range(first, last + 1) for digit in digits]
    ends = [float(np.log10(low)), float(np.log10(high))]
    return axis(title, type="log", range=ends, tickvals=ticks, ticktext=[f"{tick:.10g}" for tick in ticks])
