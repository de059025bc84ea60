"""The physics of formulas that are special cases which the literature or the shop floor knows."""

from __future__ import annotations

import numpy as np

from bench.analysis.diagnosis.found_formula import FoundFormula
from bench.analysis.diagnosis.suspects import Layout

_CURVED = 0.25  # of the range of temperature: a sine with a longer period is a bend and no interference

_ETALON = "like an etalon: interference, optical or electrical, over temperature"
_COARSE = "like a curve that the model follows too coarsely: more intervals of its spline may do the same"
_OVEN = "like a part inside that an oven or a regulator holds until it has no more to give"
_LIKE = (
    ("sin(2*pi*lag(temperature", "like an etalon whose path follows a part inside the unit"),
    ("sin(2*pi*temperature", _ETALON),
    ("sin(2*pi*(temperature", "like an etalon whose path drifts, as it ages or relaxes"),
    (") * above(chamber_temperature - lag(", "like interference of the chamber's heater, aliased by the sampling"),
    (") * above(lag(chamber_temperature", "like interference of the chamber's cooling, aliased by the sampling"),
    ("sin(2*pi*(time -", "like a heater, a pump or a valve that a clock of its own switches"),
    ("sin(2*pi*time", "like a disturbance with a period of its own: a beat, a control loop, a neighbour"),
    ("lag(latch(lag(", "like a shock at each turn of the temperature that settles: a joint or a cable that reverses"),
    ("latch(", "like a part that snaps over: a buckled membrane, a contact, a change of phase"),
    ("uneven_lag(", "like what is taken up faster than it is given off, or slower: gas through a valve, charge, water"),
    ("(dT_dt - lag(dT_dt", "like heat that spreads from part to part: it acts where the rate of change changes"),
    ("slew(", "like a control loop that follows the temperature no faster than its slew rate"),
    ("lag(dead_zone(temperature", _OVEN),
    ("dead_zone(lag(temperature", _OVEN),
    ("dead_zone(", "like a part with clearance, which acts only beyond it"),
    ("tanh((abs(dT_dt)", "like what acts only while the temperature rests, or only while it changes"),
    ("tanh((dT_dt", "like what acts only beyond a rate of change: a comparator, a protection, a chamber at full power"),
    ("tanh(lag(", "like a part or a loop that reaches its limits"),
    ("play(total(", "like an integrator that runs into its limits"),
    ("play(tanh((temperature", "like a change of phase or a magnet, which comes later than it goes"),
    ("lag(tanh((temperature", "like a change of state at one temperature that takes its time"),
    ("lag(above(temperature", "like what gives way above a temperature and recovers: softening, released gas"),
    ("/(1 + ((frequency", "like a mode of the package that the frequency of the drive meets"),
    ("sawtooth(", "like a correction in steps of temperature, a converter, or a light source that hops between modes"),
    ("above(chamber_temperature - lag(chamber_temperature", "like the chamber's heater: its current or its field"),
    ("above(lag(chamber_temperature", "like the chamber's cooling: its compressor or its valve"),
    ("lag(sign(", "like solder or glue that yields by a power of the stress, and recovers"),
    ("sign(lag(", "like a strain or a loss of heat that grows by a power of a gradient: radiation, contact"),
    ("play((chamber_temperature", "like a hinge, a duct or a cable with play between chamber and unit"),
    ("lowest(total(", "like a film that grows and dries: condensation, frost, outgassing"),
    ("highest(", "like stress that is lost whenever the unit is warmer than ever before"),
    ("lowest(", "like stress that is lost whenever the unit is colder than ever before"),
    ("lag(exp(", "like water or gas that is taken up and given off: its pressure is an exponential of the temperature"),
    ("play(temperature, ", "like friction or micro-slip in mount, glue or solder"),
    ("lag(temperature, 100 * exp(", "like a polymer at its glass transition: glue, potting, a seal"),
    ("(25 - temperature)", "like stress that relaxes, the faster the warmer: glue, solder, packaging"),
    ("lag(temperature, 25 * ", "like heat that spreads into a thick body: a base plate, potting, a housing"),
    ("(temperature - lag(temperature", "like the gradient to a part inside that follows the temperature"),
    ("exp(-total(", "like a loss that does not come back: moisture, gas, stress that heat takes out"),
    ("total(", "like an exposure that adds up: dose, creep, fatigue"),
    ("above(compressor - delay(compressor", "like a shock at each start or stop of the compressor that settles"),
    ("lag(compressor", "like heat or vibration of the compressor that reaches the unit with a delay"),
    ("play(temperature", "like a hysteresis: a mount, a glue, a solder joint"),
    ("lag(dT_dt", "like a thermal memory: gradients in the unit that outlast the change of temperature"),
    ("lag(abs(dT_dt)", "like a stress or gradient that any change of temperature leaves, and that relaxes"),
    ("lag((chamber_temperature", "like a gradient from the air through the housing"),
    ("chamber_temperature", "like a gradient from the air through the housing"),
    ("quadrature", "like quadrature that leaks through the phase of the demodulation"),
    ("exp(-((temperature", "an effect of a part of the temperature range"),
    ("tanh((temperature", "an effect of a part of the temperature range"),
    ("drive", "like the amplitude of the drive: stiffness or damping that depends on it"),
    ("dT_dt**2", "like a gradient across the unit that grows faster than the rate of change"),
    ("exp(-time", "like a warm-up"),
)


def physics_of(layout: Layout, one: FoundFormula) -> str:
    """The physics of a recognised special case."""
    words = next((words for part, words in _LIKE if part in one.text), "")
    if words != _ETALON or one.theta[0] < _CURVED * float(np.ptp(layout.temperature)):
        return words
    return _COARSE if len(one.formula.blocks) == 1 else ""
