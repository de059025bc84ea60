"""Mechanisms that a development engineer is likely to meet, written blind to the diagnosis after all other groups."""

from __future__ import annotations

import numpy as np

from bench.base import FloatArray
from benchmarks.mechanisms.likely import share_below, speed, steps, vapour
from benchmarks.mechanisms.world import World, follows, log_uniform

EARTH_DPS = 15.041 / 3600.0


def deviation(w: World, channel: FloatArray) -> FloatArray:
    """A channel without its mean over its span, both of the unit's first run."""
    mean, span = w.constant(float(np.mean(channel))), w.constant(float(np.ptp(channel)))
    return np.asarray((channel - mean) / span)


# Sensing element, package and adhesives


def adhesive_that_delaminates(w: World, rng: np.random.Generator) -> FloatArray:
    """A bond tears from its edge while pulled in the cold; where torn, it passes on pressure but no pull any more."""
    free, holds = rng.uniform(20, 45), rng.uniform(10, 30)
    slow, torn, out = log_uniform(rng, 5000, 40000), 0.0, np.empty(len(w.case))
    for i, pull in enumerate((free - follows(w.case, log_uniform(rng, 30, 200))).tolist()):
        torn += (1.0 - torn) * max(pull / holds - 1.0, 0.0) ** 2 / slow
        out[i] = pull * (1.0 - torn) if pull > 0.0 else pull
    return out


def glue_that_cures_on(w: World, rng: np.random.Generator) -> FloatArray:
    """A glue that is not fully cured cures on when hot: it shrinks, until its rising glass transition stops it."""
    cured, glass, rise = rng.uniform(0.75, 0.88), rng.uniform(45, 65), rng.uniform(200, 350)
    fast = speed(w.case, rng.uniform(6000, 8000)) / log_uniform(rng, 20000, 80000)
    shrinks, ease, first = rng.uniform(100, 300), log_uniform(rng, 60, 400), cured
    stress, out = 0.0, np.empty(len(w.case))
    for i, (c, step, rate) in enumerate(zip(w.case.tolist(), steps(w.case).tolist(), fast.tolist(), strict=True)):
        soft = 1.0 / (1.0 + np.exp((glass + rise * (cured - first) - c) / 6.0))
        more = rate * (1.0 - cured) ** 1.5 * soft
        cured += more
        stress += (0.03 + 1.0 - soft) * (step - shrinks * more) - stress * soft / ease
        out[i] = stress
    return out


def charge_from_traps_of_many_depths(w: World, rng: np.random.Generator) -> FloatArray:
    """Traps of several depths in a dielectric fill all the time and empty when warmed; their current acts."""
    fill, faster = log_uniform(rng, 2000, 8000), speed(w.case, rng.uniform(6000, 9000))
    current = np.zeros(len(w.case))
    for slow in np.geomspace(log_uniform(rng, 300, 1500), log_uniform(rng, 30000, 150000), 6).tolist():
        filled = (1.0 / fill) / (1.0 / fill + 1.0 / slow)
        for i, empties in enumerate((faster / slow).tolist()):
            rate = 1.0 / fill + empties
            before = filled
            filled += (1.0 / (fill * rate) - filled) * (1.0 - np.exp(-rate))
            current[i] += before - filled
    return current


def tuning_voltage_used_up(w: World, rng: np.random.Generator) -> FloatArray:
    """A slow loop tunes the modes to each other with no more than its supply gives; quadrature leaks by the rest."""
    needed = (
        rng.uniform(0.3, 0.6)
        + rng.choice([-1.0, 1.0]) * rng.uniform(0.6, 1.2) * (follows(w.case, log_uniform(rng, 60, 400)) - 25.0) / 120.0
    )
    most = rng.uniform(0.6, 0.8) + rng.uniform(0.2, 0.5) * deviation(w, w.supply)
    slow, tuned, rest = log_uniform(rng, 60, 400), float(needed[0]), np.empty(len(w.case))
    for i, (need, end) in enumerate(zip(needed.tolist(), most.tolist(), strict=True)):
        tuned += (min(max(need, 0.0), end) - tuned) / slow
        rest[i] = need - tuned
    return np.asarray(w.quadrature * rest)


