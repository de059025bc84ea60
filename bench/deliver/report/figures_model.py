"""Figures of models against the measurement: spline pieces, compensation, ladder, residuals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go

from bench.analysis import zero_rate
from bench.base import FloatArray
from bench.deliver.report import plotting
from bench.deliver.report.figures_run import BIAS, HOUR_S, TEMPERATURE
from bench.deliver.report.plotting import BLUE, CYCLE, GREEN, GREY, ORANGE, VERMILION, Plot, axis
from bench.record import Dataset

RESIDUAL = "measured − model [deg/h]"
LEFT = "residual"
"""Mark (`meta`) of the curves that are a residual."""
_PIECE_POINTS = 25


def spline_pieces(dataset: Dataset, knots: FloatArray, pieces: FloatArray) -> Plot:
    """Each cubic a0 + a1 (T - T_i) + ... of `pieces` (m, 4) on its own interval of `knots` (m + 1,), over the data."""
    traces = [
        plotting.dot_trace(dataset.channel("temperature"), zero_rate(dataset), "measured", GREY, size=4, opacity=0.45)
    ]
    for i, coefficients in enumerate(pieces):
        x = np.linspace(0.0, knots[i + 1] - knots[i], _PIECE_POINTS)
        y = np.polynomial.polynomial.polyval(x, coefficients)
        name = f"piece {i + 1}: {knots[i]:.1f} to {knots[i + 1]:.1f} °C"
        traces.append(plotting.line_trace(knots[i] + x, y, name, CYCLE[i % len(CYCLE)], width=3.5, showlegend=False))
    heights = np.append(pieces[:, 0], np.polynomial.polynomial.polyval(knots[-1] - knots[-2], pieces[-1]))
    marker = {"symbol": "diamond", "size": 8, "color": "#ffffff", "line": {"color": VERMILION, "width": 1.5}}
    x, y = plotting.plain(knots), plotting.plain(heights)
    traces.append(go.Scatter(x=x, y=y, mode="markers", marker=marker, name="knots"))
    return plotting.plot(traces, {"xaxis": axis(TEMPERATURE), "yaxis": axis(BIAS)}, 480)


def compensation(
    dataset: Dataset,
    model: FloatArray,
    name: str,
    floor_dph: float | None,
    extremes: tuple[FloatArray, FloatArray] | None = None,
) -> Plot:
    """Over time: measured bias and the model (n,); residual after compensation; temperature.

    `extremes` are the lowest and highest values (n,) in each mean, drawn as a band that shows spikes.
    """
    hours = dataset.time / HOUR_S
    left = dataset.bias - model
    traces = [
        *([] if extremes is None else [band(hours, *extremes)]),
        plotting.dot_trace(hours, dataset.bias, "measured", GREY, size=3),
        plotting.time_trace(hours, model, name, VERMILION, width=2),
        plotting.time_trace(hours, left, "compensated", BLUE, yaxis="y2", width=1.2, meta=LEFT),
        plotting.time_trace(hours, dataset.channel("temperature"), "temperature", ORANGE, yaxis="y3"),
    ]
    layout: dict[str, Any] = {
        "xaxis": axis("time [h]", anchor="y3"),
        "yaxis": axis("bias [deg/h]", domain=[0.62, 1.0]),
        "yaxis2": axis("residual [deg/h]", domain=[0.25, 0.57], anchor="x"),
        "yaxis3": axis("unit [°C]", domain=[0.0, 0.2], anchor="x"),
    }
    if floor_dph is not None:
        layout["shapes"] = [plotting.shade(-floor_dph, floor_dph, GREEN, "y", yref="y2", xref="paper")]
    return plotting.plot(traces, layout, 640)


def band(x: FloatArray, low: FloatArray, high: FloatArray, name: str = "lowest to highest") -> go.Scatter:
    """A pale area between two curves (n,), interrupted in gaps."""
    pieces = np.split(np.arange(x.size), np.flatnonzero(np.diff(np.isfinite(low + high).astype(np.int8))) + 1)
    at: list[FloatArray] = []
    around: list[FloatArray] = []
    for piece in pieces:
        if np.all(np.isfinite(low[piece] + high[piece])):
            at += [x[piece], x[piece][::-1], np.array([np.nan])]
            around += [low[piece], high[piece][::-1], np.array([np.nan])]
    x_shown, y_shown = (plotting.plain(np.concatenate(parts) if parts else x[:0]) for parts in (at, around))
    return go.Scatter(
        x=x_shown, y=y_shown,
        fill="toself", fillcolor="rgba(138,148,157,0.30)", line={"width": 0}, mode="lines", name=name, hoverinfo="skip",
    )  # fmt: skip


def model_ladder(
    names: Sequence[str], in_sample: FloatArray, held_out: FloatArray, band: FloatArray, floor_dph: float | None
) -> Plot:
    """In-sample and held-out RMS (m,) of each model, the held-out's interval (m, 2) and the floor, on a log axis."""
    where = [f"{name}  " for name in names]
    bars = np.nan_to_num(np.abs(band - held_out[:, None]))
    error = {
        "type": "data", "symmetric": False, "thickness": 1.5, "width": 5, "color": BLUE,
        "array": plotting.plain(bars[:, 1]), "arrayminus": plotting.plain(bars[:, 0]),
    }  # fmt: skip
    hollow = {"symbol": "circle-open", "size": 15, "color": ORANGE, "line": {"width": 2.5}}
    solid = {"symbol": "circle", "size": 10, "color": BLUE}
    traces = [
        go.Scatter(x=plotting.plain(in_sample), y=where, mode="markers", marker=hollow, name="in-sample"),
        go.Scatter(x=plotting.plain(held_out), y=where, mode="markers", marker=solid, name="held-out", error_x=error),
    ]
    layout: dict[str, Any] = {
        "xaxis": plotting.log_axis("model error, RMS [deg/h]", *_ends(in_sample, held_out, floor_dph)),
        "yaxis": axis("", autorange="reversed", gridwidth=1),
    }
    if floor_dph is not None:
        layout["shapes"] = [{
            "type": "line", "xref": "x", "x0": floor_dph, "x1": floor_dph, "yref": "y domain", "y0": 0, "y1": 1,
            "line": {"color": GREEN, "dash": "dash", "width": 2},
        }]  # fmt: skip
        layout["annotations"] = [{
            "xref": "x", "x": float(np.log10(floor_dph)), "xanchor": "right", "yref": "y domain", "y": 0,
            "yanchor": "bottom", "text": "noise floor", "showarrow": False, "font": {"color": GREEN},
        }]  # fmt: skip
    return plotting.plot(traces, layout, 130 + 42 * len(names))


