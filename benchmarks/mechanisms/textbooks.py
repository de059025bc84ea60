"""Mechanisms as textbooks have them, written together, before anything was changed for them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bench.base import FloatArray
from benchmarks.mechanisms.world import World, follows, log_uniform


def stepped(driver: FloatArray, state: float, step: Callable[[float, float, float], float]) -> FloatArray:
    """States (n,) of `step(state, value, change of the driver)`, second by second."""
    out, last = np.empty(len(driver)), float(driver[0])
    for second, value in enumerate(driver.tolist()):
        out[second] = state = step(state, value, value - last)
        last = value
    return out


def _behind(w: World, rng: np.random.Generator, low_s: float, high_s: float) -> FloatArray:
    """How far a part is behind the case."""
    return np.asarray(w.case - follows(w.case, log_uniform(rng, low_s, high_s)))


def _rate(w: World, filter_s: float = 90.0) -> FloatArray:
    """Rate of the temperature [degC/min] through a filter."""
    return np.asarray(60.0 * np.gradient(follows(w.case, filter_s)))


def two_gradients(w: World, rng: np.random.Generator) -> FloatArray:
    """A fast part and a slow one act against each other."""
    fast = _behind(w, rng, 200, 600)
    return np.asarray(fast - rng.uniform(0.3, 0.6) * _behind(w, rng, 2500, 6000))


def spread_relaxation(w: World, rng: np.random.Generator) -> FloatArray:
    """Glass relaxes with time constants over a decade and a half."""
    tau_s = log_uniform(rng, 600, 2000)
    return np.asarray(sum(w.case - follows(w.case, share * tau_s) for share in (0.1, 0.3, 1.0, 3.0)))


def power_of_the_rate(w: World, rng: np.random.Generator) -> FloatArray:
    """Convection: the gradient grows faster than the rate of change."""
    rate = _rate(w)
    return np.asarray(np.sign(rate) * np.abs(rate) ** rng.uniform(1.4, 1.8))


def gradient_by_temperature(w: World, rng: np.random.Generator) -> FloatArray:
    """The coefficient of a gradient changes its sign at a temperature."""
    behind = _behind(w, rng, 100, 400)
    return np.asarray(behind * (w.case - rng.uniform(10, 40)))


def gradient_in_the_cold(w: World, rng: np.random.Generator) -> FloatArray:
    """A glue that is stiff in the cold passes a gradient on."""
    return np.asarray(_rate(w, log_uniform(rng, 60, 300)) * np.exp(-w.case / rng.uniform(15, 35)))


def magnet_by_temperature(w: World, rng: np.random.Generator) -> FloatArray:
    """Jiles and Atherton: what follows a saturating curve by as much as the temperature changes."""
    needs, width = rng.uniform(8, 20), rng.uniform(15, 30)
    return stepped(w.case, 0.0, lambda m, t, change: m + (np.tanh((t - 20) / width) - m) / needs * abs(change))


def play_that_narrows(w: World, rng: np.random.Generator) -> FloatArray:
    """A joint whose play becomes less as it warms."""
    wide, shrinks = rng.uniform(4, 10), 0.3 * rng.uniform(0.02, 0.08)

    def step(place: float, t: float, _: float) -> float:
        half = wide * np.exp(-shrinks * (t - 25))
        return float(min(max(place, t - half), t + half))

    return stepped(w.case, float(w.case[0]), step)


def slab(w: World, rng: np.random.Generator) -> FloatArray:
    """The surface of a slab above its mean."""
    return surface_above_mean(w.case, log_uniform(rng, 400, 1500))


def surface_above_mean(case: FloatArray, tau_s: float) -> FloatArray:
    """Of a slab that heat diffuses through in twelve layers, `tau_s` its longest time constant."""
    share = 144.0 * 0.405 / tau_s
    steps = max(1, int(np.ceil(share / 0.4)))
    layers, above = np.full(12, case[0]), np.empty(len(case))
    for second, surface in enumerate(case):
        for _ in range(steps):
            outer, inner = np.append(surface, layers[:-1]), np.append(layers[1:], layers[-1])
            layers = layers + share / steps * (outer - 2.0 * layers + inner)
        above[second] = surface - layers.mean()
    return above


def gap_squared(w: World, rng: np.random.Generator) -> FloatArray:
    """Radiation or free convection from the air: the square of the gap, with its sign."""
    gap = follows(w.air - w.case, log_uniform(rng, 60, 400))
    return np.asarray(gap * np.abs(gap))


def chirped_etalon(w: World, rng: np.random.Generator) -> FloatArray:
    """Interference of a path that grows with the square of the temperature, too."""
    phase = w.case / rng.uniform(12, 25) + (w.case / rng.uniform(60, 90)) ** 2
    return np.asarray(np.sin(2 * np.pi * phase))


def etalon_inside(w: World, rng: np.random.Generator) -> FloatArray:
    """Interference of a path whose temperature follows the case."""
    inside = follows(w.case, log_uniform(rng, 100, 500))
    return np.asarray(np.sin(2 * np.pi * inside / rng.uniform(9, 25) + rng.uniform(0, 6)))


def quadrature_by_gradient(w: World, rng: np.random.Generator) -> FloatArray:
    """A gradient turns the phase that the quadrature leaks through."""
    left = w.quadrature - w.constant(float(np.mean(w.quadrature))) * rng.uniform(0, 0.8)
    return np.asarray(left * _rate(w, log_uniform(rng, 60, 300)))


def compressor_by_gap(w: World, rng: np.random.Generator) -> FloatArray:
    """Cold air blows over a duct while the compressor is on."""
    return np.asarray(w.compressor * follows(w.air - w.case, log_uniform(rng, 60, 300)))


def supply_by_temperature(w: World, rng: np.random.Generator) -> FloatArray:
    """A regulator rejects the supply less when it is warm."""
    return np.asarray((w.supply - w.constant(float(np.mean(w.supply)))) * (w.case - rng.uniform(-60, -45)))


def frequency_squared_late(w: World, rng: np.random.Generator) -> FloatArray:
    """A loop follows the square of the frequency late."""
    away = (w.frequency - w.constant(float(np.mean(w.frequency)))) / w.constant(float(np.std(w.frequency)))
    return np.asarray(follows(away, log_uniform(rng, 100, 600)) ** 2 - away**2)


def root_of_time(w: World, rng: np.random.Generator) -> FloatArray:
    """Diffusion after the start: an exponential of the square root of time."""
    return np.asarray(np.exp(-np.sqrt(w.time / log_uniform(rng, 300, 3000))))


def logarithm_since_the_turn(w: World, rng: np.random.Generator) -> FloatArray:
    """Creep by the logarithm of the time since the direction changed."""
    tau_s, since, way, out = log_uniform(rng, 100, 600), 0.0, 0.0, np.empty(len(w.case))
    for second, rate in enumerate(_rate(w).tolist()):
        now = float(np.sign(rate)) if abs(rate) > 0.1 else 0.0
        since, way = (0.0, now) if now != way else (since, way)
        since += 1.0
        out[second] = way * np.log1p(since / tau_s)
    return follows(out, 60.0)


def relay_of_an_inner_part(w: World, rng: np.random.Generator) -> FloatArray:
    """A relay in a part that follows the case; what it switches takes its time."""
    on = rng.uniform(30, 50)
    off = on - rng.uniform(10, 40)
    inside = follows(w.case, log_uniform(rng, 100, 500))
    return follows(stepped(inside, 0.0, lambda was, t, _: float(t > (off if was else on))), log_uniform(rng, 60, 600))


def bump_while_cooled(w: World, rng: np.random.Generator) -> FloatArray:
    """A seal that sticks near one temperature, while the unit is cooled."""
    near = np.exp(-0.5 * ((w.case - rng.uniform(0, 50)) / rng.uniform(5, 12)) ** 2)
    return np.asarray(near / (1 + np.exp(_rate(w) / 0.15)))


def unlike_up_and_down(w: World, rng: np.random.Generator) -> FloatArray:
    """A gradient that acts less while the unit is cooled."""
    rate = _rate(w, 120.0)
    return np.asarray(np.maximum(rate, 0) + rng.uniform(0.1, 0.4) * np.minimum(rate, 0))


def gradient_with_limits(w: World, rng: np.random.Generator) -> FloatArray:
    """A gradient that saturates."""
    return np.asarray(np.tanh(_rate(w, 120.0) / rng.uniform(0.3, 0.8)))


def gradient_beyond_a_slot(w: World, rng: np.random.Generator) -> FloatArray:
    """A part with clearance, which a gradient moves only beyond it."""
    behind = _behind(w, rng, 200, 600)
    return np.asarray(np.sign(behind) * np.maximum(np.abs(behind) - rng.uniform(2, 5), 0))


def lag_that_thaws(w: World, rng: np.random.Generator) -> FloatArray:
    """A viscous part follows the faster the warmer it is."""
    tau_s, degc = log_uniform(rng, 300, 900), rng.uniform(20, 45)
    inside = stepped(w.case, float(w.case[0]), lambda x, t, _: x + (t - x) / (tau_s * np.exp(-(t - 25) / degc)))
    return np.asarray(w.case - inside)


def water_by_arrhenius(w: World, rng: np.random.Generator) -> FloatArray:
    """Water leaves a glue towards what its temperature allows, at a rate after Arrhenius."""
    tau_s, kelvin = log_uniform(rng, 2000, 6000), rng.uniform(3000, 6000)

    def step(water: float, t: float, _: float) -> float:
        faster = np.exp(-kelvin * (1 / (t + 273) - 1 / 298))
        return float(water + (np.exp(-(t - 25) / 30) - water) * min(faster / tau_s, 0.5))

    return stepped(w.case, 1.0, step)


def heater_by_supply(w: World, rng: np.random.Generator) -> FloatArray:
    """The chamber's heater warms a cable that carries the supply."""
    return np.asarray(follows(w.heater, log_uniform(rng, 200, 900)) * w.supply)


