"""Figures with a text alternative and a table of their numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bench.analysis import entry
from bench.base import FloatArray, InputError, number
from bench.deliver.report.plotting import Plot

Table = list[list[Any]]


def described(plot: Plot, words: str, table: Table | None = None) -> dict[str, Any]:
    """A figure for a page: the plot, its description, and its numbers as rows of a CSV.

    Without a `table` the rows are the points of every curve.
    """
    return {"figure": plot, "words": words, "csv": points(plot) if table is None else table}


def points(plot: Mapping[str, Any]) -> Table:
    """Every point of a figure with the quantities of its axes; a map has one line per cell."""
    rows: Table = [["curve", "x", "x is", "y", "y is", "z"]]
    for trace in plot["data"]:
        x_is, y_is = (_title(plot["layout"], trace.get(f"{side}axis") or side) for side in "xy")
        name = str(trace.get("name") or "")
        if trace.get("z") is not None:
            cells = zip(trace["y"], trace["z"], strict=True)
            rows += [[name, x, x_is, y, y_is, z] for y, line in cells for x, z in zip(trace["x"], line, strict=True)]
        elif trace.get("hoverinfo") != "skip":  # arrows and bands repeat other curves
            rows += [[name, x, x_is, y, y_is, None] for x, y in zip(trace["x"], trace["y"], strict=True)]
    return rows


def _title(layout: Mapping[str, Any], axis: str) -> str:
    """Quantity and unit of an axis by its name in traces: x, y2."""
    key = f"{axis[0]}axis{axis[1:]}"
    return str(((layout.get(key) or {}).get("title") or {}).get("text") or "").replace("<br>", " ")


def columns(named: Mapping[str, FloatArray | None]) -> Table:
    """Columns (n,) side by side under their names; gaps are empty, columns that are None are omitted."""
    known = {name: values for name, values in named.items() if values is not None}
    cells = [[float(f"{v:.8g}") if np.isfinite(v) else None for v in values.tolist()] for values in known.values()]
    return [list(known), *(list(row) for row in zip(*cells, strict=True))]


def ladder_words(names: Sequence[str], inside: FloatArray, outside: FloatArray, floor_dph: float) -> str:
    """Errors of models one after another, and the floor."""
    errors = [
        f"{name}: {number(i)} in-sample, {number(o)} on unseen data"
        for name, i, o in zip(names, inside.tolist(), outside.tolist(), strict=True)
    ]
    return f"Error of each model in RMS deg/h. {'; '.join(errors)}. {floor_words(floor_dph)}"


def summary_of(effect: str) -> str:
    """One line about an effect; empty for a user-defined effect that is not loaded."""
    try:
        return entry(effect).summary
    except InputError:
        return ""


def floor_words(floor_dph: float) -> str:
    """The noise floor as a sentence."""
    return f"Noise floor {number(floor_dph)} deg/h." if np.isfinite(floor_dph) else "The noise floor is unknown."
