"""Signals of an image from ranges and time constants in units: integers as docs/eeprom.md defines them."""

from __future__ import annotations

from math import ceil, exp, expm1, floor, log2

import numpy as np

from bench.base import DPH_PER_DPS, FloatArray, InputError, IntArray
from bench.deliver.export.delivery import INPUTS, NO_VALUE, ONE, Kind, Signal

_BEHIND_BITS = 22


def per_count(channel: str) -> float:
    """One count of an input in the unit of the bench's channel."""
    return INPUTS[channel].count * (DPH_PER_DPS if channel == "rate" else 1.0)


def to_counts(channel: str, values: FloatArray) -> IntArray:
    """Values (n,) as whole counts; NaN becomes the count that stands for a missing value."""
    counts = np.round(values / per_count(channel))
    return np.where(np.isfinite(counts), np.clip(counts, NO_VALUE + 1, -NO_VALUE - 1), NO_VALUE).astype(np.int64)


def channel_signal(channel: str, low: float, high: float) -> Signal:
    """A channel with its validity box, rounded to whole counts; InputError for a channel that is not an input."""
    if channel not in INPUTS:
        raise InputError(f"channel '{channel}' is not an input of the unit; it has {', '.join(INPUTS)}")
    weight = per_count(channel)
    return _scaled(Kind.CHANNEL, INPUTS[channel].id, ceil(low / weight - 1e-6), floor(high / weight + 1e-6))


def box_of(signal: Signal, channel: str) -> tuple[float, float]:
    """Values at which z is -1 and 1, in the channel's unit."""
    return signal.low * per_count(channel), signal.high * per_count(channel)


def lag_signal(
    source: int,
    source_box: tuple[float, float],
    box: tuple[float, float],
    tau_s: float,
    period_s: float,
    *,
    behind: bool = False,
) -> Signal:
    """A lagged signal, or its difference from the source (`behind`); boxes in the source's unit."""
    centre, half = 0.5 * sum(source_box), 0.5 * (source_box[1] - source_box[0])
    offset = 0.0 if behind else centre
    low, high = (round((end - offset) / half * ONE) for end in box)
    step = period_s / tau_s
    fade = -expm1(-step)
    shift = _BEHIND_BITS - floor(log2(fade))
    mantissa = min(round(fade * 2.0**shift), (1 << _BEHIND_BITS + 1) - 1)
    if shift > 62:
        raise InputError(
            f"a time constant of {tau_s:g} s at a period of {period_s:g} s is beyond the filter's integers"
        )
    push = -(1.0 - exp(-step)) / step
    return _scaled(Kind.BEHIND if behind else Kind.LAG, source, low, high, (mantissa, shift, round(push * ONE)))


def play_signal(source: int, half_width: float) -> Signal:
    """A loop of this half-width, in the source's z."""
    width = round(half_width * ONE)
    return _scaled(Kind.PLAY, source, -width, width, (width, 0, 0))


def parabola_signal(source: int, coefficients: FloatArray, box: tuple[float, float]) -> Signal:
    """Another quantity as a function of a signal: Chebyshev `coefficients` (3,) in the unit of `box`."""
    centre, half = 0.5 * (box[0] + box[1]), 0.5 * (box[1] - box[0])
    scaled = (coefficients - np.array([centre, 0.0, 0.0])) / half
    if np.abs(scaled).max() >= 2.0:
        raise InputError("resonance_frequency: the thermometer's parabola is too steep for the image")
    p0, p1, p2 = (round(value * ONE) for value in scaled.tolist())
    return _scaled(Kind.PARABOLA, source, -ONE, ONE, (p0, p1, p2))


def _scaled(kind: Kind, source: int, low: int, high: int, p: tuple[int, int, int] = (0, 0, 0)) -> Signal:
    high -= (high - low) % 2  # the centre is a whole number
    if high - low < 4 or low <= NO_VALUE or high >= -NO_VALUE:
        raise InputError(f"validity from {low} to {high} counts is empty or does not fit 32 bits")
    half = (high - low) // 2
    shift = (half - 1).bit_length()
    return Signal(kind, source, low, high, (low + high) // 2, round((1 << 30 + shift) / half), shift, p)
