"""Figures of a fleet: control charts, and the distance of every unit from its lot."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import timedelta
from html import escape
from typing import Any

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from bench.archive.fleet.capability import proportion
from bench.archive.fleet.charts import Chart
from bench.archive.fleet.drift import DAY_S
from bench.archive.fleet.groups import coded
from bench.archive.fleet.statistics import Statistics
from bench.archive.fleet.trends import SYMBOLS
from bench.base import BoolArray, FloatArray, IntArray, in_print
from bench.deliver import (
    BLUE,
    CYCLE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    SKY,
    VERMILION,
    Plot,
    axis,
    dates,
    dot_trace,
    level_line,
    line_trace,
    plot,
)

UNITS = "unit, in order of time"
MOST = 4000
"""Units in a figure, the newest: more cannot be told apart."""
_MOST_BARS = 60
_MOST_DOTS = 200
"""Units in a control chart whose points are drawn on its line."""
_MOST_NAMED = 12
"""Lots, or stations, that a legend names."""
_LOOKS = tuple(zip((BLUE, PURPLE, SKY) * 5, SYMBOLS[:5] * 3, strict=True))
"""Colour and shape of each station: no colour of a line across the chart."""
MOST_PERIODS = 31
"""Days, or weeks, beyond which a yield is told by the next longer period."""


def control(
    drawn: Chart, name: str, unit: str, limits: tuple[float | None, float | None], stations: Sequence[str]
) -> Plot:
    """Individual values with three sigma and the limits of the product, coloured by station; below, moving ranges."""
    number = _numbers(drawn.values.size)
    names, code = coded(stations)
    dots = [
        dot_trace(number[code == i], drawn.values[code == i], station, colour, size=6, meta="station").update(
            marker={"symbol": symbol}
        )
        for i, (station, (colour, symbol)) in enumerate(zip(names, _LOOKS, strict=False))
        if 1 < len(names) <= _MOST_NAMED
    ]
    style = {"mode": "lines+markers", "marker": {"size": 5}} if not dots and drawn.values.size <= _MOST_DOTS else {}
    marked: list[int] = sorted({signal.index for signal in drawn.signals})
    low, high = drawn.limits
    traces = [
        line_trace(number, drawn.values, name, GREY if dots else BLUE, width=1.2).update(style),
        *dots,
        dot_trace(number[marked], drawn.values[marked], "breaks a rule", VERMILION, size=11, opacity=1.0).update(
            marker={"symbol": "circle-open", "line": {"width": 2}}
        ),
        line_trace(number[1:], drawn.ranges, "moving range", GREY, yaxis="y2", width=1.2),
    ]
    levels = [level_line(drawn.centre, "centre", GREEN), level_line(drawn.range_limit, "limit", ORANGE, yref="y2")]
    levels += [level_line(end, text, ORANGE) for end, text in ((low, "−3σ"), (high, "+3σ"))]
    inside = (drawn.values.min(), drawn.values.max(), low, high)
    for end, text in zip(limits, ("lower limit", "upper limit"), strict=True):
        # A limit far outside would flatten the curve; the table shows it.
        if end is not None and min(inside) - np.ptp(inside) < end < max(inside) + np.ptp(inside):
            levels.append(level_line(end, text, VERMILION))
    layout: dict[str, Any] = {
        "xaxis": axis(UNITS, anchor="y2"),
        "yaxis": axis(f"[{in_print(unit)}]", domain=[0.36, 1.0]),
        "yaxis2": axis("moving range", domain=[0.0, 0.28], anchor="x", rangemode="tozero"),
        "shapes": [shape for shape, _ in levels],
        "annotations": [{**label, "xanchor": "left", "yanchor": "middle"} for _, label in levels],  # beside the curve
        "margin": {"l": 70, "r": 90, "t": 40, "b": 55},
    }
    return plot(traces, layout, 460)


def histogram(values: FloatArray, unit: str, limits: tuple[float | None, float | None]) -> Plot:
    """Number of units by value (n,), with the limits of the product."""
    counts, edges = np.histogram(values, min(len(np.histogram_bin_edges(values, "auto")) - 1, _MOST_BARS))
    middle, width = 0.5 * (edges[1:] + edges[:-1]), float(edges[1] - edges[0])
    bars = go.Bar(
        x=middle.tolist(), y=counts.tolist(), width=width, marker={"color": BLUE, "opacity": 0.7}, name="units"
    )
    known = [(end, text) for end, text in zip(limits, ("lower limit", "upper limit"), strict=True) if end is not None]
    ends = [float(edges[0]), float(edges[-1]), *(end for end, _ in known)]
    edge = 0.05 * (max(ends) - min(ends)) or width
    lines = [{"type": "line", "xref": "x", "x0": end, "x1": end, "yref": "y domain", "y0": 0, "y1": 1,
              "line": {"color": VERMILION, "dash": "dash", "width": 1.5}} for end, _ in known]  # fmt: skip
    labels = [{"xref": "x", "x": end, "yref": "y domain", "y": 1, "yanchor": "bottom", "text": text, "showarrow": False,
               "font": {"color": VERMILION}} for end, text in known]  # fmt: skip
    layout: dict[str, Any] = {
        "xaxis": axis(f"[{in_print(unit)}]", range=[min(ends) - edge, max(ends) + edge]),
        "yaxis": axis("units", rangemode="tozero"),
        "shapes": lines, "annotations": labels, "showlegend": False, "bargap": 0,
    }  # fmt: skip
    return plot([bars], layout, 300)


def yields(time_s: FloatArray, passed: BoolArray) -> Plot:
    """First-pass yield with 95 % of it by day, week or month (UTC) of attempts (n,): as fine as a figure can show."""
    days = np.floor(time_s / DAY_S).astype(np.int64)
    many, monday = int(np.ptp(days)) + 1, (days + 3) // 7 * 7 - 3  # the first day of 1970 was a Thursday
    period = days if many <= MOST_PERIODS else monday if many <= 7 * MOST_PERIODS else _dates(days).astype("M8[M]")
    _, place = np.unique(period, return_inverse=True)
    whole, part = np.bincount(place), np.bincount(place, passed).astype(np.int64)
    first, last = np.full(whole.size, days.max()), np.full(whole.size, days.min())
    np.minimum.at(first, place, days)
    np.maximum.at(last, place, days)
    pairs = list(zip(part.tolist(), whole.tolist(), strict=True))
    spans = [" … ".join(dict.fromkeys(map(str, pair))) for pair in zip(_dates(first), _dates(last), strict=True)]
    share = 100.0 * part / whole
    low, high = 100.0 * np.array([proportion(*pair) for pair in pairs]).T
    points = go.Scatter(
        x=[f"{day}T12:00:00Z" for day in _dates((first + last) // 2)],  # by the clock of every zone the same day
        y=share.tolist(), mode="lines+markers", name="first-pass yield", marker={"color": BLUE, "size": 9},
        line={"color": BLUE, "width": 1.2},
        error_y={"type": "data", "symmetric": False, "array": (high - share).tolist(),
                 "arrayminus": (share - low).tolist(), "color": GREY, "thickness": 1.2},
        text=[f"{span}<br>{100 * good / of:.1f} % ({good} / {of})" for span, (good, of) in
              zip(spans, pairs, strict=True)],
        hovertemplate="%{text}<extra></extra>",
    )  # fmt: skip
    layout: dict[str, Any] = {
        "xaxis": dates(points["x"], timedelta(days=4), nticks=6),
        "yaxis": axis("[%]"),
        "showlegend": False,
    }
    return plot([points], layout, 300)


def _dates(days: IntArray) -> NDArray[np.datetime64]:
    return days.astype("M8[D]")


def named(drawn: Plot, labels: Sequence[str]) -> Plot:
    """The figure, with the label of its unit at every point; x counts units from 1."""
    for trace in drawn["data"]:
        trace["text"] = [escape(labels[round(x) - 1]) for x in trace["x"]]
        trace["hovertemplate"] = "%{text}<br>%{y:.4g}<extra></extra>"
    return drawn


def of_lots(found: Statistics) -> Plot:
    """Distances of the newest units from their lots."""
    first = max(len(found.fleet.newest) - MOST, 0)
    shown = found.fleet.newest[first:]
    odd = [one.row - first for one in found.odd if one.row >= first]
    return distances(found.distances[first:], [one.lot for one in shown], odd, [one.unit for one in shown])


def distances(values: FloatArray, lots: Sequence[str], odd: Sequence[int], serials: Sequence[str]) -> Plot:
    """Robust distance of every unit (n,), coloured by lot; odd units are named."""
    number = _numbers(values.size)
    names, code = coded(lots)
    traces = []
    for i, lot in enumerate(names):
        rows = np.flatnonzero(code == i)
        traces.append(dot_trace(number[rows], values[rows], f"lot {lot}", CYCLE[i % len(CYCLE)], size=6))
    labels = [
        {"x": float(number[row]), "y": float(values[row]), "text": serials[row], "ay": -22, "ax": 0} for row in odd[:20]
    ]
    layout: dict[str, Any] = {
        "xaxis": axis(UNITS),
        "yaxis": axis("distance from the lot [robust σ]", rangemode="tozero"),
        "annotations": labels,
        "showlegend": len(names) <= _MOST_NAMED,
    }
    return plot(traces, layout, 420)


def _numbers(count: int) -> FloatArray:
    return np.arange(1, count + 1).astype(np.float64)
