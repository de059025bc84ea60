"""The dataset of a run folder: its 1 s means, and means over longer stretches. Needs neither driver nor bus."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from bench.base import CHANNELS, OUTPUTS, RATES, THERMOMETERS, BoolArray, FloatArray, InputError, despike
from bench.record.chain import use
from bench.record.dataset import Dataset, Segment
from bench.record.earth import EARTH, earth_rate
from bench.record.records.manifest import Manifest
from bench.record.samples import SampleFile, floats

DEFAULT_INTERVAL_S = 30.0
UNKNOWN_UNIT = "unknown"
"""What an imported table calls its unit where nobody said which."""
_SLOWEST_READING_S = 300.0
"""A channel that is read less often than this has no known value between two readings [s]."""
_STANDS_OUT, _CHANGES, _LEAST_DEGC, _FEW = 20.0, 5.0, 5.0, 0.01
"""A reading that stands out of its neighbours by so many robust deviations, so many times what readings usually change,
and of a thermometer by so much, is none of what it should measure; where more of the rows do, the channel is like that.
"""
_STEADY_DPS = 0.1
"""A rate table whose rate differs by more than this from one second to the next accelerates [deg/s]."""


def load(run_folder: Path | str, interval_s: float = DEFAULT_INTERVAL_S, output: str | None = None) -> Dataset:
    """Dataset of a run `averaged` to `interval_s` [s]; `output` and InputError as `seconds_of`."""
    return averaged(seconds_of(run_folder, output), interval_s)


def averaged(seconds: Dataset, interval_s: float, *, whole: bool = False) -> Dataset:
    """The 1 s means of a run averaged to `interval_s` [s].

    Stretches of a segment shorter than half of `interval_s` are left out, and, unless `whole`, power cycles and seconds
    in which a rate table accelerates: milliseconds between its clock and the unit's would pass for hundreds of deg/h of
    bias.
    """
    base = seconds if whole else seconds.select(_steady(seconds) & _powered(seconds))
    return base.select(_lasting(base, interval_s / 2)).average(interval_s)


def seconds_of(run_folder: Path | str, output: str | None = None) -> Dataset:
    """All 1 s means of a finished or recovered run, from its `means.parquet` and `manifest.json`.

    `output` makes one of several outputs the `rate` of the dataset; without it, a unit with several has no `rate`.
    Raises InputError, one line, when the folder, the manifest or the means are missing, broken or without rows.
    """
    folder = Path(run_folder)
    if not folder.is_dir():
        raise InputError("no such run folder", folder)
    manifest = Manifest.read(folder)
    path = folder / "means.parquet"
    if not path.is_file():
        raise InputError("missing; the run was not finished: recover it with `bench resume` or `bench report`", path)
    use(folder, path.name)
    try:
        with pq.ParquetFile(path, page_checksum_verification=True) as file:  # read_table would import pandas
            table = file.read()
    except Exception as error:  # pyarrow raises several unrelated types on a truncated file
        raise InputError(f"not a readable Parquet file ({error})", path) from error
    if table.num_rows == 0:
        raise InputError("holds zero rows: nothing was captured", path)
    have = table.column_names
    for name, some in (("time", ("time",)), ("rate", OUTPUTS), ("temperature", THERMOMETERS)):
        if not set(some) & set(have):
            raise InputError(f"required column '{name}' is missing; it has {', '.join(have)}", path)
    whole = _dataset(table, manifest, folder)
    rates = [name for name in whole.outputs if name in RATES]
    return whole.of(output or rates[0]) if output or len(rates) == 1 else whole


def channels_in(folder: Path) -> set[str]:
    """Channels of a run's `Dataset`, without reading a sample."""
    with SampleFile(folder / "data.parquet") as file:
        channels = {"temperature", *file.names} & {*CHANNELS} - {"time"}
    return channels if Manifest.read(folder).orientation is None else {*channels, EARTH}


def _steady(base: Dataset) -> BoolArray:
    """Rows (n,) in which the rate table keeps its rate, or has none; all of a record in which it hardly ever does."""
    applied = base.channels.get("applied_rate")
    if applied is None:
        return np.ones(len(base), dtype=bool)
    jumps = np.abs(np.diff(applied)) > _STEADY_DPS
    steady: BoolArray = ~(np.append(jumps, False) | np.append(False, jumps))
    return steady if np.mean(steady) > 0.5 else np.ones(len(base), dtype=bool)


def _powered(base: Dataset) -> BoolArray:
    """Rows (n,) outside segments in which the unit's power is switched."""
    cycles = [segment.index for segment in base.segments if segment.kind == "power_cycle"]
    return np.isin(base.segment, cycles, invert=True)


