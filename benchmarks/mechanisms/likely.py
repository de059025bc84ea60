"""Mechanisms that an engineer is likely to meet with a real unit in a real chamber, written blind to the diagnosis."""

from __future__ import annotations

import numpy as np

from bench.base import FloatArray
from benchmarks.mechanisms.world import World, follows, log_uniform, switched


def speed(celsius: FloatArray, kelvin: float) -> FloatArray:
    """How much faster than at 25 degC a process runs whose activation energy is so many kelvins."""
    return np.asarray(np.exp(kelvin * (1.0 / 298.15 - 1.0 / (celsius + 273.15))))


def share_below(celsius: FloatArray, at: float, width: float) -> FloatArray:
    """Share of a polymer that is stiff: one well below its transition and nothing well above it."""
    return np.asarray(1.0 / (1.0 + np.exp((celsius - at) / width)))


def steps(source: FloatArray) -> FloatArray:
    """What a source gains in each second."""
    return np.diff(source, prepend=source[0])


def leaky(gain: FloatArray, tau_s: FloatArray) -> FloatArray:
    """A sum of all gains that leaks away with a time constant which is another in every second."""
    total, level = np.empty(len(gain)), 0.0
    for second, (more, tau) in enumerate(zip(gain.tolist(), tau_s.tolist(), strict=True)):
        level += more - level * min(1.0 / tau, 1.0)
        total[second] = level
    return total


def drawn(source: FloatArray, tau_s: FloatArray, start: float) -> FloatArray:
    """A state that a source draws towards itself with a time constant which is another in every second."""
    state, level = np.empty(len(source)), start
    for second, (value, tau) in enumerate(zip(source.tolist(), tau_s.tolist(), strict=True)):
        level += (value - level) * min(1.0 / tau, 1.0)
        state[second] = level
    return state


def vapour(celsius: FloatArray) -> FloatArray:
    """Saturated pressure of water [kPa]."""
    return np.asarray(0.611 * np.exp(17.27 * celsius / (celsius + 237.3)))


# Sensing element and package


def solder_between_package_and_board(w: World, rng: np.random.Generator) -> FloatArray:
    """Solder between package and board yields by a power of its stress, the faster the warmer it is."""
    firm, power, slow = rng.uniform(10, 30), rng.uniform(3, 4.5), log_uniform(rng, 2000, 10000)
    eased = firm / slow * speed(w.case, rng.uniform(4000, 6500))
    stress, out = 0.0, np.empty(len(w.case))
    for i, (step, ease) in enumerate(zip(steps(w.case).tolist(), eased.tolist(), strict=True)):
        stress += step
        stress -= np.copysign(min(ease * (abs(stress) / firm) ** power, abs(stress)), stress)
        out[i] = stress
    return out


def glue_that_recalls_its_cooling(w: World, rng: np.random.Generator) -> FloatArray:
    """A die attach keeps the structure at which it froze (fictive temperature) and softens it when it is heated."""
    tg, wide, share = rng.uniform(45, 75), rng.uniform(3, 6), rng.uniform(0.4, 0.7)
    slow, frozen, out = log_uniform(rng, 150, 600), tg - rng.uniform(2, 8), np.empty(len(w.case))
    for i, c in enumerate(w.case.tolist()):
        tau = slow * np.exp((tg - share * c - (1.0 - share) * frozen) / wide)
        frozen += (c - frozen) * min(1.0 / tau, 1.0)
        out[i] = frozen
    return out


def lid_warmer_than_the_base(w: World, rng: np.random.Generator) -> FloatArray:
    """A gradient through the package bends the die as far as the stress since the cure of its glue has bowed it."""
    lid, base = follows(w.air, log_uniform(rng, 60, 300)), follows(w.case, log_uniform(rng, 60, 400))
    return np.asarray((lid - base) * (rng.uniform(90, 150) - w.case))


def axes_of_damping(w: World, rng: np.random.Generator) -> FloatArray:
    """Unequal damping grows with the heat of the resonator; quadrature turns the pattern against the damping's axes."""
    warm = (follows(w.case, log_uniform(rng, 200, 2000)) + 273.15) / 298.15
    turned = (w.quadrature - w.constant(float(np.mean(w.quadrature)))) / w.constant(float(np.ptp(w.quadrature)))
    return np.asarray(warm ** rng.uniform(2, 5) * np.sin(rng.uniform(0, 3) + rng.uniform(0.5, 1.5) * turned))


