"""What nothing describes, in the section about missing effects: its memory, and cells of two channels."""

from __future__ import annotations

from typing import Any

import numpy as np
import plotly.graph_objects as go
from markupsafe import Markup

from bench.analysis import Diagnosis, Kernel, ResidualSurface
from bench.base import in_print
from bench.deliver.report import plotting
from bench.deliver.report.markup import figure, heading
from bench.deliver.report.plotting import BLUE, GREY, SHADES, Plot, axis

_TICKS_MIN = tuple(first * decade for decade in (0.1, 1, 10, 100, 1000) for first in (1, 2, 5))


def left(answer: Diagnosis) -> Markup:
    """Memory and cells, where the diagnosis has them."""
    parts = Markup()
    if answer.kernel is not None:
        words = (
            f"What is left of the bias after a step of 1 °C, over the time since: {answer.kernel.words}. Band: two "
            "standard deviations. A constant is open: the model's curve over temperature takes it in."
        )
        parts += heading("Memory of what is left") + figure("fig-missing-memory", memory(answer.kernel), words, words)
    if answer.surface is not None:
        text = in_print(answer.surface.words).replace("_", " ").replace("+-", "±")
        words = f"{text[0].upper()}{text[1:]}. Grey cells with a dot are within the noise."
        parts += heading("What is left over two channels")
        parts += figure("fig-missing-surface", surface(answer.surface), words, words)
    return parts


def memory(kernel: Kernel) -> Plot:
    """The response to a step of temperature over the lag, with its band."""
    minutes = kernel.lag_s / 60.0
    ends = np.concatenate([kernel.value + 2.0 * kernel.sd, (kernel.value - 2.0 * kernel.sd)[::-1]])
    band = go.Scatter(
        x=plotting.plain(np.concatenate([minutes, minutes[::-1]])), y=plotting.plain(ends), fill="toself", mode="lines",
        line={"width": 0}, fillcolor="rgba(0,114,178,0.2)", name="two standard deviations", hoverinfo="skip",
    )  # fmt: skip
    line = go.Scatter(
        x=plotting.plain(minutes), y=plotting.plain(kernel.value), mode="lines+markers", line={"color": BLUE},
        name="left after a step of 1 °C", hovertemplate="%{x:.1f} min: %{y:.3g} deg/h/°C<extra></extra>",
    )  # fmt: skip
    ticks = [at for at in _TICKS_MIN if minutes[0] <= at <= minutes[-1]]
    layout = {
        "xaxis": axis("time since the step [min]", type="log", tickmode="array", tickvals=ticks),
        "yaxis": axis("bias that is left [deg/h/°C]", zeroline=True, zerolinecolor=GREY),
    }
    return plotting.plot([band, line], layout, 300)


def surface(cells: ResidualSurface) -> Plot:
    """Cells that stand out of the noise in colour, the others grey."""
    seen = np.where(cells.stands_out, cells.mean, np.nan).T
    within = (~cells.stands_out & (cells.count > 0)).T
    noise = np.where(within, 0.0, np.nan)
    largest = max(float(np.nanmax(np.abs(cells.mean), initial=0.0)), 1e-9)
    said = np.stack([cells.se.T, cells.count.T], axis=-1)
    common: dict[str, Any] = {
        "x": plotting.plain(cells.edges[0]), "y": plotting.plain(cells.edges[1]),
        "xgap": 1, "ygap": 1, "hoverongaps": False,
    }  # fmt: skip
    grey = go.Heatmap(
        z=plotting.plain(noise), colorscale=[[0.0, GREY], [1.0, GREY]], opacity=0.35, showscale=False, hoverinfo="skip",
        text=np.where(within, "·", "").tolist(), texttemplate="%{text}", textfont={"size": 16},
        **common,
    )  # fmt: skip
    colour = go.Heatmap(
        z=plotting.plain(seen), zmin=-largest, zmax=largest, colorscale=SHADES, customdata=plotting.plain(said),
        colorbar={"title": {"text": "residual<br>[deg/h]"}, "thickness": 14, "outlinewidth": 0},
        hovertemplate="%{z:.3g} ± %{customdata[0]:.2g} deg/h, %{customdata[1]} rows<extra></extra>", **common,
    )  # fmt: skip
    titles = [
        f"{name.replace('_', ' ')} [{in_print(unit)}]" for name, unit in zip(cells.channels, cells.units, strict=True)
    ]
    return plotting.plot([grey, colour], {"xaxis": axis(titles[0]), "yaxis": axis(titles[1])}, 400)
