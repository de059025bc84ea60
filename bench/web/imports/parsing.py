"""The confined process that shows a foreign table: `python -m bench.web.imports.parsing REQUEST ANSWER`.

It limits its own memory, processor time and written bytes before it opens the file (`bench.acquisition.answering`), and
has no key: run folders are made and signed in the server's own process.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bench.acquisition import answering, shortened
from bench.base import RATES, THERMOMETERS

if TYPE_CHECKING:
    from bench.acquisition import ImportPlan, Table

MOST_COLUMNS = 300
"""Columns that the page lists."""
FIRST_ROWS = 5
_DRAWN = 600


def preview(wanted: Mapping[str, Any]) -> dict[str, Any]:
    """Content of the table and how it was understood; `problem` says what is unclear."""
    from bench.acquisition import UnclearColumnError, guess, plan_table
    from bench.base import InputError

    table = _table(wanted)
    understood, figure, problem, known = None, None, None, guess(table)
    try:
        plan = plan_table(table, _columns(wanted), wanted["serial"])
        understood, figure = _understood(plan), _figure(plan)
    except UnclearColumnError as error:  # the page has fields for what a column map says
        problem = shortened(f"{error.problem}; {'choose them below' if error.several else 'choose it below'}")
        known |= error.columns
    except InputError as error:
        problem = shortened(str(error))
    return {
        "rows": table.rows,
        "columns": [_column(table, name) for name in list(table.columns)[:MOST_COLUMNS]],
        "left_out": max(0, len(table.columns) - MOST_COLUMNS),
        "guess": known,
        "understood": understood,
        "problem": problem,
        "figure": figure,
        "notes": [shortened(note) for note in table.notes],
    }


def make(wanted: Mapping[str, Any], table: Table) -> dict[str, Any]:
    """Make the run folder and register it."""
    from bench.acquisition import plan_table, write_import
    from bench.commands import register_runs

    out = Path(wanted["out"])
    plan = plan_table(table, _columns(wanted), wanted["serial"])
    folder = write_import(plan, out, operator=wanted["operator"])
    failed = register_runs([folder.path], None, begin=True)
    return {
        "run": folder.path.relative_to(out).as_posix(),
        "warnings": [shortened(text) for text in (*plan.doubts, *filter(None, [failed]))],
    }


def _columns(wanted: Mapping[str, Any]) -> Any:
    """The column map; InputError that names what is wrong in it."""
    from pydantic import ValidationError

    from bench.acquisition import ColumnMap
    from bench.base import InputError

    try:
        return ColumnMap.model_validate(wanted.get("columns") or {})
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False)[0]
        place = ".".join(str(part) for part in first["loc"])
        raise InputError(f"column map: {place}: {first['msg']}") from None


def _table(wanted: Mapping[str, Any]) -> Table:
    import pyarrow as pa

    from bench.acquisition import read_table

    pa.set_cpu_count(1)
    pa.set_io_thread_count(1)
    encoding = (wanted.get("columns") or {}).get("encoding")
    return read_table(Path(wanted["file"]), wanted.get("dbc"), int(wanted["confines"]["memory_bytes"]), encoding)


def _column(table: Table, name: str) -> dict[str, Any]:
    import numpy as np

    from bench.acquisition import split_header

    values = table.columns[name]
    known = values[np.isfinite(values)]
    first = [float(value) if np.isfinite(value) else None for value in values[:FIRST_ROWS]]
    low, high = (float(known.min()), float(known.max())) if known.size else (None, None)
    stated = split_header(name, table.units.get(name))[1]
    return {"name": name, "unit": stated, "first": first, "low": low, "high": high, "count": int(known.size)}


def _understood(plan: ImportPlan) -> dict[str, Any]:
    import numpy as np

    from bench.base import CHANNELS

    channels = []
    for mapped in plan.mapped:
        values = plan.channels[mapped.channel]
        known = values[np.isfinite(values)]
        channels.append({
            "channel": mapped.channel, "column": mapped.column, "unit": mapped.unit, "how": mapped.how,
            "to": CHANNELS[mapped.channel].unit, "low": float(known.min()), "high": float(known.max()),
            "count": int(known.size),
        })  # fmt: skip
    return {
        "time": plan.time_source.model_dump(exclude_none=True), "channels": channels, "interval_s": plan.interval_s,
        "duration_s": float(plan.time[-1]), "rows": int(plan.time.size),
        "segments": [branch.as_segment(i).content() for i, branch in enumerate(plan.branches)],
        "warnings": [shortened(text) for text in plan.doubts],
    }  # fmt: skip


def _figure(plan: ImportPlan) -> dict[str, Any]:
    """Temperature and rate over time as the import would store them."""
    from bench.deliver import AXIS_COLOURS, ORANGE, axis, line_trace, plot, thin

    hours = plan.time / 3600
    traces = []
    lines = [(name, ORANGE, "y") for name in THERMOMETERS if name in plan.channels][:1]
    rates = [name for name in RATES if name in plan.channels]
    lines += [(name, colour, "y2") for name, colour in zip(rates, AXIS_COLOURS, strict=False)]
    for name, colour, where in lines:
        rows = thin(plan.channels[name], _DRAWN)
        traces.append(line_trace(hours[rows], plan.channels[name][rows], name, colour, yaxis=where, width=1.3))
    layout = {
        "xaxis": axis("time [h]", anchor="y2"),
        "yaxis": axis("temperature [°C]", domain=[0.56, 1.0]),
        "yaxis2": axis("rate [deg/h]", domain=[0.0, 0.44], anchor="x"),
        "showlegend": len(rates) > 1,
    }
    return plot(traces, layout, 360)


if __name__ == "__main__":
    answering(preview, Path(sys.argv[1]), Path(sys.argv[2]))
