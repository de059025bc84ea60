"""Run folders of an inertial unit to the rows that are fitted: attitudes and place as the runs recorded them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from bench.analysis.imu.plan import OUTPUTS, ImuPlan, RunOptions, StaySettings
from bench.analysis.imu.rows import ImuRows, joined, rows_of
from bench.base import Document, FloatArray, InputError
from bench.record import Dataset, Manifest, refuse_mixed, seconds_of

_TOGETHER_S = 2.0
"""Segments in one attitude that follow each other within this time are one stay: nobody was asked between them."""
_APART_S = 3600.0
"""Least time between two records whose clocks do not say [s]; simulated ones may have been made at once."""


@dataclass(frozen=True, eq=False)
class ImuRuns:
    """Rows of runs of one unit; plan and channels are those of the first."""

    rows: ImuRows
    plan: ImuPlan
    columns: Mapping[str, FloatArray]
    unit: str


def rows_of_runs(folders: Sequence[Path], options: RunOptions) -> ImuRuns:
    """Rows of one or more runs of a unit.

    InputError where a run names no attitudes, contradicts the others, or gravity contradicts it.
    """
    records = [seconds_of(folder) for folder in folders]
    manifests = [Manifest.read(folder) for folder in folders]
    refuse_mixed(records)
    plans: list[ImuPlan] = []
    parts: list[ImuRows] = []
    later: list[float] = []
    for folder, record, manifest in zip(folders, records, manifests, strict=True):
        if record.corrected:
            raise InputError("the unit corrected its outputs itself: nothing can be fitted to them", folder)
        plans.append(_plan(folder, record, manifest, options))
        parts.append(rows_of(columns_of(record), plans[-1], Document(str(folder), {}, {})))
        begun = _began_s(manifests[0], manifest)
        ended = later[-1] + float(records[len(later) - 1].time[-1]) if later else None
        later.append(begun if ended is None else max(begun, ended + _APART_S))
    places = sorted({plan.latitude_deg for plan in plans})
    if len(places) > 1:
        stated = ", ".join(f"{place:g}" for place in places)
        raise InputError(f"the runs are from latitudes {stated}; give runs of one place, or latitude_deg in a plan")
    rows = joined(parts, later) if len(parts) > 1 else parts[0]
    return ImuRuns(rows, plans[0], columns_of(records[0]), records[0].unit)


def columns_of(record: Dataset) -> Mapping[str, FloatArray]:
    """The channels of a run beside its time, (n,) each."""
    return {"time": record.time, **record.channels}


def _plan(folder: Path, record: Dataset, manifest: Manifest, options: RunOptions) -> ImuPlan:
    stays: list[StaySettings] = []
    for segment in manifest.segments:
        name, from_s, to_s = segment.attitude, segment.from_s, segment.to_s
        if name is None or not to_s > from_s:
            continue
        if stays and stays[-1].attitude == name and from_s - stays[-1].to_s <= _TOGETHER_S:
            from_s = stays.pop().from_s
        stays.append(StaySettings(from_s=from_s, to_s=to_s, attitude=name, heading_deg=segment.heading_deg))
    if not stays:
        text = "names no attitudes: run a profile with `attitude`, or give a table and a plan that says them"
        raise InputError(text, folder)
    latitude = manifest.latitude_deg if options.latitude_deg is None else options.latitude_deg
    if latitude is None:
        raise InputError(
            "states no latitude: put latitude_deg into a plan, or into `orientation` of its station", folder
        )
    given = options.model_dump(include=options.model_fields_set - {"latitude_deg", "orders"})
    known = {} if manifest.gyro is None else manifest.gyro.thermometers
    for kind, names in OUTPUTS.items():
        if known:
            given.setdefault(f"{kind}_thermometers", tuple(known.get(name, "temperature") for name in names))
    return ImuPlan(latitude_deg=latitude, stays=tuple(stays), orders=options.orders, **given)


def _began_s(first: Manifest, other: Manifest) -> float:
    """Calendar time between the beginnings of two runs [s]; 0 where they do not say."""
    if not first.created or not other.created:
        return 0.0
    return (datetime.fromisoformat(other.created) - datetime.fromisoformat(first.created)).total_seconds()
