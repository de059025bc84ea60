"""Figures that only the workbench has: zoomed measurement, a model over temperature, runs side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go

from bench.base import BoolArray, FloatArray
from bench.deliver.report import plotting
from bench.deliver.report.figures_diagnosis import Coordinate, by_direction
from bench.deliver.report.figures_model import LEFT, RESIDUAL, band
from bench.deliver.report.figures_run import BIAS, HOUR_S, TEMPERATURE, loop_trace
from bench.deliver.report.plotting import BLUE, CYCLE, GREEN, ORANGE, VERMILION, Plot, axis
from bench.record import Dataset

_GRID = 200

_BINS = 60
_LEAST_ROWS = 3


def measured_figure(dataset: Dataset, extremes: tuple[FloatArray, FloatArray] | None = None) -> Plot:
    """Bias with the lowest and highest value in each mean (n,), and temperature, over time; without a model."""
    hours = dataset.time / HOUR_S
    traces = [
        *([] if extremes is None else [band(hours, *extremes)]),
        plotting.time_trace(hours, dataset.bias, "measured", BLUE),
        plotting.time_trace(hours, dataset.channel("temperature"), "temperature", ORANGE, yaxis="y2"),
    ]
    layout = {
        "xaxis": axis("time [h]", anchor="y2"),
        "yaxis": axis("bias [deg/h]", domain=[0.38, 1.0]),
        "yaxis2": axis("unit [°C]", domain=[0.0, 0.3], anchor="x"),
    }
    return plotting.plot(traces, layout, 520)


def over_temperature(dataset: Dataset, model: FloatArray, name: str, floor_dph: float | None, rows: BoolArray) -> Plot:
    """Measurement, model and residual (n,) over temperature, heating and cooling separately; `rows` are shown."""
    temperature, bias, left = dataset.channel("temperature"), dataset.bias, dataset.bias - model
    traces: list[go.Scatter] = []
    for sign, (text, colour) in plotting.DIRECTIONS.items():
        own = rows & (dataset.direction == sign)
        if not own.any():
            continue
        traces.append(plotting.dot_trace(temperature[own], bias[own], text, colour, opacity=0.3, legendgroup=text))
        more = {"yaxis": "y2", "legendgroup": text, "showlegend": False}
        traces.append(plotting.dot_trace(temperature[own], left[own], f"{text}, residual", colour, opacity=0.4, **more))
    for sign, dash in ((1, "solid"), (-1, "dash")):
        text, _ = plotting.DIRECTIONS[sign]
        own = rows & (dataset.direction == sign)
        x, y = curve(temperature[own], model[own])
        if x.size:
            traces.append(
                plotting.line_trace(x, y, f"{name}, {text}", plotting.DIRECTIONS[sign][1], width=3, dash=dash)
            )
            x, y = curve(temperature[own], left[own])
            more = {"yaxis": "y2", "showlegend": False, "dash": dash, "meta": LEFT}
            traces.append(
                plotting.line_trace(x, y, f"residual, mean, {text}", plotting.DIRECTIONS[sign][1], width=3, **more)
            )
    layout: dict[str, Any] = {
        "xaxis": axis(TEMPERATURE, anchor="y2"),
        "yaxis": axis("bias [deg/h]", domain=[0.46, 1.0]),
        "yaxis2": axis("residual [deg/h]", domain=[0.0, 0.38], anchor="x", zeroline=True),
    }
    if floor_dph is not None:
        layout["shapes"] = [plotting.shade(-floor_dph, floor_dph, GREEN, "y", yref="y2", xref="paper")]
    return plotting.plot(traces, layout, 600)


def curve(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Means of y (n,) in equal bins of x with enough rows."""
    good = np.isfinite(x) & np.isfinite(y)
    if good.sum() < _LEAST_ROWS:
        return x[:0], y[:0]
    edges = np.linspace(x[good].min(), x[good].max() + 1e-9, _BINS + 1)
    count = np.histogram(x[good], edges)[0]
    enough = count >= _LEAST_ROWS
    sums = [np.histogram(x[good], edges, weights=v[good])[0][enough] for v in (x, y)]
    return sums[0] / count[enough], sums[1] / count[enough]


