"""The fourth group: mechanisms written after places in a temperature that lags, covers and hops had come."""

from __future__ import annotations

import numpy as np

from bench.base import FloatArray
from benchmarks.mechanisms.world import World, dragged, follows, log_uniform, unevenly


def board_with_a_thermostat(w: World, rng: np.random.Generator) -> FloatArray:
    """A heater on the board holds it warm, on below one temperature of the board and off above another."""
    on_below, off_above = rng.uniform(-15.0, 5.0), rng.uniform(8.0, 15.0)
    tau_s, power = log_uniform(rng, 300, 900), rng.uniform(15.0, 30.0)
    board, on, warmer = float(w.case[0]), False, np.empty(len(w.case))
    for second, case in enumerate(w.case.tolist()):
        on = board < (off_above if on else on_below)
        board += (case + power * on - board) / tau_s
        warmer[second] = board - case
    return warmer


def one_way_leak(w: World, rng: np.random.Generator) -> FloatArray:
    """Air enters a package through a flap within minutes, and leaves through a pore within an hour or more."""
    fast, slow = log_uniform(rng, 100, 400), log_uniform(rng, 2500, 8000)
    outside = 300.0 / (follows(w.case, 120.0) + 273.15)
    return unevenly(outside, fast, slow) - outside


def friction_that_thaws(w: World, rng: np.random.Generator) -> FloatArray:
    """A joint slides at a force that falls as its grease thaws."""
    most, cold = rng.uniform(6.0, 15.0), rng.uniform(25.0, 50.0)
    spring, last, bent = 0.0, float(w.case[0]), np.empty(len(w.case))
    for second, value in enumerate(w.case.tolist()):
        force = most * np.exp(-(value - 25.0) / cold)
        spring = min(max(spring + value - last, -force), force)
        bent[second], last = spring, value
    return bent


def dew_that_dries(w: World, rng: np.random.Generator) -> FloatArray:
    """Dew settles while the case is colder than the air, and dries by the vapour pressure of the case."""
    grows, dries, water = rng.uniform(0.5, 2.0), log_uniform(rng, 400, 1500), 0.0
    film = np.empty(len(w.case))
    for second, (air, case) in enumerate(zip(w.air.tolist(), w.case.tolist(), strict=True)):
        water += max(air - case, 0.0) * grows / 600.0 - water * np.exp(np.clip(case, -40.0, 60.0) / 18.0) / 4.0 / dries
        water = max(water, 0.0)
        film[second] = water
    return np.sqrt(film)


def cable_that_stiffens(w: World, rng: np.random.Generator) -> FloatArray:
    """A cable pulls by the gap between air and case, and the more the colder its inside is."""
    inside = follows(w.air, log_uniform(rng, 200, 800))
    return np.asarray((w.air - w.case) * np.exp(-(inside - 25.0) / rng.uniform(30.0, 60.0)))


def amplifier_that_warms_itself(w: World, rng: np.random.Generator) -> FloatArray:
    """An amplifier is warmed by the square of the drive; its phase turns the quadrature."""
    power = (w.drive / w.constant(float(np.mean(w.drive)))) ** 2
    node = follows(w.case, 200.0) + rng.uniform(60.0, 150.0) * (follows(power, log_uniform(rng, 200, 800)) - 1.0)
    return np.asarray(w.quadrature * (node - rng.uniform(0.0, 40.0)))


def switch_that_heats(w: World, rng: np.random.Generator) -> FloatArray:
    """A bimetal opens above one temperature of the case and closes below another; what it feeds warms a mass."""
    opens = rng.uniform(35.0, 55.0)
    closes, closed, feeds = opens - rng.uniform(6.0, 20.0), True, np.empty(len(w.case))
    for second, case in enumerate(w.case.tolist()):
        closed = case < (opens if closed else closes)
        feeds[second] = float(closed)
    return follows(feeds, log_uniform(rng, 300, 1200))


def ringing_of_turns(w: World, rng: np.random.Generator) -> FloatArray:
    """Each change of the rate of temperature loosens a lock by its size; it settles within some minutes."""
    slope = np.gradient(follows(w.case, 90.0)) * 60.0
    settles_s, loose, last = log_uniform(rng, 300, 1200), 0.0, float(slope[0])
    left = np.empty(len(slope))
    for second, value in enumerate(slope.tolist()):
        loose += abs(value - last) - loose / settles_s
        left[second], last = loose, value
    return left


