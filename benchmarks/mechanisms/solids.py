"""Mechanisms in solids and circuits, counted before anything was changed for them."""

from __future__ import annotations

import numpy as np

from bench.base import FloatArray
from benchmarks.mechanisms.world import World, dragged, follows, log_uniform, switched


def rate(w: World) -> FloatArray:
    """Rate of the temperature [degC/min]."""
    return np.asarray(np.gradient(follows(w.case, 30.0)) * 60.0)


def anneal(w: World, rng: np.random.Generator) -> FloatArray:
    """Cooling adds stress, which anneals at a rate by Arrhenius."""
    e, t0 = (rng.uniform(0.02, 0.05), rng.uniform(1500, 6000))
    s = 0.0
    out = np.empty(len(w.case))
    last = float(w.case[0])
    for i, c in enumerate(w.case.tolist()):
        s += max(last - c, 0.0) - s / (t0 * np.exp(-e * (c - 25.0)))
        last = c
        out[i] = s
    return out


def humid_air(w: World, rng: np.random.Generator) -> FloatArray:
    """The compressor dries the air, which takes up water again while it rests; a part follows the humidity."""
    h, dry, wet = (1.0, log_uniform(rng, 300, 1200), log_uniform(rng, 1500, 5000))
    out = np.empty(len(w.case))
    for i, c in enumerate(w.compressor.tolist()):
        h += (1 - h) / wet - c * h / dry
        out[i] = h
    return follows(out, log_uniform(rng, 200, 900))


def preload(w: World, rng: np.random.Generator) -> FloatArray:
    """A contact presses by the root of the temperature above a value, and passes on the gap to the air."""
    return np.asarray(np.sqrt(np.maximum(w.case - rng.uniform(-10, 40), 0.0)) * (w.air - w.case))


def clipped_amplifier(w: World, rng: np.random.Generator) -> FloatArray:
    """An amplifier of the frequency error reaches its limits, and scales with the supply."""
    f = w.frequency
    mid = w.constant(float(np.mean(f)))
    wide = w.constant(float(np.ptp(f)))
    return np.asarray(
        np.clip(f - mid - rng.uniform(-0.2, 0.2) * wide, -0.12 * wide, 0.12 * wide)
        * (w.supply - w.constant(float(np.mean(w.supply))))
    )


def middle_node(w: World, rng: np.random.Generator) -> FloatArray:
    """The second difference of three nodes in a row: a body that bows."""
    mid = follows(w.case, log_uniform(rng, 100, 400))
    inner = follows(mid, log_uniform(rng, 200, 800))
    return np.asarray(w.case - 2 * mid + inner)


def crack(w: World, rng: np.random.Generator) -> FloatArray:
    """A crack springs open at one temperature, and closes steadily towards a higher one."""
    low, high = sorted(rng.uniform(-15, 55, 2))
    high = max(high, low + 8)
    return np.asarray(switched(w.case, low, high) * (high - w.case))


def loop_of_the_frequency(w: World, rng: np.random.Generator) -> FloatArray:
    """The frequency drags something along with play."""
    wide = w.constant(float(np.ptp(w.frequency))) * rng.uniform(0.04, 0.12)
    return w.frequency - dragged(w.frequency, wide)


def warm_resistor(w: World, rng: np.random.Generator) -> FloatArray:
    """The drive heats a resistor, the more the colder it is; a part follows."""
    heat = (w.drive / w.constant(float(np.mean(w.drive)))) ** 2 * np.exp(-w.case / rng.uniform(30, 80))
    return follows(heat, log_uniform(rng, 200, 1500))


def blow_at_the_turn(w: World, rng: np.random.Generator) -> FloatArray:
    """Each turn of the temperature is a blow one way or the other, which dies down."""
    tau, n = (log_uniform(rng, 150, 900), 0.0)
    out = np.empty(len(w.case))
    r = rate(w)
    side = 0
    for i, x in enumerate(r.tolist()):
        now = 1 if x > 0.1 else -1 if x < -0.1 else side
        if now != side and side:
            n += now
        side = now
        n -= n / tau
        out[i] = n
    return out


