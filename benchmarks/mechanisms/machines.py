"""Mechanisms of machines, contacts and optics, counted before anything was changed for them."""

from __future__ import annotations

import numpy as np

from bench.base import FloatArray
from benchmarks.mechanisms.solids import rate
from benchmarks.mechanisms.world import World, dragged, follows, log_uniform, switched, unevenly


def film_of_oil(w: World, rng: np.random.Generator) -> FloatArray:
    """Viscous: creeps by force over viscosity that falls when warm; force is the gap."""
    tau, e = (log_uniform(rng, 300, 2000), rng.uniform(0.03, 0.07))
    x = 0.0
    out = np.empty(len(w.case))
    for i, (c, a) in enumerate(zip(w.case.tolist(), w.air.tolist(), strict=True)):
        x += ((a - c) * 0.1 - x) / tau * np.exp(e * (c - 25))
        out[i] = x
    return out


def slip_ring(w: World, rng: np.random.Generator) -> FloatArray:
    """Contact resistance with wear by |gap|, times supply."""
    return np.asarray(
        follows(np.abs(w.air - w.case), log_uniform(rng, 400, 3000)) * (w.supply - w.constant(float(np.mean(w.supply))))
    )


def dead_band_of_a_valve(w: World, rng: np.random.Generator) -> FloatArray:
    """A valve passes on rates beyond its dead band; a part follows."""
    r = rate(w)
    z = rng.uniform(0.2, 0.5)
    x = np.where(np.abs(r) > z, r - np.sign(r) * z, 0.0)
    return follows(x, log_uniform(rng, 100, 800))


def thermostat_oven(w: World, rng: np.random.Generator) -> FloatArray:
    """An inner oven holds its set point as long as it can: leakage where the heater saturates."""
    t, out, set_, p = (float(w.case[0]), np.empty(len(w.case)), rng.uniform(45, 65), rng.uniform(25, 60))
    tau = log_uniform(rng, 200, 600)
    for i, c in enumerate(w.case.tolist()):
        h = min(max((set_ - t) * 4.0, 0.0), p)
        t += (c + h - t) / tau
        out[i] = t
    return out


def two_rate_wear(w: World, rng: np.random.Generator) -> FloatArray:
    """An exponential of the temperature that is taken up faster than it is given off."""
    up_s, down_s = log_uniform(rng, 300, 1200), log_uniform(rng, 3000, 12000)
    return unevenly(np.exp((w.case - 25) / 30.0), up_s, down_s, start=0.0)


def moire(w: World, rng: np.random.Generator) -> FloatArray:
    """Two periodic effects over temperature beat."""
    p = rng.uniform(6, 14)
    return np.asarray(np.sin(2 * np.pi * w.case / p) * np.sin(2 * np.pi * w.case / (p * rng.uniform(2.5, 5))))


def parametric(w: World, rng: np.random.Generator) -> FloatArray:
    """The frequency error times a gradient."""
    f = (w.frequency - w.constant(float(np.mean(w.frequency)))) / w.constant(float(np.ptp(w.frequency)))
    return np.asarray(f * follows(rate(w), log_uniform(rng, 60, 600)))


def boil(w: World, rng: np.random.Generator) -> FloatArray:
    """Above a temperature an inner part loses something at a rate; below it returns slower."""
    m = 0.0
    t0 = rng.uniform(35, 60)
    a, b = (log_uniform(rng, 400, 1500), log_uniform(rng, 2000, 9000))
    out = np.empty(len(w.case))
    for i, c in enumerate(follows(w.case, 200.0).tolist()):
        m += (1 - m) / a if c > t0 else -m / b
        out[i] = m
    return out


def stick_of_the_frame(w: World, rng: np.random.Generator) -> FloatArray:
    """Strain builds up with the gap until it slips back to a quarter."""
    s, lim = (0.0, rng.uniform(6, 16))
    last = float(w.case[0])
    out = np.empty(len(w.case))
    for i, c in enumerate(w.case.tolist()):
        s += c - last
        last = c
        if abs(s) > lim:
            s *= 0.25
        out[i] = s
    return out


def late_heat_of_the_drive(w: World, rng: np.random.Generator) -> FloatArray:
    """What the drive did in the last while, between two time constants."""
    return np.asarray(follows(w.drive, log_uniform(rng, 500, 2500)) - follows(w.drive, log_uniform(rng, 60, 200)))


def cold_start_current(w: World, rng: np.random.Generator) -> FloatArray:
    """Two decays after the start."""
    return np.asarray(
        np.exp(-w.time / log_uniform(rng, 300, 1500))
        + rng.uniform(0.3, 0.8) * np.exp(-w.time / log_uniform(rng, 3000, 9000))
    )


def gap_to_the_fourth(w: World, rng: np.random.Generator) -> FloatArray:
    """Radiation between air and unit, seen in a window of temperature."""
    return np.asarray(
        ((w.air + 273.15) ** 4 - (w.case + 273.15) ** 4)
        / 100000000.0
        * np.exp(-(((w.case - rng.uniform(0, 50)) / rng.uniform(20, 50)) ** 2))
    )


