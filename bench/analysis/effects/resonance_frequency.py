"""The resonance frequency as a quantity of its own: the resonator's own thermometer, and a trace of its stiffness.

Equation: `use: term` B = sum_k c_k f^k, k = 1..`order`, beside the terms in temperature; `use: thermometer` replaces
the temperature that all terms see by T_f = g0 + g1 f + g2 f^2, fitted to the sensor: no terms of its own.
Units: B [deg/h], f [Hz], c_k [deg/h/Hz^k], T_f [degC].
Source: frequency as a built-in thermometer of a resonator (0.01 ppm is 0.4 mK for silicon; quadruple-mass gyro, doi
10.1016/j.sna.2012.12.024); order 1-3 as in the multi-channel regressions of the source papers.
When left out: the residual over temperature is a loop that closes over frequency.
Look-alikes: thermal_lag (frequency follows the resonator), drive_amplitude, quadrature_leakage (if they wander with f).
Separated by: comparing the loops over temperature and over frequency; a change of amplitude at constant temperature.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from bench.analysis.effects.base import (
    Effect,
    Physical,
    Series,
    Theta,
    check_choice,
    check_whole,
    powers_unit,
    prepared,
)
from bench.base import FloatArray, InputError
from bench.record import Dataset

USES = ("term", "thermometer")


@dataclass(frozen=True)
class ResonanceFrequency(Effect):
    """Powers of the frequency, or a thermometer; `use` term or thermometer, `order` 1 to 5 of the terms."""

    name = "resonance_frequency"
    family = "frequency"

    use: str = "term"
    order: int = 1
    series: Series | None = field(default=None, repr=False, metadata={"fitted": True})
    gains: tuple[float, ...] = field(default=(), repr=False, metadata={"fitted": True})
    """Of a thermometer: temperature as a parabola of the scaled frequency [degC]."""

    def __post_init__(self) -> None:
        check_choice(self.name, "use", self.use, USES)
        check_whole(self.name, "order", self.order, 1, 5)

    @property
    def moves_abscissa(self) -> bool:
        """A thermometer does."""
        return self.use == "thermometer"

    @property
    def needs(self) -> tuple[str, ...]:
        """The frequency, and the sensor to which a thermometer is fitted."""
        return ("frequency", "temperature") if self.moves_abscissa else ("frequency",)

    def prepare(self, records: Sequence[Dataset]) -> ResonanceFrequency:
        """Scale the frequency, fit a thermometer to the sensor; InputError where f does not move, or turns back."""
        ready = replace(self, series=Series.of(records, "frequency", self.order))
        return replace(ready, gains=ready._parabola(records)) if self.moves_abscissa else ready

    def _parabola(self, records: Sequence[Dataset]) -> tuple[float, ...]:
        scale = prepared(self.series).scale
        unit = np.concatenate([scale.unit(record.channel("frequency")) for record in records])
        sensor = np.concatenate([record.channel("temperature") for record in records])
        both = np.isfinite(unit) & np.isfinite(sensor)
        if both.sum() < 3:
            raise InputError("resonance_frequency: fewer than 3 rows with frequency and temperature")
        gains = np.polynomial.polynomial.polyfit(unit[both], sensor[both], 2)
        if abs(gains[1]) <= 2.0 * abs(gains[2]):
            raise InputError(
                "resonance_frequency: f turns back over temperature here, so it cannot serve as a thermometer"
            )
        return tuple(gains.tolist())

    def columns(self, record: Dataset, theta: Theta) -> FloatArray:
        """Chebyshev polynomials of the scaled frequency (n, order); none of a thermometer."""
        return super().columns(record, theta) if self.moves_abscissa else prepared(self.series).columns(record)

    def abscissa(self, record: Dataset, theta: Theta) -> FloatArray:
        """Temperature that the frequency tells (n,) [degC]."""
        unit = prepared(self.series).scale.unit(record.channel("frequency"))
        told: FloatArray = np.polynomial.polynomial.polyval(unit, np.array(self.gains))
        return told

    def physical(self) -> Physical:
        """Coefficients of powers of f, without the constant's share; none of a thermometer."""
        if self.moves_abscissa:
            return super().physical()
        powers = range(1, self.order + 1)
        matrix = np.hstack([np.zeros((self.order, 1)), prepared(self.series).powers()[1:]])
        return Physical(tuple(f"c{p}" for p in powers), tuple(powers_unit("frequency", p) for p in powers), matrix)

    def state(self) -> dict[str, Any]:
        """Scale of the frequency [Hz], and a thermometer's parabola over the scaled frequency [degC]."""
        scale = prepared(self.series).scale
        gains = {"gains_degc": list(self.gains)} if self.moves_abscissa else {}
        return {"frequency": [scale.low, scale.high], **gains}
