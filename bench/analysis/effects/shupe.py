"""Shupe effect of a fibre coil: a temperature that changes along the fibre while light passes both ways.

Equation: B = k1 r1 + k2 r2, r1 = (T - T1) / tau and r2 = (T1 - T2) / tau: dT/dt of the outer and the inner half of the
coil, each heated through what is outside it with the time constant tau. The exact form is the integral over the fibre
of (L - 2 l) dT(l, t)/dt dl. k1 + k2 acts on a steady ramp, and a symmetric winding (quadrupole) makes it small;
k1 - k2 acts where a gradient builds up.
Units: B [deg/h], T [degC], tau [s], r [degC/min], k [deg/h per degC/min].
Source: D. M. Shupe, Appl. Opt. 19 (1980) 654; F. Mohr, J. Lightwave Technol. 14 (1996) 27. Usual size 0.01 to 1 deg/h
per degC/min with quadrupole winding, ten times as much without; tau 1 to 20 min.
When left out: the residual has a peak where a ramp begins and one of the other sign where it ends.
Look-alikes: temperature_rate (keeps its level along a ramp, no peaks), thermal_lag, creep.
Separated by: steps and short ramps between long soaks; ramps at two rates.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.analysis.effects.base import Effect, Parameter, Theta
from bench.analysis.effects.operators import ramp_invariant_lag
from bench.base import FloatArray
from bench.record import Dataset


@dataclass(frozen=True)
class Shupe(Effect):
    """Two terms and the time constant of half a coil."""

    name = "shupe"
    family = "rate"
    needs = ("temperature",)
    parameters = (Parameter("tau_s", "s", 20.0, 3600.0, 200.0, log=True, meaning="time constant of half a coil"),)
    amplitudes = (("k1", "deg/h per degC/min"), ("k2", "deg/h per degC/min"))

    def columns(self, record: Dataset, theta: Theta) -> FloatArray:
        """Rates of the outer and of the inner half (n, 2) [degC/min]."""
        outside, tau_s = record.channel("temperature"), theta["tau_s"]
        outer = ramp_invariant_lag(record.time, outside, tau_s)
        inner = ramp_invariant_lag(record.time, outer, tau_s)
        return 60.0 / tau_s * np.column_stack([outside - outer, outer - inner])