def frequency_strained_as_thermometer(w: World, rng: np.random.Generator) -> FloatArray:
    """The unit reads its temperature off its resonance, which strain of a relaxing glue pulls; its curve is bent."""
    slow = log_uniform(rng, 500, 3000) / speed(w.case, rng.uniform(3000, 6000))
    strain, held, out = 0.0, rng.uniform(0.0, 0.2), np.empty(len(w.case))
    for i, (step, tau) in enumerate(zip(steps(w.case).tolist(), slow.tolist(), strict=True)):
        strain += step - strain / tau
        out[i] = strain
    x = 2.0 * deviation(w, w.frequency)
    slope = rng.uniform(-0.5, 0.5) + rng.uniform(0.5, 1.5) * x + rng.uniform(-1.5, 1.5) * x**2
    return np.asarray((out + held * (w.case - 25.0)) * slope)


def shunt_near_its_curie_point(w: World, rng: np.random.Generator) -> FloatArray:
    """A shunt takes flux from a magnet until its Curie point, where it lets go; both warm at their own pace."""
    magnet, shunt = follows(w.case, log_uniform(rng, 400, 1800)), follows(w.case, log_uniform(rng, 60, 300))
    curie = rng.uniform(50, 80)
    taken = np.sqrt(np.maximum(curie - shunt, 0.0) / (curie + 40.0))
    flux = rng.uniform(0.7, 1.2) * taken + (magnet - 25.0) / 125.0
    return np.asarray(flux * (1.0 + rng.uniform(0.3, 1.0) * deviation(w, w.drive)))


def pattern_that_turns_with_the_earth(w: World, rng: np.random.Generator) -> FloatArray:
    """Earth and bias turn the pattern of a free shell; damping by its heat acts by four times the angle."""
    shell = follows(w.case, log_uniform(rng, 800, 5000))
    unlike = rng.uniform(3, 12) / 3600.0 * (1.0 + rng.uniform(0.3, 0.8) * (shell - 25.0) / 60.0)
    earth = rng.choice([-1.0, 1.0]) * 0.277 * EARTH_DPS * rng.uniform(0.5, 0.85)
    angle, out = rng.uniform(0, 90), np.empty(len(w.case))
    for i, most in enumerate(unlike.tolist()):
        out[i] = most * np.sin(np.radians(4.0 * angle))
        angle += earth + out[i]
    return out


# Fibre and laser


def cooler_with_a_crossover(w: World, rng: np.random.Generator) -> FloatArray:
    """The cooler of a source gives nothing about zero current, cools less than it heats, and its loop is slow."""
    around = follows(w.case, log_uniform(rng, 60, 300))
    aim, reach, cools = rng.uniform(24, 40), rng.uniform(90, 120), rng.uniform(0.65, 0.85)
    dead, slow = rng.uniform(0.04, 0.12), log_uniform(rng, 40, 150)
    gain = rng.uniform(0.01, 0.03)
    more = gain / log_uniform(rng, 200, 800)
    source, summed, out = aim, (aim - float(around[0])) / reach, np.empty(len(w.case))
    for i, outside in enumerate(around.tolist()):
        summed = min(max(summed + more * (aim - source), -1.0), 1.0)
        asked = min(max(gain * (aim - source) + summed, -1.0), 1.0)
        given = float(np.copysign(max(abs(asked) - dead, 0.0), asked)) * (1.0 if asked > 0.0 else cools)
        source += (outside + reach * given - source) / slow
        out[i] = source - aim
    return out


def potting_that_yields_around_a_coil(w: World, rng: np.random.Generator) -> FloatArray:
    """A fibre feels the rate of the stress in its potting, stiff when cold and relaxing the faster the warmer."""
    coil = follows(w.case, log_uniform(rng, 60, 500))
    stiff = rng.uniform(0.2, 0.5) + share_below(coil, rng.uniform(-10, 30), rng.uniform(6, 15))
    slow = log_uniform(rng, 400, 2500) / speed(coil, rng.uniform(3000, 7000))
    stress, rate = 0.0, np.empty(len(w.case))
    for i, (step, tau) in enumerate(zip((stiff * steps(coil)).tolist(), slow.tolist(), strict=True)):
        rate[i] = step - stress * min(1.0 / tau, 1.0)
        stress += rate[i]
    return rate


