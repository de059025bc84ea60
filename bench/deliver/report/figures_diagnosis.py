"""Figures of a diagnosis: residual by place, shapes of suspects, evidence by segment, smallest detectable effects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import plotly.graph_objects as go

from bench.analysis import Detectable, Effect, Place, Rung, SuspectedEffect
from bench.base import CHANNELS, FloatArray, IntArray, in_print
from bench.deliver.report import plotting
from bench.deliver.report.figures_model import RESIDUAL
from bench.deliver.report.figures_run import HOUR_S, TEMPERATURE
from bench.deliver.report.plotting import BLUE, GREEN, ORANGE, PURPLE, VERMILION, Plot, axis
from bench.record import Dataset

EFFECT = "effect"
"""Mark (`meta`) of the curves that have the name of an effect."""
_SLOPE = "dT/dt [°C/min]"
_SINCE = {"since_extreme": "time since the last extreme [min]", "last_extreme": "temperature at the last extreme [°C]"}
_CELL_ROWS = 3
_LEAST_SCALE = 2.0  # floors at full colour: means of a few rows scatter by half a floor
_COLUMNS, _LINES = 18, 11
_BINS = 40
_MEANS = 30
_EVERYWHERE = 0.95  # of the range: above it, nothing is shaded
_LEAST_LEG = 0.02  # of the largest: shorter bars are omitted
_SUSPECTS = (BLUE, ORANGE, GREEN)

_OVER_TIME = {"creep", "warm_up", "aging", "jump"}
_OVER_SLOPE = {"rate"}


@dataclass(frozen=True, eq=False)
class Coordinate:
    """Abscissa of an effect: values (n,), title with unit, and whether a line in order of time makes sense."""

    values: FloatArray
    title: str
    ordered: bool

    @property
    def by_direction(self) -> bool:
        """Whether means of heating and cooling say something; over time each stretch has one direction."""
        return not self.title.startswith("time [")


def coordinate(data: Dataset, effect: Effect) -> Coordinate:
    """The quantity that an effect depends on most."""
    if effect.family in _OVER_TIME:
        return coordinate_over(data, "time")
    if effect.family in _OVER_SLOPE:
        return coordinate_over(data, "dT_dt")
    channels = [name for name in effect.needs if name != "temperature" and name in data.channels]
    return coordinate_over(data, channels[0] if channels else "temperature")


def drawable_coordinates(data: Dataset) -> set[str]:
    """Names that a residual can be drawn over."""
    return {"time", "dT_dt", *data.channels, *(_SINCE if extremes(data).size else ())}


def extremes(data: Dataset) -> IntArray:
    """Rows at which the temperature reached an extreme: it moved on in the other direction, at once or after a stay."""
    moving = np.flatnonzero(data.direction)
    reached: IntArray = moving[:-1][np.diff(data.direction[moving]) != 0]
    return reached


def _since_extreme(data: Dataset, name: str) -> FloatArray:
    """Time [min] since the last extreme, or the temperature there (n,); NaN before the first one."""
    reached = extremes(data)
    last = np.searchsorted(reached, np.arange(len(data)), side="right") - 1
    row = reached[np.maximum(last, 0)]
    values = (data.time - data.time[row]) / 60.0 if name == "since_extreme" else data.channel("temperature")[row]
    return np.where(last < 0, np.nan, values)


def coordinate_over(data: Dataset, name: str) -> Coordinate:
    """The quantity of this name, one of `drawable_coordinates`."""
    if name == "time":
        return Coordinate(data.time / HOUR_S, "time [h]", True)
    if name == "dT_dt":
        return Coordinate(data.dT_dt, _SLOPE, False)
    if name == "temperature":
        return Coordinate(data.channel("temperature"), TEMPERATURE, True)
    if name in _SINCE and name not in data.channels:
        return Coordinate(_since_extreme(data, name), _SINCE[name], False)
    unit = in_print(CHANNELS[name].unit) if name in CHANNELS else "as recorded"
    return Coordinate(data.channels[name], f"{name.replace('_', ' ')} [{unit}]", False)


def residual_map(data: Dataset, before: FloatArray, after: FloatArray | None, floor_dph: float | None) -> Plot:
    """Mean residual (n,) of each cell of temperature and dT/dt, in units of the floor, before and after adding."""
    temperature, slope = data.channel("temperature"), data.dT_dt
    reach = 1.02 * float(np.nanmax(np.abs(slope), initial=0.1))
    edges = (
        np.linspace(float(np.nanmin(temperature)), float(np.nanmax(temperature)), _COLUMNS + 1),
        np.linspace(-reach, reach, _LINES + 1),
    )
    unit = floor_dph or 1.0
    fields = [_cells(temperature, slope, left, edges) / unit for left in (before, after) if left is not None]
    largest = max(float(np.nanmax(np.abs(fields[0]), initial=0.0)), _LEAST_SCALE * (floor_dph is not None), 1e-9)
    middle = [0.5 * (edge[1:] + edge[:-1]) for edge in edges]
    title = "residual<br>[× floor]" if floor_dph else "residual<br>[deg/h]"
    traces = [
        go.Heatmap(
            x=plotting.plain(middle[0]), y=plotting.plain(middle[1]), z=plotting.plain(field), zmin=-largest,
            zmax=largest, colorscale=plotting.SHADES, xaxis="x" if i == 0 else "x2", yaxis="y", showscale=i == 0,
            xgap=1, ygap=1, colorbar={"title": {"text": title}, "thickness": 14, "outlinewidth": 0},
            name="before" if i == 0 else "after", hoverongaps=False,
            hovertemplate="%{x:.0f} °C, %{y:.2f} °C/min: %{z:.2f}<extra></extra>",
        )
        for i, field in enumerate(fields)
    ]  # fmt: skip
    layout: dict[str, Any] = {"xaxis": axis(TEMPERATURE), "yaxis": axis(_SLOPE)}
    if len(fields) > 1:
        layout["xaxis"] |= {"domain": [0.0, 0.485]}
        layout["xaxis2"] = axis(TEMPERATURE, domain=[0.515, 1.0], anchor="y")
        layout["annotations"] = [_above(0.2425, "before"), _above(0.7575, "with the effects found")]
    return plotting.plot(traces, layout, 400)


def _above(x: float, text: str) -> dict[str, Any]:
    return {"xref": "paper", "yref": "paper", "x": x, "y": 1.0, "xanchor": "center", "yanchor": "bottom",
            "text": text, "showarrow": False}  # fmt: skip


def _cells(x: FloatArray, y: FloatArray, values: FloatArray, edges: tuple[FloatArray, FloatArray]) -> FloatArray:
    """Mean of values (n,) in each cell (lines, columns); NaN where there are too few."""
    good = np.isfinite(x) & np.isfinite(y) & np.isfinite(values)
    bins = [edges[1], edges[0]]
    count = np.histogram2d(y[good], x[good], bins)[0]
    total = np.histogram2d(y[good], x[good], bins, weights=values[good])[0]
    mean: FloatArray = np.where(count >= _CELL_ROWS, total / np.maximum(count, 1.0), np.nan)
    return mean


def partial_residual(data: Dataset, x: Coordinate, left: FloatArray, shape: FloatArray, name: str) -> Plot:
    """Partial residual `left` + `shape` (n,) of a suspect over its coordinate, and its fitted shape."""
    traces = by_direction(data, x.values, left + shape)
    if x.by_direction:
        traces += _means_by_direction(data, x.values, left + shape)
    if x.ordered:
        traces.append(plotting.line_trace(x.values, shape, name, ORANGE, width=3, meta=EFFECT))
    else:
        traces.append(plotting.dot_trace(x.values, shape, name, ORANGE, size=5, opacity=1.0, meta=EFFECT))
    return plotting.plot(traces, {"xaxis": axis(x.title), "yaxis": axis("effect [deg/h]", zeroline=True)}, 380)


def _means_by_direction(data: Dataset, x: FloatArray, y: FloatArray) -> list[go.Scatter]:
    """Means of heating and of cooling, in bins of x with enough rows."""
    edges = np.linspace(float(np.nanmin(x)), float(np.nanmax(x)), _MEANS + 1)
    traces = []
    for sign in (1, -1):
        good = np.isfinite(x) & np.isfinite(y) & (data.direction == sign)
        count = np.histogram(x[good], edges)[0]
        enough = count >= _CELL_ROWS
        total = np.histogram(x[good], edges, weights=y[good])[0]
        text, colour = plotting.DIRECTIONS[sign]
        marker = {"size": 9, "color": colour, "symbol": "diamond", "line": {"width": 1, "color": "#ffffff"}}
        at, mean = 0.5 * (edges[1:] + edges[:-1])[enough], total[enough] / count[enough]
        x_shown, y_shown = plotting.plain(at), plotting.plain(mean)
        traces.append(go.Scatter(x=x_shown, y=y_shown, mode="markers", marker=marker, name=f"{text}, mean"))
    return traces


def misfit_figure(data: Dataset, left: FloatArray, place: Place) -> Plot:
    """Residual (n,) over the channel of a place, its mean in bins, the place shaded."""
    x = coordinate_over(data, place.channel)
    edges = np.unique(np.nanquantile(x.values[np.isfinite(left)], np.linspace(0.0, 1.0, _BINS + 1)))
    which = np.clip(np.searchsorted(edges, x.values, side="right") - 1, 0, max(len(edges) - 2, 0))
    good = np.isfinite(left) & np.isfinite(x.values)
    count = np.bincount(which[good])
    used = count > 0
    means = [np.bincount(which[good], v[good])[used] / count[used] for v in (x.values, left)]
    scale = 1.0 / HOUR_S if place.channel == "time" else 1.0
    layout: dict[str, Any] = {"xaxis": axis(x.title), "yaxis": axis(RESIDUAL, zeroline=True)}
    if scale * (place.high - place.low) < _EVERYWHERE * np.ptp(x.values[np.isfinite(x.values)]):
        layout["shapes"] = [plotting.shade(scale * place.low, scale * place.high, VERMILION)]
    traces = [*by_direction(data, x.values, left), plotting.line_trace(means[0], means[1], "mean", ORANGE, width=3)]
    return plotting.plot(traces, layout, 380)


def by_direction(data: Dataset, x: FloatArray, y: FloatArray) -> list[go.Scatter]:
    """Rows as points, heating, cooling and constant temperature apart."""
    return [
        plotting.dot_trace(x[data.direction == sign], y[data.direction == sign], text, colour, opacity=0.3)
        for sign, (text, colour) in plotting.DIRECTIONS.items()
        if np.any(data.direction == sign)
    ]


def improvement_ladder(rungs: Sequence[Rung], floor_dph: float | None) -> Plot:
    """In-sample and held-out error of each rung; rivals as separate points."""
    names = [f"{rung.name}  " for rung in rungs]
    own = [i for i, rung in enumerate(rungs) if not rung.rival]
    other = [i for i, rung in enumerate(rungs) if rung.rival]
    hollow = {"symbol": "circle-open", "size": 15, "color": ORANGE, "line": {"width": 2.5}}
    inside, outside = (np.array([getattr(r, key) for r in rungs]) for key in ("in_sample_dph", "held_out_dph"))
    traces = [
        _points([names[i] for i in own], inside[own], hollow, "in-sample", "markers"),
        _points([names[i] for i in own], outside[own], {"size": 10, "color": BLUE}, "held-out", "lines+markers"),
    ]
    if other:
        rival = {"size": 11, "color": PURPLE, "symbol": "diamond"}
        traces.append(_points([names[i] for i in other], outside[other], rival, "rival, held-out", "markers"))
    layout: dict[str, Any] = {
        "xaxis": axis("model error, RMS [deg/h]", rangemode="tozero"),
        "yaxis": axis("", autorange="reversed"),
    }
    if floor_dph is not None:
        layout |= _floor_line(floor_dph)
    return plotting.plot(traces, layout, 140 + 42 * len(names))


def _points(names: list[str], x: FloatArray, marker: dict[str, Any], name: str, mode: str) -> go.Scatter:
    line = {"color": BLUE, "width": 1.5}
    return go.Scatter(x=plotting.plain(x), y=names, mode=mode, marker=marker, line=line, name=name)


def suspects_by_leg(suspects: Sequence[SuspectedEffect]) -> Plot:
    """Gain in 2 ln L that each segment gives to each suspect, as bars in order of time."""
    gains = [[gain for _, gain in suspect.legs] for suspect in suspects]
    least = _LEAST_LEG * max((abs(gain) for own in gains for gain in own), default=0.0)
    shown = [i for i, at in enumerate(zip(*gains, strict=False)) if max(map(abs, at)) >= least]
    seen: dict[str, int] = {}
    labels = []
    for i in shown:
        name = suspects[0].legs[i][0]
        seen[name] = seen.get(name, 0) + 1
        labels.append(f"{name}{f' ({seen[name]})' if seen[name] > 1 else ''}  ")
    traces = [
        go.Bar(
            x=plotting.plain([own[i] for i in shown]), y=labels, orientation="h", name=suspect.effect,
            marker={"color": colour}, meta=EFFECT,
        )
        for suspect, own, colour in zip(suspects, gains, _SUSPECTS, strict=False)
    ]  # fmt: skip
    layout = {
        "xaxis": axis("evidence gained [2 ln L]", zeroline=True),
        "yaxis": axis("", autorange="reversed"),
        "barmode": "group",
        "bargap": 0.3,
    }
    return plotting.plot(traces, layout, 140 + (12 + 14 * len(suspects)) * max(len(shown), 1))


def detectable(limits: Sequence[Detectable], floor_dph: float | None) -> Plot:
    """Smallest RMS of each effect that the run would have shown, and the floor."""
    values = np.array([limit.rms_dph for limit in limits])
    names = [f"{limit.effect}  " for limit in limits]
    marker = {"color": BLUE, "size": 10}
    traces = [go.Scatter(x=plotting.plain(values), y=names, mode="markers", marker=marker, showlegend=False)]
    shown = [*values.tolist(), *([floor_dph] if floor_dph is not None else [])]
    layout: dict[str, Any] = {
        "xaxis": plotting.log_axis("smallest detectable effect, RMS [deg/h]", min(shown) / 1.5, max(shown) * 1.5),
        "yaxis": axis("", autorange="reversed"),
    }
    if floor_dph is not None:
        layout |= _floor_line(floor_dph, logarithmic=True)
    return plotting.plot(traces, layout, 130 + 24 * len(limits))


def _floor_line(floor_dph: float, logarithmic: bool = False) -> dict[str, Any]:
    """A vertical line at the floor; plotly needs the position of the label, but not of the line, as a logarithm."""
    at = float(np.log10(floor_dph)) if logarithmic else floor_dph
    line = {"color": GREEN, "dash": "dash", "width": 2}
    label = {"xref": "x", "x": at, "xanchor": "right", "yref": "y domain", "y": 0, "yanchor": "bottom",
             "text": "noise floor", "showarrow": False, "font": {"color": GREEN}}  # fmt: skip
    shape = {"type": "line", "xref": "x", "x0": floor_dph, "x1": floor_dph, "yref": "y domain", "y0": 0, "y1": 1}
    return {"shapes": [{**shape, "line": line}], "annotations": [label]}