def gas_from_the_walls(w: World, rng: np.random.Generator) -> FloatArray:
    """Walls of the cavity give off gas when hot and the getter takes it up again; the gas damps the two modes."""
    slow = log_uniform(rng, 2000, 10000)
    given = speed(w.case, rng.uniform(4000, 7000)) / slow
    pressure = leaky(given, slow / speed(w.case, rng.uniform(500, 2500)))
    return np.asarray(pressure * np.sqrt((w.case + 273.15) / 298.15))


def modes_that_approach(w: World, rng: np.random.Generator) -> FloatArray:
    """The gap between drive and sense mode changes with the heat of the die; quadrature counts by its inverse."""
    die = follows(w.case, log_uniform(rng, 30, 300))
    gap = 1.0 + rng.choice([-1.0, 1.0]) * rng.uniform(0.3, 0.75) * (die - 25.0) / 60.0
    return np.asarray(w.quadrature / gap)


def charge_that_thaws(w: World, rng: np.random.Generator) -> FloatArray:
    """Charge on an insulator at the electrodes goes to its balance when hot, and stays as it is when cold."""
    uneven = (w.supply - w.constant(float(np.mean(w.supply)))) / w.constant(float(np.ptp(w.supply)))
    balance = (w.case - 25.0) / 60.0 + rng.uniform(-1, 1) * uneven
    return drawn(balance, log_uniform(rng, 3000, 20000) / speed(w.case, rng.uniform(5000, 8000)), 0.0)


def joint_that_slips(w: World, rng: np.random.Generator) -> FloatArray:
    """A clamped joint holds the stress of unlike expansion until it slips, and keeps a part of it every time."""
    typical, left = rng.uniform(8, 20), rng.uniform(0.3, 0.7)
    stress, hold, out = 0.0, typical, np.empty(len(w.case))
    for i, step in enumerate(steps(w.case).tolist()):
        stress += step
        if abs(stress) > hold:
            stress, hold = float(np.copysign(left * hold, stress)), typical * rng.uniform(0.8, 1.2)
        out[i] = stress
    return out


def lid_that_snaps(w: World, rng: np.random.Generator) -> FloatArray:
    """The gas inside bulges a lid, which snaps out when hot and back only when much cooler; then it moves more."""
    gas = follows(w.case, log_uniform(rng, 60, 600))
    out, back = rng.uniform(40, 65), rng.uniform(10, 35)
    snapped = switched(-gas, -out, -back)
    return np.asarray(snapped * (1.0 + (gas - back) / rng.uniform(30, 90)))


def shell_warmed_by_radiation(w: World, rng: np.random.Generator) -> FloatArray:
    """A shell in vacuum gets its heat by radiation and through its stem; its bias has a turning point."""
    bare, stem = log_uniform(rng, 1500, 6000) * 4.0 * 298.15**3, log_uniform(rng, 3000, 15000)
    shell, out = float(w.case[0]) + 273.15, np.empty(len(w.case))
    for i, wall in enumerate((w.case + 273.15).tolist()):
        shell += (wall**4 - shell**4) / bare + (wall - shell) / stem
        out[i] = shell
    return np.asarray((out - 273.15 - rng.uniform(-20, 60)) ** 2)


def ring_bent_to_an_oval(w: World, rng: np.random.Generator) -> FloatArray:
    """Rim and hub of a ring expand unequally; the split of its modes goes by the square of that, whatever its sign."""
    rim, hub = follows(w.case, log_uniform(rng, 20, 100)), follows(w.case, log_uniform(rng, 200, 1200))
    return np.asarray((rim - hub) ** 2)


def potting_that_stiffens(w: World, rng: np.random.Generator) -> FloatArray:
    """Potting presses on the package only while it is cold and stiff; its unstrained shape follows when it is warm."""
    glassy = share_below(w.case, rng.uniform(-30, 0), rng.uniform(4, 10))
    shape = drawn(w.case, log_uniform(rng, 1000, 6000) * (1.0 + rng.uniform(5, 30) * glassy), float(w.case[0]))
    return np.asarray((rng.uniform(0.03, 0.1) + glassy) * (w.case - shape))


# Electronics


def reference_that_keeps_its_extremes(w: World, rng: np.random.Generator) -> FloatArray:
    """The package of a reference is shifted by the farthest heat and cold so far, and recovers over many hours."""
    slow, of_cold = log_uniform(rng, 20000, 100000), rng.uniform(0.3, 1.0)
    high = low = float(w.case[0])
    out = np.empty(len(w.case))
    for i, c in enumerate(w.case.tolist()):
        high = max(high - (high - c) / slow, c)
        low = min(low + (c - low) / slow, c)
        out[i] = high + of_cold * low
    return out


