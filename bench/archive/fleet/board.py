"""The fleet for a web page: an overview without figures, one figure at a time, and a table for spreadsheets."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable
from itertools import islice
from typing import Any

import numpy as np

from bench.archive.fleet import figures
from bench.archive.fleet.charts import Chart
from bench.archive.fleet.page import GOOD_CPK
from bench.archive.fleet.selection import profile_of
from bench.archive.fleet.statistics import Measured, Statistics, to_csv
from bench.archive.fleet.units import Calibrated
from bench.archive.registry.summaries import decided, good

DISTANCES = "distances"
"""Name of the figure of all units against their lots."""
YIELD = "yield"
"""Name of the figure of the first-pass yield over time."""
_MOST_NAMED = 6
"""Units that are named among those of one kind."""

Found = dict[str, Any]


def overview(found: Statistics) -> Found:
    """All numbers, what needs attention, and which figures exist."""
    newest = found.fleet.newest
    content = found.to_json()
    for one, measured in zip(content["quantities"], found.measured, strict=True):
        one["mean"] = float(np.mean(measured.values)) if measured.values.size else None
        one["signals"] = len(measured.chart.signals) if measured.chart else None
        one["capable"] = None if measured.capability is None else bool(measured.capability.ppk >= GOOD_CPK)
        one.pop("chart")
    moved = [one for one, drift in zip(content["drifts"], found.drifts, strict=True) if drift in found.moved]
    for one in moved:
        one["unit"] = found.fleet.units[one["quantity"]]
    for one in content["shifts"]:
        one["unit_of_value"] = found.fleet.units[one["quantity"]]
    return {
        **content,
        "drifts": moved,
        "tested": len(found.drifts),
        "plan": profile_of(newest.column("cause")[0], newest.column("profile")[0]).item(),
        "simulated": bool(newest.column("simulated")[0]),
        "lots": len({one.lot for one in newest}),
        "stations": len({one.station for one in newest}),
        "from": newest[0].created,
        "to": newest[-1].created,
        "attention": _attention(found, content.pop("later"), content["shifts"]),
        "distances": bool(np.any(np.isfinite(found.distances))),
    }


def _attention(found: Statistics, later: list[Found], shifts: list[Found]) -> Found:
    """The parts of the sentence that `bench fleet` prints."""
    return {
        "quiet": found.quiet,
        "silent": found.silent,
        "outside": found.passes.outside,
        "unjudged": found.passes.unjudged,
        "outside_units": _units(found, lambda word: decided(word) and not good(word)),
        "unjudged_units": _units(found, lambda word: word is not None and not decided(word)),
        "later": len(later),
        "later_runs": later[-_MOST_NAMED:],
        "stations": found.drifted("station"),
        "shifted": [shifts[found.shifts.index(one)] for one in found.shifted()],
        "lots": found.drifted("lot"),
        "odd": [found.fleet.newest[one.row].unit for one in found.odd],
        "beyond": found.beyond,
    }


def _units(found: Statistics, of: Callable[[str | None], bool]) -> list[str]:
    """The newest units with such a verdict."""
    words = found.fleet.words
    rows = (row for row in reversed(range(len(words))) if of(words[row]))
    return [found.fleet.newest[row].unit for row in islice(rows, _MOST_NAMED)]


def drawn(found: Statistics) -> dict[str, Found]:
    """Every figure by its name: of the newest units, with unit and run of each place on x; histograms of all."""
    figures_of = {one.name: _charted(found, one, one.chart) for one in found.measured if one.chart is not None}
    if np.any(np.isfinite(found.distances)):
        newest = found.fleet.newest[-figures.MOST :]
        plot = figures.named(figures.of_lots(found), [_label(one) for one in newest])
        figures_of[DISTANCES] = {
            "name": DISTANCES, "figure": plot, "histogram": None, "units": [one.unit for one in newest],
            "runs": [one.path for one in newest], "signals": [], "all": len(found.fleet.newest),
        }  # fmt: skip
    if found.passes.judged:
        figures_of[YIELD] = {"name": YIELD, "figure": figures.yields(*found.attempts), "histogram": None, "units": [],
                             "runs": [], "signals": [], "all": found.passes.judged}  # fmt: skip
    return figures_of


def _charted(found: Statistics, one: Measured, whole: Chart) -> Found:
    chart = whole.newest(figures.MOST)
    shown = [found.fleet.newest[row] for row in one.rows[-figures.MOST :]]
    units = [unit.unit for unit in shown]
    signals = [{"rule": s.rule, "text": s.text, "unit": units[s.index], "at": s.index + 1} for s in chart.signals]
    limits = one.lower, one.upper
    drawn = figures.control(chart, one.name, one.unit, limits, [unit.station for unit in shown])
    plot = figures.named(drawn, [_label(unit) for unit in shown])
    return {"name": one.name, "figure": plot, "histogram": figures.histogram(one.values, one.unit, limits),
            "units": units, "runs": [unit.path for unit in shown], "signals": signals,
            "all": len(one.rows)}  # fmt: skip


def _label(one: Calibrated) -> str:
    """Serial, lot, station and day (UTC) of a unit's run."""
    return " · ".join([one.unit, one.lot, one.station, f"{one.created[:10]} UTC"])


def safe_csv(found: Statistics) -> str:
    """`to_csv` for a spreadsheet, with no cell that it would take for a formula."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(
        [harmless(cell) for cell in row] for row in csv.reader(io.StringIO(to_csv(found)))
    )
    return text.getvalue()


def harmless(cell: str) -> str:
    """The cell, with an apostrophe in front where a spreadsheet would take it for a formula; numbers stay numbers."""
    if not cell or cell[0] not in "=+-@\t\r":
        return cell
    try:
        float(cell)
    except ValueError:
        return f"'{cell}"
    return cell
