"""Steps of thermometer and output, found before anything is named: what they cause looks like effects.

A converter without dither errs by up to half a step, the same way each time the same value comes back: no noise, but a
fine structure over temperature. Where the error of the steps matters, columns that follow the output's rounding join
the model's, and no effect is named whose contribution is smaller than what the steps may cause.

Of the samples of a mean, noise of standard deviation s and steps q leave a saw-tooth of the value whose harmonics have
the amplitudes q / (pi k) exp(-2 pi^2 k^2 s^2 / q^2), and an error that differs from sample to sample (B. Widrow and
I. Kollar, Quantization Noise, 2008). A value that moves within a mean has the saw-tooth averaged over that way.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from bench.analysis.thresholds import STEPS_MATTER
from bench.base import FloatArray
from bench.record import Dataset

_ORDERS = (1, 2)
_HARMONICS = np.arange(1, 41)
_AT_MOST = 1.5  # times its RMS: where the temperature stands still, an error keeps its sign for hours
_STILL = 0.125  # of a step: a value that moves less from sample to sample shows its noise by their differences
_ONE_STEP = 1.2  # of a squared step: half the square of a difference by one step and what averaging adds
_OUTLIER = 50.0  # times the median of squares: no noise


@dataclass(frozen=True)
class Resolution:
    """Steps of the output [deg/h] and of the thermometer [degC], 0 where none is seen, and the RMS of what they cause
    in the means [deg/h].
    """

    rate_step_dph: float = 0.0
    rate_error_dph: float = 0.0
    temperature_step_degc: float = 0.0
    temperature_error_dph: float = 0.0
    repeats_dph: float = 0.0
    """RMS of the part of both that comes back with the value: the rest is noise."""

    def matters(self, floor_dph: float) -> bool:
        """Whether the steps cause more than a share of the noise, or of a noise that is not known (NaN)."""
        return self.repeats_dph > 0.0 and not self.repeats_dph <= STEPS_MATTER * floor_dph

    def hides(self, contribution: FloatArray) -> bool:
        """Whether what an effect adds beside the model (n,) [deg/h] is within what the steps may cause."""
        return float(np.sqrt(np.mean(contribution**2))) < _AT_MOST * self.repeats_dph

    def explains(self, left_dph: float, floor_dph: float) -> bool:
        """Whether what is left beyond the noise (NaN: not known) is within what the steps may cause."""
        return left_dph**2 - float(np.nan_to_num(floor_dph)) ** 2 < (_AT_MOST * self.repeats_dph) ** 2

    def rounding(self, fitted: FloatArray) -> FloatArray:
        """Columns (n, k) that rounding the output adds, from its fitted values (n,) [deg/h]; none without a step.

        The error of rounding is a saw-tooth of the value: its first harmonics, what noise leaves of them.
        """
        if not self.rate_step_dph:
            return np.empty((len(fitted), 0))
        phase = 2.0 * np.pi * fitted / self.rate_step_dph
        return np.column_stack([wave(order * phase) for order in _ORDERS for wave in (np.sin, np.cos)])

    def words(self) -> str:
        """The finding, empty where there is none."""
        parts = []
        if self.temperature_step_degc:
            parts.append(
                f"the thermometer has steps of {self.temperature_step_degc:.3g} degC, which cause "
                f"{self.temperature_error_dph:.2g} deg/h RMS"
            )
        if self.rate_step_dph:
            text = f"the output has steps of {self.rate_step_dph:.3g} deg/h, which cause "
            parts.append(f"{text}{self.rate_error_dph:.2g} deg/h RMS")
        return " and ".join(parts)


def resolution(runs: Sequence[Dataset], outputs: Sequence[FloatArray], slopes: Sequence[FloatArray]) -> Resolution:
    """Resolution of runs with these fitted outputs (n,) [deg/h] and slopes of the curve (n,) [deg/h/degC]."""
    errors = np.zeros((2, 2, 0))  # of output and thermometer, what repeats and the rest
    for run, output, slope in zip(runs, outputs, slopes, strict=True):
        rate = _variances(run, "rate", run.rate_step, np.abs(np.diff(output, prepend=output[:1])))
        moves = np.abs(np.nan_to_num(run.dT_dt)) * run.interval_s / 60.0
        thermometer = slope**2 * _variances(run, "temperature", run.temperature_step, moves)
        errors = np.concatenate([errors, np.stack([rate, thermometer])], axis=2)
    mean = errors[:, :, np.isfinite(errors).all(axis=(0, 1))].mean(axis=2)
    rate_dph, temperature_dph = np.sqrt(mean.sum(axis=1)).tolist()
    steps = [max(run.rate_step for run in runs), max(run.temperature_step for run in runs)]
    return Resolution(steps[0], rate_dph, steps[1], temperature_dph, float(np.sqrt(mean[:, 0].sum())))


def _variances(run: Dataset, name: str, step: float, moves: FloatArray) -> FloatArray:
    """Variances (2, n) of what rounding adds to the means of a channel that `moves` (n,) within each: of what comes
    back with the value, and of the rest.
    """
    if not step:
        return np.zeros((2, len(run)))
    count = np.maximum(run.count(name), 1.0)
    harmonics = _harmonics(_noise(run, name, step, moves), step)
    blurred = np.sinc(np.outer(_HARMONICS, (1.0 - 1.0 / count) * moves / step))
    return np.stack([0.5 * harmonics**2 @ blurred**2, (step**2 / 12.0 - 0.5 * np.sum(harmonics**2)) / count])


def _harmonics(noise: float, step: float) -> FloatArray:
    """Amplitudes (k,) of the saw-tooth that noise of this standard deviation leaves of rounding to a step."""
    return np.asarray(step / (np.pi * _HARMONICS) * np.exp(-2.0 * (np.pi * _HARMONICS * noise / step) ** 2))


def _noise(run: Dataset, name: str, step: float, moves: FloatArray) -> float:
    """Standard deviation of the noise of a sample before rounding, from that after it.

    Over all places within a step the samples at one value scatter with s^2 + step^2 / 12 less the saw-tooth's square.
    """
    fine, row = (run.finer.record, run.finer.row) if run.finer else (run, np.arange(len(run)))
    square = fine.variances.get(name, np.empty(0))
    square = square[np.isfinite(square)]
    if not square.size:
        slow = (row >= 0) & (moves[row] * fine.spacing_s / run.interval_s < _STILL * step)
        near = (np.diff(fine.time) < 1.5 * fine.spacing_s) & slow[1:] & slow[:-1]
        square = 0.5 * np.diff(fine.channel(name))[near] ** 2
        square = square[np.isfinite(square)]
    if not square.size:
        return 0.0
    scatter = float(np.mean(square[square <= max(_ONE_STEP * step**2, _OUTLIER * float(np.median(square)))]))

    def beyond(noise: float) -> float:
        return noise**2 + step**2 / 12.0 - 0.5 * float(np.sum(_harmonics(noise, step) ** 2)) - scatter

    return float(scipy.optimize.brentq(beyond, 0.0, np.sqrt(scatter) + step)) if beyond(0.0) < 0.0 else 0.0
