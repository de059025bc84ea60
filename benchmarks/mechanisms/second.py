"""The second group of mechanisms, integrated second by second, too."""

from __future__ import annotations

import numpy as np

from bench.base import FloatArray
from benchmarks.mechanisms.world import World, dragged, follows, log_uniform, switched, unevenly

# The following were written after the search was frozen for the third time, and led to a check run that has a say, and
# to terms that grow with a reference value of their own.


def outgassing(w: World, rng: np.random.Generator) -> FloatArray:
    """Pressure of a gas that a part gives off, more of it when it is warm, and a pump that takes it away."""
    tau_s, pressure, level = log_uniform(rng, 600, 3000), np.empty(len(w.case)), 0.0
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
    return follows(np.sign(gap) * np.abs(gap) ** 1.25, log_uniform(rng, 100, 600))


def transient_of_the_air(w: World, rng: np.random.Generator) -> FloatArray:
    """A thin cover feels the air at once, the frame it is held by later."""
    return follows(w.air, 15.0) - follows(w.air, log_uniform(rng, 300, 1500))


def plastic_flow(w: World, rng: np.random.Generator) -> FloatArray:
    """Solder yields to a gradient, much faster to a large one, and recovers slowly."""
    gradient = (w.case - follows(w.case, log_uniform(rng, 150, 500))) / rng.uniform(3.0, 6.0)
    tau_s, strain, level = log_uniform(rng, 2000, 6000), np.empty(len(w.case)), 0.0
    for second, rate in enumerate(np.sinh(np.clip(gradient, -4.0, 4.0)).tolist()):
        level += rate / 600.0 - level / tau_s
        strain[second] = level
    return strain


def pulled_loop(w: World, rng: np.random.Generator) -> FloatArray:
    """The frequency loop lags while the frequency moves, by more the further it is from its centre."""
    behind = w.frequency - follows(w.frequency, log_uniform(rng, 100, 500))
    return behind * np.abs(w.frequency - w.constant(np.median(w.frequency)))


def thermoelastic(w: World, rng: np.random.Generator) -> FloatArray:
    """Damping with a peak over temperature, in a gradient."""
    gradient = w.case - follows(w.case, log_uniform(rng, 60, 300))
    ratio = np.exp((w.case - rng.uniform(0.0, 50.0)) / rng.uniform(10.0, 20.0))
    return gradient * 2.0 * ratio / (1.0 + ratio**2)


def two_masses(w: World, rng: np.random.Generator) -> FloatArray:
    """The difference between two masses acts in proportion to the temperature of the slower one."""
    fast, slow = follows(w.case, log_uniform(rng, 60, 200)), follows(w.case, log_uniform(rng, 800, 2000))
    return (fast - slow) * (slow + rng.uniform(20.0, 60.0))


def duty_cycle(w: World, rng: np.random.Generator) -> FloatArray:
    """A heater of the electronics switches by a clock of its own while it is cold."""
    period = log_uniform(rng, 500, 1500)
    on = (np.mod(w.time, period) < rng.uniform(0.3, 0.6) * period) & (w.case < rng.uniform(10.0, 30.0))
    return follows(on.astype(np.float64), 30.0)


def one_sided_seal(w: World, rng: np.random.Generator) -> FloatArray:
    """A seal lets warm air in, and keeps cold air out for the most part."""
    gap = follows(w.air, log_uniform(rng, 20, 100)) - w.case
    return np.where(gap > 0.0, gap, rng.uniform(0.0, 0.3) * gap)


def stretched_relaxation(w: World, rng: np.random.Generator) -> FloatArray:
    """Glue with many time constants, each with its own share."""
    taus = np.geomspace(log_uniform(rng, 30, 80), log_uniform(rng, 8000, 20000), 7)
    return np.asarray(sum((follows(w.case, tau) - w.case) * tau ** -rng.uniform(0.2, 0.5) for tau in taus.tolist()))


# The following were written after the check run had a say in which formula is best, before it had one in what is named.


def latent_heat(w: World, rng: np.random.Generator) -> FloatArray:
    """A wax in the potting melts: its temperature stands still until the heat of melting has flowed in or out."""
    at, latent, tau_s = rng.uniform(20.0, 50.0), rng.uniform(8.0, 20.0), log_uniform(rng, 150, 600)
    part, heat = np.empty(len(w.case)), float(w.case[0])
    heat += latent if heat > at else 0.0
    for second, value in enumerate(w.case.tolist()):
        now = heat if heat < at else max(at, heat - latent)
        heat += (value - now) / tau_s
        part[second] = now
    return w.case - part


def package_leak(w: World, rng: np.random.Generator) -> FloatArray:
    """Gas leaves a package while it is warm and returns while it is cold; its pressure damps the mode."""
    tau_s, amount, pressure = log_uniform(rng, 1500, 6000), 1.0, np.empty(len(w.case))
    for second, kelvin in enumerate(((w.case + 273.15) / 298.15).tolist()):
        inside = amount * kelvin
        amount -= (inside - 1.0) / tau_s
        pressure[second] = inside
    return pressure