def _ends(*values: FloatArray | float | None) -> tuple[float, float]:
    """Range of a logarithmic axis that shows all these values."""
    flat = np.concatenate([np.atleast_1d(np.asarray(value, dtype=np.float64)) for value in values if value is not None])
    flat = flat[np.isfinite(flat) & (flat > 0)]
    return (float(flat.min() / 1.8), float(flat.max() * 1.4)) if flat.size else (0.01, 100.0)


def residual_over_temperature(dataset: Dataset, residual: FloatArray, floor_dph: float | None) -> Plot:
    """Residual (n,) over temperature, heating and cooling separately; the floor as a band."""
    temperature = dataset.channel("temperature")
    traces = [
        plotting.dot_trace(temperature[dataset.direction == sign], residual[dataset.direction == sign], text, colour)
        for sign, (text, colour) in plotting.DIRECTIONS.items()
        if np.any(dataset.direction == sign)
    ]
    layout = {"xaxis": axis(TEMPERATURE), "yaxis": axis(RESIDUAL, zeroline=True), **_floor_band(floor_dph)}
    return plotting.plot(traces, layout, 440)


def residual_over_time(dataset: Dataset, residual: FloatArray, floor_dph: float | None) -> Plot:
    """Residual (n,) over time with the borders of the segments; the floor as a band."""
    hours = dataset.time / HOUR_S
    layout: dict[str, Any] = {
        "xaxis": axis("time [h]"),
        "yaxis": axis(RESIDUAL, zeroline=True),
        **_floor_band(floor_dph),
    }
    borders = [s.from_s / HOUR_S for s in dataset.segments if np.isfinite(s.from_s)]
    layout["shapes"] = [
        *layout.get("shapes", []),
        *({
            "type": "line", "xref": "x", "x0": at, "x1": at, "yref": "y domain", "y0": 0, "y1": 1, "layer": "below",
            "line": {"color": GREY, "dash": "dot", "width": 1},
        } for at in borders),
    ]  # fmt: skip
    return plotting.plot([plotting.time_trace(hours, residual, "residual", BLUE, width=1.2)], layout, 380)


def _floor_band(floor_dph: float | None) -> dict[str, Any]:
    if floor_dph is None:
        return {}
    return {"shapes": [plotting.shade(-floor_dph, floor_dph, GREEN, "y")]}
