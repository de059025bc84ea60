"""A table that somebody else recorded, into a run folder; with a preview of what was understood, and refusals.

`plan_table` converts and judges without writing anything; `write_import` makes the run folder from the plan.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np

from bench.acquisition.importer.branches import Branch, find_branches, segment_of
from bench.acquisition.importer.columns import ColumnMap, Mapped, TimeSource, find_columns, time_conversion
from bench.acquisition.importer.doubts import doubts, refuse_impossible, time_doubts, time_gaps
from bench.acquisition.importer.table import Table
from bench.base import CHANNELS, OTHERS, RATES, THERMOMETERS, FloatArray, InputError, __version__, dump, load_config
from bench.record import (
    EVENTS,
    Dataset,
    Manifest,
    RunFolder,
    Segment,
    create_run,
    sha256,
    slug,
    staged,
    write_events,
    write_means,
    write_samples,
)
from drivers.units import Conversion

_LEAST_SORTED = 3
_HOUR_S = 3600.0
_BRANCHES = 24  # that the preview lists; a noisy thermometer, or a wrong column, makes hundreds

_CLEAR = re.compile("were read as points$|was read as (1 and 0|the units)|^'.*' begins at ")
"""Notes of a table that leave no doubt."""


@dataclass(frozen=True, eq=False)
class ImportPlan:
    """A foreign table as it was understood: channels in the bench's units, (n,) each, NaN in gaps."""

    table: Table
    serial: str
    time_source: TimeSource
    time: FloatArray
    channels: Mapping[str, FloatArray]
    mapped: tuple[Mapped, ...]
    branches: tuple[Branch, ...]
    warnings: tuple[str, ...]

    @property
    def interval_s(self) -> float:
        """Median time from sample to sample [s]."""
        return float(np.median(np.diff(self.time)))

    @property
    def doubts(self) -> list[str]:
        """What may be wrong with the table, without what only tells how something in it was read."""
        return [text for text in self.warnings if _CLEAR.search(text) is None]

    def dataset(self) -> Dataset:
        """The table as a record in memory, its rows as they are; nothing is written."""
        segments = tuple(Segment.of(branch.as_segment(i)) for i, branch in enumerate(self.branches))
        segment = segment_of(self.branches, self.time)
        warm = next(name for name in THERMOMETERS if name in self.channels)
        channels = {**self.channels, "temperature": self.channels[warm]}
        return Dataset(self.table.path.stem, self.time, channels, segment, segments, self.interval_s)

    def preview(self) -> str:
        """What was understood, as text for a person."""
        hours = (self.time[-1] - self.time[0]) / 3600
        lines = [
            f"{self.table.path}: {self.time.size:,} rows, {hours:.2f} h, one every {self.interval_s:.4g} s",
            f"  time                 from {_spell(self.time_source)}",
        ]
        for mapped in self.mapped:
            values = self.channels[mapped.channel]
            known = values[np.isfinite(values)]
            unit = CHANNELS[mapped.channel].unit
            given = "" if mapped.unit == unit else f", converted from {mapped.unit}"
            how = f"column '{mapped.column}' (unit: {mapped.how}{given})"
            lines.append(
                f"  {mapped.channel:<20} {known.min():.6g} to {known.max():.6g} {unit}, {known.size:,} values, {how}"
            )
        used = {self.time_source.column, *(m.column for m in self.mapped)}
        numbers = [name for name in self.table.columns if name not in used]
        left_out = [*numbers, *(name for name in self.table.unread if name not in used)]
        lines.append(f"  not used             {', '.join(left_out)}" if left_out else "  every column is used")
        if spare := next((name for name in OTHERS if name not in self.channels), "") if numbers else "":
            entry = f"`{spare}: {{column: {numbers[0]}}}`"
            lines.append(f"  effects of a further quantity are searched, too, if a column map has it: {entry}")
        lines += [f"  branch {b.as_segment(i).name}, {(b.to_s - b.from_s) / 60:.0f} min, {b.rate_degc_per_min:.2g} "
                  "degC/min" for i, b in enumerate(self.branches[:_BRANCHES])]  # fmt: skip
        if len(self.branches) > _BRANCHES:
            lines.append(f"  … and {len(self.branches) - _BRANCHES} further branches")
        doubts = self.doubts
        said = [f"  {'warning' if text in doubts else 'note'}: {text}" for text in self.warnings]
        return "\n".join([*lines, *said])

    def to_json(self) -> dict[str, Any]:
        """The same for a program."""
        return {
            "file": str(self.table.path),
            "unit": self.serial,
            "rows": int(self.time.size),
            "interval_s": self.interval_s,
            "time": self.time_source.model_dump(exclude_none=True),
            "columns": {m.channel: {"column": m.column, "unit": m.unit, "how": m.how} for m in self.mapped},
            "segments": [branch.as_segment(i).content() for i, branch in enumerate(self.branches)],
            "warnings": list(self.warnings),
        }