def reference_of_two_diodes(w: World, rng: np.random.Generator) -> FloatArray:
    """Two diodes of a reference lie on parts with time constants of their own; the supply scales the difference."""
    near, far = follows(w.case, log_uniform(rng, 60, 200)), follows(w.case, log_uniform(rng, 500, 2000))
    return np.asarray((near - far) * (w.supply / w.constant(float(np.mean(w.supply))) - rng.uniform(0.9, 0.97)))


def saturated_core(w: World, rng: np.random.Generator) -> FloatArray:
    """The heater's field magnetises a core towards saturation; what remains fades slowly."""
    fades_s, strength, core = log_uniform(rng, 1500, 6000), rng.uniform(1.0, 3.0), 0.0
    field = np.empty(len(w.heater))
    for second, heats in enumerate((w.heater / max(w.constant(float(np.max(w.heater))), 1e-9)).tolist()):
        core += max(np.tanh(strength * heats) - core, 0.0) / 60.0 - core / fades_s
        field[second] = core
    return field


def mode_by_inner_temperature(w: World, rng: np.random.Generator) -> FloatArray:
    """A mode of the frame is met at one temperature of a part inside, and scales with the drive's error."""
    inside = follows(w.case, log_uniform(rng, 100, 500))
    apart = (inside - rng.uniform(0.0, 50.0)) / rng.uniform(3.0, 8.0)
    return np.asarray((w.drive - w.constant(float(np.mean(w.drive))) * rng.uniform(0.97, 1.03)) / (1.0 + apart**2))


def pump_of_the_room(w: World, rng: np.random.Generator) -> FloatArray:
    """A pump outside shakes the table by a clock of its own; a rubber foot passes it on while it is cold."""
    period, foot = log_uniform(rng, 700, 2500), follows(w.air, log_uniform(rng, 600, 2000))
    runs = np.mod(w.time + rng.uniform(0.0, period), period) < rng.uniform(0.3, 0.6) * period
    return np.asarray(runs / (1.0 + np.exp((foot - rng.uniform(-5.0, 25.0)) / 6.0)))


def charge_by_warming(w: World, rng: np.random.Generator) -> FloatArray:
    """A pyroelectric crystal is charged by each change of temperature; it leaks the faster, the warmer it is."""
    tau_s, warm, charge, out = log_uniform(rng, 300, 3000), rng.uniform(15.0, 40.0), 0.0, np.empty(len(w.case))
    last = float(w.case[0])
    for second, case in enumerate(w.case.tolist()):
        charge += (case - last) - charge * np.exp((case - 25.0) / warm) / tau_s
        out[second], last = charge, case
    return out


def getter(w: World, rng: np.random.Generator) -> FloatArray:
    """Walls give off gas by an exponential of the temperature, and a getter takes it up."""
    tau_s, warm, gas, out = log_uniform(rng, 1000, 8000), rng.uniform(12.0, 30.0), 0.0, np.empty(len(w.case))
    for second, case in enumerate(w.case.tolist()):
        gas += (np.exp((case - 60.0) / warm) - gas) / tau_s
        out[second] = gas
    return out


def bowed_housing(w: World, rng: np.random.Generator) -> FloatArray:
    """Lid and base of a housing follow air and case; what they are apart bows it, more than in proportion."""
    apart = follows(w.air, log_uniform(rng, 100, 600)) - follows(w.case, log_uniform(rng, 30, 200))
    return np.asarray(apart * np.abs(apart))


def lid_that_snaps_flat(w: World, rng: np.random.Generator) -> FloatArray:
    """A lid over warm gas bulges one way or the other from the pressure at which it is flat."""
    gas = follows(w.case, log_uniform(rng, 100, 800))
    return np.asarray(np.abs(gas - rng.uniform(0.0, 50.0)))


def dirty_contact(w: World, rng: np.random.Generator) -> FloatArray:
    """A contact is worn by warming, cleans itself by cooling at half the speed, and forgets."""
    tau_s, worn, out, last = log_uniform(rng, 600, 4000), 0.0, np.empty(len(w.case)), float(w.case[0])
    for second, case in enumerate(w.case.tolist()):
        worn += max(case - last, 0.0) - 0.5 * max(last - case, 0.0) - worn / tau_s
        out[second], last = worn, case
    return out


def fan_by_demand(w: World, rng: np.random.Generator) -> FloatArray:
    """The chamber's fan turns the faster, the faster its air changes; a cold mount passes the shaking on."""
    speed = follows(np.abs(_per_minute(w.air)), log_uniform(rng, 20, 200))
    return np.asarray(speed * np.exp(-(w.case - 25.0) / rng.uniform(20.0, 60.0)))