def regulator_that_drops_out(w: World, rng: np.random.Generator) -> FloatArray:
    """A regulator needs more voltage across it when its board is hot; what the supply lacks is missing behind it."""
    board = follows(w.case, log_uniform(rng, 200, 900))
    mid, wide = w.constant(float(np.mean(w.supply))), w.constant(float(np.ptp(w.supply)))
    needed = mid + wide * (rng.uniform(-0.3, 0.2) + rng.uniform(0.3, 0.8) * (board - 25.0) / 60.0)
    return np.maximum(needed - w.supply, 0.0)


def rejection_that_falls_with_heat(w: World, rng: np.random.Generator) -> FloatArray:
    """The warmer the board of an amplifier is, the more of the supply gets through to its output."""
    board = follows(w.case, log_uniform(rng, 100, 900))
    off = w.supply - w.constant(float(np.mean(w.supply)))
    return np.asarray(off * 2.0 ** ((board - 25.0) / rng.uniform(15, 40)))


def thermometer_with_a_dead_band(w: World, rng: np.random.Generator) -> FloatArray:
    """The compensation takes a new temperature only once it is off by a band from the one in use."""
    band, bend = rng.uniform(1, 4), rng.uniform(60, 150)
    used, out = float(w.case[0]), np.empty(len(w.case))
    for i, c in enumerate(w.case.tolist()):
        if abs(c - used) > band:
            used = c
        out[i] = (c - used) * (1.0 + (c + used - 50.0) / (2.0 * bend))
    return out