def load_columns(path: Path | str) -> ColumnMap:
    """Column map from its YAML file; InputError with file and line."""
    return load_config(path, ColumnMap)


def plan_table(table: Table, columns: ColumnMap, serial: str) -> ImportPlan:
    """Judge a table that was read; InputError when it cannot become a run."""
    source, mapped = find_columns(table, columns)
    table = _in_order(table, source)
    time = _time(table, source)
    with np.errstate(over="ignore"):  # what is beyond every number is refused below
        channels = {name: entry.convert(table.columns[entry.column]) for name, entry in mapped.items()}
    rate, warm = (next(name for name in some if name in channels) for some in (RATES, THERMOMETERS))
    for name in (rate, warm):
        if not np.any(np.isfinite(channels[name])):
            raise InputError(f"column '{mapped[name].column}' ({name}) has no value in any row", table.path)
    channels = {name: values for name, values in channels.items() if np.any(np.isfinite(values))}
    used = tuple(mapped[name] for name in channels)
    refuse_impossible(time, channels, used, table)
    warnings = (*table.notes, *time_doubts(time, channels[warm]), *doubts(channels, mapped))
    warnings = (*warnings, *time_gaps(time, table))
    branches = find_branches(time, channels[warm])
    return ImportPlan(table, serial, source, time, channels, used, branches, warnings)


def write_import(
    plan: ImportPlan, out: Path, created: datetime | None = None, operator: str | None = None
) -> RunFolder:
    """Make the run folder of a plan under `out`: data, means, events, column map and manifest; InputError if it cannot.

    The folder appears when it is complete. The same file with the same columns again is the run that is there already.
    `created` is the calendar time of the import, for a folder with a known name; `operator` is who asked for it.
    """
    known = _imported_before(plan, out)
    if known is not None:
        return known
    created = created or datetime.now(UTC)
    name = f"import_{plan.table.path.stem}"
    while list((out / slug(plan.serial)).glob(f"{created:%Y%m%dT%H%M%SZ}_{slug(name)}*")):
        created += timedelta(seconds=1)
    try:
        with staged(out) as place:
            run = _write(plan, create_run(place, plan.serial, name, created), created, operator)
            final = out / slug(plan.serial) / run.path.name
            final.parent.mkdir(parents=True, exist_ok=True)
            return RunFolder(run.path.rename(final))
    except OSError as error:
        raise InputError(f"cannot be written: {error.strerror}; choose another place with --out", out) from None


def _imported_before(plan: ImportPlan, out: Path) -> RunFolder | None:
    """The run that this very import made before, if its folder is complete."""
    digest, columns = sha256(plan.table.path), _column_map(plan)
    for path in sorted((out / slug(plan.serial)).glob(f"*_{slug(f'import_{plan.table.path.stem}')}*/{Manifest.FILE}")):
        with contextlib.suppress(InputError, OSError):  # a damaged folder is not this run
            source = Manifest.read(path.parent).source or {}
            if source.get("sha256") == digest and (path.parent / "columns.yaml").read_text(encoding="utf-8") == columns:
                return RunFolder(path.parent)
    return None


