"""The first mechanisms that neither the catalogue nor the grammar of formulas held, integrated second by second."""

from __future__ import annotations

import numpy as np

from bench.base import FloatArray
from benchmarks.mechanisms.world import World, dragged, follows, log_uniform, unevenly


def quadrature_of_a_gradient(w: World, rng: np.random.Generator) -> FloatArray:
    """The phase of the demodulator follows the difference between electronics and case; quadrature leaks through it."""
    return (w.case - follows(w.case, log_uniform(rng, 200, 1500))) * w.quadrature


def radiation(w: World, rng: np.random.Generator) -> FloatArray:
    """Radiated heat between the case and a shielded mass: fourth powers of absolute temperatures."""
    mass = follows(w.case, log_uniform(rng, 900, 3000))
    return ((w.case + 273.15) ** 4 - (mass + 273.15) ** 4) / 1e8


def stress_that_relaxes(w: World, rng: np.random.Generator) -> FloatArray:
    """Any change of temperature, up or down, adds stress, which relaxes."""
    tau_s, stress, level = log_uniform(rng, 600, 3000), np.empty(len(w.case)), 0.0
    for second, step in enumerate(np.abs(np.diff(w.case, prepend=w.case[0])).tolist()):
        level += step - level / tau_s
        stress[second] = level
    return stress


def etalon_of_a_mass(w: World, rng: np.random.Generator) -> FloatArray:
    """Interference over a path whose length follows a mass inside."""
    inner = follows(w.case, log_uniform(rng, 60, 240))
    return np.asarray(np.cos(2.0 * np.pi * inner / rng.uniform(7.0, 13.0) + rng.uniform(0, 6.28)) ** 3)


def beat(w: World, rng: np.random.Generator) -> FloatArray:
    """A neighbour's oscillator, near a multiple of the sampling rate."""
    own = rng.uniform(0, 6.28) + np.cumsum(np.full(len(w.time), 2.0 * np.pi / log_uniform(rng, 500, 3300)))
    return np.asarray(np.sin(own))


def regulator(w: World, rng: np.random.Generator) -> FloatArray:
    """A regulator whose rejection of the supply weakens with temperature."""
    return (w.supply - w.constant(np.median(w.supply))) * (w.case + rng.uniform(60.0, 90.0))


def compressor_heat(w: World, rng: np.random.Generator) -> FloatArray:
    """The compressor warms the mount while it runs."""
    return follows(w.compressor, log_uniform(rng, 300, 1500))


def crossing_of_modes(w: World, rng: np.random.Generator) -> FloatArray:
    """Near one temperature two modes couple, and gradients act there only (a Lorentzian)."""
    slope = w.case - follows(w.case, 45.0)
    return slope / (1.0 + ((w.case - rng.uniform(0.0, 55.0)) / rng.uniform(4.0, 9.0)) ** 2)


def melting(w: World, rng: np.random.Generator) -> FloatArray:
    """Ice that melts on the way up, near one temperature, and is not there on the way down."""
    at, width = rng.uniform(0.0, 8.0), rng.uniform(3.0, 6.0)
    up = np.clip(w.case - follows(w.case, 60.0), 0.0, None)
    return up / np.cosh((w.case - at) / width)


def duffing(w: World, rng: np.random.Generator) -> FloatArray:
    """Stiffness that grows with the square of the amplitude."""
    return w.drive**3 - 3.0 * w.drive * 2.5**2


def leak_by_the_air(w: World, rng: np.random.Generator) -> FloatArray:
    """A gradient from the air through the housing shifts the phase; quadrature leaks through it."""
    return (follows(w.air, log_uniform(rng, 20, 60)) - w.case) * w.quadrature


def friction_joints(w: World, rng: np.random.Generator) -> FloatArray:
    """Three joints that slip one after the other."""
    total = np.zeros(len(w.case))
    for limit in (rng.uniform(1, 3), rng.uniform(4, 8), rng.uniform(9, 16)):
        held, last = 0.0, float(w.case[0])
        joint = np.empty(len(w.case))
        for second, value in enumerate(w.case.tolist()):
            held = min(max(held + value - last, -limit), limit)
            joint[second], last = held, value
        total += joint
    return total


def brown_out(w: World, rng: np.random.Generator) -> FloatArray:
    """Below a voltage the reference gives way."""
    low, high = (w.constant(np.quantile(w.supply, share)) for share in (0.02, 0.98))
    edge = low + rng.uniform(0.35, 0.6) * (high - low)
    return np.asarray(np.logaddexp(0.0, (edge - w.supply) / (0.04 * (high - low))))