def integrator_that_saturates(w: World, rng: np.random.Generator) -> FloatArray:
    """The quadrature loop integrates the error, and its integrator runs into its ends."""
    error = w.quadrature - w.constant(np.median(w.quadrature))
    most, level, held = rng.uniform(200.0, 600.0) * w.constant(np.std(error)), 0.0, np.empty(len(error))
    for second, value in enumerate(error.tolist()):
        level = min(max(level + value, -most), most)
        held[second] = level
    return held


def frosted_evaporator(w: World, rng: np.random.Generator) -> FloatArray:
    """Frost grows while the compressor runs in cold air, and melts in warm; it slows the air that cools the mount."""
    grows_s, melts_s, level, frost = log_uniform(rng, 1500, 4000), log_uniform(rng, 300, 900), 0.0, np.empty(len(w.air))
    for second, (runs, air) in enumerate(zip(w.compressor.tolist(), w.air.tolist(), strict=True)):
        level += runs * (air < 5.0) * (1.0 - level) / grows_s - max(0.0, air - 5.0) / 20.0 * level / melts_s
        frost[second] = level
    return frost * (w.air - w.case - 5.0)


def tilt_of_two_legs(w: World, rng: np.random.Generator) -> FloatArray:
    """The fixture stands on a thin leg in the air and a thick one on the plate: it tilts to the input axis."""
    thin, thick = follows(w.air, log_uniform(rng, 60, 200)), follows(w.case, log_uniform(rng, 900, 2500))
    return np.asarray(np.sin((thin - rng.uniform(1.05, 1.4) * thick) / 40.0))


def humid_board(w: World, rng: np.random.Generator) -> FloatArray:
    """A board takes up water by the relative humidity of the air, which falls as the air warms, and leaks with it."""
    water = follows(np.exp(-np.clip(w.air, -20.0, None) / rng.uniform(14.0, 20.0)), log_uniform(rng, 1500, 5000))
    return np.asarray(water**1.5)


def backlash_of_the_gap(w: World, rng: np.random.Generator) -> FloatArray:
    """A duct bends with the difference to the air and drags a hinge with play along."""
    gap = follows(w.air - w.case, 40.0)
    return dragged(gap, rng.uniform(0.15, 0.35) * w.constant(np.ptp(gap)) / 2.0)


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
    heals_s, level, last, way = log_uniform(rng, 6000, 20000), 0.0, float(w.case[0]), 0.0
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
    gap = follows(w.air - w.case, log_uniform(rng, 60, 400))
    touches = rng.uniform(0.15, 0.4) * w.constant(np.max(np.abs(gap)))
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
    span = w.constant(np.ptp(w.frequency))
    mode = rng.uniform(w.constant(w.frequency.min()), w.constant(w.frequency.max()))
    return follows(w.compressor, 20.0) / (1.0 + ((w.frequency - mode) / (rng.uniform(0.1, 0.3) * span)) ** 2)


def sag_of_the_heater(w: World, rng: np.random.Generator) -> FloatArray:
    """The heater's load warms a reference that scales the drive."""
    return (
        follows(w.heater, log_uniform(rng, 200, 900))
        * (w.drive - rng.uniform(0.2, 0.8) * w.constant(w.drive.min())) ** 2
    )


def water_in_a_slab(w: World, rng: np.random.Generator) -> FloatArray:
    """Water diffuses into a board of five layers from the air's side; the innermost one leaks."""
    rate = 1.0 / log_uniform(rng, 250, 700)
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
    return (slope > rng.uniform(0.55, 0.8)) * (w.quadrature - rng.uniform(0.2, 0.8) * w.constant(w.quadrature.max()))


def two_loops(w: World, rng: np.random.Generator) -> FloatArray:
    """Two joints with play in a row: the second one is dragged by the first, at another stiffness."""
    first, second = rng.uniform((2.0, 4.0), (6.0, 12.0)).tolist()
    return (w.case - dragged(dragged(w.case, first), second)) * (1.0 + w.case / rng.uniform(60.0, 120.0))


# The following were written before limits, dead zones, modes and steps that take their time, and led to them.


def swelling_bond(w: World, rng: np.random.Generator) -> FloatArray:
    """A bond takes up water slowly from cold air and dries much faster in warm air."""
    takes_s, dries_s = log_uniform(rng, 3000, 9000), log_uniform(rng, 600, 2000)
    return unevenly(1.0 / (1.0 + np.exp((w.air - 15.0) / 12.0)), takes_s, dries_s, start=0.5)


def cold_trap(w: World, rng: np.random.Generator) -> FloatArray:
    """Gas of the package condenses on a part below one temperature, and comes back above it; it damps the mode."""
    at, gas, pressure = rng.uniform(-15.0, 15.0), 1.0, np.empty(len(w.case))
    freezes_s, melts_s = log_uniform(rng, 800, 3000), log_uniform(rng, 300, 1200)
    for second, case in enumerate(w.case.tolist()):
        gas += -gas / freezes_s if case < at else (1.0 - gas) / melts_s
        pressure[second] = gas
    return pressure