def source_that_needs_more_current(w: World, rng: np.random.Generator) -> FloatArray:
    """A power loop feeds a source that weakens as it warms itself, up to a limit; chip and missing light shift it."""
    board, slow = follows(w.case, log_uniform(rng, 60, 300)), log_uniform(rng, 200, 900)
    fades, heat, most = rng.uniform(60, 100), rng.uniform(8, 20), rng.uniform(1.5, 2.2)
    chip, missing, out = float(board[0]) + heat, rng.uniform(20, 80), np.empty(len(w.case))
    for i, outside in enumerate(board.tolist()):
        yields = np.exp(-(chip - 25.0 - heat) / fades)
        current = min(1.0 / yields, most)
        chip += (outside + heat * current - chip) / slow
        out[i] = chip + missing * (1.0 - current * yields)
    return out


def dither_of_a_cold_piezo(w: World, rng: np.random.Generator) -> FloatArray:
    """A piezo, weak in the cold or at low supply, dithers less; what is left of lock-in is scatter over that."""
    block, piezo = follows(w.case, log_uniform(rng, 400, 2500)), follows(w.case, log_uniform(rng, 60, 400))
    scatter = 1.0 + rng.uniform(0.3, 0.9) * np.cos(2.0 * np.pi * block / rng.uniform(25, 70) + rng.uniform(0, 6))
    able = 1.0 + rng.uniform(0.3, 0.6) * (piezo - rng.uniform(-10, 30)) / 60.0
    able = able + rng.uniform(0.05, 0.2) * deviation(w, w.supply)
    return np.asarray(scatter / np.minimum(able, 1.0) ** rng.uniform(1, 2))


# Electronics


def ceramic_capacitor_that_ages(w: World, rng: np.random.Generator) -> FloatArray:
    """A filter's ceramic ages by the logarithm of time and heat renews it; its phase lets quadrature through."""
    ceramic = follows(w.case, log_uniform(rng, 100, 600))
    renewed = speed(ceramic, rng.uniform(7000, 10000)) / log_uniform(rng, 50000, 200000)
    soon, age, aged = log_uniform(rng, 100, 600), rng.uniform(2.0, 4.0), np.empty(len(w.case))
    for i, rate in enumerate(renewed.tolist()):
        age += np.exp(-age) / soon - age * min(rate, 1.0)
        aged[i] = age
    curve = ((ceramic - rng.uniform(10, 40)) / 60.0) ** 2
    return np.asarray(w.quadrature * (aged - rng.uniform(1, 3) + rng.uniform(0.3, 1.0) * curve))


def cable_that_feeds_constant_power(w: World, rng: np.random.Generator) -> FloatArray:
    """A converter draws more current as a warm cable leaves it less voltage, and more while it heats its board."""
    of_air = rng.uniform(0.4, 1.0)
    cable = follows(of_air * w.air + (1.0 - of_air) * w.case, log_uniform(rng, 60, 400))
    board, aim, band = follows(w.case, log_uniform(rng, 400, 1800)), rng.uniform(0, 35), rng.uniform(10, 30)
    power = 1.0 + rng.uniform(0.3, 1.0) * np.clip((aim - board) / band, 0.0, 1.0)
    resists = rng.uniform(0.05, 0.1) * (1.0 + 0.0039 * (cable - 25.0))
    return np.asarray(0.5 + np.sqrt(0.25 - resists * power))


# Compensation inside the unit


