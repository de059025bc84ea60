"""The noise floor of runs, read where the temperature stands still: the error that the best model would leave."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bench.analysis.noise.allan import AllanCurve, allan_deviation
from bench.analysis.noise.estimate import Noise, estimate_noise
from bench.analysis.thresholds import LEAST_STRETCH_S, SETTLED_DEGC_PER_MIN, TURNING_DPS
from bench.base import FloatArray, InputError, IntArray
from bench.record import Dataset

_AHEAD_S = 60.0


@dataclass(frozen=True)
class Floor:
    """Noise of the soaks; `floor_dph` [deg/h] is NaN and `reason` says why where there is no usable soak."""

    floor_dph: float = np.nan
    noise: Noise | None = None
    curves: tuple[tuple[str, AllanCurve], ...] = ()
    stretches: tuple[tuple[str, float, float], ...] = ()
    """Name, from and to [s] of the stretches that were used."""
    reason: str = ""
    static: str = ""
    """Name of the isothermal run that it was read from; empty where it was read from the runs themselves."""


def noise_floor(runs: Sequence[Dataset], interval_s: float, static: Dataset | None = None) -> Floor:
    """Floor of means over `interval_s` of a run as long as the first, read from the isothermal run if one is given.

    All are given in rows as fine as there are (1 s means). The floor is the expected RMS about their mean of such means
    under the noise found in the soaks (N, B, K).
    """
    sources = tuple(runs) if static is None else (static,)
    stretches = [(source, name, rows) for source in sources for name, rows in _stretches(source)]
    of = "" if static is None else static.name
    if not stretches:
        still = f"isothermal stretch of at least {LEAST_STRETCH_S / 60:g} minutes to read the noise from"
        empty = not any(len(source) for source in sources)
        return Floor(reason="nothing was captured" if empty else f"no {still}", static=of)
    blocks = [_on_grid(source, rows) for source, _, rows in stretches]
    base_s = stretches[0][0].interval_s
    try:
        noise = estimate_noise(blocks, base_s)
        floor_dph = noise.std_of_means(interval_s, float(np.ptp(runs[0].time)))
        pairs = zip(stretches, blocks, strict=True)
        curves = tuple((name, allan_deviation(block, base_s)) for (_, name, _), block in pairs)
    except InputError as error:
        return Floor(reason=str(error), static=of)
    spans = tuple((name, float(source.time[rows[0]]), float(source.time[rows[-1]])) for source, name, rows in stretches)
    return Floor(floor_dph, noise, curves, spans, static=of)


def _stretches(base: Dataset) -> list[tuple[str, IntArray]]:
    """Rows of each isothermal stretch: each soak after its settling, or any stand-still where there are no segments."""
    soaks = [segment for segment in base.segments if segment.settles]
    if soaks:
        pieces = [(s.name, np.flatnonzero(base.segment == s.index)) for s in soaks]
        tails = [(name, _settled(base, rows)) for name, rows in pieces if rows.size]
    else:
        still = np.abs(np.nan_to_num(base.dT_dt, nan=np.inf)) < SETTLED_DEGC_PER_MIN
        edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]]).astype(np.int8)))
        runs = [np.arange(a, b) for a, b in edges.reshape(-1, 2).tolist()]
        tails = [(f"still at {np.nanmean(base.channel('temperature')[rows]):.0f} °C", rows) for rows in runs]
    long = [(name, rows) for name, rows in tails if rows.size and np.ptp(base.time[rows]) >= LEAST_STRETCH_S]
    return [(name, rows) for name, rows in long if not _turns(base, rows)] or long


def _turns(base: Dataset, rows: IntArray) -> bool:
    """Whether a rate table turns: then the scale factor makes every change of temperature part of the noise."""
    applied = base.channels.get("applied_rate")
    return applied is not None and bool(np.nanmax(np.abs(applied[rows]), initial=0.0) > TURNING_DPS)


def _settled(base: Dataset, rows: IntArray) -> IntArray:
    """Rows after the last fast change of temperature, at least the last half (some chambers never stop cycling)."""
    fast = np.flatnonzero(np.abs(np.nan_to_num(base.dT_dt[rows])) > SETTLED_DEGC_PER_MIN)
    # The slope looks half a window ahead: the last rows of a soak may already see the next ramp.
    inner = fast[fast < rows.size - max(round(_AHEAD_S / base.interval_s), rows.size // 20)]
    begin = int(inner[-1]) + 1 if inner.size else 0
    return rows[min(begin, rows.size // 2) :]


def _on_grid(base: Dataset, rows: IntArray) -> FloatArray:
    """Bias of the rows on an even grid of time, NaN in gaps."""
    index = np.rint((base.time[rows] - base.time[rows[0]]) / base.interval_s).astype(np.int64)
    grid = np.full(int(index[-1]) + 1, np.nan)
    grid[index] = base.bias[rows]
    return grid
