"""A run on one time base: what effects, fits and figures see."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from bench.base import CHANNELS, DPH_PER_DPS, OUTPUTS, RATES, BoolArray, FloatArray, InputError, IntArray
from bench.record.earth import EARTH
from bench.record.records.manifest import ExecutedSegment

STILL_DEGC_PER_MIN = 0.05
"""Slower than this the temperature counts as constant [degC/min]."""
_SLOPE_WINDOW_S = 60.0


@dataclass(frozen=True)
class Segment:
    """One piece of a run between two commands: a ramp, a soak, a step."""

    index: int
    name: str
    kind: str = ""
    from_s: float = np.nan
    to_s: float = np.nan
    direction: str = ""
    target: float | None = None
    rate: float | None = None
    turn_on: int = 1
    """Which turn-on of the run it belongs to."""
    attitude: str | None = None
    """Name of the attitude that the unit stood in; None: nobody said."""

    @property
    def settles(self) -> bool:
        """Whether the temperature comes to stand still in it: a soak, or a step and its rest."""
        return self.direction == "constant" or self.kind in {"soak", "step"}

    @classmethod
    def of(cls, entry: ExecutedSegment) -> Segment:
        """As the manifest lists it."""
        return cls(
            index=entry.index,
            name=entry.name,
            kind=entry.kind,
            from_s=entry.from_s,
            to_s=entry.to_s,
            direction=entry.direction,
            target=entry.target_degc,
            rate=entry.rate_degc_per_min,
            turn_on=entry.turn_on,
            attitude=entry.attitude,
        )


@dataclass(frozen=True, eq=False)
class Finer:
    """Rows that a record averages: `first` (m,) is the row that each belonged to when they were averaged."""

    record: Dataset
    first: IntArray
    then: tuple[IntArray, ...] = ()
    """What became of the rows since: -1 where they are gone."""

    @cached_property
    def row(self) -> IntArray:
        """Row of the record that each belongs to (m,), -1 for none."""
        row = self.first
        for rows in self.then:
            row = np.where(row >= 0, rows[row], -1)
        return row

    def to(self, rows: IntArray) -> Finer:
        """The same for a record whose row i became `rows[i]`, -1 where it is gone."""
        return Finer(self.record, self.first, (*self.then, rows))


class Disturbance(NamedTuple):
    """Rows of a run between two times [s] that stand out by `height_dph` [deg/h]."""

    from_s: float
    to_s: float
    height_dph: float


class Jump(NamedTuple):
    """A jump of the bias by `height_dph` [deg/h] at a time of a run [h]; one that fades, or returns, lasts [s]."""

    at_h: float
    then: str
    lasts_s: float
    height_dph: float


@dataclass(frozen=True, eq=False)
class Dataset:
    """Channels of one run on one time base, shape (n,) each; NaN is a gap.

    `counts` says how many samples stand behind each value, `variances` how they scatter; both may lack a channel that
    was never sampled faster (an imported table): its count is then 1 where it has a value.
    """

    name: str
    time: FloatArray
    channels: Mapping[str, FloatArray]
    segment: IntArray
    segments: tuple[Segment, ...] = ()
    interval_s: float = 1.0
    counts: Mapping[str, FloatArray] = field(default_factory=dict)
    variances: Mapping[str, FloatArray] = field(default_factory=dict)
    corrected: bool = False
    """Whether the unit corrected its rate itself while this was recorded: nothing may be fitted to it."""
    finer_step: float | None = None
    """`temperature_step` of the finer record that this one averages."""
    finer_rate_step: float | None = None
    """`rate_step` of the same."""
    unit: str = ""
    """Serial number of the unit; empty where it is not known."""
    finer: Finer | None = field(default=None, repr=False)
    """The rows that this record averages."""
    output: str = "rate"
    """Which output of the unit `rate` is."""
    outliers: Mapping[str, int] = field(default_factory=dict)
    """Single readings of a channel that stood out, and were left out when the run was read."""
    disturbed: tuple[Disturbance, ...] | None = None
    """Stretches that stood out, of which the rate was left out; None before anybody looked for them."""
    jump: Jump | None = None
    """A jump that a check run has for itself, where one was looked for and found."""
    moved: frozenset[str] = frozenset()
    """Channels that were replaced since: their finer rows are of another channel."""

    def __post_init__(self) -> None:
        columns = {**self.channels, "segment": self.segment}
        for name, column in columns.items():
            if column.shape != self.time.shape:
                raise InputError(f"{self.name}: '{name}' has {column.size} rows, time has {self.time.size}")
        if np.any(np.diff(self.time) <= 0):
            raise InputError(f"{self.name}: time runs backwards or stands still")

    def __len__(self) -> int:
        return int(self.time.size)

    def has(self, name: str) -> bool:
        """Whether there is at least one value of this channel."""
        return name in self.channels and bool(np.any(np.isfinite(self.channels[name])))

    def channel(self, name: str) -> FloatArray:
        """Values of one channel (n,); InputError that names it where the run has none."""
        if name == "time":
            return self.time
        if not self.has(name):
            have = ", ".join(sorted(filter(self.has, self.channels)))
            if name == "rate" and len(self.outputs) > 1:
                rates = ", ".join(one for one in self.outputs if one in RATES)
                raise InputError(
                    f"{self.name}: the unit has {len(self.outputs)} outputs; choose one of {rates} with --output"
                )
            unit = f" [{CHANNELS[name].unit}]" if name in CHANNELS else ""
            raise InputError(f"{self.name}: channel '{name}'{unit} is missing; the run has {have}")
        return self.channels[name]

    def count(self, name: str) -> FloatArray:
        """Samples behind each value of a channel (n,), 0 in gaps."""
        if name in self.counts:
            return self.counts[name]
        return np.isfinite(self.channel(name)).astype(np.float64)

    @property
    def outputs(self) -> tuple[str, ...]:
        """What the unit measures: `rate`, or rates and accelerations by axis."""
        return tuple(name for name in OUTPUTS if name in self.channels)

    def of(self, output: str) -> Dataset:
        """The same with one output as its `rate`, without the others; InputError for one that is no rate."""
        if output not in self.outputs or output not in RATES:
            rates = ", ".join(name for name in self.outputs if name in RATES)
            raise InputError(f"{self.name}: '{output}' is not a rate of this unit; choose one of {rates} with --output")
        gone = set(self.outputs) - {output}

        def chosen(columns: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
            return {"rate" if name == output else name: column for name, column in columns.items() if name not in gone}

        return replace(
            self, channels=chosen(self.channels), counts=chosen(self.counts), variances=chosen(self.variances),
            output=output,
        )  # fmt: skip

    @cached_property
    def own_rate(self) -> FloatArray:
        """Rate without what the Earth turned along the axis, where the orientation is stated [deg/h], (n,)."""
        rate, earth = self.channel("rate"), self.channels.get(EARTH)
        return rate if earth is None else rate - earth

    @cached_property
    def bias(self) -> FloatArray:
        """Zero-rate output: rate minus what the rate table and, where it is known, the Earth turned [deg/h], (n,)."""
        rate = self.own_rate
        applied = self.channels.get("applied_rate")
        if applied is None or not np.any(np.isfinite(applied)):
            return rate
        return rate - DPH_PER_DPS * applied

    @cached_property
    def turn_on(self) -> IntArray:
        """Which turn-on of the run each row (n,) belongs to, from 1; rows between segments: that of the one before."""
        numbers = np.maximum.accumulate([1, *(segment.turn_on for segment in self.segments)])
        last = np.maximum.accumulate(np.maximum(self.segment, -1)) if len(self) else self.segment
        return np.asarray(numbers[last + 1], dtype=np.int64)

    @cached_property
    def dT_dt(self) -> FloatArray:  # noqa: N802 - the symbol of the papers
        """Slope of the unit's own temperature, central over about a minute [degC/min], (n,)."""
        temperature = self.channel("temperature")
        half = max(1, round(_SLOPE_WINDOW_S / self.interval_s / 2))
        rows = np.arange(len(self))
        before, after = np.maximum(rows - half, 0), np.minimum(rows + half, len(self) - 1)
        if len(self) < 2:
            return np.full(len(self), np.nan)
        return 60.0 * (temperature[after] - temperature[before]) / (self.time[after] - self.time[before])

    @cached_property
    def direction(self) -> IntArray:
        """+1 heating, -1 cooling, 0 constant or unknown (n,): from the slope here and now, without memory."""
        slope = np.nan_to_num(self.dT_dt)
        return np.where(np.abs(slope) < STILL_DEGC_PER_MIN, 0, np.sign(slope)).astype(np.int64)

    @cached_property
    def temperature_step(self) -> float:
        """Step of the temperature sensor [degC], 0 where its values look continuous.

        Averages hide it, so they remember what the finest record showed.
        """
        return self._step("temperature") if self.finer_step is None else self.finer_step

    @cached_property
    def rate_step(self) -> float:
        """Step of the output [deg/h] that no noise within a row blurs, 0 where its values look continuous."""
        return self._step("rate") if self.finer_rate_step is None else self.finer_rate_step

    def _step(self, name: str) -> float:
        """Rows whose samples did not scatter show a converter's codes; the step is their smallest distance, if all
        others are multiples of it.
        """
        value = self.channel(name)
        scatter = self.variances.get(name, np.full(len(self), np.nan))
        known = np.isfinite(value)
        raw = value[known & ~(scatter > 0.0)]
        codes = np.unique(np.round(raw, 9))
        if raw.size < max(4, 0.1 * np.count_nonzero(known)) or codes.size < 2 or codes.size > 0.5 * raw.size:
            return 0.0
        step = float(np.diff(codes).min())
        multiples = np.diff(codes) / step
        return step if np.all(np.abs(multiples - np.round(multiples)) < 0.02 * np.maximum(multiples, 1.0)) else 0.0

    def mean_of(self, product: Callable[[Mapping[str, FloatArray]], FloatArray], *names: str) -> FloatArray:
        """Mean over each row (n,) of a product of channels, formed on the finer rows where they are kept.

        The square of a mean is not the mean of a square: a rate that steps within 30 s is squared before averaging.
        """
        coarse = {name: self.channel(name) for name in names}
        if self.finer is None:
            return product(coarse)
        inside = self.finer.row >= 0
        row, fine = self.finer.row[inside], self.finer.record
        values = {n: coarse[n][row] if n in self.moved else fine.channel(n)[inside] for n in names}
        formed = product(values)
        weight = np.where(np.isfinite(formed), fine.count("rate")[inside], 0.0)
        total = np.bincount(row, weight, len(self))
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(np.bincount(row, weight * np.nan_to_num(formed), len(self)) / total)

    def select(self, mask: BoolArray) -> Dataset:
        """Only the rows of `mask` (n,). Effects with memory want the whole record: mask after, not before."""
        return replace(
            self,
            time=self.time[mask],
            channels={name: column[mask] for name, column in self.channels.items()},
            segment=self.segment[mask],
            counts={name: column[mask] for name, column in self.counts.items()},
            variances={name: column[mask] for name, column in self.variances.items()},
            finer=None if self.finer is None else self.finer.to(np.where(mask, np.cumsum(mask) - 1, -1)),
        )

    def with_channel(self, name: str, values: FloatArray) -> Dataset:
        """The same record with one channel replaced or added (an effect that moves the abscissa uses it)."""
        return replace(self, channels={**self.channels, name: values}, moved=self.moved | {name})

    @property
    def spacing_s(self) -> float:
        """Usual distance of the rows [s]: a slow table of somebody else has less than one a second."""
        return (
            max(self.interval_s, round(float(np.median(np.diff(self.time))), 3)) if len(self) > 1 else self.interval_s
        )

    def average(self, interval_s: float) -> Dataset:
        """Means over about `interval_s` [s]: each stretch of one segment is cut into equal bins, none across its end.

        Equal bins keep the rows evenly spaced, which a covariance over time needs. Means are weighted by counts;
        counts add; variances are those of all samples inside. A gap shrinks the count, an empty bin is no row, a
        channel without a sample in a bin is NaN there. Rows that are further apart stay as they are, each a mean over
        their distance. Raises InputError below the base.
        """
        if not interval_s >= self.interval_s * (1 - 1e-9):
            raise InputError(f"{self.name}: cannot average over {interval_s:g} s, its rows are {self.interval_s:g} s")
        if len(self) == 0 or np.isclose(interval_s, self.interval_s):
            return self
        stretch = np.cumsum(np.diff(self.segment, prepend=self.segment[:1]) != 0)
        firsts = np.flatnonzero(np.diff(stretch, prepend=-1))
        lasts = np.append(firsts[1:], len(self)) - 1
        spacing_s = self.spacing_s
        begin = self.time[firsts] - spacing_s / 2
        length = self.time[lasts] + spacing_s / 2 - begin
        # Rounding guards: a border that falls on a row's edge belongs to the same bin on every machine.
        bins = np.maximum(np.floor(length / interval_s + 0.5 + 1e-9), 1.0)
        step = np.floor((self.time - spacing_s / 2 - begin[stretch]) / (length / bins)[stretch] + 1e-9)
        starts = np.flatnonzero((np.diff(stretch, prepend=-1) != 0) | (np.diff(step, prepend=-1) != 0))
        group = np.repeat(np.arange(starts.size), np.diff(np.append(starts, len(self))))
        rows = np.bincount(group)
        pooled = {name: self._pool(name, starts, group) for name in self.channels}
        return replace(
            self,
            time=np.add.reduceat(self.time, starts) / rows,
            channels={name: mean for name, (mean, _, _) in pooled.items()},
            counts={name: count for name, (_, count, _) in pooled.items()},
            variances={name: variance for name, (_, _, variance) in pooled.items()},
            segment=self.segment[starts],
            interval_s=max(float(interval_s), spacing_s),
            finer_step=self.temperature_step,
            finer_rate_step=self.rate_step if "rate" in self.channels else None,
            finer=Finer(self, group) if self.finer is None else self.finer.to(group),
        )

    def _pool(self, name: str, starts: IntArray, group: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        value = self.channels[name]
        present = np.isfinite(value)
        count = np.where(present, self.counts.get(name, present.astype(np.float64)), 0.0)
        inner = np.nan_to_num(self.variances.get(name, np.zeros(len(self)))) * np.maximum(count - 1, 0)
        filled = np.where(present, value, 0.0)
        total = np.add.reduceat(count, starts)
        with np.errstate(invalid="ignore", divide="ignore"):
            # About the bin's first value: a 14 kHz frequency keeps its last digits.
            offset = filled[starts]
            mean = offset + np.add.reduceat(count * (filled - offset[group]), starts) / total
            square = np.add.reduceat(inner + count * np.where(present, filled - mean[group], 0.0) ** 2, starts)
            return mean, total, np.where(total > 1, square / (total - 1), np.nan)


def refuse_mixed(records: Iterable[Dataset]) -> None:
    """InputError where records are of different units, as a fit to several is a fit of none, or where one is twice."""
    kept = tuple(records)
    units = sorted({record.unit for record in kept} - {""})
    if len(units) > 1:
        raise InputError(
            f"the runs are of {len(units)} units ({', '.join(units)}), which one fit does not describe: give runs of "
            "one unit, compare two with `bench diff A B`, or ask for one fit to the whole lot with --lot"
        )
    refuse_twice(kept)


def refuse_twice(records: Iterable[Dataset]) -> None:
    """InputError where two records are one recording: fitted twice it weighs double, as a check it judges itself."""
    known: dict[bytes, Dataset] = {}
    for one in records:
        rates = b"".join(one.channels[name].tobytes() for name in RATES if name in one.channels)
        other = known.setdefault(rates, one)
        if other is not one and len(one) > 1:
            raise InputError(
                f"{other.name} and {one.name} are the same recording: give each run once, and as a check run or an "
                "isothermal run one that is not fitted"
            )