def filter_that_stops_short(w: World, rng: np.random.Generator) -> FloatArray:
    """A filter of whole numbers rounds down its steps: its temperature stays behind on warming and not on cooling."""
    shift, every = int(rng.integers(5, 8)), int(rng.integers(1, 6))
    bit, bend = rng.uniform(2, 6) / 2.0**shift, rng.uniform(60, 150)
    kept = round(float(w.case[0]) / bit) - 2 ** (shift - 1)
    out = np.empty(len(w.case))
    for i, c in enumerate(w.case.tolist()):
        if i % every == 0:
            kept += (round(c / bit) - kept) >> shift
        out[i] = (c - bit * kept) * (1.0 + (c - 25.0) / bend)
    return out


def rate_term_that_is_clipped(w: World, rng: np.random.Generator) -> FloatArray:
    """The unit corrects its gradient by the rate of its thermometer over some minutes, up to a limit."""
    slow, back = log_uniform(rng, 150, 900), int(log_uniform(rng, 60, 300))
    gradient = (follows(w.case, log_uniform(rng, 20, 100)) - follows(w.case, slow)) * 60.0 / slow
    before = np.concatenate([np.full(back, w.case[0]), w.case[:-back]])
    limit = rng.uniform(0.6, 1.5)
    return np.asarray(gradient - rng.uniform(0.8, 1.2) * np.clip((w.case - before) * 60.0 / back, -limit, limit))


def table_of_two_thermometers(w: World, rng: np.random.Generator) -> FloatArray:
    """A coarse table over the temperatures of lid and base corrects a bent effect of both, and ends at its edge."""
    base = follows(w.case, log_uniform(rng, 60, 400))
    apart = follows(w.air, log_uniform(rng, 100, 600)) - base
    flat, bent, square = rng.uniform(-1, 1), rng.uniform(1, 3) * rng.choice([-1.0, 1.0]), rng.uniform(0.03, 0.1)

    def acts(warm: FloatArray, gap: FloatArray) -> FloatArray:
        x = (warm - 25.0) / 60.0
        return np.asarray(gap * (flat + x + bent * x**2) + square * gap * np.abs(gap))

    every, edge = rng.uniform(30, 60), rng.uniform(4, 9)
    low = -45.0 + every * np.floor((base + 45.0) / every)
    inside = np.clip(apart, -edge, edge)
    at_edge, share = np.copysign(edge, inside), (base - low) / every
    entry = (1.0 - share) * acts(low, at_edge) + share * acts(low + every, at_edge)
    return np.asarray(acts(base, apart) - entry * np.abs(inside) / edge)


# Mounting, chamber and humidity


def plates_that_slide_softly(w: World, rng: np.random.Generator) -> FloatArray:
    """Two plates of unlike expansion slide on each other bit by bit (Bouc and Wen) under screws that heat tightens."""
    firm = rng.uniform(6, 20) * (1.0 + rng.uniform(0.2, 0.7) * (w.case - 25.0) / 60.0)
    power, turns, slid = rng.uniform(1, 2), rng.uniform(0.5, 0.9), 0.0
    out = np.empty(len(w.case))
    for i, (step, most) in enumerate(zip(steps(w.case).tolist(), firm.tolist(), strict=True)):
        against = turns * np.sign(step * slid) + 1.0 - turns
        slid += step / most * (1.0 - abs(slid) ** power * against)
        out[i] = most * slid
    return out


def paste_that_is_pumped_out(w: World, rng: np.random.Generator) -> FloatArray:
    """Each warming squeezes paste out of the joint beneath the unit, which then follows its mount ever later."""
    slow, most, reach = log_uniform(rng, 60, 250), rng.uniform(2, 6), rng.uniform(100, 350)
    inside, gone, out = float(w.case[0]), 0.0, np.empty(len(w.case))
    for i, (c, step) in enumerate(zip(w.case.tolist(), steps(w.case).tolist(), strict=True)):
        gone += max(step, 0.0) / reach * (most - gone)
        inside += (c - inside) / (slow * (1.0 + gone))
        out[i] = c - inside
    return out