def drive_by_gradient(w: World, rng: np.random.Generator) -> FloatArray:
    """The drive's amplitude scales a gradient."""
    left = w.drive - w.constant(float(np.mean(w.drive))) * rng.uniform(0.9, 0.98)
    return np.asarray(left * _behind(w, rng, 200, 800))


def loop_by_rate(w: World, rng: np.random.Generator) -> FloatArray:
    """A friction whose force grows with the rate of change."""
    force, grows = rng.uniform(6, 15), rng.uniform(0.5, 1.5)
    most = iter((force * (1 + grows * np.abs(_rate(w)))).tolist())
    return stepped(w.case, 0.0, lambda z, _, change: z + change - abs(change) * z / next(most))


def beat_by_temperature(w: World, rng: np.random.Generator) -> FloatArray:
    """A beat with a period of its own that is stronger when it is warm."""
    return np.asarray(np.sin(2 * np.pi * w.time / log_uniform(rng, 900, 3000) + rng.uniform(0, 6)) * (w.case + 45))


def exponential_gap(w: World, rng: np.random.Generator) -> FloatArray:
    """Leakage currents of two parts, of which one follows the case."""
    return np.asarray(np.exp(follows(w.case, log_uniform(rng, 200, 900)) / 20) - np.exp(w.case / 20))


