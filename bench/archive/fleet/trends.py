"""The quantities of one unit from run to run, against the limits of its newest judged run."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from datetime import datetime, timedelta
from typing import Any

import plotly.graph_objects as go

from bench.archive.fleet.history import Archive
from bench.archive.registry.asking import rows_of
from bench.archive.registry.opening import Registry
from bench.archive.registry.summaries import calibrates
from bench.base import InputError, in_print
from bench.deliver import CYCLE, VERMILION, Plot, axis, dates, level_line, plot
from bench.record import JudgedQuantity, LimitsRecord

SYMBOLS = ("circle", "square", "diamond", "triangle-up", "cross", "x")
"""A shape beside each colour."""

FIRST = (
    "residual_rms_dph", "residual_peak_dph", "noise_floor_dph", "angle_random_walk_dprh", "bias_instability_dph",
    "bias_span_dph", "bias_max_dph", "thermal_hysteresis_dph", "residual_hysteresis_dph",
)  # fmt: skip
"""The quantities that come first, in this order; the others follow by name."""

Found = dict[str, Any]


def trends(registry: Registry, archive: Archive, runs: Sequence[Mapping[str, Any]]) -> list[Found]:
    """Every quantity of one unit's calibrations, with its points in order of time, its limits and its change."""
    limits = _limits(archive, runs)
    points: dict[str, list[Found]] = {}
    units: dict[str, str] = {}
    by_id = {f"{run['archive']}/{run['path']}": run for run in runs if calibrates(run, run["judged"])}
    for row in rows_of(registry, "quantities", list(by_id)):
        run = by_id[row["run"]]
        point = {"run": run["path"], "created": run["created"], "profile": run["profile"], "value": row["value"]}
        points.setdefault(row["name"], []).append(point)
        units[row["name"]] = row["unit"] or ""
    return [_trend(name, units[name], points[name], limits.get(name)) for name in sorted(points, key=_place)]


def thinned(trend: Found, most: int, run: str | None) -> Found:
    """The same with its newest points, the first one of each profile, from which a change counts, and that of `run`."""
    points = trend["points"]
    firsts = {point["profile"]: point["run"] for point in reversed(points)}
    kept = {run, *firsts.values(), *(point["run"] for point in points[-most:])}
    return {**trend, "points": [point for point in points if point["run"] in kept]}


def _place(name: str) -> tuple[int, str]:
    return (FIRST.index(name) if name in FIRST else len(FIRST), name)


def _trend(name: str, unit: str, points: list[Found], limit: JudgedQuantity | None) -> Found:
    points = sorted(points, key=lambda point: str(point["created"]))
    last = points[-1]
    # Runs of different profiles are not comparable: the change is taken between runs of one profile.
    same = [point for point in points if point["profile"] == last["profile"]]
    change = last["value"] - same[0]["value"] if len(same) > 1 else None
    lower, upper = (limit.lower, limit.upper) if limit else (None, None)
    above = upper is not None and last["value"] > upper
    below = lower is not None and last["value"] < lower
    return {
        "name": name, "unit": unit, "lower": lower, "upper": upper, "points": points, "of": len(points),
        "last": last["value"],
        "change": change, "outside": above or below,
    }  # fmt: skip


def figure(trend: Mapping[str, Any]) -> Plot:
    """The values over time, a colour and a shape for each profile, with the limits."""
    traces, colours = [], [colour for colour in CYCLE if colour != VERMILION]
    for i, profile in enumerate(dict.fromkeys(point["profile"] for point in trend["points"])):
        own = [point for point in trend["points"] if point["profile"] == profile]
        style = {"color": colours[i % len(colours)], "size": 9, "symbol": SYMBOLS[i % len(SYMBOLS)]}
        traces.append(go.Scatter(
            x=[point["created"] for point in own], y=[point["value"] for point in own], name=str(profile),
            mode="lines+markers", marker=style, line={"color": style["color"], "width": 1.2},
            text=[point["run"] for point in own],
        ))  # fmt: skip
    values = [point["value"] for point in trend["points"]]
    most = 6 * max(abs(value) for value in values)
    ends = ((trend["lower"], "lower limit"), (trend["upper"], "upper limit"))
    # A limit far away would flatten the curve; the table beside the figure shows it.
    near = [(end, text) for end, text in ends if end is not None and abs(end) <= most]
    levels = [level_line(end, text, VERMILION) for end, text in near]
    layout = {
        "xaxis": dates([point["created"] for point in trend["points"]], timedelta(hours=2), nticks=5),
        "yaxis": axis(f"[{in_print(trend['unit'])}]", rangemode="tozero" if min(values) >= 0 else "normal"),
        "shapes": [shape for shape, _ in levels],
        "annotations": [
            label | _clear(end, trend["points"]) for (end, _), (_, label) in zip(near, levels, strict=True)
        ],
        "showlegend": True,
    }
    return plot(traces, layout, 340)


def _clear(level: float, points: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The end of a level's line at which its label has the points farther away."""
    moments = [datetime.fromisoformat(point["created"]) for point in points]
    middle = min(moments) + (max(moments) - min(moments)) / 2
    away = [(moment > middle, abs(point["value"] - level)) for moment, point in zip(moments, points, strict=True)]
    early, late = (min((apart for half, apart in away if half is wanted), default=math.inf) for wanted in (False, True))
    return {"x": 0, "xanchor": "left"} if early > late else {}


def _limits(archive: Archive, runs: Sequence[Mapping[str, Any]]) -> dict[str, JudgedQuantity]:
    """Limits by quantity, from the newest run that was judged."""
    for run in sorted(runs, key=lambda run: str(run["created"]), reverse=True):
        folder = archive.folder(run)
        try:
            judged = LimitsRecord.find(folder) if folder else None
        except InputError:  # what is not known is not drawn; the run's own page says what is wrong
            return {}
        if judged is not None and judged.results:
            return {entry.name: entry for entry in judged.results}
    return {}