def compensation_renewed_seldom(w: World, rng: np.random.Generator) -> FloatArray:
    """The firmware renews its compensation only every few minutes and holds it in between."""
    every, bend = int(log_uniform(rng, 240, 1800)), rng.uniform(60, 200)
    used = w.case[np.arange(len(w.case)) // every * every]
    return np.asarray((w.case - used) * (1.0 + (w.case + used - 50.0) / (2.0 * bend)))


def quadrature_loop_too_slow(w: World, rng: np.random.Generator) -> FloatArray:
    """What a slow loop has not yet nulled of quadrature leaks by a phase that depends on the heat of the board."""
    left = w.quadrature - follows(w.quadrature, log_uniform(rng, 100, 900))
    board = follows(w.case, log_uniform(rng, 100, 600))
    return np.asarray(left * (rng.uniform(-1, 1) + (board - 25.0) / rng.uniform(30, 80)))


def filter_off_its_frequency(w: World, rng: np.random.Generator) -> FloatArray:
    """Resonance and a narrow filter on the board drift apart; the filter's phase turns quadrature into rate."""
    board = follows(w.case, log_uniform(rng, 150, 900))
    moved = (w.frequency - w.constant(float(np.mean(w.frequency)))) / w.constant(float(np.ptp(w.frequency)))
    off = moved + rng.uniform(0.2, 0.8) * (board - 25.0) / 60.0 + rng.uniform(-0.3, 0.3)
    return np.asarray(w.quadrature * np.arctan(rng.uniform(1, 3) * off))


def clock_whose_thermistor_lags(w: World, rng: np.random.Generator) -> FloatArray:
    """A compensated clock is corrected for the cubic of a thermistor that is slower than its crystal."""
    crystal, thermistor = follows(w.case, log_uniform(rng, 30, 120)), follows(w.case, log_uniform(rng, 150, 600))
    slope = rng.uniform(-0.8, -0.3)
    x, y = (crystal - 27.0) / 50.0, (thermistor - 27.0) / 50.0
    return np.asarray(slope * x + x**3 - slope * y - y**3)


def range_of_the_gain(w: World, rng: np.random.Generator) -> FloatArray:
    """An amplifier for quadrature changes its range at two levels; the ranges differ in offset and in gain."""
    level = w.quadrature - w.constant(float(np.min(w.quadrature)))
    level = np.asarray(level / w.constant(float(np.ptp(w.quadrature))))
    low = rng.uniform(0.3, 0.45)
    fine = switched(level, low, low + rng.uniform(0.1, 0.25))
    return np.asarray(fine * (rng.uniform(0.3, 1) + rng.uniform(-1, 1) * level))


def regulator_beside_the_input(w: World, rng: np.random.Generator) -> FloatArray:
    """The heat of a regulator reaches the two transistors of an input one after the other."""
    current = 1.0 + (w.case - 25.0) / rng.uniform(150, 400)
    power = np.asarray((w.supply - rng.uniform(0.6, 0.97) * w.constant(float(np.mean(w.supply)))) * current)
    near, far = follows(power, log_uniform(rng, 30, 200)), follows(power, log_uniform(rng, 400, 1500))
    return np.asarray(near - rng.uniform(0.7, 1.0) * far)


def oven_that_winds_up(w: World, rng: np.random.Generator) -> FloatArray:
    """An oven is out of range when it is hot or very cold outside; the sum in its controller has run away by then."""
    aim, rise, slow = rng.uniform(55, 75), rng.uniform(75, 100), log_uniform(rng, 150, 600)
    gain = rng.uniform(0.03, 0.1)
    more, core, out = gain / log_uniform(rng, 300, 1500), aim, np.empty(len(w.case))
    summed = (aim - float(w.case[0])) / rise
    for i, c in enumerate(w.case.tolist()):
        summed = min(max(summed + more * (aim - core), -1.0), 2.0)
        duty = min(max(gain * (aim - core) + summed, 0.0), 1.0)
        core += (c + rise * duty - core) / slow
        out[i] = core
    return out


def table_that_ends(w: World, rng: np.random.Generator) -> FloatArray:
    """The compensation holds its last value beyond either end of its table, which it enters with a slow thermometer."""
    board = follows(w.case, log_uniform(rng, 150, 900))
    hot, cold = np.maximum(board - rng.uniform(45, 70), 0.0), np.maximum(rng.uniform(-30, -10) - board, 0.0)
    return np.asarray(hot + rng.uniform(-1.5, 1.5) * cold)


# Optics, laser and fibre


def beats_of_two_layers(w: World, rng: np.random.Generator) -> FloatArray:
    """Crossed polarisation beats with the light in two layers of a coil, which come to their temperature in turn."""
    outer = follows(w.case, log_uniform(rng, 60, 200))
    inner = follows(outer, log_uniform(rng, 300, 900))
    turn = 2.0 * np.pi / rng.uniform(8, 20)
    first, other = np.sin(turn * outer + rng.uniform(0, 6)), np.sin(turn * inner + rng.uniform(0, 6))
    return np.asarray(first + rng.uniform(0.5, 1.0) * other)


def coating_that_stiffens(w: World, rng: np.random.Generator) -> FloatArray:
    """The rate of the temperature of a coil strains its fibre by its coating, which is soft when warm."""
    coil = follows(w.case, log_uniform(rng, 60, 500))
    stiff = rng.uniform(0.1, 0.3) + share_below(coil, rng.uniform(-20, 10), rng.uniform(5, 12))
    return np.asarray(np.gradient(coil) * stiff)


def hub_that_presses(w: World, rng: np.random.Generator) -> FloatArray:
    """A metal hub expands before its coil and more; it presses on the fibre only once it has closed the gap."""
    hub, coil = follows(w.case, log_uniform(rng, 30, 150)), follows(w.case, log_uniform(rng, 400, 1500))
    return np.maximum(hub - 25.0 - rng.uniform(0.4, 0.8) * (coil - 25.0) - rng.uniform(2, 12), 0.0)


def pyroelectric_modulator(w: World, rng: np.random.Generator) -> FloatArray:
    """A change of temperature charges the crystal of a modulator; the charge leaks away, the faster the warmer."""
    leak = log_uniform(rng, 500, 4000) / speed(w.case, rng.uniform(3000, 6000))
    return leaky(steps(w.case), leak)


def pick_up_over_the_light(w: World, rng: np.random.Generator) -> FloatArray:
    """Pick-up at the detector counts by the inverse of the light, which a source gives less of when its chip is hot."""
    light = np.exp(-(follows(w.case, log_uniform(rng, 60, 400)) - 25.0) / rng.uniform(60, 120))
    off = (w.supply - w.constant(float(np.mean(w.supply)))) / w.constant(float(np.ptp(w.supply)))
    return np.asarray((rng.uniform(-0.5, 0.5) + off) / light)


def mirror_that_starts_anew(w: World, rng: np.random.Generator) -> FloatArray:
    """The mirror that holds the path of a laser comes to its end and jumps a wavelength back; it tilts as it moves."""
    block, wave = follows(w.case, log_uniform(rng, 200, 900)), rng.uniform(15, 40)
    reach, start, out = wave * rng.uniform(0.6, 0.9), float(w.case[0]), np.empty(len(w.case))
    for i, c in enumerate(block.tolist()):
        if abs(c - start) > reach:
            start += float(np.copysign(wave, c - start))
        out[i] = c - start
    return out


def scatter_of_two_mirrors(w: World, rng: np.random.Generator) -> FloatArray:
    """The light that two mirrors scatter back interferes by the difference of their temperatures."""
    near, far = follows(w.case, log_uniform(rng, 60, 300)), follows(w.case, log_uniform(rng, 400, 1200))
    return np.asarray(np.cos(2.0 * np.pi * (near - far) / rng.uniform(8, 25) + rng.uniform(0, 6)))


def bends_in_the_cold(w: World, rng: np.random.Generator) -> FloatArray:
    """The jacket of a fibre shrinks and bends it once it is much colder than where the jacket has come to rest."""
    slow = log_uniform(rng, 2000, 8000) / speed(w.case, rng.uniform(3000, 6000))
    rest = drawn(w.case, slow, float(w.case[0]))
    return np.maximum(rest - w.case - rng.uniform(5, 20), 0.0) ** rng.uniform(1.3, 2.0)


# Mounting, cables, chamber, humidity and ageing


def cable_that_takes_a_set(w: World, rng: np.random.Generator) -> FloatArray:
    """A cable pulls at the unit by all it was strained while it was stiff with cold; it takes a set when it is warm."""
    cable = follows(w.air, log_uniform(rng, 60, 400))
    stiff = 0.1 + share_below(cable, rng.uniform(-15, 15), rng.uniform(4, 12))
    return leaky(stiff * steps(w.case), log_uniform(rng, 1000, 6000) / speed(cable, rng.uniform(2000, 5000)))


def draught_on_one_side(w: World, rng: np.random.Generator) -> FloatArray:
    """The air takes heat from one side of the unit, and more of it while the compressor runs and the air is cold."""
    blown = 1.0 + rng.uniform(0.5, 2.0) * w.compressor
    return follows(np.asarray((w.air - w.case) * blown), log_uniform(rng, 30, 300))


def screws_that_settle(w: World, rng: np.random.Generator) -> FloatArray:
    """Screws lose preload in heat until they stand it, and do not get it back; a loose unit expands otherwise."""
    beyond, hardens, slow = rng.uniform(35, 60), rng.uniform(0.8, 1.5), log_uniform(rng, 1500, 8000)
    lost, out = 0.0, np.empty(len(w.case))
    for i, c in enumerate(w.case.tolist()):
        lost += max(c - beyond - hardens * lost, 0.0) / slow
        out[i] = lost
    return np.asarray(out * (1.0 + (w.case - 25.0) / rng.uniform(40, 120)))


def plastic_that_swells(w: World, rng: np.random.Generator) -> FloatArray:
    """Plastic takes up water by the relative humidity of the air and dries when hot; cold stops both."""
    dew = np.minimum(rng.uniform(-5, 12), w.air)
    slow = log_uniform(rng, 3000, 15000) / speed(w.case, rng.uniform(3000, 6000))
    return drawn(np.asarray(vapour(dew) / vapour(w.air)), slow, rng.uniform(0.3, 0.5))


def film_of_water_on_the_board(w: World, rng: np.random.Generator) -> FloatArray:
    """Water from the warming walls of the chamber falls on a unit that is colder than they are; its film conducts."""
    excess = vapour(np.minimum(rng.uniform(4, 15), w.air)) - vapour(w.case)
    film, slow, out = 0.0, log_uniform(rng, 30, 200), np.empty(len(w.case))
    for i, more in enumerate(excess.tolist()):
        film = max(film + more / slow, 0.0)
        out[i] = film / (1.0 + film)
    return out


def stand_that_leans(w: World, rng: np.random.Generator) -> FloatArray:
    """The stand leans while its two pillars differ in temperature, and the unit sees another part of Earth's rate."""
    slim, thick = follows(w.air, log_uniform(rng, 200, 900)), follows(w.air, log_uniform(rng, 1200, 4000))
    return np.asarray(np.sin(rng.uniform(-1, 1) + (slim - thick) / rng.uniform(40, 120)))


def compressor_through_rubber(w: World, rng: np.random.Generator) -> FloatArray:
    """A rubber mount that stiffens in the cold comes into resonance with the compressor and passes its vibration on."""
    rubber = follows(w.case, log_uniform(rng, 200, 900))
    own = 1.0 + rng.uniform(0.4, 1.0) * share_below(rubber, rng.uniform(-15, 25), rng.uniform(8, 20))
    ratio = rng.uniform(1.1, 1.6) / own
    return np.asarray(w.compressor / ((1.0 - ratio**2) ** 2 + (2.0 * rng.uniform(0.08, 0.2) * ratio) ** 2))


def ageing_that_heat_speeds_up(w: World, rng: np.random.Generator) -> FloatArray:
    """Ageing by the logarithm of a time that runs by the law of Arrhenius: nearly all of it is in the hot hours."""
    aged = np.cumsum(speed(w.case, rng.uniform(5000, 9000)))
    return np.log1p(aged / log_uniform(rng, 2000, 20000))
