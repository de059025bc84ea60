"""The noise floor of a run, from its own isothermal stretches: what the best possible model would leave."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.channels import FloatArray, IntArray
from bench.dataset import STILL_DEGC_PER_MIN, Dataset
from bench.errors import InputError
from bench.noise import AllanCurve, Noise, allan_deviation, estimate_noise

_SETTLED_DEGC_PER_MIN = 2 * STILL_DEGC_PER_MIN
_LEAST_S = 300.0


@dataclass(frozen=True)
class Floor:
    """Noise of the soaks; `floor_dph` [deg/h] is NaN and `reason` says why where the run has no usable soak."""

    floor_dph: float = np.nan
    noise: Noise | None = None
    curves: tuple[tuple[str, AllanCurve], ...] = ()
    stretches: tuple[tuple[str, float, float], ...] = ()
    """Name, from and to [s] of the stretches that were used."""
    reason: str = ""


def noise_floor(base: Dataset, interval_s: float) -> Floor:
    """Floor of means over `interval_s` of a run as long as this; `base` are its 1 s means.

    The floor is the expected RMS about their mean of such means under the noise found in the soaks (N, B, K).
    """
    if len(base) == 0:
        return Floor(reason="nothing was captured")
    found = _stretches(base)
    if not found:
        return Floor(reason=f"no isothermal stretch of at least {_LEAST_S / 60:g} minutes to read the noise from")
    blocks = [_on_grid(base, rows) for _, rows in found]
    try:
        noise = estimate_noise(blocks, base.interval_s)
        duration_s = float(base.time[-1] - base.time[0])
        floor_dph = noise.std_of_means(interval_s, duration_s)
        pairs = zip(found, blocks, strict=True)
        curves = tuple((name, allan_deviation(block, base.interval_s)) for (name, _), block in pairs)
    except InputError as error:
        return Floor(reason=str(error))
    spans = tuple((name, float(base.time[rows[0]]), float(base.time[rows[-1]])) for name, rows in found)
    return Floor(floor_dph, noise, curves, spans)


def _stretches(base: Dataset) -> list[tuple[str, IntArray]]:
    """Rows of each isothermal stretch: each soak after its settling, or any stand-still where there are no segments."""
    soaks = [s for s in base.segments if s.direction == "constant" or s.kind in {"soak", "step"}]
    if soaks:
        pieces = [(s.name, np.flatnonzero(base.segment == s.index)) for s in soaks]
        tails = [(name, _settled(base, rows)) for name, rows in pieces if rows.size]
    else:
        still = np.abs(np.nan_to_num(base.dT_dt, nan=np.inf)) < _SETTLED_DEGC_PER_MIN
        edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]]).astype(np.int8)))
        runs = [np.arange(a, b) for a, b in edges.reshape(-1, 2).tolist()]
        tails = [(f"still at {np.nanmean(base.channel('temperature')[rows]):.0f} °C", rows) for rows in runs]
    return [(name, rows) for name, rows in tails if rows.size and np.ptp(base.time[rows]) >= _LEAST_S]


def _settled(base: Dataset, rows: IntArray) -> IntArray:
    """Rows after the last fast change of temperature, at least the last half (a chamber may cycle for ever)."""
    fast = np.flatnonzero(np.abs(np.nan_to_num(base.dT_dt[rows])) > _SETTLED_DEGC_PER_MIN)
    # The slope looks half a window ahead: the last rows of a soak may already see the next ramp.
    inner = fast[fast < rows.size - max(60, rows.size // 20)]
    begin = int(inner[-1]) + 1 if inner.size else 0
    return rows[min(begin, rows.size // 2) :]


def _on_grid(base: Dataset, rows: IntArray) -> FloatArray:
    """Bias of the rows on an even grid of time, NaN in gaps."""
    index = np.rint((base.time[rows] - base.time[rows[0]]) / base.interval_s).astype(np.int64)
    grid = np.full(int(index[-1]) + 1, np.nan)
    grid[index] = base.bias[rows]
    return grid