def mode_late(w: World, rng: np.random.Generator) -> FloatArray:
    """A mode of the package that the frequency meets rings on for minutes."""
    low, high = w.constant(float(w.frequency.min())), w.constant(float(w.frequency.max()))
    away = (w.frequency - low - (high - low) * rng.uniform(0.3, 0.7)) / ((high - low) * rng.uniform(0.04, 0.12))
    return follows(1 / (1 + away**2), log_uniform(rng, 150, 600))


def gap_by_gradient(w: World, rng: np.random.Generator) -> FloatArray:
    """Two gradients that multiply: from the air and within the unit."""
    outside = follows(w.air, log_uniform(rng, 100, 300)) - w.case
    return np.asarray(outside * _behind(w, rng, 300, 900))


def dose_of_warmth(w: World, rng: np.random.Generator) -> FloatArray:
    """Ageing by an exponential of the temperature."""
    return np.asarray(np.cumsum(np.exp(w.case / rng.uniform(15, 40))))


def gradient_that_turns_over(w: World, rng: np.random.Generator) -> FloatArray:
    """Above one temperature a gradient acts the other way, and less."""
    behind = _behind(w, rng, 150, 500)
    return np.where(w.case > rng.uniform(10, 45), behind, -rng.uniform(0.2, 0.6) * behind)


def kick_at_each_turn(w: World, rng: np.random.Generator) -> FloatArray:
    """Each change of the direction kicks a lock, one way and the other; it settles."""
    tau_s, kicked, way, out = log_uniform(rng, 600, 3000), 0.0, 1.0, np.empty(len(w.case))
    for second, rate in enumerate(_rate(w).tolist()):
        if rate * way < -0.1:
            kicked, way = kicked + way, -way
        kicked -= kicked / tau_s
        out[second] = kicked
    return out


def quadrature_late(w: World, rng: np.random.Generator) -> FloatArray:
    """A loop follows the quadrature late."""
    return np.asarray(follows(w.quadrature, log_uniform(rng, 200, 900)) - w.quadrature)


def compressor_by_gradient(w: World, rng: np.random.Generator) -> FloatArray:
    """Shaking by the compressor moves what a gradient has bent."""
    return np.asarray(w.compressor * _behind(w, rng, 200, 600))