def still_only(w: World, rng: np.random.Generator) -> FloatArray:
    """What settles only while the temperature stands still, in proportion to the temperature."""
    calm = (np.abs(rate(w)) < rng.uniform(0.05, 0.15)).astype(float)
    return np.asarray(follows(calm, log_uniform(rng, 60, 400)) * (w.case - rng.uniform(0, 40)))


def coil_of_the_heater(w: World, rng: np.random.Generator) -> FloatArray:
    """The square of the heater's current, through a mass, grows with the temperature."""
    i2 = (w.heater / max(w.constant(float(np.max(w.heater))), 1e-09)) ** 2
    return np.asarray(follows(i2, log_uniform(rng, 30, 120)) * np.exp((w.case - 25) / rng.uniform(40, 90)))


def seebeck(w: World, rng: np.random.Generator) -> FloatArray:
    """Two junctions at two depths, whose voltage grows with their mean temperature."""
    a, b = (follows(w.case, log_uniform(rng, 50, 150)), follows(w.case, log_uniform(rng, 300, 900)))
    return np.asarray((a - b) * (a + b + 2 * 273.15 - 2 * rng.uniform(250, 290)))


def leak_while_still(w: World, rng: np.random.Generator) -> FloatArray:
    """Charge follows the temperature, and leaks only while it stands still."""
    q, k, tau = (0.0, rng.uniform(0.1, 0.4), log_uniform(rng, 400, 2500))
    out = np.empty(len(w.case))
    r = rate(w)
    last = float(w.case[0])
    for i, c in enumerate(w.case.tolist()):
        q += c - last
        last = c
        if abs(r[i]) < k:
            q -= q / tau
        out[i] = q
    return out


def vent(w: World, rng: np.random.Generator) -> FloatArray:
    """A valve in an inner part opens above a temperature and closes below another; it lets the air in."""
    inner = follows(w.case, log_uniform(rng, 100, 500))
    low, high = sorted(rng.uniform(0, 60, 2))
    high = max(high, low + 6)
    return np.asarray(switched(-inner, -high, -low) * (w.air - inner))


def spring_of_two_metals(w: World, rng: np.random.Generator) -> FloatArray:
    """The gap between air and unit, and a part of its square with its sign."""
    d = follows(w.air, log_uniform(rng, 60, 200)) - w.case
    return np.asarray(d + rng.uniform(0.03, 0.1) * d * np.abs(d) * np.sign(rng.uniform(-0.3, 1)))


def worn_by_swings(w: World, rng: np.random.Generator) -> FloatArray:
    """Any change of temperature wears, the more the warmer it is; it recovers."""
    s, tau = (0.0, log_uniform(rng, 1500, 8000))
    out = np.empty(len(w.case))
    last = float(w.case[0])
    for i, c in enumerate(w.case.tolist()):
        s += abs(c - last) * np.exp((c - 25) / 40.0) - s / tau
        last = c
        out[i] = s
    return out


def gate(w: World, rng: np.random.Generator) -> FloatArray:
    """The compressor acts only where the supply is low."""
    q = w.constant(float(np.quantile(w.supply, rng.uniform(0.35, 0.65))))
    return np.asarray(w.compressor * (w.supply < q))


def mirror_image(w: World, rng: np.random.Generator) -> FloatArray:
    """A gradient whose sign and size change about a temperature, by a logarithm."""
    x = w.case - rng.uniform(5, 45)
    return np.asarray(np.sign(x) * np.log1p(np.abs(x) / rng.uniform(2, 6)) * rate(w))


def quad_over_drive(w: World, rng: np.random.Generator) -> FloatArray:
    """The quadrature over an amplitude that comes near to nothing."""
    d = w.drive - w.constant(float(np.min(w.drive))) + 0.15 * w.constant(float(np.ptp(w.drive)))
    return np.asarray((w.quadrature - w.constant(float(np.mean(w.quadrature)))) / d)


def gel(w: World, rng: np.random.Generator) -> FloatArray:
    """Stiffness follows an inner temperature, stress is what case and inner differ by."""
    i = follows(w.case, log_uniform(rng, 200, 900))
    return np.asarray((w.case - i) / (1 + np.exp((i - rng.uniform(5, 45)) / rng.uniform(2, 6))))
