"""What the magnitudes of a foreign table say: the impossible is refused, the implausible is warned of."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from bench.acquisition.importer.columns import Mapped
from bench.acquisition.importer.table import Table
from bench.base import CHANNELS, DPH_PER_DPS, DPH_PER_RADPS, RATES, THERMOMETERS, FloatArray, InputError, IntArray

_FASTEST_DPH = 5000 * DPH_PER_DPS
"""No gyro measures more [deg/h]."""
_QUIETEST_DPH = 0.01
"""A rate that scatters less is most likely in another unit [deg/h]."""
_COLDEST_DEGC, _HOTTEST_DEGC = -100.0, 200.0
_CONSTANT_DEGC = 1.0
_JUMP_DEGC = 0.5
"""Change from one row to the next, after many equal ones, that is no step of a thermometer."""
_COARSE_DEGC = 0.4
_SWAPPED = 0.2
"""Part of the thermometer's distance from the chamber's temperature within which a rate lies in its place."""
_GAP_INTERVALS = 5.0
_FEW = 0.1  # of the rows: a sensor that failed for a while, not another unit
_HANGS, _STEPS = 30, 20.0
"""Equal rows, and how many times what is usual, of an output that hangs; coarse steps have equal rows, too."""
_SATURATED, _CROWDED, _LEVELS = 30, 10.0, 100
"""Rows at the end of the range, how many times those at the values beside it, and how many values there are at least:
of an output in coarse steps many rows lie at its largest value."""

_DEGC = (-273.15, 1000.0)
_POSSIBLE = {
    **dict.fromkeys(RATES, (-1e6 * DPH_PER_DPS, 1e6 * DPH_PER_DPS)), **dict.fromkeys(THERMOMETERS, _DEGC),
    **{f"acceleration_{axis}": (-1e6, 1e6) for axis in "xyz"}, "chamber_temperature": _DEGC,
    "chamber_setpoint": _DEGC, "frequency": (0.0, 1e9), "applied_rate": (-1e6, 1e6), "drive": (-1e6, 1e6),
    "quadrature": (-1e6, 1e6), "supply": (-1e6, 1e6),
}  # fmt: skip
"""Values outside are no measurement of a gyro [unit of the channel]."""
_POSSIBLE_STEP_S = (1e-7, 1e5)
"""Median time from row to row."""
_PLAUSIBLE_STEP_S = (1e-5, 3600.0)
_LONGEST_S = 20 * 365.25 * 86400
_LONG_S = 14 * 86400.0
_SPAN_DEGC = 5.0
_DAY_S = 86400.0
_SLOW, _FAST = 0.05, 60.0
"""Chambers that sweep more than `_SPAN_DEGC` do so within these rates [degC/min]."""
_MINUTE_S = 60.0


def refuse_impossible(
    time: FloatArray, channels: Mapping[str, FloatArray], mapped: Sequence[Mapped], table: Table
) -> None:
    """InputError, with the line, for what no gyro, chamber or clock can have measured; time in [s] since the first."""
    advice = "check the unit (s, ms, us?) and the column"
    if time[-1] > _LONGEST_S:
        raise InputError(f"time goes on for {time[-1]:.3g} s, which is {time[-1] / 31557600:.3g} years: {advice}",
                         table.path, table.line(time.size - 1))  # fmt: skip
    step_s = float(np.median(np.diff(time))) if time.size > 1 else 1.0  # finite, as the last one is
    low, high = _POSSIBLE_STEP_S
    if not low <= step_s <= high:
        text = f"one row every {step_s:.3g} s, must be {low:g} to {high:g}"
        raise InputError(f"{text}: {advice}", table.path, table.line(1))
    for one in mapped:
        low, high = _POSSIBLE.get(one.channel, (-np.inf, np.inf))
        values = channels[one.channel]
        wrong = np.flatnonzero((values < low) | (values > high))
        if wrong.size:
            unit = CHANNELS[one.channel].unit
            text = f"'{one.column}' ({one.channel}) is {values[wrong[0]]:.6g} {unit} when read as {one.unit}"
            raise InputError(f"{text}, must be {low:.6g} to {high:.6g}: check the unit and the column; leave the field "
                             "empty where nothing was measured", table.path, table.line(int(wrong[0])))  # fmt: skip


def time_doubts(time: FloatArray, degc: FloatArray) -> list[str]:
    """What makes the unit of the time doubtful; (n,) each, [s] and [degC]."""
    if time.size < 2:
        return []
    step_s = float(np.median(np.diff(time)))
    low, high = _PLAUSIBLE_STEP_S
    if not low <= step_s <= high:
        return [f"one row every {step_s:.3g} s: check the unit of the time (s, ms, us?)"]
    fastest = _fastest(time, degc)
    lasts = (
        f"the record lasts {time[-1] / 86400:.3g} days, and its temperature changes by {fastest:.2g} degC/min at most"
    )
    slow = time[-1] > _DAY_S and np.nanmax(degc) - np.nanmin(degc) > _SPAN_DEGC and fastest < _SLOW
    if slow or time[-1] > _LONG_S:
        return [f"{lasts}: is the time in ms? then it would be {time[-1] / 1000 / 3600:.3g} h"]
    if fastest > _FAST:
        return [f"temperature changes by {fastest:.3g} degC/min: no chamber does; check the unit of the time"]
    return []


def _fastest(time: FloatArray, degc: FloatArray) -> float:
    """Fastest change of the temperature over a minute, or over a hundredth of a shorter record [degC/min]."""
    known = np.isfinite(degc)
    if np.count_nonzero(known) < 2:
        return 0.0
    time, degc = time[known], degc[known]
    width_s = min(_MINUTE_S, max(float(time[-1] - time[0]) / 100, float(np.median(np.diff(time)))))
    grid = np.linspace(time[0], time[-1], 5000)
    change = np.abs(np.interp(grid + width_s, time, degc) - np.interp(grid, time, degc))
    return float(np.quantile(change, 0.95)) * _MINUTE_S / width_s


def doubts(channels: Mapping[str, FloatArray], mapped: Mapping[str, Mapped]) -> list[str]:
    """What the magnitudes make doubtful."""
    rates, warm = [name for name in RATES if name in channels], next(n for n in THERMOMETERS if n in channels)
    found = [text for name in rates for text in _of_rate(name, channels[name], mapped[name].unit)]
    found += [text for name in THERMOMETERS if name in channels for text in _of_thermometer(name, channels[name])]
    degc = channels[warm][np.isfinite(channels[warm])]
    beyond = np.flatnonzero((channels[warm] < _COLDEST_DEGC) | (channels[warm] > _HOTTEST_DEGC))
    if 0 < beyond.size < _FEW * degc.size:
        text = f"temperature is {channels[warm][beyond[0]]:.4g} degC in {beyond.size} rows, the first {beyond[0] + 1}"
        found.append(f"{text}: a sensor that failed? leave these fields empty")
    elif beyond.size:
        text = f"temperature is {degc.min():.4g} to {degc.max():.4g} degC when read as {mapped[warm].unit}"
        found.append(f"{text}: check the unit (K, degF?)")
    if np.ptp(degc) < _CONSTANT_DEGC:
        found.append(f"temperature is constant ({degc.min():.2f} to {degc.max():.2f} degC): good as a static run for "
                     "the noise, useless for a model over temperature")  # fmt: skip
    else:
        steps = np.diff(np.unique(degc))
        if steps.size and steps.min() >= _COARSE_DEGC:
            found.append(f"temperature moves in steps of {steps.min():.2g} degC: too coarse for a good calibration")
    air = channels.get("chamber_temperature")
    found += [
        f"{name} follows the temperature of the chamber and {warm} does not: are the two columns swapped?"
        for name in rates
        if air is not None
        and _apart(channels[name], air) < _SWAPPED * min(_apart(channels[warm], air), float(np.nanstd(air)))
    ]
    return found


def _apart(values: FloatArray, others: FloatArray) -> float:
    """RMS of the difference where both are known; infinite where neither is."""
    square = (values - others) ** 2
    known = np.isfinite(square)
    return float(np.sqrt(square[known].mean())) if known.any() else np.inf


def time_gaps(time: FloatArray, table: Table) -> list[str]:
    """Where rows are missing."""
    steps = np.diff(time)
    gaps = np.flatnonzero(steps > _GAP_INTERVALS * np.median(steps))
    if not gaps.size:
        return []
    line = table.line(int(gaps[0]) + 1)
    where = "" if line is None else f", the first before line {line}"
    return [f"gaps in time: {gaps.size}, together {float(steps[gaps].sum()):.4g} s{where}; they stay gaps"]


def _of_rate(name: str, values: FloatArray, given: str) -> Iterator[str]:
    rate = values[np.isfinite(values)]
    if not rate.size:
        return
    fastest, scatter = float(np.abs(rate).max()), float(np.std(np.diff(rate))) if rate.size > 1 else 0.0
    if fastest > _FASTEST_DPH:
        yield (
            f"{name} reaches {fastest / DPH_PER_DPS:.3g} deg/s when read as {given}: more than any gyro measures; is "
            "it in deg/h?"
        )
    elif 0 < scatter < _QUIETEST_DPH and fastest < 15.0:
        yield (
            f"{name} scatters by only {scatter:.2g} deg/h from sample to sample when read as {given}; read as rad/s it "
            f"would be {scatter * DPH_PER_RADPS:.2g} deg/h, as deg/s {scatter * DPH_PER_DPS:.2g} deg/h: check the unit"
        )
    first, rows = _longest(values)
    if rows >= _HANGS and np.ptp(rate) > 0.0:
        yield (
            f"{name} is {values[first]:.6g} deg/h in {rows} rows, one after the other, the first {first + 1}: did the "
            "unit hang? leave these fields empty"
        )
    for end, stands in _ends(rate):
        yield (
            f"{name} is {end:.6g} deg/h in {stands} rows and never beyond: does the output saturate there? leave these "
            "fields empty"
        )
    if rate.size > 1 and np.ptp(rate) == 0.0:
        yield (
            f"{name} is {rate[0]:.6g} deg/h in every row: no gyro is so quiet; check the column, and whether "
            "the unit still measured"
        )


def _stretches(values: FloatArray) -> tuple[IntArray, IntArray]:
    """First row and length of each stretch of one value."""
    firsts = np.flatnonzero(np.diff(values, prepend=np.nan) != 0.0)  # a gap equals nothing
    return firsts, np.diff(np.append(firsts, values.size))


def _longest(values: FloatArray) -> tuple[int, int]:
    """First row and length of the longest stretch of one value, where it is far longer than others; else 0, 0."""
    firsts, rows = _stretches(values)
    longest = int(np.argmax(rows))
    return (int(firsts[longest]), int(rows[longest])) if rows[longest] > _STEPS * np.quantile(rows, 0.95) else (0, 0)


def _of_thermometer(name: str, degc: FloatArray) -> Iterator[str]:
    """A thermometer that stood still and then jumped; where it only rests, it goes on by a step of its own."""
    firsts, rows = _stretches(degc)
    steps = np.abs(np.diff(degc[firsts]))  # after each stretch but the last
    if not np.any(np.isfinite(steps)):
        return
    jump = max(_JUMP_DEGC, _STEPS * float(np.nanmedian(steps)))
    for stretch in np.flatnonzero((rows[:-1] >= _HANGS) & (steps > jump))[:1]:
        before, after = degc[firsts[stretch : stretch + 2]]
        yield (
            f"{name} is {before:.6g} degC in {rows[stretch]} rows, one after the other, the first "
            f"{firsts[stretch] + 1}, and {after:.6g} degC in the next: did the thermometer stand still? leave these "
            "fields empty"
        )


def _ends(rate: FloatArray) -> Iterator[tuple[float, int]]:
    """The smallest and the largest value where the rows crowd, with their number."""
    if max(np.count_nonzero(rate == end) for end in (rate.min(), rate.max())) < _SATURATED:
        return  # the usual case, without sorting what may be millions of rows
    levels, rows = np.unique(rate, return_counts=True)
    if levels.size < _LEVELS:
        return
    for end, beside in ((0, rows[1:6]), (-1, rows[-6:-1])):
        if rows[end] >= max(_SATURATED, _CROWDED * beside.max()):
            yield float(levels[end]), int(rows[end])
