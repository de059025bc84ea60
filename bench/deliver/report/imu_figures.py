"""Figures of a whole inertial unit: parameters over temperature with U, and what the fit left."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import plotly.graph_objects as go

from bench.analysis import curves_of
from bench.base import FloatArray, in_print
from bench.deliver.report import plotting
from bench.deliver.report.figures_run import HOUR_S, TEMPERATURE
from bench.deliver.report.plotting import BLUE, GREEN, VERMILION, Plot, axis
from bench.record import AXES, ImuRecord, ImuTriad

_POINTS = 61
AXIS_COLOURS = (BLUE, VERMILION, GREEN)
"""Of x, y and z."""
_PALE = ("rgba(0,114,178,0.22)", "rgba(213,94,0,0.22)", "rgba(0,158,115,0.22)")
_GAP = 0.075

Values = Mapping[str, tuple[FloatArray, FloatArray]]
"""Value and U (n,) of parameters by name."""


def over_temperature(record: ImuRecord, triad: ImuTriad) -> Iterator[tuple[str, str, Plot]]:
    """Kind, unit and figure of each kind of parameter of a triad: a column for each axis, values above and U below."""
    grid, values = _values(record, triad)
    for kind in dict.fromkeys(parameter.kind for parameter in triad.axes[0].parameters):
        unit = next(p.unit for p in triad.axes[0].parameters if p.kind == kind)
        yield kind, unit, _columns(triad, kind, unit, grid, values)


def _values(record: ImuRecord, triad: ImuTriad) -> tuple[FloatArray, Values]:
    """Temperatures (n,) [degC] that all axes of the triad had, and every parameter there."""
    ends = [axis.range_degc for axis in triad.axes]
    grid = np.linspace(max(low for low, _ in ends), min(high for _, high in ends), _POINTS)
    curves = curves_of(record)
    own = curves.gyro if triad.kind == "gyro" else curves.accelerometer
    found: dict[str, list[tuple[float, float]]] = {}
    for estimate in own.estimates(grid.tolist()):
        found.setdefault(estimate.name, []).append((estimate.value, estimate.U))
    tables = {name: np.array(pairs) for name, pairs in found.items()}
    return grid, {name: (table[:, 0], table[:, 1]) for name, table in tables.items()}


def _columns(triad: ImuTriad, kind: str, unit: str, grid: FloatArray, values: Values) -> Plot:
    traces: list[go.Scatter] = []
    layout: dict[str, Any] = {"margin": {"l": 70, "r": 20, "t": 60, "b": 55}, "annotations": []}
    width = (1.0 - 2.0 * _GAP) / 3.0
    for column, stored in enumerate(triad.axes):
        low = column * (width + _GAP)
        upper, lower = ("" if column == 0 else str(2 * column + 1)), str(2 * column + 2)
        places = {"xaxis": f"x{upper}"}
        for parameter in (p for p in stored.parameters if p.kind == kind):
            number = column if parameter.towards is None else parameter.towards
            value, U = values[parameter.name]
            shown = {**places, "legendgroup": str(number), "showlegend": False}
            traces += [_band(grid, value - U, value + U, _PALE[number], yaxis=f"y{upper}", **shown)]
            name = AXES[number] if parameter.towards is None else f"input {AXES[number]}"
            first = parameter.towards is not None and not any(trace.name == name for trace in traces)
            legend = {**shown, "showlegend": first, "legendrank": number}
            traces += [
                plotting.line_trace(grid, value, name, AXIS_COLOURS[number], yaxis=f"y{upper}", **legend,
                                    hovertemplate="%{x:.1f} °C: %{y:.5g}"),
                plotting.line_trace(grid, U, name, AXIS_COLOURS[number], yaxis=f"y{lower}", **shown, dash="dot",
                                    hovertemplate="%{x:.1f} °C: U = %{y:.3g}"),
            ]  # fmt: skip
        own = {"domain": [low, low + width], "anchor": f"y{lower}"}
        layout[f"xaxis{upper}"] = axis(TEMPERATURE, **own)
        first_column = column == 0
        layout[f"yaxis{upper}"] = axis(
            f"{kind} [{in_print(unit)}]" if first_column else "", domain=[0.4, 1.0], anchor=f"x{upper}"
        )
        layout[f"yaxis{lower}"] = axis(
            "U" if first_column else "", domain=[0.0, 0.28], anchor=f"x{upper}", rangemode="tozero"
        )
        layout["annotations"].append(
            {"text": f"{triad.kind} {stored.axis}", "showarrow": False, "xref": "paper", "yref": "paper",
             "x": low + 0.5 * width, "y": 1.0, "yanchor": "bottom", "font": {"size": 13}}
        )  # fmt: skip
    layout["legend"] = {"orientation": "h", "x": 0, "y": 1.1, "yanchor": "bottom"}
    return plotting.plot(traces, layout, 430)


def _band(x: FloatArray, low: FloatArray, high: FloatArray, colour: str, **more: Any) -> go.Scatter:
    return go.Scatter(
        x=plotting.plain(np.concatenate([x, x[::-1]])), y=plotting.plain(np.concatenate([low, high[::-1]])),
        fill="toself", fillcolor=colour, line={"width": 0}, mode="lines", name="U", hoverinfo="skip", **more,
    )  # fmt: skip


def residuals(record: ImuRecord, triad: ImuTriad) -> Plot:
    """What the fit left, over time and over the temperature of each axis."""
    hours = np.array(record.time_s) / HOUR_S
    traces = []
    for stored, colour in zip(triad.axes, AXIS_COLOURS, strict=True):
        left, warm = np.array(stored.residual), np.array(stored.temperature_degc)
        own: dict[str, Any] = {"legendgroup": stored.axis, "size": 5}
        traces.append(plotting.dot_trace(hours, left, f"{triad.kind} {stored.axis}", colour, **own))
        traces.append(
            plotting.dot_trace(warm, left, stored.axis, colour, **own, xaxis="x2", yaxis="y2", showlegend=False)
        )
    layout = {
        "xaxis": axis("time [h]", domain=[0.0, 0.47]),
        "yaxis": axis(f"measured − model [{in_print(triad.unit)}]"),
        "xaxis2": axis(TEMPERATURE, domain=[0.53, 1.0], anchor="y2"),
        "yaxis2": axis("", anchor="x2", matches="y"),
    }
    return plotting.plot(traces, layout, 380)