def glow_of_the_heater(w: World, rng: np.random.Generator) -> FloatArray:
    """The rods of the chamber's heater shine on one side of the unit by the fourth power of their temperature."""
    rods = w.air + rng.uniform(250, 600) * follows(w.heater, log_uniform(rng, 20, 150)) + 273.15
    shine = (rods / 298.15) ** 4 - ((w.case + 273.15) / 298.15) ** 4
    near, far = follows(shine, log_uniform(rng, 60, 300)), follows(shine, log_uniform(rng, 500, 2500))
    return np.asarray(near - rng.uniform(0.3, 0.9) * far)


def readout_warmed_by_the_room(w: World, rng: np.random.Generator) -> FloatArray:
    """The chamber's waste heat warms the room and the rack in it; ventilation helps from a temperature of the room."""
    waste = rng.uniform(0.7, 1.3) * w.compressor + rng.uniform(0.5, 2.0) * w.heater
    slow, begins, helps = log_uniform(rng, 1500, 6000), rng.uniform(0.25, 0.5), rng.uniform(1, 4)
    warmer, out = 0.0, np.empty(len(w.case))
    for i, heat in enumerate(waste.tolist()):
        warmer += (heat - warmer - helps * max(warmer - begins, 0.0)) / slow
        out[i] = warmer
    return follows(out, log_uniform(rng, 500, 2400))


def stream_from_the_air_duct(w: World, rng: np.random.Generator) -> FloatArray:
    """The side at the duct gets air that an evaporator, weak in the cold, has cooled and a heater warmed, unmixed."""
    metal = follows(w.compressor * np.maximum(w.air + rng.uniform(45, 65), 0.0) / 80.0, log_uniform(rng, 60, 400))
    fresh = rng.uniform(1.5, 4.0) * follows(w.heater, log_uniform(rng, 20, 90)) - metal
    side, core = follows(fresh, log_uniform(rng, 30, 200)), follows(fresh, log_uniform(rng, 400, 1800))
    return np.asarray(side - core)


def air_inside_that_begins_to_roll(w: World, rng: np.random.Generator) -> FloatArray:
    """The air in a housing begins to roll once its base is warmer than its lid by enough, and carries heat up then."""
    base, lid = follows(w.case, log_uniform(rng, 30, 200)), follows(w.air, log_uniform(rng, 150, 600))
    critical, slow = rng.uniform(1.5, 5), log_uniform(rng, 60, 300)
    roll, carried = 0.02, np.empty(len(w.case))
    for i, over in enumerate((base - lid).tolist()):
        roll = max(roll + roll * (over / critical - 1.0 - roll**2) / slow, 0.02)
        carried[i] = roll**2 * over
    return follows(carried, log_uniform(rng, 60, 500))


def dew_that_warms_and_cools(w: World, rng: np.random.Generator) -> FloatArray:
    """Dew warms the side on which it settles and cools it while it dries, as long as there is any of it."""
    excess = vapour(np.minimum(rng.uniform(2, 14), w.air)) - vapour(w.case)
    film, most, soon = 0.0, rng.uniform(100, 600), log_uniform(rng, 60, 400)
    heat = np.empty(len(w.case))
    for i, more in enumerate(excess.tolist()):
        heat[i] = min(more, most - film) if more > 0.0 else max(more, -film / soon)
        film += heat[i]
    return follows(heat, log_uniform(rng, 60, 400))


def residue_that_takes_up_water(w: World, rng: np.random.Generator) -> FloatArray:
    """Residue of flux melts in humid air and dries out in much drier air only; its brine conducts until it freezes."""
    humid = np.minimum(vapour(np.minimum(rng.uniform(6, 14), w.air)) / vapour(w.case), 0.95)
    melts, dries, slow = rng.uniform(0.6, 0.8), rng.uniform(0.2, 0.4), log_uniform(rng, 100, 900)
    liquid = 1.0 - share_below(w.case, rng.uniform(-25, -10), rng.uniform(2, 5))
    wet, brine, out = False, 0.0, np.empty(len(w.case))
    for i, share in enumerate(humid.tolist()):
        wet = share > (dries if wet else melts)
        brine += (wet * share / (1.2 - share) - brine) / slow
        out[i] = brine
    return np.asarray(out * liquid * np.exp((w.case - 25.0) / rng.uniform(25, 50)))