def side_by_side(runs: Sequence[tuple[str, Dataset]]) -> Plot:
    """Bias of several runs over temperature, all on one zero: each minus its mean over what all of them cover."""
    zeros = zeros_of([data for _, data in runs])
    values = [
        (name, data.channel("temperature"), data.bias - zero) for (name, data), zero in zip(runs, zeros, strict=True)
    ]
    return overlaid(values, TEMPERATURE, "bias [deg/h], minus its mean")


def overlaid(runs: Sequence[tuple[str, FloatArray, FloatArray]], x_title: str, y_title: str) -> Plot:
    """Values (n,) of several runs over a quantity (n,), each run with its name: rows and means, a colour for each."""
    traces: list[go.Scatter] = []
    for i, (name, x, y) in enumerate(runs):
        colour, symbol = CYCLE[i % len(CYCLE)], ("circle", "diamond", "square", "cross", "x", "star")[i % 6]
        group = {"legendgroup": name}
        traces.append(plotting.dot_trace(x, y, f"{name}, rows", colour, opacity=0.2, showlegend=False, **group))
        x_mean, y_mean = curve(x, y)
        marker = {"symbol": symbol, "size": 8, "color": colour}
        x_shown, y_shown = plotting.plain(x_mean), plotting.plain(y_mean)
        traces.append(go.Scatter(x=x_shown, y=y_shown, name=name, mode="lines+markers", marker=marker, **group))
    return plotting.plot(traces, {"xaxis": axis(x_title), "yaxis": axis(y_title)}, 520)


def zeros_of(runs: Sequence[Dataset]) -> list[float]:
    """Mean bias [deg/h] of each run's curve over the range of temperature that all cover, a degree as much as another.

    Of its own rows where they cover nothing in common.
    """
    curves = [curve(data.channel("temperature"), data.bias) for data in runs]
    low, high = max(np.nanmin(x) for x, _ in curves), min(np.nanmax(x) for x, _ in curves)
    if not high > low:
        return [float(np.nanmean(data.bias)) for data in runs]
    grid = np.linspace(low, high, _GRID)
    return [float(np.mean(np.interp(grid, x[np.isfinite(y)], y[np.isfinite(y)]))) for x, y in curves]


def residuals_figure(dataset: Dataset, left: FloatArray, floor_dph: float | None) -> Plot:
    """Residual (n,) of a model over temperature, as a loop coloured by time."""
    traces = [loop_trace(dataset, left, "residual", 0.6, meta=LEFT)]
    layout: dict[str, Any] = {"xaxis": axis(TEMPERATURE), "yaxis": axis(RESIDUAL, zeroline=True)}
    if floor_dph is not None:
        layout["shapes"] = [plotting.shade(-floor_dph, floor_dph, GREEN, "y")]
    return plotting.plot(traces, layout, 520)


def over_axis(dataset: Dataset, x: Coordinate, y: FloatArray, floor_dph: float | None, fitted: bool) -> Plot:
    """Residual of a model (n,), or without one the bias, over any quantity: rows, and means of heating and cooling."""
    traces = by_direction(dataset, x.values, y)
    mark: dict[str, Any] = {"meta": LEFT} if fitted else {}
    for sign, dash in ((1, "solid"), (-1, "dash"), (0, "dot")):
        text, colour = plotting.DIRECTIONS[sign]
        own = dataset.direction == sign
        means = curve(x.values[own], y[own])
        if means[0].size:
            traces.append(plotting.line_trace(*means, f"{text}, mean", colour, width=3, dash=dash, **mark))
    layout: dict[str, Any] = {"xaxis": axis(x.title), "yaxis": axis(RESIDUAL if fitted else BIAS, zeroline=fitted)}
    if fitted and floor_dph is not None:
        layout["shapes"] = [plotting.shade(-floor_dph, floor_dph, GREEN, "y")]
    return plotting.plot(traces, layout, 520)


def difference(curves: Mapping[str, Any]) -> Plot:
    """Model curves of two runs, B minus A, over temperature."""
    x = np.array([point["degc"] for point in curves["curve"]])
    y = np.array([point["difference_dph"] for point in curves["curve"]])
    layout: dict[str, Any] = {"xaxis": axis(TEMPERATURE), "yaxis": axis("B − A [deg/h]", zeroline=True)}
    if curves["floor_dph"] is not None:
        layout["shapes"] = [plotting.shade(-curves["floor_dph"], curves["floor_dph"], GREEN, "y")]
    return plotting.plot([plotting.line_trace(x, y, "B − A", VERMILION, width=2.5)], layout, 400)
