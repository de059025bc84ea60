"""Sinusoids in the output of a gyro at rest (IEEE 952, sinusoidal noise): vibration, a beat, a control loop.

A white noise fit would take their power for angle random walk, and the noise floor would hide errors as large. A line
is a peak of the windowed spectrum that stands so far above the median about it that white noise makes one in 100,000
records; of other colours, which are smooth there, one record in 2,700 had one. Its frequency is refined off the grid by
least squares.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import scipy

from bench.base import FloatArray

_LEAST_ROWS = 256
_LEAST_CYCLES = 20  # in the record: slower ones are not told from flicker
_BESIDE = 40  # frequencies on either side that tell how high chance reaches
_CHANCE = 1e-5
_MOST = 10
_TRIED = 17  # frequencies between two neighbours of the grid: a line is as wide as its distance to the next


class Line(NamedTuple):
    """A sinusoid: its period [s] and amplitude [deg/h]."""

    period_s: float
    amplitude_dph: float


def without_lines(rate: FloatArray, interval_s: float) -> tuple[FloatArray, tuple[Line, ...]]:
    """Rows (n,) every `interval_s` [deg/h], NaN in gaps, less their lines; and these, strongest first."""
    found: list[Line] = []
    while len(found) < _MOST and (cycles := _highest(rate)):
        period, wave = _fitted(rate, cycles)
        rate = rate - wave
        found.append(Line(period * interval_s, float(np.ptp(wave)) / 2.0))
    return rate, tuple(sorted(found, key=lambda line: -line.amplitude_dph))


def refined(gains: Callable[[FloatArray], FloatArray], cycles: float) -> float:
    """Cycles of a line between the neighbours of its place on the grid; `gains` (m,) is larger the better each fits."""
    grid = np.linspace(max(0.5, cycles - 1.0), cycles + 1.0, _TRIED)
    best = int(np.argmax(gains(grid)))
    ends = float(grid[max(best - 1, 0)]), float(grid[min(best + 1, _TRIED - 1)])
    least = scipy.optimize.minimize_scalar(
        lambda f: -float(gains(np.array([f]))[0]), bounds=ends, method="bounded", options={"maxiter": 12}
    )
    return float(least.x)


def _highest(rate: FloatArray) -> int:
    """Cycles in the record of the line that stands out most; 0 for none."""
    known = np.isfinite(rate)
    if known.sum() < _LEAST_ROWS:
        return 0
    place = np.arange(len(rate), dtype=np.float64)
    trend = np.polyfit(place[known], rate[known], 1)
    power = np.abs(np.fft.rfft(np.where(known, rate - np.polyval(trend, place), 0.0) * np.hanning(len(rate)))) ** 2
    about = np.pad(power, _BESIDE, mode="reflect")
    usual = np.median(np.lib.stride_tricks.sliding_window_view(about, 2 * _BESIDE + 1), axis=1) / np.log(2.0)
    ratio = power[_LEAST_CYCLES:] / np.maximum(usual[_LEAST_CYCLES:], 1e-300)
    top = int(np.argmax(ratio))
    return top + _LEAST_CYCLES if ratio[top] > np.log(len(ratio) / _CHANCE) else 0


def _fitted(rate: FloatArray, cycles: int) -> tuple[float, FloatArray]:
    """Period [rows] of the line about so many cycles, and its sinusoid (n,)."""
    known, place = np.isfinite(rate), np.arange(len(rate)) / len(rate)
    centred = rate[known] - rate[known].mean()

    def waves(frequency: float) -> FloatArray:
        phase = 2.0 * np.pi * frequency * place
        return np.column_stack([np.cos(phase), np.sin(phase)])

    def gain(frequency: float) -> float:
        columns = waves(frequency)[known]
        return -float(np.sum((centred - columns @ np.linalg.lstsq(columns, centred)[0]) ** 2))

    frequency = refined(lambda each: np.array([gain(one) for one in each]), cycles)
    columns = waves(frequency)
    return len(rate) / frequency, columns @ np.linalg.lstsq(columns[known], centred)[0]
