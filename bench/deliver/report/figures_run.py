"""Figures of the measured data, without a model: profile, bias loop, other channels, noise of the soaks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go

from bench.analysis import FLICKER_FLOOR, AllanCurve, Noise, zero_rate
from bench.base import CHANNELS, INSTRUMENTS, OTHERS, FloatArray
from bench.deliver.report import plotting
from bench.deliver.report.plotting import BLUE, GREEN, GREY, ORANGE, SKY, VERMILION, Plot, axis
from bench.record import Dataset

HOUR_S = 3600.0
TEMPERATURE = "temperature of the unit [°C]"
BIAS = "zero-rate output [deg/h]"
_TURN_DEGC = 4.0
_ARROWS = 14


def profile_figure(dataset: Dataset, failed: Sequence[tuple[float, float]]) -> Plot:
    """Set point, chamber air and unit over time; the spans [s] of segments that failed are shaded."""
    hours = dataset.time / HOUR_S
    curves: tuple[tuple[str, str, str, dict[str, Any]], ...] = (
        ("chamber_setpoint", "set point", GREY, {"dash": "dash"}),
        ("chamber_temperature", "chamber air", SKY, {}),
        ("temperature", "unit", VERMILION, {"width": 2.2}),
    )
    traces = [
        plotting.time_trace(hours, dataset.channels[name], text, colour, **style)
        for name, text, colour, style in curves
        if dataset.has(name)
    ]
    shapes = [plotting.shade(a / HOUR_S, b / HOUR_S, VERMILION) for a, b in failed]
    layout = {"xaxis": axis("time [h]"), "yaxis": axis("temperature [°C]"), "shapes": shapes}
    return plotting.plot(traces, layout, 380)


def loop_figure(dataset: Dataset) -> Plot:
    """Bias over temperature, coloured by time, with arrows in the direction of travel."""
    traces = [loop_trace(dataset, zero_rate(dataset), "bias", 0.8), _arrows(dataset)]
    return plotting.plot(traces, {"xaxis": axis(TEMPERATURE), "yaxis": axis(BIAS)}, 520)


def loop_trace(dataset: Dataset, values: FloatArray, name: str, width: float, **more: Any) -> go.Scatter:
    """Values (n,) over temperature, coloured by time."""
    rows = plotting.thin(values)
    marker = {
        "color": plotting.plain(dataset.time[rows] / HOUR_S), "colorscale": plotting.PASSAGE, "size": 5,
        "colorbar": {"title": {"text": "time [h]"}, "thickness": 14, "outlinewidth": 0},
    }  # fmt: skip
    x, y = plotting.plain(dataset.channel("temperature")[rows]), plotting.plain(values[rows])
    style = {"mode": "lines+markers", "marker": marker, "line": {"color": GREY, "width": width}}
    return go.Scatter(x=x, y=y, name=name, showlegend=False, **style, **more)


def _arrows(dataset: Dataset) -> go.Scatter:
    """Arrow heads along the loop: each at the end of a step of a few degC, pointing away from its beginning."""
    smooth = _smooth(zero_rate(dataset)), _smooth(dataset.channel("temperature"))
    bias, temperature = smooth
    moving = np.flatnonzero((dataset.direction != 0) & np.isfinite(bias) & np.isfinite(temperature))
    x: list[float] = []
    y: list[float] = []
    if moving.size:
        travelled = np.cumsum(np.abs(np.diff(temperature[moving], prepend=temperature[moving[0]])))
        for mark in np.linspace(0, travelled[-1], _ARROWS + 2)[1:-1]:
            end = int(moving[np.searchsorted(travelled, mark)])
            begin = end - 1
            while begin > 0 and abs(temperature[end] - temperature[begin]) < _TURN_DEGC:
                begin -= 1
            x += [float(temperature[begin]), float(temperature[end])]
            y += [float(bias[begin]), float(bias[end])]
    marker = {"symbol": "arrow", "angleref": "previous", "size": [0, 15] * (len(x) // 2), "color": GREEN, "opacity": 1}
    return go.Scatter(x=x, y=y, mode="markers", marker=marker, name="direction", hoverinfo="skip", showlegend=False)


def _smooth(values: FloatArray, width: int = 7) -> FloatArray:
    """Running median, so that arrows follow the loop and not the noise."""
    if values.size < width:
        return values
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(values, width // 2, mode="edge"), width)
    out: FloatArray = np.median(windows, axis=1)
    return out


def further_channels(dataset: Dataset) -> list[str]:
    """What the unit and the instruments of its station measured beside rate and temperature."""
    return [name for name in ("frequency", "drive", "quadrature", *INSTRUMENTS, *OTHERS) if dataset.has(name)]


def channels_figure(dataset: Dataset) -> Plot | None:
    """The further channels over temperature, heating and cooling separately; None without any."""
    names = further_channels(dataset)
    if not names:
        return None
    traces, layout = [], {}
    temperature = dataset.channel("temperature")
    for i, name in enumerate(names):
        suffix = "" if i == 0 else str(i + 1)
        values = dataset.channels[name]
        for sign, (text, colour) in plotting.DIRECTIONS.items():
            own = dataset.direction == sign
            more = {"xaxis": f"x{suffix}", "yaxis": f"y{suffix}", "legendgroup": text, "showlegend": i == 0}
            traces.append(plotting.dot_trace(temperature[own], values[own], text, colour, size=3, **more))
        column, row = i % 2, i // 2
        rows = (len(names) + 1) // 2
        span = 1.0 if len(names) == 1 else 0.44
        gap = 0.4 / rows
        height = (1.0 - gap * (rows - 1)) / rows
        top = 1.0 - row * (height + gap)
        place = {"domain": [column * 0.56, column * 0.56 + span], "anchor": f"y{suffix}"}
        layout[f"xaxis{suffix}"] = axis(TEMPERATURE, **place, **({"matches": "x"} if i else {}))  # zoomed together
        layout[f"yaxis{suffix}"] = axis(
            f"{name} [{CHANNELS[name].unit}]", domain=[max(0.0, top - height), top], anchor=f"x{suffix}"
        )
    return plotting.plot(traces, layout, 300 if len(names) <= 2 else 280 * rows)


def allan_figure(curves: Sequence[tuple[str, AllanCurve]], noise: Noise | None) -> Plot:
    """Allan deviation of each soak, the 95 % band of the longest, and the three slopes of the estimated noise."""
    traces: list[Any] = []
    longest = max((curve for _, curve in curves), key=lambda curve: curve.tau_s[-1])
    band_x = np.concatenate([longest.tau_s, longest.tau_s[::-1]])
    band_y = np.concatenate([longest.high_dph, longest.low_dph[::-1]])
    traces.append(
        go.Scatter(
            x=plotting.plain(band_x), y=plotting.plain(band_y), fill="toself", fillcolor="rgba(0,114,178,0.18)",
            line={"width": 0}, name="95 % band", hoverinfo="skip",
        )
    )  # fmt: skip
    for i, (name, curve) in enumerate(curves):
        colour = BLUE if curve is longest else plotting.CYCLE[(i % (len(plotting.CYCLE) - 1)) + 1]
        traces.append(
            plotting.line_trace(curve.tau_s, curve.deviation_dph, name, colour, width=2 if curve is longest else 1)
        )
    lowest = min(curve.deviation_dph.min() for _, curve in curves)
    highest = max(curve.deviation_dph.max() for _, curve in curves)
    if noise is not None:
        traces += _slopes(longest.tau_s, noise)
    layout = {
        "xaxis": plotting.log_axis("averaging time τ [s]", float(longest.tau_s[0]), float(longest.tau_s[-1])),
        "yaxis": plotting.log_axis("Allan deviation [deg/h]", 0.7 * float(lowest), 1.4 * float(highest)),
        "legend": {"orientation": "v", "x": 1, "xanchor": "right", "y": 1, "yanchor": "top"},
    }
    return plotting.plot(traces, layout, 480)


def _slopes(tau_s: FloatArray, noise: Noise) -> list[go.Scatter]:
    tau_h = np.array([tau_s[0], tau_s[-1]]) / HOUR_S
    parts = (
        ("white (N)", noise.white / np.sqrt(tau_h), noise.white, GREY),
        ("flicker (B)", np.full(2, FLICKER_FLOOR * noise.flicker), noise.flicker, ORANGE),
        ("random walk (K)", noise.walk * np.sqrt(tau_h / 3.0), noise.walk, GREEN),
    )
    return [
        plotting.line_trace(tau_h * HOUR_S, values, text, colour, dash="dash")
        for text, values, coefficient, colour in parts
        if coefficient > 0
    ]