def _write(plan: ImportPlan, run: RunFolder, created: datetime, operator: str | None) -> RunFolder:
    run.journal.rmdir()  # there is no raw journal: the source file is named with its hash instead
    segment = segment_of(plan.branches, plan.time).astype(np.int16)
    write_samples(run.data, {"time": plan.time, **plan.channels, "segment": segment})
    write_means(run.data, run.means)
    (run.path / "columns.yaml").write_text(_column_map(plan), encoding="utf-8")
    write_events(run.path / EVENTS, [{"t_s": 0.0, "kind": "import", "text": warning} for warning in plan.warnings])
    _manifest(plan, run, created, operator).write(run.path)
    return run


def _in_order(table: Table, source: TimeSource) -> Table:
    """The rows in the order of their times, where nothing but their order is wrong: no time twice, none between two."""
    if source.column is None:
        return table
    values = table.columns[source.column]
    if values.size < _LEAST_SORTED or not np.all(np.isfinite(values)) or np.all(np.diff(values) > 0.0):
        return table
    order = np.argsort(values, kind="stable")
    steps = np.diff(values[order])
    if steps.min() <= 0.5 * np.median(steps):
        return table
    return table.take(order, f"its rows were put in the order of '{source.column}'")


def _time(table: Table, source: TimeSource) -> FloatArray:
    """Time of each row since the first [s]; InputError with the line where it stands still, runs back or is missing."""
    if source.column is None:
        return np.arange(table.rows, dtype=np.float64) * (source.step_s or 1.0)
    values = table.columns[source.column]
    missing = np.flatnonzero(~np.isfinite(values))
    if missing.size:
        raise InputError(
            f"'{source.column}' (time) has no value; delete that line", table.path, table.line(int(missing[0]))
        )
    convert = time_conversion(table, source) if source.step_s is None else Conversion(source.step_s)
    with np.errstate(over="ignore"):
        time = convert(values - values[0])
    if time.size < 2:
        raise InputError("holds one row; a run needs more", table.path)
    wrong = np.flatnonzero(time[1:] <= time[:-1])
    if wrong.size:
        row = int(wrong[0]) + 1
        verb = "stands still" if time[row] == time[row - 1] else "runs backwards"
        text = f"time {verb}: '{source.column}' is {values[row]:.10g} after {values[row - 1]:.10g}"
        hour = abs(float(time[row] - time[row - 1]) + _HOUR_S) < 0.1 * _HOUR_S
        advice = (
            "is it the end of summer time? export times with their zone"
            if hour
            else ("two records or two units in one file? split it; or give sample numbers with interval_s")
        )
        raise InputError(f"{text}; {advice}", table.path, table.line(row))
    return time


def _spell(source: TimeSource) -> str:
    if source.step_s is None:
        return f"column '{source.column}'" + (f" [{source.unit}]" if source.unit else "")
    numbers = "row numbers" if source.column is None else f"sample numbers in '{source.column}'"
    return f"{numbers}, one every {source.step_s:g} s"


def _column_map(plan: ImportPlan) -> str:
    """The map that repeats this import exactly."""
    columns = {m.channel: {"column": m.column, "unit": m.unit} for m in plan.mapped}
    encoding = {} if plan.table.encoding is None else {"encoding": plan.table.encoding}
    return dump({**encoding, "time": plan.time_source.model_dump(exclude_none=True), **columns})


def _manifest(plan: ImportPlan, run: RunFolder, created: datetime, operator: str | None) -> Manifest:
    people = {} if operator is None else {"operator": operator}
    return Manifest(
        run=run.path.name,
        unit=plan.serial,
        created=created.isoformat(timespec="seconds"),
        profile=f"import of {plan.table.path.name}",
        state="done",
        cause="imported",
        simulated=False,
        source={**plan.to_json(), "sha256": sha256(plan.table.path)},
        sample_rate_hz=1.0 / plan.interval_s,
        rows=int(plan.time.size),
        duration_s=float(plan.time[-1]),
        segments=tuple(branch.as_segment(i) for i, branch in enumerate(plan.branches)),
        losses={},
        versions={"bench": __version__, "numpy": np.__version__},
        seeds={},
        files=run.hashes(),
        **people,
    )
