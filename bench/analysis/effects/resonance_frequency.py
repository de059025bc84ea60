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
from typing import Any, ClassVar

import numpy as np

from bench.analysis.effects.base import (
    Effect,
    Parameter,
    Physical,
    Scale,
    Series,
    Theta,
    check_choice,
    check_whole,
    linear_terms,
    powers_unit,
    prepared,
)
from bench.base import FloatArray, InputError
from bench.record import Dataset

USES = ("term", "thermometer")


@dataclass(frozen=True)
class ResonanceFrequency:
    """Powers of the frequency; `use` term or thermometer, `order` 1 to 5 of the terms."""

    name: ClassVar[str] = "resonance_frequency"
    family: ClassVar[str] = "frequency"
    needs: ClassVar[tuple[str, ...]] = ("frequency",)
    parameters: ClassVar[tuple[Parameter, ...]] = ()

    use: str = "term"
    order: int = 1
    series: Series | None = field(default=None, repr=False, metadata={"fitted": True})

    def __post_init__(self) -> None:
        check_choice(self.name, "use", self.use, USES)
        check_whole(self.name, "order", self.order, 1, 5)

    def resolved(self) -> Effect:
        """The effect that the options ask for."""
        return self if self.use == "term" else FrequencyThermometer("thermometer")

    def prepare(self, records: Sequence[Dataset]) -> ResonanceFrequency:
        """Scale the frequency; InputError where it does not move."""
        return replace(self, series=Series.of(records, "frequency", self.order))

    def columns(self, record: Dataset, theta: Theta) -> FloatArray:
        """Chebyshev polynomials of the scaled frequency (n, order)."""
        return prepared(self.series).columns(record)

    def physical(self) -> Physical:
        """Coefficients of powers of f, without the constant's share."""
        powers = range(1, self.order + 1)
        matrix = np.hstack([np.zeros((self.order, 1)), prepared(self.series).powers()[1:]])
        return Physical(tuple(f"c{p}" for p in powers), tuple(powers_unit("frequency", p) for p in powers), matrix)

    def state(self) -> dict[str, Any]:
        """Scale of the frequency [Hz]."""
        scale = prepared(self.series).scale
        return {"frequency": [scale.low, scale.high]}


@dataclass(frozen=True)
class FrequencyThermometer:
    """Moves the abscissa of all terms to the temperature that the frequency tells."""

    name: ClassVar[str] = "resonance_frequency"
    family: ClassVar[str] = "frequency"
    needs: ClassVar[tuple[str, ...]] = ("frequency", "temperature")
    parameters: ClassVar[tuple[Parameter, ...]] = ()

    use: str = "term"  # always thermometer; the default of the effect, so that models write the option
    scale: Scale | None = field(default=None, repr=False, metadata={"fitted": True})
    gains: tuple[float, ...] = field(default=(), repr=False, metadata={"fitted": True})

    def prepare(self, records: Sequence[Dataset]) -> FrequencyThermometer:
        """Fit the sensor by a parabola in f; InputError where f does not move, or turns back within the range."""
        scale = Scale.of(records, "frequency")
        unit = np.concatenate([scale.unit(record.channel("frequency")) for record in records])
        sensor = np.concatenate([record.channel("temperature") for record in records])
        both = np.isfinite(unit) & np.isfinite(sensor)
        if both.sum() < 3:
            raise InputError("resonance_frequency: fewer than 3 rows with frequency and temperature")
        gains = np.polynomial.polynomial.polyfit(unit[both], sensor[both], 2)
        if abs(gains[1]) <= 2.0 * abs(gains[2]):
            raise InputError("resonance_frequency: f turns back over temperature here, so it is no thermometer")
        return replace(self, scale=scale, gains=tuple(gains.tolist()))

    def abscissa(self, record: Dataset, theta: Theta) -> FloatArray:
        """Temperature told by the frequency (n,) [degC]."""
        unit = prepared(self.scale).unit(record.channel("frequency"))
        told: FloatArray = np.polynomial.polynomial.polyval(unit, np.array(self.gains))
        return told

    def columns(self, record: Dataset, theta: Theta) -> FloatArray:
        """No columns (n, 0)."""
        return np.empty((len(record), 0))

    def physical(self) -> Physical:
        """No amplitudes."""
        return linear_terms((), ())

    def state(self) -> dict[str, Any]:
        """Scale of the frequency [Hz] and the parabola over the scaled frequency [degC]."""
        scale = prepared(self.scale)
        return {"frequency": [scale.low, scale.high], "gains_degc": list(self.gains)}
