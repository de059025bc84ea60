"""Samples of an inertial unit to the rows that are fitted: means of equal length within the stays of a plan."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bench.analysis.imu.attitudes import Stay, inputs
from bench.analysis.imu.mounting import outputs_of
from bench.analysis.imu.plan import OUTPUTS, ImuPlan
from bench.analysis.imu.triad import MOST_ROWS, Triad
from bench.base import Document, FloatArray, InputError, IntArray
from bench.record import WRONG_DEG, Dataset, nearest_attitude, off_deg

STEADY_DPS = 0.1
"""A table whose rate scatters by more than this within a row accelerates."""
_HISTORY_S = 10.0


@dataclass(frozen=True, eq=False)
class ImuRows:
    """Both triads in rows, and how many rows were left out because the table changed its rate or samples lacked."""

    gyro: Triad
    accelerometer: Triad
    left_out: int


def rows_of(columns: Mapping[str, FloatArray], plan: ImuPlan, document: Document) -> ImuRows:
    """Rows of the channels (n,) of a table; InputError names a channel that lacks, or the line of a wrong attitude."""
    time = _channel(columns, "time")
    if np.any(np.diff(time) <= 0.0):
        raise InputError("time runs backwards or stands still")
    names = [*OUTPUTS["gyro"], *OUTPUTS["accelerometer"]]
    thermometers = [*plan.thermometers("gyro"), *plan.thermometers("accelerometer")]
    values = np.stack([_channel(columns, name) for name in (*names, *thermometers)], axis=1)
    turning = columns.get("applied_rate", np.zeros(len(time)))
    angle = _angle(columns, time, turning)
    row, visit, starts = _cut(time, turning, plan)
    if not len(starts):
        raise InputError(f"no stay is as long as a row of {plan.row_s:g} s; lower row_s", document.file)
    means, sound = _means(np.column_stack([values, angle, turning]), row, len(starts), time, plan.row_s)
    if np.sum(sound) > MOST_ROWS:
        longer = plan.row_s * np.sum(sound) / MOST_ROWS
        raise InputError(
            f"row_s is {plan.row_s:g}: {np.sum(sound)} rows, allowed are {MOST_ROWS}; raise it to {longer:.0f} or more",
            document.file, document.line(("row_s",)),
        )  # fmt: skip
    if not sound.any():
        raise InputError("no row has all its samples and a steady table; look at gaps and applied_rate", document.file)
    placed = [stay.placed for stay in plan.stays]
    chosen = [placed[i] for i in visit[sound]]
    stay = Stay(np.array([a.matrix for a in chosen]), means[sound, 12], means[sound, 13], plan.row_s)
    middle = starts[sound] + 0.5 * plan.row_s
    triads = _triads(plan, means[sound], middle, stay, visit[sound], _histories(time, values))
    _refuse_wrong_attitudes(triads[1], plan, document)
    return ImuRows(*triads, int(np.sum(~sound)))


def _angle(columns: Mapping[str, FloatArray], time: FloatArray, turning: FloatArray) -> FloatArray:
    """Of the table (n,) [deg] since the first sample: as its encoder says, else between samples by their mean rate."""
    if (own := columns.get("table_angle")) is not None and np.isfinite(own).any():
        return np.asarray(own - own[np.isfinite(own)][0])
    steps = np.diff(time, prepend=time[0]) * 0.5 * (turning + np.concatenate([turning[:1], turning[:-1]]))
    return np.cumsum(np.nan_to_num(steps))


def _channel(columns: Mapping[str, FloatArray], name: str) -> FloatArray:
    if name not in columns:
        raise InputError(f"channel '{name}' is missing; the table has {', '.join(sorted(columns))}")
    return columns[name]


def _cut(time: FloatArray, turning: FloatArray, plan: ImuPlan) -> tuple[IntArray, IntArray, FloatArray]:
    """Row of each sample (n,), -1 for none; stay and start [s] of each row.

    A row begins again after the table has changed its rate, so that what a stay lasts beyond that is not lost.
    """
    row = np.full(len(time), -1, dtype=np.int64)
    visit: list[int] = []
    starts: list[float] = []
    half = 0.5 * float(np.median(np.diff(time))) if len(time) > 1 else 0.0
    for number, stay in enumerate(plan.stays):
        start = stay.from_s
        while start + plan.row_s <= stay.to_s + 1e-6:
            first, last = np.searchsorted(time, [start, start + plan.row_s - 1e-6])
            changed = np.abs(turning[first:last] - turning[last - 1 : last]) > STEADY_DPS
            if changed.any():
                start = float(time[first + int(np.flatnonzero(changed)[-1]) + 1]) - half
                continue
            row[first:last] = len(starts)
            visit.append(number)
            starts.append(start)
            start += plan.row_s
    return row, np.array(visit, dtype=np.int64), np.array(starts)


def _means(
    values: FloatArray, row: IntArray, rows: int, time: FloatArray, row_s: float
) -> tuple[FloatArray, np.ndarray[tuple[int], np.dtype[np.bool_]]]:
    """Means (rows, k) and which rows have their samples and a steady table (last column)."""
    inside = (row >= 0) & np.isfinite(values).all(axis=1)
    where, own = row[inside], values[inside]
    count = np.bincount(where, minlength=rows)
    sums = np.stack([np.bincount(where, own[:, k], rows) for k in range(values.shape[1])], axis=1)
    means = sums / np.maximum(count, 1)[:, None]
    apart = np.zeros(rows)
    np.maximum.at(apart, where, np.abs(own[:, -1] - means[where, -1]))
    expected = row_s / float(np.median(np.diff(time)))
    return means, np.asarray((count >= 0.99 * expected) & (apart <= STEADY_DPS))


def _histories(time: FloatArray, values: FloatArray) -> tuple[Dataset, ...]:
    """Temperature of each of the six axes over the whole record, about every ten seconds."""
    step = max(1, round(_HISTORY_S / float(np.median(np.diff(time)))))
    some, segment = time[::step], np.zeros(len(time[::step]), dtype=np.int64)
    return tuple(
        Dataset("imu", some, {"temperature": values[::step, 6 + k]}, segment, interval_s=_HISTORY_S) for k in range(6)
    )


def _triads(
    plan: ImuPlan, means: FloatArray, middle: FloatArray, stay: Stay, visit: IntArray, histories: tuple[Dataset, ...]
) -> tuple[Triad, Triad]:
    rate, force = inputs(stay, plan.latitude_deg, plan.gravity)
    common = (rate, force, stay, visit, _numbered(stay), plan.row_s)
    gyro = Triad("gyro", middle, means[:, :3], means[:, 6:9], *common, histories[:3])
    return gyro, Triad("accelerometer", middle, means[:, 3:6], means[:, 9:12], *common, histories[3:])


def _numbered(stay: Stay) -> IntArray:
    """The same number (n,) for the same attitude."""
    flat = np.round(stay.attitude.reshape(len(stay.attitude), 9), 6)
    return np.unique(flat, axis=0, return_inverse=True)[1].reshape(-1).astype(np.int64)


def joined(parts: Sequence[ImuRows], later_s: Sequence[float]) -> ImuRows:
    """Rows of several records of a unit as those of one; `later_s` is when each of them began [s]."""
    visits = np.cumsum([0, *(int(part.gyro.visit.max()) + 1 for part in parts)])
    triads = []
    for kind in ("gyro", "accelerometer"):
        own: list[Triad] = [getattr(part, kind) for part in parts]

        def together(name: str, own: list[Triad] = own) -> FloatArray:
            return np.concatenate([getattr(one, name) for one in own])

        stays = [one.stay for one in own]
        stay = Stay(
            np.concatenate([one.attitude for one in stays]), np.concatenate([one.angle_deg for one in stays]),
            np.concatenate([one.rate_dps for one in stays]), stays[0].interval_s,
        )  # fmt: skip
        triads.append(
            Triad(
                own[0].kind,
                np.concatenate([one.time + later for one, later in zip(own, later_s, strict=True)]),
                together("output"),
                together("temperature"),
                together("rate"),
                together("force"),
                stay,
                np.concatenate([one.visit + first for one, first in zip(own, visits, strict=False)]),
                _numbered(stay),
                own[0].interval_s,
                tuple(_after([one.history[k] for one in own], later_s) for k in range(3)),
            )
        )
    return ImuRows(triads[0], triads[1], sum(part.left_out for part in parts))


def _after(records: Sequence[Dataset], later_s: Sequence[float]) -> Dataset:
    time = np.concatenate([one.time + later for one, later in zip(records, later_s, strict=True)])
    warm = np.concatenate([one.channels["temperature"] for one in records])
    return replace(
        records[0], time=time, channels={"temperature": warm}, segment=np.zeros(len(time), dtype=np.int64)
    )  # fmt: skip


def _refuse_wrong_attitudes(accelerometer: Triad, plan: ImuPlan, document: Document) -> None:
    """InputError where gravity says that single stays had another attitude; outputs that are swapped are no such."""
    seen = accelerometer.output @ outputs_of(accelerometer)
    apart = off_deg(accelerometer.stay.attitude[:, :, 2], seen)
    wrong = np.unique(accelerometer.visit[apart > WRONG_DEG])
    if not len(wrong):
        return
    number = int(wrong[0])
    row = int(np.flatnonzero(accelerometer.visit == number)[0])
    stay, like = plan.stays[number], nearest_attitude(seen[row])
    more = f"; so do {len(wrong) - 1} more stays" if len(wrong) > 1 else ""
    raise InputError(
        f"stay from {stay.from_s:g} to {stay.to_s:g} s: attitude {stay.placed.name} is stated, but gravity is "
        f"{apart[row]:.0f} deg from there, as in {like.name}{more}; correct the plan or measure again",
        document.file, document.line(("stays", number)),
    )  # fmt: skip
