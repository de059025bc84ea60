"""Figures of the second source paper as files: the measured and the fitted surface, and both ways through them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
import pandas as pd

from bench.analysis import Points
from bench.base import DPH_PER_DPS, FloatArray, InputError
from bench.deliver.report.plotting import BLUE, GREY, ORANGE, PASSAGE, VERMILION
from bench.deliver.report.sections_surface import error_of, mesh_of, surface_of, turned
from bench.record import Dataset

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import Colormap
    from matplotlib.figure import Figure

Named: TypeAlias = "tuple[str, pd.DataFrame, Callable[[Figure], None]]"
ERROR = "error [deg/h]"
RATE, TEMPERATURE = "rate of the table [deg/s]", "temperature [°C]"
_COLUMNS = ["rate_dps", "temperature_degC", "measured_dph", "fitted_dph"]
_COLOURS = ((0.0, BLUE), (0.5, "#4f7a66"), (0.75, ORANGE), (1.0, VERMILION))
_BIN_DEGC = 4.0
"""Points within it count as one temperature."""
_LEAST = 3
"""Least number of points of one curve."""


def surfaces(dataset: Dataset) -> Iterator[Named]:
    """Name, data and picture of each; nothing for a run without a table, or with too few rates for a surface."""
    if not turned(dataset):
        return
    try:
        points, found = surface_of(dataset)
    except InputError:  # the section of the report says why
        return
    measured = DPH_PER_DPS * (points.raw - points.reference)
    columns = (points.reference, points.temperature, measured, error_of(found, points.raw, points.temperature))
    data = pd.DataFrame(dict(zip(_COLUMNS, columns, strict=True)))
    yield "surface_measured", data, lambda canvas: _measured(canvas, data)
    raw, celsius, error = mesh_of(found)
    sheet = pd.DataFrame({"raw_dps": raw.ravel(), "temperature_degC": celsius.ravel(), "fitted_dph": error.ravel()})
    yield "surface_fitted", sheet, lambda canvas: _fitted(canvas, raw, celsius, error)
    yield _ways("varied_rate_at_fixed_temperatures", data, _at_temperatures(points), "temperature_degC", "rate_dps")
    yield _ways("varied_temperature_at_fixed_rates", data, _at_rates(points), "rate_dps", "temperature_degC")


def _at_rates(points: Points) -> FloatArray:
    """Curve of each point: the rate of the table."""
    return np.round(points.reference)


def _at_temperatures(points: Points) -> FloatArray:
    """Curve of each point: the middle of its bin, of the bins that the table passed with at least half of its rates."""
    middle = _BIN_DEGC * np.round(points.temperature / _BIN_DEGC)
    rates = np.round(points.reference)
    passed = {degc: np.unique(rates[middle == degc]).size for degc in np.unique(middle).tolist()}
    most = max(passed.values())
    return np.array([degc if passed[degc] * 2 > most else np.nan for degc in middle.tolist()])


def _ways(name: str, data: pd.DataFrame, curve: FloatArray, fixed: str, varied: str) -> Named:
    """Measured points and fitted lines over one quantity, a curve for each value of the other."""
    own = data.assign(curve=curve)[np.isfinite(curve)].sort_values(["curve", varied], kind="stable")
    own = own[own.groupby("curve")["curve"].transform("size") >= _LEAST]
    words = {"temperature_degC": (TEMPERATURE, "°C"), "rate_dps": (RATE, "deg/s")}

    def draw(canvas: Figure) -> None:
        axes = canvas.subplots()
        groups = list(own.groupby("curve"))
        colours = _map(PASSAGE)(np.linspace(0.0, 1.0, max(2, len(groups))))
        for (_, group), colour in zip(groups, colours, strict=False):
            axes.plot(group[varied], group["measured_dph"], "o", color=colour, markersize=3)
            axes.plot(
                group[varied], group["fitted_dph"], color=colour, label=f"{group[fixed].mean():.3g} {words[fixed][1]}"
            )
        axes.set(xlabel=words[varied][0], ylabel=ERROR)
        axes.legend(fontsize=7, loc="center left", bbox_to_anchor=(1.0, 0.5), title="dots measured,\nlines fitted")

    return name, own[[fixed, varied, *_COLUMNS[2:]]], draw


def _measured(canvas: Figure, data: pd.DataFrame) -> None:
    from matplotlib.tri import Triangulation

    x, y, z = (data[name].to_numpy() for name in _COLUMNS[:3])
    axes = _space(canvas, RATE)
    # Neighbours are sought with both abscissas scaled to their own ranges.
    flat = Triangulation(*((v - v.min()) / np.ptp(v) for v in (x, y)))
    axes.plot_trisurf(x, y, z, triangles=flat.triangles, cmap=_map(_COLOURS), alpha=0.7, linewidth=0.1)  # type: ignore[attr-defined]
    axes.plot(x, y, z, ".", color=GREY, markersize=2)


def _fitted(canvas: Figure, raw: FloatArray, celsius: FloatArray, error: FloatArray) -> None:
    _space(canvas, "raw output NR [deg/s]").plot_surface(raw, celsius, error, cmap=_map(_COLOURS), linewidth=0)  # type: ignore[attr-defined]


def _space(canvas: Figure, rate: str) -> Axes:
    axes: Axes = canvas.add_subplot(projection="3d", azim=-48.0, elev=22.0)
    axes.set(xlabel=rate, ylabel=TEMPERATURE, zlabel=ERROR)
    axes.locator_params(nbins=5)
    axes.set_box_aspect((1.3, 1.3, 0.8), zoom=1.05)  # type: ignore[arg-type, call-arg]
    return axes


def _map(colours: Sequence[tuple[float, str]]) -> Colormap:
    from matplotlib.colors import LinearSegmentedColormap

    return LinearSegmentedColormap.from_list("error", colours)