def drop_out(w: World, rng: np.random.Generator) -> FloatArray:
    """A regulator runs out of headroom below a supply, and pulls the frequency's reference."""
    low, high = w.constant(float(w.supply.min())), w.constant(float(w.supply.max()))
    middle = w.constant(float(np.mean(w.frequency)))
    short = np.maximum(low + rng.uniform(0.3, 0.7) * (high - low) - w.supply, 0.0)
    return np.asarray(short * (w.frequency - middle + rng.uniform(-4.0, 4.0)))


def oven_at_its_limits(w: World, rng: np.random.Generator) -> FloatArray:
    """An oven inside holds a temperature until its power is used up, or no more is needed."""
    inside = follows(w.case, log_uniform(rng, 200, 1200))
    return np.asarray(np.clip((rng.uniform(40.0, 70.0) - inside) / rng.uniform(20.0, 50.0), 0.0, 1.0))


def activity_dip(w: World, rng: np.random.Generator) -> FloatArray:
    """A crystal that lags has an activity dip at one temperature."""
    away = (follows(w.case, log_uniform(rng, 60, 500)) - rng.uniform(-10.0, 60.0)) / rng.uniform(2.0, 6.0)
    return np.asarray(1.0 / (1.0 + away**2))


def ripple_of_a_pump(w: World, rng: np.random.Generator) -> FloatArray:
    """The ripple of a charge pump beats with the supply, and grows with the temperature of the pump."""
    low, high = w.constant(float(w.supply.min())), w.constant(float(w.supply.max()))
    turns = (w.supply - low) / (high - low) * rng.uniform(2.0, 4.0)
    return np.asarray(np.sin(2.0 * np.pi * turns + rng.uniform(0.0, 6.0)) * (w.case + rng.uniform(50.0, 90.0)))


def screw_that_creeps(w: World, rng: np.random.Generator) -> FloatArray:
    """A screw loses preload by the logarithm of the time that it was hot."""
    hot = np.cumsum(w.case > rng.uniform(40.0, 60.0))
    return np.asarray(np.log1p(hot / log_uniform(rng, 300, 1500)))


def limiter_of_the_drive(w: World, rng: np.random.Generator) -> FloatArray:
    """Above a drive the loop limits, and quadrature leaks in proportion to what is cut off."""
    low, high = w.constant(float(w.drive.min())), w.constant(float(w.drive.max()))
    return np.asarray(np.maximum(w.drive - low - rng.uniform(0.4, 0.7) * (high - low), 0.0) * w.quadrature)


def shock_of_cooling(w: World, rng: np.random.Generator) -> FloatArray:
    """The compressor's shaking reaches the unit while it is cooled, in proportion to how fast."""
    return np.asarray(follows(w.compressor, log_uniform(rng, 60, 400)) * np.maximum(-_per_minute(w.case), 0.0))


def seal_dragged_by_the_air(w: World, rng: np.random.Generator) -> FloatArray:
    """A seal at the chamber's wall moves with the air, and drags with play."""
    return w.air - dragged(w.air, rng.uniform(3.0, 15.0))


def loop_behind_its_reference(w: World, rng: np.random.Generator) -> FloatArray:
    """A phase loop is behind a frequency that moves, and its error turns with the frequency."""
    low, high = w.constant(float(w.frequency.min())), w.constant(float(w.frequency.max()))
    turned = np.cos(2.0 * np.pi * (w.frequency - low) / (high - low) * rng.uniform(0.5, 1.5))
    return np.asarray((w.frequency - follows(w.frequency, log_uniform(rng, 60, 600))) * turned)


def poled_by_the_drive(w: World, rng: np.random.Generator) -> FloatArray:
    """A piezo is poled by the drive, faster when warm, towards what the drive is now."""
    tau_s, warm, poled, out = (
        log_uniform(rng, 2000, 8000),
        rng.uniform(20.0, 40.0),
        float(w.drive[0]),
        np.empty(len(w.case)),
    )
    for second, (drive, case) in enumerate(zip(w.drive.tolist(), w.case.tolist(), strict=True)):
        poled += (drive - poled) * np.exp((case - 25.0) / warm) / tau_s
        out[second] = poled - drive
    return out


def _per_minute(value: FloatArray) -> FloatArray:
    return np.asarray(60.0 * np.gradient(follows(value, 60.0)))