def wet_side(w: World, rng: np.random.Generator) -> FloatArray:
    """Water condenses below a dew point, and dries the faster the warmer it is."""
    m, dew = (0.0, rng.uniform(2, 18))
    ev = log_uniform(rng, 500, 2500)
    out = np.empty(len(w.case))
    for i, c in enumerate(w.case.tolist()):
        m += max(dew - c, 0.0) * 0.001 - m / (ev * np.exp(-0.05 * (c - 25)))
        m = max(m, 0.0)
        out[i] = m
    return out


def saturating_loop(w: World, rng: np.random.Generator) -> FloatArray:
    """A loop with play behind a limiter, less the limiter without play."""
    x = (w.case - rng.uniform(10, 40)) / rng.uniform(15, 35)
    return np.asarray(np.tanh(dragged(x, rng.uniform(0.1, 0.3))) - np.tanh(x))


def comb_of_modes(w: World, rng: np.random.Generator) -> FloatArray:
    """The frequency passes three modes."""
    f = w.frequency
    lo = w.constant(float(f.min()))
    span = w.constant(float(np.ptp(f)))
    return np.asarray(
        sum(
            (
                1 / (1 + ((f - lo - s * span) / (0.04 * span)) ** 2) * g
                for s, g in zip(rng.uniform(0.1, 0.9, 3), rng.uniform(0.4, 1, 3) * np.array([1, -1, 1]), strict=True)
            )
        )
    )


def supply_of_the_cold(w: World, rng: np.random.Generator) -> FloatArray:
    """The supply acts only in the cold."""
    return np.asarray(
        (w.supply - w.constant(float(np.mean(w.supply))))
        / (1 + np.exp((w.case - rng.uniform(-10, 30)) / rng.uniform(2, 6)))
    )


def compressor_fades(w: World, rng: np.random.Generator) -> FloatArray:
    """The mount gets used to shaking: what the compressor does fades as it runs, and comes back while it rests."""
    u, a, b = (0.0, log_uniform(rng, 100, 400), log_uniform(rng, 300, 1500))
    out = np.empty(len(w.case))
    for i, c in enumerate(w.compressor.tolist()):
        u += (1 - u) / a if c > 0.5 else -u / b
        out[i] = c * (1 - u)
    return out


def rate_squared_late(w: World, rng: np.random.Generator) -> FloatArray:
    """The square of the rate, late, and more when it is warm."""
    r = rate(w)
    return np.asarray(follows(r * r, log_uniform(rng, 200, 1500)) * (1 + w.case / rng.uniform(60, 150)))


def wall_and_core(w: World, rng: np.random.Generator) -> FloatArray:
    """The product of the gradients in a wall and in its core."""
    a = follows(w.case, log_uniform(rng, 100, 400))
    b = follows(a, log_uniform(rng, 300, 1200))
    return np.asarray((w.case - a) * (a - b))


def ratchets_down(w: World, rng: np.random.Generator) -> FloatArray:
    """Each cooling below a place takes a little away for good, in proportion to the depth."""
    t0, lvl, deep = (rng.uniform(-10, 20), 0.0, 0.0)
    out = np.empty(len(w.case))
    for i, c in enumerate(w.case.tolist()):
        d = max(t0 - c, 0.0)
        if d > deep:
            lvl += d - deep
        deep = d if d > 0 else 0.0
        out[i] = lvl
    return out


def coil_of_fibre(w: World, rng: np.random.Generator) -> FloatArray:
    """Two ends of a coil feel the rate at two depths, one against the other."""
    r = rate(w)
    return np.asarray(
        follows(r, log_uniform(rng, 40, 120)) - rng.uniform(0.6, 1.0) * follows(r, log_uniform(rng, 300, 900))
    )


def package_that_bows(w: World, rng: np.random.Generator) -> FloatArray:
    """A gradient and its square."""
    g = w.case - follows(w.case, log_uniform(rng, 150, 700))
    return np.asarray(g + rng.uniform(0.05, 0.2) * g * g)


def power_of_the_supply(w: World, rng: np.random.Generator) -> FloatArray:
    """The square of the supply heats a part."""
    s = w.supply - w.constant(float(np.mean(w.supply))) * rng.uniform(0.97, 1.0)
    return np.asarray(follows(s * s, log_uniform(rng, 200, 1200)) * 1000.0)


def frozen_joint(w: World, rng: np.random.Generator) -> FloatArray:
    """Below zero a joint is rigid and passes on the gap; above it slips."""
    return np.asarray(
        (w.air - w.case)
        / (1 + np.exp((follows(w.case, log_uniform(rng, 60, 300)) - rng.uniform(-5, 8)) / rng.uniform(1, 3)))
    )


def pyroelectric(w: World, rng: np.random.Generator) -> FloatArray:
    """Charge by each change of temperature, which leaks faster when it is warm, squared with its sign."""
    q = 0.0
    tau = log_uniform(rng, 100, 900)
    e = rng.uniform(0.02, 0.05)
    out = np.empty(len(w.case))
    last = float(w.case[0])
    for i, c in enumerate(w.case.tolist()):
        q += c - last - q / (tau * np.exp(-e * (c - 25)))
        last = c
        out[i] = q
    return np.asarray(out * np.abs(out))


