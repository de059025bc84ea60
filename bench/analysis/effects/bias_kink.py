"""A change of the bias curve at one temperature: a mount that loosens, a glass transition, two modes that cross.

Equation: shape `slope` B = k w ln(1 + exp((T - T_k) / w)), the slope changes by k over the rounding w (`rounding_degc`,
an option); shape `bump` B = a exp(-((T - T_k) / w)^2), w `width_degc`, or fitted if 0. The same on both branches.
Units: B and a [deg/h], T, T_k and w [degC], k [deg/h/degC].
Source: softened piecewise-linear regression; glass transitions of epoxies 40-120 degC, mode crossings 3-15 degC wide.
When left out: the residual has a sharp corner or a bump at one temperature, equally while heating and cooling.
Look-alikes: spline with too few intervals, frost (heating only), bias_jump (a time, not a temperature).
Separated by: a slow ramp both ways through the place: same temperature both ways and each time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from bench.analysis.effects.base import Effect, Parameter, Scale, Theta, check_choice, check_number
from bench.base import FloatArray
from bench.record import Dataset

SHAPES = ("slope", "bump")
_BUMPS_DEGC = (3.0, 6.0, 12.0)


@dataclass(frozen=True)
class BiasKink(Effect):
    """One local term; `shape` slope or bump, `rounding_degc` of a slope 0.1 to 20, `width_degc` of a bump 0 to 30."""

    name = "bias_kink"
    family = "kink"
    needs = ("temperature",)

    shape: str = "slope"
    rounding_degc: float = 1.0
    width_degc: float = 0.0
    range_degc: tuple[float, float] = field(default=(-50.0, 120.0), repr=False, metadata={"fitted": True})

    def __post_init__(self) -> None:
        check_choice(self.name, "shape", self.shape, SHAPES)
        check_number(self.name, "rounding_degc", self.rounding_degc, 0.1, 20.0)
        check_number(self.name, "width_degc", self.width_degc, 0.0, 30.0)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Temperature of the kink, and the width of a bump."""
        low, high = self.range_degc
        at = Parameter("at_degc", "degC", low, high, 0.5 * (low + high), meaning="where it is", change_point=True)
        width = Parameter("width_degc", "degC", 1.0, 20.0, 5.0, log=True, meaning="half-width of the bump")
        return (at, width) if self.shape == "bump" and not self.width_degc else (at,)

    def shapes(self) -> tuple[Effect, ...]:
        """Corner and bumps of three widths, one effect for a ranking, each with the place as its one parameter."""
        return (replace(self, shape="slope"), *(replace(self, shape="bump", width_degc=w) for w in _BUMPS_DEGC))

    def suited(self, records: Sequence[Dataset]) -> BiasKink:
        """The place within the temperatures of the records, 3 % from their ends."""
        scale = Scale.of(records, "temperature")
        return replace(self, range_degc=(scale.centre - 0.94 * scale.half, scale.centre + 0.94 * scale.half))

    def columns(self, record: Dataset, theta: Theta) -> FloatArray:
        """Rounded corner [degC] or bump [1], (n, 1)."""
        above = record.channel("temperature") - theta["at_degc"]
        if self.shape == "bump":
            return np.exp(-((above / (self.width_degc or theta["width_degc"])) ** 2))[:, None]
        corner = np.maximum(above, 0.0) + self.rounding_degc * np.log1p(np.exp(-np.abs(above) / self.rounding_degc))
        return corner[:, None]

    @property
    def amplitudes(self) -> tuple[tuple[str, str], ...]:
        """Change of slope k, or height a."""
        return (("k", "deg/h/degC"),) if self.shape == "slope" else (("a", "deg/h"),)