def _lasting(base: Dataset, least_s: float) -> BoolArray:
    """Rows (n,) of stretches of one segment that last at least `least_s` [s]; a shorter one makes no honest mean."""
    stretch = np.cumsum(np.diff(base.segment, prepend=base.segment[:1]) != 0)
    rows: BoolArray = (np.bincount(stretch) * base.spacing_s >= least_s)[stretch]
    return rows


def _dataset(table: pa.Table, manifest: Manifest, folder: Path) -> Dataset:
    columns = {name: np.array(floats(table.column(name).combine_chunks())) for name in table.column_names}
    names = [name for name in CHANNELS if name in columns and name != "time"]
    time = columns["time"]
    channels = {name: columns[name] for name in names}
    own = next(name for name in THERMOMETERS if name in names)
    channels.setdefault("temperature", channels[own])
    columns |= {f"temperature{of}": columns[f"{own}{of}"] for of in ("_count", "_var") if f"{own}{of}" in columns}
    names = [*channels]
    if manifest.orientation is not None:
        channels[EARTH] = earth_rate(manifest.orientation, time, columns.get("applied_rate"))
    segment = columns["segment"] if "segment" in columns else np.full(time.shape, -1.0)
    run = Dataset(
        name=manifest.run or folder.name,
        time=time,
        channels=channels,
        segment=np.where(np.isnan(segment), -1, segment).astype(np.int64),
        segments=tuple(map(Segment.of, manifest.segments)),
        interval_s=1.0,
        corrected=manifest.corrected,
        counts={name: columns[f"{name}_count"] for name in names if f"{name}_count" in columns},
        variances={name: columns[f"{name}_var"] for name in names if f"{name}_var" in columns},
        unit="" if manifest.unit == UNKNOWN_UNIT else manifest.unit,
        output=manifest.output,
    )
    others = {name: values for name, values in channels.items() if name not in {*OUTPUTS, "applied_rate", EARTH}}
    run = _without_outliers(run, others)
    others = {name: run.channels[name] for name in others}
    between = {name: _between_readings(time, values, run.spacing_s) for name, values in others.items()}
    slow = {name: values for name, values in between.items() if values is not None}
    if not slow:
        return run
    # The steps of a thermometer are those of its readings: values between them would hide them.
    step = run.temperature_step if "temperature" in slow else None
    counts = {n: np.where(np.isfinite(v), np.maximum(run.count(n), 1.0), 0.0) for n, v in slow.items()}
    return replace(run, channels={**run.channels, **slow}, counts={**run.counts, **counts}, finer_step=step)


def _without_outliers(run: Dataset, channels: Iterable[str]) -> Dataset:
    """The run without single readings of these channels that stand out: a sensor that answers with a code of its own, a
    digit that was lost on the way.
    """
    kept, outliers = dict(run.channels), dict[str, int]()
    for name in channels:
        values, known = run.channels[name], np.isfinite(run.channels[name])
        if known.sum() < 2:
            continue
        usual = _CHANGES * float(np.quantile(np.abs(np.diff(values[known])), 0.9))
        least = max(usual, _LEAST_DEGC if CHANNELS[name].unit == "degC" else 0.0)
        out = known & ~despike(values, _STANDS_OUT, least)
        if 0 < (count := int(out.sum())) <= _FEW * len(run):
            kept[name], outliers[name] = np.where(out, np.nan, values), count
    return replace(run, channels=kept, outliers=outliers) if outliers else run


def _between_readings(time: FloatArray, values: FloatArray, spacing_s: float) -> FloatArray | None:
    """Values (n,) with those between readings, for a channel that is read regularly, but less often than every
    `spacing_s`, the distance of the rows.

    Monotone cubics (PCHIP) never leave the range of the two readings. Without them a mean would have the temperature of
    one instant, and no slope. None where every row has its reading; a reading that fails leaves a gap.
    """
    known = np.flatnonzero(np.isfinite(values))
    if not 2 <= known.size < 0.9 * values.size:
        return None
    apart_s = np.diff(time[known])
    usual_s = float(np.median(apart_s))
    if not 1.5 * spacing_s < usual_s <= _SLOWEST_READING_S:
        return None
    from scipy.interpolate import PchipInterpolator

    before = np.clip(np.searchsorted(time[known], time, side="right") - 1, 0, known.size - 2)
    near = (time >= time[known[0]]) & (time <= time[known[-1]]) & (apart_s[before] <= 2.5 * usual_s)
    between = PchipInterpolator(time[known], values[known])(time)
    return np.where(np.isfinite(values), values, np.where(near, between, np.nan))
