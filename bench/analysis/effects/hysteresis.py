"""Bias that depends on the way the temperature came: friction and micro-slip in mount, glue and solder.

Equation: B = sum_i a_i h_i, i = 1..`count`, loops h of height one. Shape `play`: h_i = (T - P_i) / r_i with P_i the
play operator of half-width r_i = r i / count (several: Prandtl-Ishlinskii). Shape `bouc_wen`: L dh/dT = 1 - |h| while
|h| grows and 1 while it falls. The part of the operator that is a line in T belongs to the static curve.
Units: B and a_i [deg/h], half the opening of the loop; T, r and L [degC]; h [1].
Source: Krasnosel'skii, Pokrovskii, Systems with Hysteresis (1989); Y.-K. Wen, J. Eng. Mech. Div. ASCE 102 (1976) 249;
play operators removed most of the loop of a measured MEMS unit (835 to 128 deg/h, a lag alone to 403).
When left out: two branches over temperature, as far apart at any ramp rate and after a soak; the residual flips within
a few degrees after each reversal.
Look-alikes: creep (loop width changes with rate), temperature_rate and thermal_lag (vanish in a soak).
Separated by: minor loops, the same loop at two rates, a soak in the middle of a ramp.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from bench.analysis.effects.base import Effect, Parameter, Scale, Theta, check_choice, check_whole
from bench.analysis.effects.operators import bouc_wen, play
from bench.base import FloatArray
from bench.record import Dataset

SHAPES = ("play", "bouc_wen")
_NARROWEST_DEGC, _WIDEST_DEGC = 0.5, 40.0


@dataclass(frozen=True)
class Hysteresis(Effect):
    """Loops of one shape; `shape` play or bouc_wen, `count` 1 to 20 widths (play only)."""

    name = "hysteresis"
    family = "loop"
    needs = ("temperature",)

    shape: str = "play"
    count: int = 1
    widest_degc: float = field(default=_WIDEST_DEGC, repr=False, metadata={"fitted": True})

    def __post_init__(self) -> None:
        check_choice(self.name, "shape", self.shape, SHAPES)
        check_whole(self.name, "count", self.count, 1, 20 if self.shape == "play" else 1)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Half-width of the widest play, or length of the smooth loop [degC]."""
        meaning = "half-width of the widest play" if self.shape == "play" else "way to open the loop to 63 %"
        start = min(5.0, 0.5 * self.widest_degc)
        return (Parameter("width_degc", "degC", _NARROWEST_DEGC, self.widest_degc, start, True, meaning),)

    def shapes(self) -> tuple[Effect, ...]:
        """Play and Bouc-Wen, one effect for a ranking."""
        return tuple(replace(self, shape=shape, count=1) for shape in SHAPES) if self.count == 1 else (self,)

    def suited(self, records: Sequence[Dataset]) -> Hysteresis:
        """No loop wider than nearly the whole range: it would never turn."""
        spans = [2.0 * Scale.of([record], "temperature").half for record in records]
        return replace(self, widest_degc=float(np.clip(0.45 * max(spans), 2 * _NARROWEST_DEGC, _WIDEST_DEGC)))

    def columns(self, record: Dataset, theta: Theta) -> FloatArray:
        """Loops h (n, count) within [-1, 1], positive on heating; the first is the narrowest."""
        temperature, width = record.channel("temperature"), theta["width_degc"]
        if self.shape == "bouc_wen":
            return bouc_wen(temperature, width)[:, None]
        widths = [width * (i + 1) / self.count for i in range(self.count)]
        return np.column_stack([(temperature - play(temperature, r)) / r for r in widths])

    @property
    def amplitudes(self) -> tuple[tuple[str, str], ...]:
        """Half opening of each loop."""
        return tuple((f"a{i + 1}" if self.count > 1 else "a", "deg/h") for i in range(self.count))
