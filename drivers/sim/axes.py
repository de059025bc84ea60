"""A simulated unit with several outputs: single-axis truths side by side, in the same surroundings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from drivers.errors import ConfigError
from drivers.layout import ACCELERATIONS, OUTPUTS, RATES, THERMOMETERS, Layout
from drivers.sim.resonator import DIVIDER, Environment, PowerOn, Resonator, UnitSettings, default_unit
from drivers.sim.truth.base import FloatArray

MS2_PER_DPH = 1e-4
"""An accelerometer is simulated as a gyro whose deg/h are so many m/s^2 …"""
GRAVITY = {"acceleration_z": 9.80665}
"""… beside what it measures at rest [m/s^2]."""
_SLOW = ("frequency", "drive", "quadrature")


class Axes:
    """The truths of a unit, by output; each has a seed and a turn-on of its own. Only the first one turns."""

    def __init__(self, layout: Layout, simulation: Mapping[str, Any] | None, seed: int, power: PowerOn) -> None:
        """`simulation` has the settings of a truth by output. ConfigError for other outputs."""
        self._channels = tuple(layout.channels)
        outputs = [name for name in OUTPUTS if name in self._channels]
        given = dict(simulation or {})
        if wrong := given.keys() - {*outputs}:
            text = f"it has {', '.join(outputs)}"
            raise ConfigError(f"simulation: {', '.join(sorted(wrong))} is not an output of this unit; {text}")
        self._rate_hz = 1e3 / layout.interval_ms
        self._axes = {
            name: Resonator(
                UnitSettings.parse(given[name]) if name in given else default_unit(),
                seed + 101 * place,
                self._rate_hz,
                power=replace(power, seed=(power.seed or 0) + 101 * place),
            )
            for place, name in enumerate(outputs)
        }
        self._turning = next((name for name in outputs if name in RATES), outputs[0])

    def advance(self, environment: Environment) -> dict[str, FloatArray]:
        """Values (n,) of all channels, in their units."""
        environment = replace(environment, rate_hz=self._rate_hz)
        still = replace(environment, applied_rate_dps=(0.0, 0.0))
        found, values = {}, {}
        for name, axis in self._axes.items():
            found[name] = axis.advance(environment if name == self._turning else still)
            values[name] = found[name].rate_dph
            if name in ACCELERATIONS:
                values[name] = GRAVITY.get(name, 0.0) + MS2_PER_DPH * values[name]
        dies = list(found.values())
        for place, name in enumerate(name for name in self._channels if THERMOMETERS.fullmatch(name)):
            values[name] = np.repeat(dies[place % len(dies)].temperature, DIVIDER)
        for name in set(_SLOW) & set(self._channels):
            values[name] = np.repeat(getattr(dies[0], name), DIVIDER)
        if "supply" in self._channels:
            values["supply"] = np.full(environment.samples, dies[0].supply)
        return values
