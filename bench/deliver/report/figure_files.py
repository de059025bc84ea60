"""Figures as files for a paper or a slide: SVG and PNG, each with the data behind it as CSV; the report stays as it is.

Each picture of a model is made for every model that was fitted, not only for the best one. The same run gives the same
bytes. matplotlib draws: it needs no browser.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from io import BytesIO
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from bench.analysis import Comparison, Score, zero_rate
from bench.base import FloatArray, InputError
from bench.deliver.report import figure_surfaces
from bench.deliver.report.figures_run import BIAS, HOUR_S, TEMPERATURE
from bench.deliver.report.plotting import BLUE, CYCLE, DIRECTIONS, GREEN, GREY, ORANGE, PASSAGE, VERMILION, thin
from bench.deliver.report.sections_model import spline_of
from bench.record import Dataset

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WIDTH_IN = 6.3
"""Text width of a page of A4 [inch]."""
PNG_DPI = 300
_PIECE_POINTS = 25
_STYLE: Any = {
    "font.size": 9, "axes.spines.top": False, "axes.spines.right": False, "axes.grid": True, "grid.color": "#dde1e5",
    "grid.linewidth": 0.5, "legend.frameon": False, "lines.linewidth": 1.2, "svg.hashsalt": "bench",
    "axes.prop_cycle": f"cycler('color', {list(CYCLE)})",
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Drawing:
    """One figure: name of its files, the data behind it, height [inch], and how it is drawn."""

    name: str
    data: pd.DataFrame
    draw: Callable[[Figure], None]
    height_in: float = 3.9


def figure_files(dataset: Dataset, comparison: Comparison) -> dict[str, bytes]:
    """Content of each file by its name. InputError where matplotlib is not installed."""
    if find_spec("matplotlib") is None:
        raise InputError("figures as files need matplotlib: pip install 'gyro-thermal-bench[figures]'")
    made: dict[str, bytes] = {}
    for drawing in drawings(dataset, comparison):
        made[f"{drawing.name}.csv"] = drawing.data.to_csv(index=False, float_format="%.9g").encode()
        made |= {f"{drawing.name}.{kind}": picture for kind, picture in _pictures(drawing).items()}
    return made


def drawings(dataset: Dataset, comparison: Comparison) -> Iterator[Drawing]:
    """The figures that this run has data for."""
    yield _profile(dataset)
    yield _loop(dataset)
    for score in comparison.scores:
        yield from _of_model(dataset, score, comparison.floor_dph)
        if (found := spline_of(score)) is not None:
            yield _pieces(dataset, score, *found)
    for name, data, draw in figure_surfaces.surfaces(dataset):
        yield Drawing(name, data, draw, 4.6)


def _pictures(drawing: Drawing) -> dict[str, bytes]:
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    made = {}
    with rc_context(_STYLE):
        canvas = Figure(figsize=(WIDTH_IN, drawing.height_in), layout="constrained")
        drawing.draw(canvas)
        for kind, metadata in (("svg", {"Date": None}), ("png", {"Software": None})):
            file = BytesIO()
            canvas.savefig(file, format=kind, dpi=PNG_DPI, metadata=metadata)
            made[kind] = file.getvalue()
    return made


def _profile(dataset: Dataset) -> Drawing:
    shown = {
        "chamber_setpoint": ("set point", GREY, "--"),
        "chamber_temperature": ("chamber air", BLUE, "-"),
        "temperature": ("unit", VERMILION, "-"),
    }
    hours = dataset.time / HOUR_S
    present = {name: dataset.channels[name] for name in shown if name in dataset.channels}

    def draw(canvas: Figure) -> None:
        axes = canvas.subplots()
        for name, values in present.items():
            text, colour, style = shown[name]
            axes.plot(hours, values, style, color=colour, label=text)
        axes.set(xlabel="time [h]", ylabel="temperature [°C]")
        axes.legend(ncols=3, loc="lower left", bbox_to_anchor=(0.0, 1.0))

    return Drawing("profile", _table(hours, {f"{name}_degC": values for name, values in present.items()}), draw)


def _loop(dataset: Dataset) -> Drawing:
    hours, temperature, bias = dataset.time / HOUR_S, dataset.channel("temperature"), zero_rate(dataset)

    def draw(canvas: Figure) -> None:
        from matplotlib.colors import LinearSegmentedColormap

        axes, rows = canvas.subplots(), thin(bias)
        axes.plot(temperature[rows], bias[rows], color=GREY, linewidth=0.4, zorder=1)
        passage = LinearSegmentedColormap.from_list("passage", PASSAGE)
        dots = axes.scatter(temperature[rows], bias[rows], c=hours[rows], cmap=passage, s=7, zorder=2)
        axes.set(xlabel=TEMPERATURE, ylabel=BIAS)
        canvas.colorbar(dots, ax=axes, label="time [h]")

    return Drawing("bias_over_temperature", _table(hours, {"temperature_degC": temperature, "bias_dph": bias}), draw)


def _of_model(dataset: Dataset, score: Score, floor_dph: float) -> Iterator[Drawing]:
    """Measured and modelled bias over time with what is left, and over temperature."""
    hours, temperature = dataset.time / HOUR_S, dataset.channel("temperature")
    model = score.fit.predict(dataset).bias
    left = dataset.bias - model
    columns = {"temperature_degC": temperature, "bias_dph": dataset.bias, "model_dph": model, "residual_dph": left}
    data, file = _table(hours, columns), _file(score.model.name)

    def over_time(canvas: Figure) -> None:
        upper, lower = canvas.subplots(2, sharex=True, height_ratios=(2, 1))
        rows = thin(dataset.bias)
        upper.plot(hours[rows], dataset.bias[rows], ".", color=GREY, markersize=2, label="measured")
        upper.plot(hours, model, color=VERMILION, label=score.model.name)
        upper.set(ylabel="bias [deg/h]")
        lower.plot(hours, left, color=BLUE, linewidth=0.8, label=f"compensated, {score.rms_dph:.4g} deg/h RMS")
        if np.isfinite(floor_dph):
            lower.axhspan(-floor_dph, floor_dph, color=GREEN, alpha=0.2, linewidth=0, label="noise floor")
        lower.set(xlabel="time [h]", ylabel="residual [deg/h]")
        for axes in (upper, lower):
            axes.legend(ncols=3, loc="lower left", bbox_to_anchor=(0.0, 1.0))

    def over_temperature(canvas: Figure) -> None:
        axes = canvas.subplots()
        for sign, (text, colour) in DIRECTIONS.items():
            rows = np.flatnonzero((dataset.direction == sign) & np.isfinite(dataset.bias))
            rows = rows[thin(dataset.bias[rows])] if rows.size else rows
            axes.plot(temperature[rows], dataset.bias[rows], ".", color=colour, markersize=2, label=f"measured, {text}")
        order = np.argsort(temperature, kind="stable")
        axes.plot(temperature[order], model[order], ".", color="black", markersize=1, label=score.model.name)
        axes.set(xlabel=TEMPERATURE, ylabel="bias [deg/h]")
        axes.legend(ncols=2, markerscale=3, loc="lower left", bbox_to_anchor=(0.0, 1.0))

    yield Drawing(f"{file}_over_time", data, over_time, 4.6)
    yield Drawing(f"{file}_over_temperature", data, over_temperature)


def _pieces(dataset: Dataset, score: Score, knots: FloatArray, pieces: FloatArray) -> Drawing:
    """Each cubic piece `pieces` (m, 4) of a spline between its `knots` (m + 1,), over the measurement."""
    measured = pd.DataFrame({"temperature_degC": dataset.channel("temperature"), "bias_dph": zero_rate(dataset)})
    x = [np.linspace(low, high, _PIECE_POINTS) for low, high in pairwise(knots)]
    y = [np.polynomial.polynomial.polyval(at - at[0], piece) for at, piece in zip(x, pieces, strict=True)]
    curves = [pd.DataFrame({"temperature_degC": a, "bias_dph": b}) for a, b in zip(x, y, strict=True)]
    parts = {"measured": measured, **{f"piece {i + 1}": curve for i, curve in enumerate(curves)}}

    def draw(canvas: Figure) -> None:
        axes = canvas.subplots()
        rows = thin(measured["bias_dph"].to_numpy())
        axes.plot(*measured.iloc[rows].to_numpy().T, ".", color=GREY, markersize=2, alpha=0.6, label="measured")
        for i, (at, values) in enumerate(zip(x, y, strict=True)):
            axes.plot(at, values, color=CYCLE[i % len(CYCLE)], linewidth=2)
        ends = np.append(pieces[:, 0], y[-1][-1])
        axes.plot(knots, ends, "D", color="white", markeredgecolor=ORANGE, markersize=4, label="knots")
        axes.set(xlabel=TEMPERATURE, ylabel=BIAS)
        axes.legend(ncols=2, loc="lower left", bbox_to_anchor=(0.0, 1.0))

    data = pd.concat([part.assign(series=name) for name, part in parts.items()])
    return Drawing(f"{_file(score.model.name)}_pieces", data[["series", "temperature_degC", "bias_dph"]], draw)


def _table(hours: FloatArray, columns: Mapping[str, FloatArray]) -> pd.DataFrame:
    return pd.DataFrame({"time_h": hours, **columns})


def _file(name: str) -> str:
    """Name of a model as part of a file's name."""
    return re.sub(r"[^A-Za-z0-9.-]+", "_", name).strip("_.") or "model"
