"""Bias of a whole-angle resonator over the angle of its standing wave.

Equation: B = sum_h s_h sin(2 h a) + c_h cos(2 h a), h = 1 and 2, a = -k integral of W dt; the phase of each is free.
Units: B [deg/h], W rate of the table [deg/s], a [rad], k angular gain (1, `gain`), s and c [deg/h].
Source: D. D. Lynch, Proc. Symposium Gyro Technology, Stuttgart (1995): unequal damping gives half the difference of
1/tau times sin 2a, unequal frequencies the fourth harmonic; G. H. Bryan, Proc. Cambridge Phil. Soc. 7 (1890) 101: gain
0.277 of a hemisphere. Usual size 0.01 to 10 deg/h.
When left out: a residual that repeats with the angle turned, 90 deg of the wave for the second harmonic.
Look-alikes: scale_factor_nonlinearity where each rate is held for one angle only; a periodic disturbance at one rate.
Separated by: slow rotation through several turns at two rates, both ways. At rest it is a constant.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bench.analysis.effects.base import Effect, Scale, Theta, check_number
from bench.analysis.effects.operators import integral
from bench.base import FloatArray
from bench.record import Dataset


@dataclass(frozen=True)
class PatternAngle(Effect):
    """Second and fourth harmonic; `gain` 0.05 to 1, 0.277 is a hemisphere's."""

    name = "pattern_angle"
    family = "rotation"
    needs = ("applied_rate",)
    amplitudes = (("sin2", "deg/h"), ("cos2", "deg/h"), ("sin4", "deg/h"), ("cos4", "deg/h"))

    gain: float = 0.277

    def __post_init__(self) -> None:
        check_number(self.name, "gain", self.gain, 0.05, 1.0)

    def prepare(self, records: Sequence[Dataset]) -> PatternAngle:
        """Checks that the table turned."""
        Scale.of(records, "applied_rate")
        return self

    def columns(self, record: Dataset, theta: Theta) -> FloatArray:
        """Sines and cosines of two and four times the angle (n, 4), as means over each row."""
        rate = record.channel("applied_rate")
        angle = -self.gain * np.radians(integral(record.time, rate))
        moved = 0.5 * self.gain * np.radians(rate) * record.interval_s  # half of what the wave turns within a row
        parts = []
        for h in (2.0, 4.0):
            smeared = np.sinc(h * moved / np.pi)
            parts += [smeared * np.sin(h * angle), smeared * np.cos(h * angle)]
        return np.column_stack(parts)

    def state(self) -> dict[str, float]:
        """The gain."""
        return {"gain": self.gain}
