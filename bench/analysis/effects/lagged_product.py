"""A channel that acts in proportion to a temperature difference inside the unit, which follows the temperature late.

Equation: B = k (x - x0) (T - T_lag), T_lag behind T by tau, x the channel `channel`, x0 the middle of its range.
Units: B [deg/h], T [degC], x in the channel's unit, tau [s], k [deg/h/degC per unit of x].
Source: product terms of the multi-channel polynomials of vibratory gyros (drive, frequency and quadrature with
temperature), where the electronics or one anchor lags behind the thermometer; a phase that a gradient turns.
When left out: loops over temperature that open and close with the channel.
Look-alikes: temperature_rate and thermal_lag (do not follow the channel), quadrature_leakage (no loop), creep.
Separated by: ramps with the channel changed by its own set point; standing still.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from bench.analysis.effects.base import Effect, Parameter, Scale, Theta, check_choice, prepared
from bench.analysis.effects.operators import ramp_invariant_lag
from bench.base import FloatArray
from bench.record import Dataset

CHANNELS = ("quadrature", "drive", "supply", "frequency")


@dataclass(frozen=True)
class LaggedProduct(Effect):
    """One term; `channel` quadrature, drive, supply or frequency."""

    name = "lagged_product"
    rarity = 0.5
    parameters = (
        Parameter("tau_s", "s", 20.0, 7200.0, 400.0, log=True, meaning="time constant of the part that lags"),
    )

    channel: str = "quadrature"
    scale: Scale | None = field(default=None, repr=False, metadata={"fitted": True})

    def __post_init__(self) -> None:
        check_choice(self.name, "channel", self.channel, CHANNELS)

    @property
    def needs(self) -> tuple[str, ...]:
        """The channel and the temperature."""
        return (self.channel, "temperature")

    @property
    def amplitudes(self) -> tuple[tuple[str, str], ...]:
        """The amplitude k."""
        unit = {"quadrature": "V", "drive": "V", "supply": "V", "frequency": "Hz"}[self.channel]
        return (("k", f"deg/h/degC/{unit}"),)

    def prepare(self, records: Sequence[Dataset]) -> LaggedProduct:
        """The middle of the channel's range; InputError where it stands still."""
        return replace(self, scale=Scale.of(records, self.channel))

    def columns(self, record: Dataset, theta: Theta) -> FloatArray:
        """The product (n, 1)."""
        temperature = record.channel("temperature")
        behind = temperature - ramp_invariant_lag(record.time, temperature, theta["tau_s"])
        return np.asarray((record.channel(self.channel) - prepared(self.scale).centre) * behind)[:, None]