def heated_board(w: World, rng: np.random.Generator) -> FloatArray:
    """A heater of the board has a thermostat with a band of its own; its heat reaches the sensor later."""
    on_at, band = rng.uniform(-20.0, 0.0), rng.uniform(6.0, 15.0)
    heat = switched(w.case, on_at, on_at + band).astype(float)
    return follows(heat, log_uniform(rng, 100, 600))


def trapped_charge(w: World, rng: np.random.Generator) -> FloatArray:
    """The drive's voltage charges a dielectric, faster when it is warm; the charge leaks away slowly."""
    fills, leaks_s, level = rng.uniform(20.0, 35.0), log_uniform(rng, 4000, 12000), 0.0
    charge = np.empty(len(w.case))
    flow = (w.drive / w.constant(np.mean(w.drive))) ** 2 * np.exp((w.case - 25.0) / fills)
    for second, value in enumerate(flow.tolist()):
        level += value * (1.0 - level) / 6000.0 - level / leaks_s
        charge[second] = level
    return charge


def stick_and_slip(w: World, rng: np.random.Generator) -> FloatArray:
    """A foot sticks until the strain under it is too large, and slips to rest then."""
    most, rests, strain = rng.uniform(12.0, 30.0), float(w.case[0]), np.empty(len(w.case))
    for second, case in enumerate(w.case.tolist()):
        if abs(case - rests) > most:
            rests = case
        strain[second] = case - rests
    return strain


def fanned_wall(w: World, rng: np.random.Generator) -> FloatArray:
    """A cover follows the air faster while the compressor's fan blows, and pulls the frame that follows the plate."""
    blown_s, still_s, cover = log_uniform(rng, 60, 150), log_uniform(rng, 500, 1200), float(w.air[0])
    behind = np.empty(len(w.air))
    for second, (air, runs) in enumerate(zip(w.air.tolist(), w.compressor.tolist(), strict=True)):
        cover += (air - cover) * (runs / blown_s + (1.0 - runs) / still_s)
        behind[second] = air - cover
    return behind


def touching_strip(w: World, rng: np.random.Generator) -> FloatArray:
    """A strip presses on the housing only where the gradient through it is beyond its clearance."""
    gradient = w.case - follows(w.case, log_uniform(rng, 200, 700))
    clearance = rng.uniform(0.3, 0.6) * w.constant(np.max(np.abs(gradient)))
    return np.sign(gradient) * np.maximum(np.abs(gradient) - clearance, 0.0)


def crossed_modes(w: World, rng: np.random.Generator) -> FloatArray:
    """The drive's frequency crosses a mode of the package: the phase turns, the error changes its sign there."""
    span = w.constant(np.ptp(w.frequency))
    away = (w.frequency - rng.uniform(0.3, 0.7) * span - w.constant(w.frequency.min())) / (
        rng.uniform(0.04, 0.15) * span
    )
    return away / (1.0 + away**2)


def soaked_capacitor(w: World, rng: np.random.Generator) -> FloatArray:
    """A capacitor of the supply's filter takes up charge late, and leaks with temperature into the reference."""
    late = w.supply - follows(w.supply, log_uniform(rng, 300, 2000))
    return np.asarray(late * np.exp((w.case - 25.0) / rng.uniform(20.0, 40.0)))


def squared_gradient(w: World, rng: np.random.Generator) -> FloatArray:
    """A gradient between two parts detunes both springs alike: it acts by its square."""
    return np.asarray((follows(w.case, log_uniform(rng, 60, 200)) - follows(w.case, log_uniform(rng, 300, 900))) ** 2)


def warm_driver(w: World, rng: np.random.Generator) -> FloatArray:
    """The drive's stage warms itself by its power, and its offset changes with that and the board's temperature."""
    power = follows((w.drive / w.constant(np.mean(w.drive))) ** 2, log_uniform(rng, 200, 1500))
    return (power - w.constant(np.mean(power))) * (follows(w.case, 300.0) + rng.uniform(10.0, 60.0))


def yielding_solder(w: World, rng: np.random.Generator) -> FloatArray:
    """Solder creeps by the hyperbolic sine of its stress, and by temperature; what is left of the stress acts."""
    scale, warm, strain = rng.uniform(5.0, 12.0), rng.uniform(20.0, 40.0), float(w.case[0])
    slow_s, stress = log_uniform(rng, 1500, 6000), np.empty(len(w.case))
    for second, case in enumerate(w.case.tolist()):
        rate = np.sinh(min(max((case - strain) / scale, -6.0), 6.0)) * np.exp((case - 25.0) / warm)
        strain += scale * rate / slow_s
        stress[second] = case - strain
    return stress