def plume(w: World, rng: np.random.Generator) -> FloatArray:
    """Air takes minutes on its way to the far side of the fixture."""
    late = round(log_uniform(rng, 100, 400))
    far = np.concatenate([np.full(late, w.air[0]), w.air[:-late]])
    return far - w.case


# The following were written after the search was first frozen, and led to memories of powers, plays of channels, lags
# that change with temperature or direction, starts, and exposure.


def drying(w: World, rng: np.random.Generator) -> FloatArray:
    """Moisture that leaves, faster when it is warm, and does not come back."""
    wet, level, tau_s = np.empty(len(w.case)), 1.0, log_uniform(rng, 4000, 12000)
    for second, rate in enumerate(np.exp((w.case - 25.0) / 20.0).tolist()):
        level -= level * rate / tau_s
        wet[second] = level
    return wet


def heater_pickup(w: World, rng: np.random.Generator) -> FloatArray:
    """The heater's current couples into the pick-off, in proportion to the quadrature."""
    return follows(w.heater, rng.uniform(5.0, 30.0)) * w.quadrature


def bimetal(w: World, rng: np.random.Generator) -> FloatArray:
    """A gradient bends a part whose stiffness depends on temperature."""
    return (w.case - follows(w.case, log_uniform(rng, 100, 800))) * (1.0 + (w.case - 20.0) / rng.uniform(30.0, 60.0))


def sticking_electrode(w: World, rng: np.random.Generator) -> FloatArray:
    """The quadrature electrode follows its command only beyond a dead band."""
    return dragged(w.quadrature, rng.uniform(0.0045, 0.009)) - w.quadrature


def rectified_supply(w: World, rng: np.random.Generator) -> FloatArray:
    """What is fast of the supply is rectified in an amplifier."""
    return follows((w.supply - follows(w.supply, 120.0)) ** 2, log_uniform(rng, 60, 300))


def starts_of_the_compressor(w: World, rng: np.random.Generator) -> FloatArray:
    """Each start of the compressor shakes the mount, which settles."""
    begins = np.clip(np.diff(w.compressor, prepend=w.compressor[0]), 0.0, None)
    tau_s, level, pulse = log_uniform(rng, 150, 900), 0.0, np.empty(len(begins))
    for second, start in enumerate(begins.tolist()):
        level += start - level / tau_s
        pulse[second] = level
    return pulse


def two_walls(w: World, rng: np.random.Generator) -> FloatArray:
    """One side of the unit sees the air, the other the fixture, each through a wall."""
    return follows(w.air, log_uniform(rng, 150, 500)) - follows(w.case, log_uniform(rng, 20, 100))


def activated_relaxation(w: World, rng: np.random.Generator) -> FloatArray:
    """A glue relaxes towards the temperature, twice as fast for every 20 degC more."""
    state, glue, tau_s = float(w.case[0]), np.empty(len(w.case)), log_uniform(rng, 600, 2400)
    for second, value in enumerate(w.case.tolist()):
        state += (value - state) / tau_s * 2.0 ** ((value - 25.0) / 20.0)
        glue[second] = state
    return glue - w.case


def drive_of_a_gradient(w: World, rng: np.random.Generator) -> FloatArray:
    """Damping that differs across the unit, in proportion to the amplitude's deviation."""
    return (w.drive - 2.5) * (w.case - follows(w.case, log_uniform(rng, 100, 600)))


def quadrature_that_moves(w: World, rng: np.random.Generator) -> FloatArray:
    """The loop of the quadrature leaves an error while it moves."""
    tau_s = log_uniform(rng, 100, 400)
    return (w.quadrature - follows(w.quadrature, tau_s)) / tau_s


def warms_fast_and_cools_slowly(w: World, rng: np.random.Generator) -> FloatArray:
    """A part in vacuum: it takes heat up faster than it gives it away."""
    up_s, times = log_uniform(rng, 100, 400), rng.uniform(2.0, 3.5)
    return w.case - unevenly(w.case, up_s, times * up_s)


def root_of_a_flow(w: World, rng: np.random.Generator) -> FloatArray:
    """Convection that grows with the root of the difference that drives it."""
    flow = follows(w.air, 30.0) - follows(w.case, log_uniform(rng, 30, 120))
    return np.asarray(np.sign(flow) * np.sqrt(np.abs(flow)))


