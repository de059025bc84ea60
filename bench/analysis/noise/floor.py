"""The noise floor of runs, read where the temperature stands still: the error that the best model would leave."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bench.analysis.noise.allan import AllanCurve, allan_deviation
from bench.analysis.noise.components import Stretch
from bench.analysis.noise.estimate import Estimate, Noise, estimate_noise
from bench.analysis.noise.lines import Line, without_lines
from bench.analysis.noise.spikes import spiky
from bench.analysis.noise.turning import at_rest
from bench.analysis.thresholds import CYCLES_DEGC, LEAST_STRETCH_S, SETTLED_DEGC_PER_MIN, TURNING_DPS
from bench.base import BoolArray, FloatArray, InputError, IntArray, number
from bench.record import Dataset

_AHEAD_S = 60.0
_LEAST_SHARE = 0.25
"""Of the longest stretch: a short one beside a long one tells little of slow noise, and thermal tails pass for it."""


@dataclass(frozen=True)
class Floor:
    """Noise of the soaks; `floor_dph` [deg/h] is NaN and `reason` says why where there is no usable soak.

    The floor is the expected RMS about their mean of means over `interval_s` of a run of `duration_s`, from the noise
    that the soaks determine; its 95 % interval also has what they leave open of flicker and random walk.
    """

    floor_dph: float = np.nan
    noise: Noise | None = None
    curves: tuple[tuple[str, AllanCurve], ...] = ()
    stretches: tuple[tuple[str, float, float], ...] = ()
    """Name, from and to [s] of the stretches that were used."""
    reason: str = ""
    static: str = ""
    """Name of the isothermal run that it was read from; empty where it was read from the runs themselves."""
    interval_dph: tuple[float, float] = (np.nan, np.nan)
    duration_s: float = np.nan
    """Length of the run that it is expected in: slow noise moves a long run further."""
    estimate: Estimate | None = None
    lines: tuple[Line, ...] = ()
    """Sinusoids of the stretch that has the largest: they are no noise, and are not in it."""

    spikes: int = 0
    """Means that stand out of all others: they are no noise, and are not in it."""

    @property
    def notes(self) -> tuple[str, ...]:
        """A sentence for each of the sinusoids, and one for the spikes."""
        left_out = (f"{self.spikes} means with spikes are not counted as noise",) if self.spikes else ()
        return left_out + tuple(
            f"a sinusoid of {number(line.amplitude_dph)} deg/h with a period of {number(line.period_s, 4)} s is not "
            "counted as noise: vibration, a beat or a control loop"
            for line in self.lines
        )


def noise_floor(
    runs: Sequence[Dataset], interval_s: float, static: Dataset | None = None, *, intervals: bool = True
) -> Floor:
    """Floor of means over `interval_s` of a run as long as the first, read from the isothermal run if one is given.

    Rows of the first run that are further apart are means over their distance. All are given in rows as fine as there
    are (1 s means). `intervals` takes half a second more.
    """
    sources = tuple(runs) if static is None else (static,)
    turning = static is not None
    stretches = [(source, name, rows) for source in sources for name, rows in _stretches(source, turning)]
    of = "" if static is None else static.name
    if not stretches:
        turned = any(len(source) and _turns(source, np.arange(len(source))) for source in sources)
        still = f"isothermal stretch of at least {LEAST_STRETCH_S / 60:g} minutes{' at one rate' if turned else ''}"
        still += " to read the noise from"
        empty = not any(len(source) for source in sources)
        return Floor(reason="nothing was captured" if empty else f"no {still}", static=of)
    longest = max(rows.size for _, _, rows in stretches)
    stretches = [one for one in stretches if one[2].size >= _LEAST_SHARE * longest]
    base_s, duration_s = stretches[0][0].spacing_s, float(np.ptp(runs[0].time))
    interval_s = max(interval_s, runs[0].spacing_s)
    per_mean = max(1, round(interval_s / base_s))
    pieces = [_on_grid(source, rows) for source, _, rows in stretches]
    quiet, lines = zip(*(without_lines(piece.rate, base_s) for piece in pieces), strict=True)
    spikes = [spiky(rate, per_mean, base_s) for rate in quiet]
    try:
        parts = zip(pieces, quiet, spikes, strict=True)
        estimate = estimate_noise([replace(p, rate=rate).without(gone) for p, rate, gone in parts], base_s)
        pairs = zip(stretches, pieces, strict=True)
        curves = tuple((name, allan_deviation(piece.rate, base_s)) for (_, name, _), piece in pairs)
    except InputError as error:
        return Floor(reason=str(error), static=of)
    spans = tuple((name, float(source.time[rows[0]]), float(source.time[rows[-1]])) for source, name, rows in stretches)
    floor_dph = estimate.noise.std_of_means(interval_s, duration_s)
    found = Floor(
        floor_dph, estimate.noise, curves, spans, static=of, estimate=estimate, duration_s=duration_s,
        lines=max(lines, key=lambda own: max((line.amplitude_dph for line in own), default=0.0)),
        spikes=round(sum(int(gone.sum()) for gone in spikes) / per_mean),
    )  # fmt: skip
    if not intervals:
        return found
    return replace(found, noise=estimate.with_intervals(), interval_dph=estimate.floor_interval(interval_s, duration_s))


def _stretches(base: Dataset, turning: bool) -> list[tuple[str, IntArray]]:
    """Rows of each isothermal stretch: each soak after its settling, or any stand-still where there are no segments.

    A run of which the temperature cycles about one value is a single stretch. With `turning` a table may change its
    rate in all of them: an isothermal run is long enough to tell the error of the scale factor from noise.
    """
    soaks = [segment for segment in base.segments if segment.settles]
    if soaks:
        pieces = [(s.name, np.flatnonzero(base.segment == s.index)) for s in soaks]
        tails = [(name, _settled(base, rows)) for name, rows in pieces if rows.size]
    else:
        runs = [np.arange(a, b) for a, b in stretches_of(_still(base))]
        if 2 * max(map(len, runs), default=0) < len(base) and _cycles(base):
            runs = [np.arange(len(base))]
        tails = [(f"still at {np.nanmean(base.channel('temperature')[rows]):.0f} °C", rows) for rows in runs]
    long = [(name, rows) for name, rows in tails if rows.size and np.ptp(base.time[rows]) >= LEAST_STRETCH_S]
    resting = [(name, rows) for name, rows in long if not _turns(base, rows)]
    at_one_rate = resting or [(name, rows) for name, rows in long if not _changes(base, rows)]
    return at_one_rate or (long if turning else [])


def stretches_of(flags: BoolArray) -> list[tuple[int, int]]:
    """First row, and the row after the last, of each stretch of true flags (n,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return [(first, end) for first, end in edges.reshape(-1, 2).tolist()]


def _turns(base: Dataset, rows: IntArray) -> bool:
    """Whether a rate table turns: then the scale factor makes every change of temperature part of the noise."""
    applied = base.channels.get("applied_rate")
    return applied is not None and bool(np.nanmax(np.abs(applied[rows]), initial=0.0) > TURNING_DPS)


def _changes(base: Dataset, rows: IntArray) -> bool:
    """Whether the rate of a table changes: then the error of the scale factor passes for noise."""
    applied = base.channels["applied_rate"][rows]
    return bool(np.ptp(applied[np.isfinite(applied)]) > TURNING_DPS)


def _still(base: Dataset) -> BoolArray:
    return np.abs(np.nan_to_num(base.dT_dt, nan=np.inf)) < SETTLED_DEGC_PER_MIN


def _cycles(base: Dataset) -> bool:
    """Whether the temperature stays about one value and does not stand still."""
    temperature = base.channel("temperature")
    known = temperature[np.isfinite(temperature)]
    return bool(known.size) and float(np.ptp(known)) <= CYCLES_DEGC


def _settled(base: Dataset, rows: IntArray) -> IntArray:
    """Rows after the last fast change of temperature, at least the last half (some chambers never stop cycling)."""
    fast = np.flatnonzero(np.abs(np.nan_to_num(base.dT_dt[rows])) > SETTLED_DEGC_PER_MIN)
    # The slope looks half a window ahead: the last rows of a soak may already see the next ramp.
    inner = fast[fast < rows.size - max(round(_AHEAD_S / base.interval_s), rows.size // 20)]
    begin = int(inner[-1]) + 1 if inner.size else 0
    return rows[min(begin, rows.size // 2) :]


def _on_grid(base: Dataset, rows: IntArray) -> Stretch:
    """Bias of the rows on an even grid of time, NaN in gaps, and how the samples behind each row scatter.

    Where the whole run cycles about its temperature, what follows that and its slope is no noise.
    """
    index = np.rint((base.time[rows] - base.time[rows[0]]) / base.spacing_s).astype(np.int64)

    def grid(values: FloatArray) -> FloatArray:
        column = np.full(int(index[-1]) + 1, np.nan)
        column[index] = values[rows]
        return column

    variances = base.variances.get("rate")
    counts = None if variances is None else grid(base.count("rate"))
    bias = at_rest(base, rows).bias
    if rows.size == len(base) and not _still(base).all():
        moving = np.column_stack([base.channel("temperature"), base.dT_dt])
        known = rows[np.isfinite(bias[rows]) & np.isfinite(moving[rows]).all(axis=1)]
        if known.size:
            moving = np.nan_to_num(moving - moving[known].mean(axis=0))
            bias = bias - moving @ np.linalg.lstsq(moving[known], bias[known] - bias[known].mean())[0]
    return Stretch(grid(bias), counts, None if variances is None else grid(variances))
