"""Input and output of every mechanism of the truth.

The truth integrates separate states; it shares no formula with the analysis half. A mechanism is a frozen, strictly
validated set of named parameters (each with its unit) whose `start` returns a function to call once per step. Steps
are resolved on *nodes*, the sampling times of the slow channels plus the end of the step, so the last node of one step
is the first of the next.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache
from typing import ClassVar, Literal

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict

FloatArray = npt.NDArray[np.float64]


@dataclass(slots=True)
class Scene:
    """Environment and channels during one step: arrays over its nodes `(m + 1,)`, scalars constant over the step."""

    time: FloatArray
    """Bench time [s]."""
    on: FloatArray
    """Time since power came on [s]; 0 while off."""
    node_s: float
    """Time between nodes [s]."""
    case: FloatArray
    """Temperature of the unit's case [degC]."""
    sensor: FloatArray
    """Temperature of the unit's thermometer, before its noise [degC]."""
    resonator: FloatArray
    """Temperature of the resonator [degC]."""
    air: FloatArray
    """Chamber air [degC]."""
    applied_rate: FloatArray
    """True rate of rotation of the unit [deg/s]."""
    supply: FloatArray
    """Supply at the unit's pins [V]."""
    compressor: float
    """Share of the step that the compressor runs, 0 to 1."""
    heater: float
    """Share of the heater's power, 0 to 1."""
    humidity: float
    """Relative humidity of the gas in the chamber at ambient, 0 to 1."""
    powered: bool
    power_on: int = 1
    """Which power-on of the unit's life this is, counted from 1."""
    frequency: FloatArray = field(default_factory=lambda: np.empty(0))
    """Resonance frequency [Hz]."""
    drive: FloatArray = field(default_factory=lambda: np.empty(0))
    """Drive amplitude [V]."""
    drive_share: FloatArray = field(default_factory=lambda: np.empty(0))
    """Drive amplitude relative to its nominal value, minus one."""
    quadrature_dps: FloatArray = field(default_factory=lambda: np.empty(0))
    """Quadrature as a rate [deg/s]."""


Contribution = Callable[[Scene], FloatArray]
"""Called once per step, in order of time: the bias that a mechanism adds at the nodes [deg/h], shape `(m + 1,)`."""


class Mechanism(BaseModel):
    """Parameters of one mechanism; the class docstring describes it and gives its source."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    effect: ClassVar[str | None] = None
    """The effect of the analysis library that covers it; None when the library does not."""
    kind: ClassVar[Literal["thermal", "static", "bias"]] = "bias"
    """`thermal` sets the resonator's temperature, `static` is a function of only this temperature, `bias` any other."""
    lifelong: ClassVar[bool] = False
    """Whether one random stream serves all power-ons of the unit; otherwise each run draws from a new one."""


class Lag:
    """First-order lag, exact for an input that is linear over each step; starts in equilibrium."""

    def __init__(self, tau_s: float) -> None:
        self.tau_s = tau_s
        self.value: float | None = None

    def __call__(self, node_s: float, u: FloatArray) -> FloatArray:
        """Response [unit of u] at the nodes to an input that goes straight from `u[0]` to `u[-1]`, shape of `u`."""
        n = len(u) - 1
        first, slope = float(u[0]), float(u[-1] - u[0]) / (n * node_s)
        start = first if self.value is None else self.value
        offset = -slope * self.tau_s
        steady = first + offset + slope * node_s * _count(n + 1)
        response: FloatArray = steady + (start - first - offset) * decay(self.tau_s, node_s, n + 1)
        self.value = float(response[-1])
        return response


def straight(first: float, last: float, nodes: int) -> FloatArray:
    """Straight line over the nodes of a step, shape `(nodes,)`: as `numpy.linspace`, five times faster."""
    line = _count(nodes) * ((last - first) / (nodes - 1))
    line += first
    line[-1] = last
    return line


@lru_cache(maxsize=16)
def _count(nodes: int) -> FloatArray:
    numbers = np.arange(nodes, dtype=np.float64)
    numbers.setflags(write=False)
    return numbers


@lru_cache(maxsize=256)
def decay(tau_s: float, node_s: float, nodes: int) -> FloatArray:
    """exp(-t / tau) at the nodes of a step, shape `(nodes,)`; cached, so read only."""
    table = np.exp(-node_s / tau_s * np.arange(nodes, dtype=np.float64))
    table.setflags(write=False)
    return table


class OrnsteinUhlenbeck:
    """Sum of stationary first-order processes on the nodes, generated ahead in blocks for speed.

    It does not depend on how the record is divided into steps.
    """

    BLOCK = 3000

    def __init__(self, tau_s: FloatArray, sigma: FloatArray, node_s: float, rng: np.random.Generator) -> None:
        self._keep = np.exp(-node_s / tau_s)
        self._kick = sigma * np.sqrt(-np.expm1(-2.0 * node_s / tau_s))
        self._state = sigma * rng.standard_normal(len(tau_s))
        self._rng = rng
        self._ahead = np.array([self._state.sum()])

    def __call__(self, nodes: int) -> FloatArray:
        """Values at the next nodes; the last one is repeated as the first of the next call."""
        while len(self._ahead) < nodes:
            self._ahead = np.concatenate([self._ahead, self._block()])
        taken, self._ahead = self._ahead[:nodes], self._ahead[nodes - 1 :]
        return taken

    def _block(self) -> FloatArray:
        from scipy.signal import lfilter  # a second of imports, which only a run needs

        total = np.zeros(self.BLOCK)
        for i, (keep, kick) in enumerate(zip(self._keep, self._kick, strict=True)):
            white = kick * self._rng.standard_normal(self.BLOCK)
            path, _ = lfilter([1.0], [1.0, -keep], white, zi=[keep * self._state[i]])
            self._state[i] = path[-1]
            total += path
        return total
