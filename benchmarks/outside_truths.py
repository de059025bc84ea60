"""Mechanisms that neither the catalogue nor the grammar of formulas holds literally, integrated second by second."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bench.base import FloatArray


@dataclass(frozen=True, eq=False)
class World:
    """States (n,) of every second: case and air of the chamber [degC], its switches, and the unit's channels."""

    time: FloatArray
    case: FloatArray
    air: FloatArray
    compressor: FloatArray
    heater: FloatArray
    quadrature: FloatArray
    drive: FloatArray
    frequency: FloatArray
    supply: FloatArray


Truth = Callable[[World, np.random.Generator], FloatArray]


def follows(source: FloatArray, tau_s: float) -> FloatArray:
    """A node that exchanges heat with a source, by small steps of its own balance."""
    node, level = np.empty(len(source)), float(source[0])
    share = 1.0 / tau_s
    for second, value in enumerate(source.tolist()):
        level += share * (value - level)
        node[second] = level
    return node


def _log(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def quadrature_of_a_gradient(w: World, rng: np.random.Generator) -> FloatArray:
    """The phase of the demodulator follows the difference between electronics and case; quadrature leaks through it."""
    return (w.case - follows(w.case, _log(rng, 200, 1500))) * w.quadrature


def radiation(w: World, rng: np.random.Generator) -> FloatArray:
    """Radiated heat between the case and a shielded mass: fourth powers of absolute temperatures."""
    mass = follows(w.case, _log(rng, 900, 3000))
    return ((w.case + 273.15) ** 4 - (mass + 273.15) ** 4) / 1e8


def stress_that_relaxes(w: World, rng: np.random.Generator) -> FloatArray:
    """Any change of temperature, up or down, adds stress, which relaxes."""
    tau_s, stress, level = _log(rng, 600, 3000), np.empty(len(w.case)), 0.0
    for second, step in enumerate(np.abs(np.diff(w.case, prepend=w.case[0])).tolist()):
        level += step - level / tau_s
        stress[second] = level
    return stress


def etalon_of_a_mass(w: World, rng: np.random.Generator) -> FloatArray:
    """Interference over a path whose length follows a mass inside."""
    inner = follows(w.case, _log(rng, 60, 240))
    return np.asarray(np.cos(2.0 * np.pi * inner / rng.uniform(7.0, 13.0) + rng.uniform(0, 6.28)) ** 3)


def beat(w: World, rng: np.random.Generator) -> FloatArray:
    """A neighbour's oscillator, near a multiple of the sampling rate."""
    own = rng.uniform(0, 6.28) + np.cumsum(np.full(len(w.time), 2.0 * np.pi / _log(rng, 500, 3300)))
    return np.asarray(np.sin(own))


def regulator(w: World, rng: np.random.Generator) -> FloatArray:
    """A regulator whose rejection of the supply weakens with temperature."""
    return (w.supply - np.median(w.supply)) * (w.case + rng.uniform(60.0, 90.0))


def compressor_heat(w: World, rng: np.random.Generator) -> FloatArray:
    """The compressor warms the mount while it runs."""
    return follows(w.compressor, _log(rng, 300, 1500))


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
    return (follows(w.air, _log(rng, 20, 60)) - w.case) * w.quadrature


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
    low, high = np.quantile(w.supply, [0.02, 0.98])
    edge = low + rng.uniform(0.35, 0.6) * (high - low)
    return np.asarray(np.logaddexp(0.0, (edge - w.supply) / (0.04 * (high - low))))


def plume(w: World, rng: np.random.Generator) -> FloatArray:
    """Air takes minutes on its way to the far side of the fixture."""
    late = round(_log(rng, 100, 400))
    far = np.concatenate([np.full(late, w.air[0]), w.air[:-late]])
    return far - w.case


# The following were written after the search was first frozen, and led to memories of powers, plays of channels, lags
# that change with temperature or direction, starts, and exposure.


def drying(w: World, rng: np.random.Generator) -> FloatArray:
    """Moisture that leaves, faster when it is warm, and does not come back."""
    wet, level, tau_s = np.empty(len(w.case)), 1.0, _log(rng, 4000, 12000)
    for second, rate in enumerate(np.exp((w.case - 25.0) / 20.0).tolist()):
        level -= level * rate / tau_s
        wet[second] = level
    return wet


def heater_pickup(w: World, rng: np.random.Generator) -> FloatArray:
    """The heater's current couples into the pick-off, in proportion to the quadrature."""
    return follows(w.heater, rng.uniform(5.0, 30.0)) * w.quadrature


def bimetal(w: World, rng: np.random.Generator) -> FloatArray:
    """A gradient bends a part whose stiffness depends on temperature."""
    return (w.case - follows(w.case, _log(rng, 100, 800))) * (1.0 + (w.case - 20.0) / rng.uniform(30.0, 60.0))


def sticking_electrode(w: World, rng: np.random.Generator) -> FloatArray:
    """The quadrature electrode follows its command only beyond a dead band."""
    band, at = rng.uniform(0.0045, 0.009), float(w.quadrature[0])
    stuck = np.empty(len(w.quadrature))
    for second, value in enumerate(w.quadrature.tolist()):
        at = min(max(at, value - band), value + band)
        stuck[second] = at
    return stuck - w.quadrature


def rectified_supply(w: World, rng: np.random.Generator) -> FloatArray:
    """What is fast of the supply is rectified in an amplifier."""
    return follows((w.supply - follows(w.supply, 120.0)) ** 2, _log(rng, 60, 300))


def starts_of_the_compressor(w: World, rng: np.random.Generator) -> FloatArray:
    """Each start of the compressor shakes the mount, which settles."""
    begins = np.clip(np.diff(w.compressor, prepend=w.compressor[0]), 0.0, None)
    tau_s, level, pulse = _log(rng, 150, 900), 0.0, np.empty(len(begins))
    for second, start in enumerate(begins.tolist()):
        level += start - level / tau_s
        pulse[second] = level
    return pulse


def two_walls(w: World, rng: np.random.Generator) -> FloatArray:
    """One side of the unit sees the air, the other the fixture, each through a wall."""
    return follows(w.air, _log(rng, 150, 500)) - follows(w.case, _log(rng, 20, 100))


def activated_relaxation(w: World, rng: np.random.Generator) -> FloatArray:
    """A glue relaxes towards the temperature, twice as fast for every 20 degC more."""
    state, glue, tau_s = float(w.case[0]), np.empty(len(w.case)), _log(rng, 600, 2400)
    for second, value in enumerate(w.case.tolist()):
        state += (value - state) / tau_s * 2.0 ** ((value - 25.0) / 20.0)
        glue[second] = state
    return glue - w.case


def drive_of_a_gradient(w: World, rng: np.random.Generator) -> FloatArray:
    """Damping that differs across the unit, in proportion to the amplitude's deviation."""
    return (w.drive - 2.5) * (w.case - follows(w.case, _log(rng, 100, 600)))


def quadrature_that_moves(w: World, rng: np.random.Generator) -> FloatArray:
    """The loop of the quadrature leaves an error while it moves."""
    tau_s = _log(rng, 100, 400)
    return (w.quadrature - follows(w.quadrature, tau_s)) / tau_s


def warms_fast_and_cools_slowly(w: World, rng: np.random.Generator) -> FloatArray:
    """A part in vacuum: it takes heat up faster than it gives it away."""
    up_s, times = _log(rng, 100, 400), rng.uniform(2.0, 3.5)
    part, state = np.empty(len(w.case)), float(w.case[0])
    for second, value in enumerate(w.case.tolist()):
        state += (value - state) / (up_s if value > state else times * up_s)
        part[second] = state
    return w.case - part


def root_of_a_flow(w: World, rng: np.random.Generator) -> FloatArray:
    """Convection that grows with the root of the difference that drives it."""
    flow = follows(w.air, 30.0) - follows(w.case, _log(rng, 30, 120))
    return np.asarray(np.sign(flow) * np.sqrt(np.abs(flow)))


# The following were written after the search was frozen again, and led to amplitudes that change with a channel, soft
# edges, films, extremes, overtones, and temperatures that lag.


def diffusion(w: World, rng: np.random.Generator) -> FloatArray:
    """Heat on its way into a thick wall of twenty layers; the gyro feels the surface against the tenth layer."""
    layers, share = np.full(20, float(w.case[0])), 1.0 / _log(rng, 8, 30)
    felt = np.empty(len(w.case))
    for second, value in enumerate(w.case.tolist()):
        beside = np.concatenate([[value], layers, layers[-1:]])
        layers = layers + share * np.diff(beside, 2)
        felt[second] = value - layers[10]
    return felt


def saturating_gradient(w: World, rng: np.random.Generator) -> FloatArray:
    """A gradient bends a part until it meets a stop."""
    gradient = w.case - follows(w.case, _log(rng, 100, 500))
    return np.asarray(np.clip(gradient / (rng.uniform(0.3, 0.6) * 8.0), -1.0, 1.0))


def condensation(w: World, rng: np.random.Generator) -> FloatArray:
    """A film grows while the case is colder than the air, and dries twice as fast."""
    film, level, tau_s = np.empty(len(w.case)), 0.0, _log(rng, 1000, 4000)
    for second, gap in enumerate((w.air - w.case).tolist()):
        level = max(0.0, level + (gap if gap > 0.0 else 2.0 * gap) / tau_s)
        film[second] = level
    return film


def supply_by_inner_temperature(w: World, rng: np.random.Generator) -> FloatArray:
    """The rejection of a regulator depends on its own temperature, which lags."""
    inner = follows(w.case, _log(rng, 400, 1500))
    return (w.supply - np.median(w.supply)) * (inner - rng.uniform(-20.0, 60.0))


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
    omega, damping = 2.0 * np.pi / _log(rng, 600, 1800), rng.uniform(0.2, 0.4)
    place = speed = 0.0
    rung = np.empty(len(w.case))
    for second, step in enumerate(np.diff(w.case, prepend=w.case[0]).tolist()):
        speed += omega * (step - 2.0 * damping * speed) - omega**2 * place
        place += speed
        rung[second] = place
    return rung


def dissipation_of_the_drive(w: World, rng: np.random.Generator) -> FloatArray:
    """The power of the drive warms the resonator, which warms slowly."""
    return follows(w.drive**2, _log(rng, 300, 1200))


def dead_zone_of_the_gap(w: World, rng: np.random.Generator) -> FloatArray:
    """A door seal moves once the air is far enough from the case."""
    gap = w.air - w.case
    return np.sign(gap) * np.clip(np.abs(gap) - rng.uniform(1.0, 3.0), 0.0, None)


# The following were written after the search was frozen for the third time, and led to a check run that has a say, and
# to terms that grow with a reference value of their own.


def outgassing(w: World, rng: np.random.Generator) -> FloatArray:
    """Pressure of a gas that a part gives off, more of it when it is warm, and a pump that takes it away."""
    tau_s, pressure, level = _log(rng, 600, 3000), np.empty(len(w.case)), 0.0
    source = np.exp((w.case - 25.0) / rng.uniform(18.0, 35.0)).tolist()
    level = source[0]
    for second, value in enumerate(source):
        level += (value - level) / tau_s
        pressure[second] = level
    return pressure


def buckling(w: World, rng: np.random.Generator) -> FloatArray:
    """A membrane that snaps over above one temperature, and back below another."""
    up, down = rng.uniform(35.0, 60.0), rng.uniform(-15.0, 15.0)
    side, state = np.empty(len(w.case)), -1.0
    for second, value in enumerate(w.case.tolist()):
        state = 1.0 if value > up else -1.0 if value < down else state
        side[second] = state
    return side


def since_the_turn(w: World, rng: np.random.Generator) -> FloatArray:
    """Friction is set free at each turn of the temperature, and tightens with the way since then."""
    way, length = np.empty(len(w.case)), rng.uniform(6.0, 20.0)
    last, turn, sign = float(w.case[0]), float(w.case[0]), 1.0
    for second, value in enumerate(follows(w.case, 20.0).tolist()):
        if (value - last) * sign < 0.0:
            turn, sign = last, -sign
        last = value
        way[second] = sign * (1.0 - np.exp(-abs(value - turn) / length))
    return way


def natural_convection(w: World, rng: np.random.Generator) -> FloatArray:
    """Heat by natural convection grows with the power 1.25 of the difference; the part beneath follows it."""
    gap = w.air - w.case
    return follows(np.sign(gap) * np.abs(gap) ** 1.25, _log(rng, 100, 600))


def transient_of_the_air(w: World, rng: np.random.Generator) -> FloatArray:
    """A thin cover feels the air at once, the frame it is held by later."""
    return follows(w.air, 15.0) - follows(w.air, _log(rng, 300, 1500))


def plastic_flow(w: World, rng: np.random.Generator) -> FloatArray:
    """Solder yields to a gradient, much faster to a large one, and recovers slowly."""
    gradient = (w.case - follows(w.case, _log(rng, 150, 500))) / rng.uniform(3.0, 6.0)
    tau_s, strain, level = _log(rng, 2000, 6000), np.empty(len(w.case)), 0.0
    for second, rate in enumerate(np.sinh(np.clip(gradient, -4.0, 4.0)).tolist()):
        level += rate / 600.0 - level / tau_s
        strain[second] = level
    return strain


def pulled_loop(w: World, rng: np.random.Generator) -> FloatArray:
    """The frequency loop lags while the frequency moves, by more the further it is from its centre."""
    behind = w.frequency - follows(w.frequency, _log(rng, 100, 500))
    return behind * np.abs(w.frequency - np.median(w.frequency))


def thermoelastic(w: World, rng: np.random.Generator) -> FloatArray:
    """Damping with a peak over temperature, in a gradient."""
    gradient = w.case - follows(w.case, _log(rng, 60, 300))
    ratio = np.exp((w.case - rng.uniform(0.0, 50.0)) / rng.uniform(10.0, 20.0))
    return gradient * 2.0 * ratio / (1.0 + ratio**2)


def two_masses(w: World, rng: np.random.Generator) -> FloatArray:
    """The difference between two masses acts in proportion to the temperature of the slower one."""
    fast, slow = follows(w.case, _log(rng, 60, 200)), follows(w.case, _log(rng, 800, 2000))
    return (fast - slow) * (slow + rng.uniform(20.0, 60.0))


def duty_cycle(w: World, rng: np.random.Generator) -> FloatArray:
    """A heater of the electronics switches by a clock of its own while it is cold."""
    period = _log(rng, 500, 1500)
    on = (np.mod(w.time, period) < rng.uniform(0.3, 0.6) * period) & (w.case < rng.uniform(10.0, 30.0))
    return follows(on.astype(np.float64), 30.0)


def one_sided_seal(w: World, rng: np.random.Generator) -> FloatArray:
    """A seal lets warm air in, and keeps cold air out for the most part."""
    gap = follows(w.air, _log(rng, 20, 100)) - w.case
    return np.where(gap > 0.0, gap, rng.uniform(0.0, 0.3) * gap)


def stretched_relaxation(w: World, rng: np.random.Generator) -> FloatArray:
    """Glue with many time constants, each with its own share."""
    taus = np.geomspace(_log(rng, 30, 80), _log(rng, 8000, 20000), 7)
    return np.asarray(sum((follows(w.case, tau) - w.case) * tau ** -rng.uniform(0.2, 0.5) for tau in taus.tolist()))


# The following were written after the check run had a say in which formula is best, before it had one in what is named.


def latent_heat(w: World, rng: np.random.Generator) -> FloatArray:
    """A wax in the potting melts: its temperature stands still until the heat of melting has flowed in or out."""
    at, latent, tau_s = rng.uniform(20.0, 50.0), rng.uniform(8.0, 20.0), _log(rng, 150, 600)
    part, heat = np.empty(len(w.case)), float(w.case[0])
    heat += latent if heat > at else 0.0
    for second, value in enumerate(w.case.tolist()):
        now = heat if heat < at else max(at, heat - latent)
        heat += (value - now) / tau_s
        part[second] = now
    return w.case - part


def package_leak(w: World, rng: np.random.Generator) -> FloatArray:
    """Gas leaves a package while it is warm and returns while it is cold; its pressure damps the mode."""
    tau_s, amount, pressure = _log(rng, 1500, 6000), 1.0, np.empty(len(w.case))
    for second, kelvin in enumerate(((w.case + 273.15) / 298.15).tolist()):
        inside = amount * kelvin
        amount -= (inside - 1.0) / tau_s
        pressure[second] = inside
    return pressure


def integrator_that_saturates(w: World, rng: np.random.Generator) -> FloatArray:
    """The quadrature loop integrates the error, and its integrator runs into its ends."""
    error = w.quadrature - np.median(w.quadrature)
    most, level, held = rng.uniform(200.0, 600.0) * float(np.std(error)), 0.0, np.empty(len(error))
    for second, value in enumerate(error.tolist()):
        level = min(max(level + value, -most), most)
        held[second] = level
    return held


def frosted_evaporator(w: World, rng: np.random.Generator) -> FloatArray:
    """Frost grows while the compressor runs in cold air, and melts in warm; it slows the air that cools the mount."""
    grows_s, melts_s, level, frost = _log(rng, 1500, 4000), _log(rng, 300, 900), 0.0, np.empty(len(w.air))
    for second, (runs, air) in enumerate(zip(w.compressor.tolist(), w.air.tolist(), strict=True)):
        level += runs * (air < 5.0) * (1.0 - level) / grows_s - max(0.0, air - 5.0) / 20.0 * level / melts_s
        frost[second] = level
    return frost * (w.air - w.case - 5.0)


def tilt_of_two_legs(w: World, rng: np.random.Generator) -> FloatArray:
    """The fixture stands on a thin leg in the air and a thick one on the plate: it tilts to the input axis."""
    thin, thick = follows(w.air, _log(rng, 60, 200)), follows(w.case, _log(rng, 900, 2500))
    return np.asarray(np.sin((thin - rng.uniform(1.05, 1.4) * thick) / 40.0))


def humid_board(w: World, rng: np.random.Generator) -> FloatArray:
    """A board takes up water by the relative humidity of the air, which falls as the air warms, and leaks with it."""
    water = follows(np.exp(-np.clip(w.air, -20.0, None) / rng.uniform(14.0, 20.0)), _log(rng, 1500, 5000))
    return np.asarray(water**1.5)


def backlash_of_the_gap(w: World, rng: np.random.Generator) -> FloatArray:
    """A duct bends with the difference to the air and drags a hinge with play along."""
    gap = follows(w.air - w.case, 40.0)
    half, at, dragged = rng.uniform(0.15, 0.35) * float(np.ptp(gap)) / 2.0, float(gap[0]), np.empty(len(gap))
    for second, value in enumerate(gap.tolist()):
        at = min(max(at, value - half), value + half)
        dragged[second] = at
    return dragged


def slew_limited(w: World, rng: np.random.Generator) -> FloatArray:
    """A loop follows the temperature, and no faster than its slew rate."""
    most, at, behind = rng.uniform(0.7, 0.95) / 60.0, float(w.case[0]), np.empty(len(w.case))
    for second, value in enumerate(w.case.tolist()):
        at += min(max(value - at, -most), most)
        behind[second] = value - at
    return behind


# The following were written after the search was frozen for the last time, and changed nothing.


def turns_that_count(w: World, rng: np.random.Generator) -> FloatArray:
    """A solder joint yields at each turn of the temperature, in proportion to the swing before it, and heals slowly."""
    heals_s, level, last, way = _log(rng, 6000, 20000), 0.0, float(w.case[0]), 0.0
    yielded = np.empty(len(w.case))
    for second, value in enumerate(w.case.tolist()):
        step = value - last
        if step * way < 0.0 and abs(step) > 1e-4:
            level, way = level + abs(way), 0.0
        way, last = way + step, value
        level *= 1.0 - 1.0 / heals_s
        yielded[second] = level
    return yielded


def saturating_air_gap(w: World, rng: np.random.Generator) -> FloatArray:
    """The gradient through the housing bends a strip until it touches on either side."""
    gap = follows(w.air - w.case, _log(rng, 60, 400))
    touches = rng.uniform(0.15, 0.4) * float(np.max(np.abs(gap)))
    return np.asarray(np.tanh(gap / touches))


def glass_transition(w: World, rng: np.random.Generator) -> FloatArray:
    """An adhesive flows above its glass transition, and holds its shape below it."""
    at, shape, frozen = rng.uniform(35.0, 65.0), float(w.case[0]), np.empty(len(w.case))
    for second, value in enumerate(w.case.tolist()):
        shape += (value - shape) / (400.0 * np.exp(-(min(value, at + 20.0) - at) / 6.0))
        frozen[second] = value - shape
    return frozen


def compressor_beside_a_mode(w: World, rng: np.random.Generator) -> FloatArray:
    """The compressor shakes the mount, the more the nearer the drive's frequency is to a mode of it."""
    span = float(np.ptp(w.frequency))
    mode = rng.uniform(float(w.frequency.min()), float(w.frequency.max()))
    return follows(w.compressor, 20.0) / (1.0 + ((w.frequency - mode) / (rng.uniform(0.1, 0.3) * span)) ** 2)


def sag_of_the_heater(w: World, rng: np.random.Generator) -> FloatArray:
    """The heater's load warms a reference that scales the drive."""
    return follows(w.heater, _log(rng, 200, 900)) * (w.drive - rng.uniform(0.2, 0.8) * float(w.drive.min())) ** 2


def water_in_a_slab(w: World, rng: np.random.Generator) -> FloatArray:
    """Water diffuses into a board of five layers from the air's side; the innermost one leaks."""
    rate = 1.0 / _log(rng, 250, 700)
    layers = np.full(5, float(np.exp(-w.air[0] / 18.0)))
    inner = np.empty(len(w.air))
    for second, outside in enumerate(np.exp(-np.clip(w.air, -20.0, None) / 18.0).tolist()):
        left = np.concatenate([[outside], layers[:-1]])
        right = np.concatenate([layers[1:], layers[-1:]])
        layers += rate * (left - 2.0 * layers + right)
        inner[second] = layers[-1]
    return inner


def quadrature_with_a_threshold(w: World, rng: np.random.Generator) -> FloatArray:
    """A comparator adds a share of the quadrature only while the temperature rises faster than a value."""
    slope = np.gradient(follows(w.case, 60.0)) * 60.0
    return (slope > rng.uniform(0.55, 0.8)) * (w.quadrature - rng.uniform(0.2, 0.8) * float(w.quadrature.max()))


def two_loops(w: World, rng: np.random.Generator) -> FloatArray:
    """Two joints with play in a row: the second one is dragged by the first, at another stiffness."""
    dragged = w.case
    for half in rng.uniform((2.0, 4.0), (6.0, 12.0)).tolist():
        at, moved = float(dragged[0]), np.empty(len(dragged))
        for second, value in enumerate(dragged.tolist()):
            at = min(max(at, value - half), value + half)
            moved[second] = at
        dragged = moved
    return (w.case - dragged) * (1.0 + w.case / rng.uniform(60.0, 120.0))


TRUTHS: dict[str, Truth] = {
    truth.__name__: truth
    for truth in (
        quadrature_of_a_gradient, radiation, stress_that_relaxes, etalon_of_a_mass, beat, regulator, compressor_heat,
        crossing_of_modes, melting, duffing, leak_by_the_air, friction_joints, brown_out, plume,
        drying, heater_pickup, bimetal, sticking_electrode, rectified_supply, starts_of_the_compressor, two_walls,
        activated_relaxation, drive_of_a_gradient, quadrature_that_moves, warms_fast_and_cools_slowly, root_of_a_flow,
        diffusion, saturating_gradient, condensation, supply_by_inner_temperature, frequency_pulling,
        quadrature_by_frequency, compressor_when_cold, exposure_above, first_heating, ringing_mount,
        dissipation_of_the_drive, dead_zone_of_the_gap,
        outgassing, buckling, since_the_turn, natural_convection, transient_of_the_air, plastic_flow, pulled_loop,
        thermoelastic, two_masses, duty_cycle, one_sided_seal, stretched_relaxation,
        latent_heat, package_leak, integrator_that_saturates, frosted_evaporator, tilt_of_two_legs, humid_board,
        backlash_of_the_gap, slew_limited,
        turns_that_count, saturating_air_gap, glass_transition, compressor_beside_a_mode, sag_of_the_heater,
        water_in_a_slab, quadrature_with_a_threshold, two_loops,
    )
}  # fmt: skip
_NAMES = tuple(TRUTHS)
GROUPS = {
    "before the search was frozen": _NAMES[:14],
    "after it was frozen, before it grew": _NAMES[14:26],
    "after it was frozen again, before it grew again": _NAMES[26:38],
    "after the third time, before a check run had a say": _NAMES[38:50],
    "after the fourth time, before it had one in what is named": _NAMES[50:58],
    "after it was frozen for the last time": _NAMES[58:],
}
"""When the mechanisms were written."""
