"""Section about a run on a rate table: the measured surface over rate and temperature, the fitted one, C0 ... C20."""

from __future__ import annotations

from typing import Any

import numpy as np
import plotly.graph_objects as go

from bench.analysis import Analysis, Points, RateSurface, fit_surface, points_of
from bench.base import DPH_PER_DPS, FloatArray, InputError, number
from bench.deliver.report.markup import Section, figure, paragraph, table
from bench.deliver.report.plotting import BLUE, GREY, ORANGE, VERMILION, Plot, plot
from bench.record import Dataset

ORDER = 5
_MESH = 41
_AROUND = {"showlegend": False, "margin": {"l": 0, "r": 0, "t": 10, "b": 10}}
_COLOURS = [[0.0, BLUE], [0.5, GREY], [0.75, ORANGE], [1.0, VERMILION]]


def surface(analysis: Analysis) -> Section | None:
    """Both surfaces and the coefficients; None for a run without a table, a reason if it has too few steps."""
    data = analysis.dataset
    if data is None or not turned(data):
        return None
    try:
        points, fitted_surface = surface_of(data)
    except InputError as error:
        return Section("surface", "Rate surface", paragraph(f"No surface of order {ORDER}: {error}."))
    words = _words(points, fitted_surface)
    measured = figure(
        "fig-surface-measured", _measured(points), "Measured: raw output minus the table's rate, one point per bin.",
        "Measured error of the output over rate and temperature, as a surface in space.",
    )  # fmt: skip
    fitted = figure(
        "fig-surface-fitted", _fitted(fitted_surface),
        f"Fitted: the same error by the surface of order {fitted_surface.order}.",
        f"Fitted error over rate and temperature. {words}",
    )  # fmt: skip
    terms = zip(
        fitted_surface.powers, fitted_surface.normalised.tolist(), fitted_surface.coefficients.tolist(), strict=True
    )
    rows = [(f"C{k}", f"u^{i} v^{j}", f"{a:.9e}", f"{b:.9e}", _unit(i, j)) for k, ((i, j), a, b) in enumerate(terms)]
    head = ("", "term", "normalised [deg/s]", "de-normalised", "unit")
    html = paragraph(words) + measured + fitted
    html += table("Rate(NR, T); u and v are NR and T mapped to -1 ... 1 over their ranges", head, rows, (2, 3))
    return Section("surface", "Rate surface", html)


def _words(points: Points, found: RateSurface) -> str:
    """Description of a fitted surface."""
    return (
        f"Order {found.order}, {found.normalised.size} coefficients from {points.raw.size} bins of equal width "
        f"({points.left_out} omitted, with too few samples). Residual "
        f"{number(found.rms * DPH_PER_DPS)} deg/h RMS, condition {number(found.condition, 2)}; least squares and "
        f"orthogonal polynomials differ by {found.disagreement:.1g} of the full rate. Valid from "
        f"{number(found.raw.low, 4)} to {number(found.raw.high, 4)} deg/s and {number(found.temperature.low, 3)} to "
        f"{number(found.temperature.high, 3)} °C; outside, inputs are clamped."
    )


def turned(data: Dataset) -> bool:
    """Whether a rate table turned the unit."""
    return bool(np.any(np.nan_to_num(data.channels.get("applied_rate", np.zeros(1)))))


def surface_of(data: Dataset) -> tuple[Points, RateSurface]:
    """Bins of a run and the surface through them. InputError when its steps do not determine one."""
    points = points_of(data)
    return points, fit_surface(points, ORDER)


def _measured(points: Points) -> Plot:
    error = DPH_PER_DPS * (points.raw - points.reference)
    x, y, z = points.reference.tolist(), points.temperature.tolist(), error.tolist()
    # plotly triangulates in the plane of both abscissas, each scaled to its own range.
    mesh = go.Mesh3d(
        x=x, y=y, z=z, intensity=z, colorscale=_COLOURS, opacity=0.6,
        delaunayaxis="z", showscale=False, hoverinfo="skip",
    )  # fmt: skip
    marks = go.Scatter3d(
        x=x, y=y, z=z, mode="markers", marker={"size": 2.5, "color": GREY},
        name="bin", hovertemplate="%{x:.4g} deg/s, %{y:.4g} °C: %{z:.5g} deg/h<extra></extra>",
    )  # fmt: skip
    return plot([mesh, marks], {"scene": _scene("table's rate [deg/s]"), **_AROUND}, 520)


def mesh_of(found: RateSurface) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Raw output [deg/s], temperature [degC] and fitted error [deg/h] on an even grid, (m, m) each."""
    raw = np.linspace(found.raw.low, found.raw.high, _MESH)
    celsius = np.linspace(found.temperature.low, found.temperature.high, _MESH)
    grid = np.meshgrid(raw, celsius)
    return grid[0], grid[1], np.array([error_of(found, *row) for row in zip(*grid, strict=True)])


def _fitted(found: RateSurface) -> Plot:
    raw, celsius, error = mesh_of(found)
    sheet = go.Surface(
        x=raw[0].tolist(), y=celsius[:, 0].tolist(), z=error.tolist(), colorscale=_COLOURS,
        colorbar={"title": {"text": "deg/h"}, "len": 0.7},
        hovertemplate="%{x:.4g} deg/s, %{y:.4g} °C: %{z:.5g} deg/h<extra></extra>",
    )  # fmt: skip
    return plot([sheet], {"scene": _scene("raw output NR [deg/s]"), **_AROUND}, 520)


def error_of(found: RateSurface, raw: FloatArray, celsius: FloatArray) -> FloatArray:
    """Error of the raw output [deg/h] by the surface (n,)."""
    error: FloatArray = DPH_PER_DPS * (raw - found.predict(raw, celsius)[0])
    return error


def _scene(rate: str) -> dict[str, Any]:
    titles = {"xaxis": rate, "yaxis": "temperature [°C]", "zaxis": "error [deg/h]"}
    look = {"gridcolor": GREY, "showbackground": False}
    axes = {name: {"title": {"text": text}, **look} for name, text in titles.items()}
    aspect = {"x": 1.3, "y": 1.3, "z": 0.8}
    # From far enough, and looking low enough, that the labels of the nearest corner are inside the frame.
    camera = {"eye": {"x": 1.7, "y": -1.9, "z": 0.9}, "center": {"x": 0.0, "y": 0.0, "z": -0.2}}
    return {**axes, "aspectmode": "manual", "aspectratio": aspect, "camera": camera}


def _unit(i: int, j: int) -> str:
    """Unit of a de-normalised coefficient."""
    if i == 1 and j == 0:
        return "1"
    powers = (f"(deg/s)^{1 - i}" if i else "deg/s", f"°C^{-j}" if j else "")
    return " ".join(filter(None, (powers[0] if i != 1 else "", powers[1])))