# The following were written after the search was frozen again, and led to amplitudes that change with a channel, soft
# edges, films, extremes, overtones, and temperatures that lag.


def diffusion(w: World, rng: np.random.Generator) -> FloatArray:
    """Heat on its way into a thick wall of twenty layers; the gyro feels the surface against the tenth layer."""
    layers, share = np.full(20, float(w.case[0])), 1.0 / log_uniform(rng, 8, 30)
    felt = np.empty(len(w.case))
    for second, value in enumerate(w.case.tolist()):
        beside = np.concatenate([[value], layers, layers[-1:]])
        layers = layers + share * np.diff(beside, 2)
        felt[second] = value - layers[10]
    return felt


def saturating_gradient(w: World, rng: np.random.Generator) -> FloatArray:
    """A gradient bends a part until it meets a stop."""
    gradient = w.case - follows(w.case, log_uniform(rng, 100, 500))
    return np.asarray(np.clip(gradient / (rng.uniform(0.3, 0.6) * 8.0), -1.0, 1.0))


def condensation(w: World, rng: np.random.Generator) -> FloatArray:
    """A film grows while the case is colder than the air, and dries twice as fast."""
    film, level, tau_s = np.empty(len(w.case)), 0.0, log_uniform(rng, 1000, 4000)
    for second, gap in enumerate((w.air - w.case).tolist()):
        level = max(0.0, level + (gap if gap > 0.0 else 2.0 * gap) / tau_s)
        film[second] = level
    return film


def supply_by_inner_temperature(w: World, rng: np.random.Generator) -> FloatArray:
    """The rejection of a regulator depends on its own temperature, which lags."""
    inner = follows(w.case, log_uniform(rng, 400, 1500))
    return (w.supply - w.constant(np.median(w.supply))) * (inner - rng.uniform(-20.0, 60.0))


def frequency_pulling(w: World, rng: np.random.Generator) -> FloatArray:
    """The mode is pulled each time its frequency passes a line of a comb."""
    return np.asarray(np.sin(2.0 * np.pi * w.frequency / rng.uniform(1.5, 3.0) + rng.uniform(0, 6.28)))


def quadrature_by_frequency(w: World, rng: np.random.Generator) -> FloatArray:
    """The phase of the demodulator follows the frequency; quadrature leaks through it."""
    return w.quadrature * (w.frequency - rng.uniform(13998.0, 14005.0))


def compressor_when_cold(w: World, rng: np.random.Generator) -> FloatArray:
    """Lubricant stiffens: the compressor shakes the mount below a temperature only."""
    return w.compressor / (1.0 + np.exp((w.case - rng.uniform(-20.0, 10.0)) / 3.0))


def exposure_above(w: World, rng: np.random.Generator) -> FloatArray:
    """A getter releases gas above a temperature, and keeps nothing back."""
    return np.cumsum(np.clip(w.case - rng.uniform(40.0, 65.0), 0.0, None)) / 3600.0


def first_heating(w: World, rng: np.random.Generator) -> FloatArray:
    """Stress that is lost whenever the temperature is higher than it ever was."""
    return np.maximum.accumulate(w.case) + rng.uniform(0.0, 0.5) * np.minimum.accumulate(w.case)


def ringing_mount(w: World, rng: np.random.Generator) -> FloatArray:
    """A mount of two masses exchanges heat like a damped oscillation after each change of the ramp."""
    omega, damping = 2.0 * np.pi / log_uniform(rng, 600, 1800), rng.uniform(0.2, 0.4)
    place = speed = 0.0
    rung = np.empty(len(w.case))
    for second, step in enumerate(np.diff(w.case, prepend=w.case[0]).tolist()):
        speed += omega * (step - 2.0 * damping * speed) - omega**2 * place
        place += speed
        rung[second] = place
    return rung


def dissipation_of_the_drive(w: World, rng: np.random.Generator) -> FloatArray:
    """The power of the drive warms the resonator, which warms slowly."""
    return follows(w.drive**2, log_uniform(rng, 300, 1200))


def dead_zone_of_the_gap(w: World, rng: np.random.Generator) -> FloatArray:
    """A door seal moves once the air is far enough from the case."""
    gap = w.air - w.case
    return np.sign(gap) * np.clip(np.abs(gap) - rng.uniform(1.0, 3.0), 0.0, None)