def connector(w: World, rng: np.random.Generator) -> FloatArray:
    """A contact is bad from one temperature down until another one up; it then passes on the supply."""
    lo, hi = sorted(rng.uniform(-20, 50, 2))
    bad = switched(w.case, lo, max(hi, lo + 10))
    return np.asarray(bad * (w.supply - w.constant(float(np.min(w.supply)))))


def mode_hop_with_memory(w: World, rng: np.random.Generator) -> FloatArray:
    """A light source hops between modes, later up than down."""
    step = rng.uniform(12, 25)
    h = rng.uniform(0.15, 0.35) * step
    k = 0
    out = np.empty(len(w.case))
    for i, c in enumerate(w.case.tolist()):
        if c > k * step + step / 2 + h:
            k += 1
        if c < k * step - step / 2 - h:
            k -= 1
        out[i] = c - k * step
    return out


def hum_of_the_pump(w: World, rng: np.random.Generator) -> FloatArray:
    """A period of its own, only while the compressor runs."""
    per = log_uniform(rng, 300, 900)
    return np.asarray(w.compressor * np.sin(2 * np.pi * w.time / per))


def arrhenius_ageing(w: World, rng: np.random.Generator) -> FloatArray:
    """Ageing that is faster when it is warm."""
    return np.asarray(np.cumsum(np.exp((w.case - 25) / rng.uniform(15, 35))) / 3600.0)


def free_convection(w: World, rng: np.random.Generator) -> FloatArray:
    """Convection by the power 1.25 of the gap, less when it is warm."""
    g = w.air - w.case
    return np.asarray(np.sign(g) * np.abs(g) ** 1.25 * np.exp(-w.case / rng.uniform(60, 200)))


def friction_that_weakens(w: World, rng: np.random.Generator) -> FloatArray:
    """Friction that falls with the rate."""
    r = rate(w)
    return np.asarray(np.sign(r) * np.exp(-np.abs(r) / rng.uniform(0.3, 0.9)) * (np.abs(r) > 0.03))


def limit_cycle(w: World, rng: np.random.Generator) -> FloatArray:
    """A loop swings by its own period, the more the further the temperature is from a value."""
    return np.asarray(
        np.abs(w.case - rng.uniform(10, 40))
        * np.sin(2 * np.pi * w.time / log_uniform(rng, 400, 1500) + rng.uniform(0, 6))
    )


def foot_by_the_air(w: World, rng: np.random.Generator) -> FloatArray:
    """A foot that follows the air, times the distance of the temperature from a value."""
    a = follows(w.air, log_uniform(rng, 600, 3000))
    return np.asarray((a - w.constant(25.0)) * (w.case - rng.uniform(0, 40)))


def last_extreme(w: World, rng: np.random.Generator) -> FloatArray:
    """Residual stress by the last turning point: it stays until the next turn."""
    last = float(w.case[0])
    way = 0
    peak = last
    out = np.empty(len(w.case))
    held = last
    for i, c in enumerate(w.case.tolist()):
        if way >= 0:
            if c > peak:
                peak = c
                way = 1
            elif c < peak - 1.0:
                held = peak
                way = -1
                peak = c
        elif c < peak:
            peak = c
        elif c > peak + 1.0:
            held = peak
            way = 1
            peak = c
        out[i] = held
    return follows(out, log_uniform(rng, 60, 300))


def heat_pipe(w: World, rng: np.random.Generator) -> FloatArray:
    """Conducts only one way: the inner node warms fast from the case and cools slowly, more so when cold."""
    up_s, down_s = log_uniform(rng, 60, 250), log_uniform(rng, 1500, 6000)
    return np.asarray((w.case - unevenly(w.case, up_s, down_s)) * (1 + w.case / rng.uniform(80, 200)))


def rectified_gradient(w: World, rng: np.random.Generator) -> FloatArray:
    """The size of a gradient, with the sign of the distance from a temperature."""
    r = follows(rate(w), log_uniform(rng, 80, 300))
    return np.asarray(np.abs(r) * np.sign(w.case - rng.uniform(5, 45)))


def damped_swing(w: World, rng: np.random.Generator) -> FloatArray:
    """A control loop rings after each change of the rate: second order, lightly damped."""
    x = v = 0.0
    om = 2 * np.pi / log_uniform(rng, 500, 1500)
    z = rng.uniform(0.1, 0.3)
    r = rate(w)
    out = np.empty(len(w.case))
    for i, u in enumerate(r.tolist()):
        v += om * om * (u - x) - 2 * z * om * v
        x += v
        out[i] = x - u
    return out


def supply_through_the_heater(w: World, rng: np.random.Generator) -> FloatArray:
    """The heater's current acts through the supply."""
    return np.asarray(
        follows(w.heater / max(w.constant(float(np.max(w.heater))), 1e-09), log_uniform(rng, 30, 100))
        * (w.supply - w.constant(float(np.mean(w.supply))))
    )
