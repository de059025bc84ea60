"""Mechanisms by an author who did not know the search, counted before anything was changed."""

from __future__ import annotations

import numpy as np
from scipy.special import erfc

from bench.base import FloatArray
from benchmarks.mechanisms.world import World, follows, log_uniform

KELVIN = 273.15


def back_stress_of_the_die_attach(w: World, rng: np.random.Generator) -> FloatArray:
    """A die attach yields once its stress is too far from a back stress, which hardens by the flow and saturates."""
    limit, hard, most = rng.uniform(4, 15), rng.uniform(0.1, 0.5), rng.uniform(10, 30)
    stress, back, last, out = 0.0, 0.0, float(w.case[0]), np.empty(len(w.case))
    for i, c in enumerate(w.case.tolist()):
        stress += c - last
        last = c
        side = 1.0 if stress > back else -1.0
        beyond = side * (stress - back) - limit
        if beyond > 0.0:
            growth = hard * (1.0 - side * back / most)
            flow = beyond / (1.0 + growth)
            stress -= side * flow
            back += side * growth * flow
        out[i] = stress
    return out


def getter_with_a_covered_surface(w: World, rng: np.random.Generator) -> FloatArray:
    """A getter pumps by the part of its surface that is free; what covers it diffuses into the bulk when it is warm."""
    pump, cover, bulk = log_uniform(rng, 200, 1000), log_uniform(rng, 2000, 8000), log_uniform(rng, 1000, 5000)
    give, sink = rng.uniform(0.02, 0.05), rng.uniform(0.05, 0.09)
    p, covered, out = 1.0, 0.0, np.empty(len(w.case))
    gas, into = np.exp(give * (w.case - 40.0)) / pump, np.exp(sink * (w.case - 60.0)) / bulk
    for i, (more, inward) in enumerate(zip(gas.tolist(), into.tolist(), strict=True)):
        taken = (1.0 - covered) * p
        p += more - taken / pump
        covered = min(covered + taken / cover - covered * inward, 1.0)
        out[i] = p
    return out


def charges_of_two_signs(w: World, rng: np.random.Generator) -> FloatArray:
    """Electrons charge an oxide soon and holes late, each activated by heat; the force is the square of the voltage."""
    fast, slow = log_uniform(rng, 500, 3000), log_uniform(rng, 4000, 10800)
    little, much = rng.uniform(0.01, 0.03), rng.uniform(0.03, 0.06)
    ratio, size = rng.uniform(0.5, 1.2), rng.uniform(0.1, 0.3)
    minus, plus, out = 0.0, 0.0, np.empty(len(w.case))
    for i, c in enumerate((w.case - 25.0).tolist()):
        minus += (1.0 - minus) * float(np.exp(little * c)) / fast
        plus += (1.0 - plus) * float(np.exp(much * c)) / slow
        out[i] = (1.0 + size * (minus - ratio * plus)) ** 2
    return out


def phase_of_a_small_split(w: World, rng: np.random.Generator) -> FloatArray:
    """The phase of the sense mode is its width over the split of the modes, which the die's temperature changes."""
    die = follows(w.case, log_uniform(rng, 60, 400))
    split = rng.uniform(5, 10) + rng.choice([-1.0, 1.0]) * rng.uniform(0.02, 0.05) * (die - 25.0)
    width = rng.uniform(0.5, 2.0) * np.sqrt((die + KELVIN) / 298.15)
    return np.asarray(np.arctan(width / split) * w.quadrature)


def tether_near_its_buckling(w: World, rng: np.random.Generator) -> FloatArray:
    """A tether bends by what is left to its buckling load; package against die, and the cold, press on it."""
    package = follows(w.case, log_uniform(rng, 60, 300))
    die = follows(package, log_uniform(rng, 200, 900))
    cold, gradient = rng.uniform(0.1, 0.25), rng.uniform(0.04, 0.1)
    load = rng.uniform(0.2, 0.4) + cold * (25.0 - package) / 100.0 + gradient * (package - die) / 10.0
    return np.asarray(1.0 / (1.0 - load))


def leakage_that_heats_itself(w: World, rng: np.random.Generator) -> FloatArray:
    """A circuit warms its die by its power, of which the leakage doubles with every 10 degC of the die itself."""
    board = follows(w.case, log_uniform(rng, 300, 1200))
    tau, fixed, leak = log_uniform(rng, 30, 300), rng.uniform(3, 8), rng.uniform(0.01, 0.035)
    die, out = float(board[0]), np.empty(len(board))
    for i, b in enumerate(board.tolist()):
        die += (b + fixed + leak * 2.0 ** ((die - 25.0) / 10.0) - die) / tau
        out[i] = die - b
    return out


def quadrature_nulled_in_steps(w: World, rng: np.random.Generator) -> FloatArray:
    """A converter nulls the quadrature in whole steps, once the rest exceeds three quarters of one; it leaks."""
    step = w.constant(float(np.ptp(w.quadrature))) / rng.uniform(4, 10)
    held = step * round(float(w.quadrature[0]) / step)
    out = np.empty(len(w.quadrature))
    for i, q in enumerate(w.quadrature.tolist()):
        if abs(q - held) > 0.75 * step:
            held += step * round((q - held) / step)
        out[i] = q - held
    return out


def transpiration_between_cavities(w: World, rng: np.random.Generator) -> FloatArray:
    """Thin gas creeps between two cavities until pressure over the root of temperature is equal; one damps the mode."""
    near = follows(w.case, log_uniform(rng, 100, 400)) + KELVIN
    far = follows(w.air, log_uniform(rng, 400, 1500)) + KELVIN
    volume, tau = rng.uniform(3, 10), log_uniform(rng, 600, 7200)
    here, there, out = 1.0, 1.0, np.empty(len(near))
    for i, (one, other) in enumerate(zip(np.sqrt(near / 298.15).tolist(), np.sqrt(far / 298.15).tolist(), strict=True)):
        flow = (there * other - here * one) / tau
        here += flow
        there -= flow / volume
        out[i] = here * one
    return out


def fictive_temperature_of_the_adhesive(w: World, rng: np.random.Generator) -> FloatArray:
    """Narayanaswamy: the structure of an adhesive relaxes at a rate by temperature and by its own state."""
    glass, heat = rng.uniform(30, 60) + KELVIN, rng.uniform(1.5e4, 3.5e4)
    share, tau = rng.uniform(0.3, 0.6), log_uniform(rng, 60, 600)
    state, out = float(w.case[0]) + KELVIN, np.empty(len(w.case))
    for i, t in enumerate((w.case + KELVIN).tolist()):
        rate = float(np.exp(heat * (1.0 / glass - share / t - (1.0 - share) / state))) / tau
        state += (t - state) * min(rate, 1.0)
        out[i] = state
    return out


def localisation_of_two_tines(w: World, rng: np.random.Generator) -> FloatArray:
    """Two coupled tines, of which one follows the air, share their motion by how far they are out of tune (veering)."""
    left, right = follows(w.air, log_uniform(rng, 100, 600)), follows(w.case, log_uniform(rng, 100, 600))
    detuned = rng.uniform(-1.5, 1.5) + (left - right) / rng.uniform(4, 12)
    return np.asarray(np.sin(0.5 * np.arctan2(1.0, detuned)))


def shupe_of_a_quadrupole_winding(w: World, rng: np.random.Generator) -> FloatArray:
    """Heat diffuses between hub and skin of a quadrupole winding; rates count by place in the fibre and trim error."""
    skin, hub = follows(w.case, log_uniform(rng, 30, 120)), follows(w.case, log_uniform(rng, 200, 900))
    layers = 8
    pass_on = layers**2 / np.pi**2 / log_uniform(rng, 100, 600)
    coupling = pass_on * (np.eye(layers, k=1) + np.eye(layers, k=-1) - 2.0 * np.eye(layers))
    rates, shapes = np.linalg.eigh(coupling)
    place = np.arange(layers) / layers
    sensed = np.array([1.0, -1.0, -1.0, 1.0, 1.0, -1.0, -1.0, 1.0]) * (1.0 - place) + rng.uniform(0.02, 0.1) * place
    out = np.zeros(len(w.case))
    for rate, shape in zip(rates, shapes.T, strict=True):
        mode = follows(pass_on * (shape[0] * skin + shape[-1] * hub) / -rate, float(-1.0 / rate))
        out += float(sensed @ shape) * 60.0 * np.gradient(mode)
    return out


def pump_off_the_erbium_line(w: World, rng: np.random.Generator) -> FloatArray:
    """A pump diode drifts off the absorption line of a fibre source and weakens; an offset counts by one over power."""
    diode = follows(w.case, log_uniform(rng, 60, 400))
    off = (diode - rng.uniform(0, 50)) / rng.uniform(15, 35)
    return np.asarray((1.0 + off**2) * np.exp((diode - 25.0) / rng.uniform(100, 200)))


def kerr_effect_of_the_coupler(w: World, rng: np.random.Generator) -> FloatArray:
    """Kerr effect: the coupler's distance from an even split, by its temperature, times the power of a warm source."""
    coupler, source = follows(w.case, log_uniform(rng, 200, 900)), follows(w.case, log_uniform(rng, 30, 150))
    split = np.sin(0.25 * np.pi + rng.uniform(0.003, 0.01) * (coupler - rng.uniform(-20, 60))) ** 2 - 0.5
    return np.asarray(split * np.exp(-(source - 25.0) / rng.uniform(60, 150)))


def reset_of_the_phase_ramp(w: World, rng: np.random.Generator) -> FloatArray:
    """A loop corrects the reset voltage of a modulator at resets only, as often as the coil's rate asks for them."""
    chip = follows(w.case, log_uniform(rng, 60, 300))
    coil = 60.0 * np.gradient(follows(w.case, log_uniform(rng, 300, 900)))
    earth, drift = rng.uniform(5, 15), rng.uniform(2, 8)
    turned, tau = earth + drift * coil, log_uniform(rng, 600, 3000)
    held, out = float(chip[0]), np.empty(len(chip))
    for i, (c, rate) in enumerate(zip(chip.tolist(), turned.tolist(), strict=True)):
        held += (c - held) * min(abs(rate) / earth / tau, 1.0)
        out[i] = (c - held) * rate
    return out


def backscatter_of_two_mirrors(w: World, rng: np.random.Generator) -> FloatArray:
    """Adler: backscatter of two mirrors adds by a phase over the block's temperature and pulls the beat frequency."""
    block = follows(w.case, log_uniform(rng, 400, 2500))
    one, other = rng.uniform(0.3, 0.6), rng.uniform(0.15, 0.35)
    phase = 2 * np.pi * block / rng.uniform(20, 60) + rng.uniform(0, 6)
    return np.asarray(np.sqrt(1.0 - one**2 - other**2 - 2.0 * one * other * np.cos(phase)))


def beam_at_the_edge_of_the_aperture(w: World, rng: np.random.Generator) -> FloatArray:
    """The block of a laser gyro bends by its gradient and moves a Gaussian beam sideways; an aperture cuts it."""
    top, bottom = follows(w.air, log_uniform(rng, 200, 900)), follows(w.case, log_uniform(rng, 300, 1500))
    aside = rng.uniform(-0.5, 0.5) + (top - bottom) / rng.uniform(8, 20)
    edge = rng.uniform(1.2, 2.0)
    return np.asarray(0.5 * (erfc(np.sqrt(2.0) * (edge - aside)) + erfc(np.sqrt(2.0) * (edge + aside))))


def currents_of_two_anodes(w: World, rng: np.random.Generator) -> FloatArray:
    """Each anode's ballast warms by its own current, one at the case and one in the air; plasma resists negatively."""
    far = follows(w.air, log_uniform(rng, 300, 1500))
    tempco, plasma, heat = rng.uniform(5e-4, 3e-3), rng.uniform(0.2, 0.5), rng.uniform(10, 30)
    tau, other_tau = log_uniform(rng, 60, 300), log_uniform(rng, 60, 300)
    one, other, out = float(w.case[0]), float(far[0]), np.empty(len(far))
    for i, (c, a, v) in enumerate(zip(w.case.tolist(), far.tolist(), (w.supply / 5.0).tolist(), strict=True)):
        first, second = 1.0 + tempco * (one - 25.0), 1.0 + tempco * (other - 25.0)
        here, there = v * (1.0 - plasma) / (first - plasma), v * (1.0 - plasma) / (second - plasma)
        one += (c + heat * here**2 * first - one) / tau
        other += (a + heat * there**2 * second - other) / other_tau
        out[i] = here - there
    return out


def damping_axis_of_the_hemisphere(w: World, rng: np.random.Generator) -> FloatArray:
    """A shell in vacuum warms by radiation only; its damping grows with temperature, and the axis of it turns."""
    tau, at = log_uniform(rng, 1500, 9000), rng.uniform(0, np.pi)
    turn, more = rng.uniform(0.003, 0.012), rng.uniform(-0.003, 0.003)
    shell, out = float(w.case[0]) + KELVIN, np.empty(len(w.case))
    for i, walls in enumerate((w.case + KELVIN).tolist()):
        shell += (walls**4 - shell**4) / (4.0 * 298.15**3 * tau)
        out[i] = (1.0 + more * (shell - 298.15)) * np.sin(2.0 * (at + turn * (shell - 298.15)))
    return out


def float_that_settles_on_its_pivot(w: World, rng: np.random.Generator) -> FloatArray:
    """A float rises or sinks off neutral buoyancy through a fluid that thins when warm, as far as its pivots let it."""
    fluid = follows(w.case, log_uniform(rng, 600, 2400))
    neutral, tau, thin = rng.uniform(15, 45), log_uniform(rng, 300, 1500), rng.uniform(0.03, 0.06)
    speed = (fluid - neutral) / 10.0 / tau * np.exp(thin * (fluid - 50.0))
    place, out = -1.0, np.empty(len(fluid))
    for i, moved in enumerate(speed.tolist()):
        place = min(max(place + moved, -1.0), 1.0)
        out[i] = place
    return out


def grease_that_channels(w: World, rng: np.random.Generator) -> FloatArray:
    """A spin bearing is warmed by churning grease, less as it thins, and as it leaves the track after a start."""
    tau, heat, thin = log_uniform(rng, 120, 600), rng.uniform(3, 10), rng.uniform(0.015, 0.03)
    leave, rest = log_uniform(rng, 1800, 7200), rng.uniform(0.2, 0.5)
    bearing, churned, out = float(w.case[0]), 1.0, np.empty(len(w.case))
    for i, c in enumerate(w.case.tolist()):
        bearing += (c + heat * churned * float(np.exp(-thin * (bearing - 25.0))) - bearing) / tau
        churned += (rest - churned) / leave
        out[i] = bearing - c
    return out


def reference_checked_at_intervals(w: World, rng: np.random.Generator) -> FloatArray:
    """A circuit nulls its offset at fixed intervals and holds the correction; what the board drifts since then acts."""
    board = follows(w.case, log_uniform(rng, 200, 900)) - 25.0
    offset = board + rng.uniform(-0.5, 0.5) * board**2 / 100.0
    every = rng.uniform(600, 2400)
    last = (np.floor(w.time / every) * every).astype(np.int64)
    return np.asarray(offset - offset[last])


def bit_weights_of_the_converter(w: World, rng: np.random.Generator) -> FloatArray:
    """The converter of the thermometer for the compensation has bits of wrong weight; its board lags."""
    board = follows(w.case, log_uniform(rng, 120, 600))
    share = (board + 60.0) / 170.0
    errors = rng.normal(size=6) / np.sqrt(2.0 ** np.arange(6))
    return np.asarray(sum(errors[bit] * (np.floor(share * 2.0 ** (bit + 1)) % 2.0) for bit in range(6)))


def oscillator_compensated_elsewhere(w: World, rng: np.random.Generator) -> FloatArray:
    """A crystal's cubic curve is corrected by a thermistor of another lag; the clock's error leaks quadrature."""
    crystal, thermistor = follows(w.case, log_uniform(rng, 60, 200)), follows(w.case, log_uniform(rng, 250, 900))
    slope = rng.uniform(0.1, 0.4)

    def curve(temperature: FloatArray) -> FloatArray:
        """Of an AT cut [1e-6]."""
        return np.asarray(1e-4 * (temperature - 25.0) ** 3 - slope * (temperature - 25.0))

    return np.asarray((curve(crystal) - curve(thermistor)) * w.quadrature)


def regulator_that_skips_pulses(w: World, rng: np.random.Generator) -> FloatArray:
    """A switching regulator skips pulses at a small load until leakage loads it; ripple is supply over load."""
    board, slope = follows(w.case, log_uniform(rng, 300, 1200)), rng.uniform(20, 30)
    load = 1.0 + np.exp((board - 70.0) / slope)
    at, wide = rng.uniform(5, 40), rng.uniform(5, 15)
    low, high = (1.0 + float(np.exp((limit - 70.0) / slope)) for limit in (at, at + wide))
    level = 1.0 + 0.5 * (w.supply - w.constant(float(np.mean(w.supply)))) / w.constant(float(np.ptp(w.supply)))
    skips, out = load[0] < high, np.empty(len(load))
    for i, (now, ripple) in enumerate(zip(load.tolist(), (level / load).tolist(), strict=True)):
        skips = now < low or (skips and now < high)
        out[i] = ripple if skips else 0.0
    return out


def ripple_past_a_cold_capacitor(w: World, rng: np.random.Generator) -> FloatArray:
    """The chopped current of the heater leaves ripple by the root of D (1 - D) at a capacitor resistive when cold."""
    capacitor = follows(w.case, log_uniform(rng, 300, 1200))
    resists = rng.uniform(0.2, 0.5) + np.exp(-capacitor / rng.uniform(15, 30))
    duty = follows(w.heater, log_uniform(rng, 20, 60))
    return np.asarray(np.sqrt(np.clip(duty * (1.0 - duty), 0.0, None)) * resists)


def cable_of_ptfe(w: World, rng: np.random.Generator) -> FloatArray:
    """PTFE of a cable between air and case expands by a step at its transition near 19 degC, which takes its time."""
    of_air = rng.uniform(0.3, 0.8)
    cable = follows(of_air * w.air + (1.0 - of_air) * w.case, log_uniform(rng, 60, 400))
    changed = 1.0 / (1.0 + np.exp(-(cable - rng.uniform(18, 21)) / rng.uniform(1.5, 4.0)))
    return np.asarray(rng.uniform(20, 40) * follows(changed, log_uniform(rng, 300, 1500)) + cable - w.case)


def water_of_the_chamber(w: World, rng: np.random.Generator) -> FloatArray:
    """A budget of water: the room leaks it in, the evaporator takes it out, and a film on the case takes part."""

    def saturated(temperature: FloatArray) -> FloatArray:
        """Magnus [hPa]."""
        return np.asarray(6.112 * np.exp(17.62 * temperature / (243.12 + temperature)))

    leak, dry = log_uniform(rng, 1200, 3600), log_uniform(rng, 600, 1800)
    colder, bound, grow = rng.uniform(5, 12), rng.uniform(0.5, 2.0), log_uniform(rng, 300, 1500)
    cold, wall = saturated(w.air - colder), saturated(w.case)
    vapour, film, out = 10.0, 0.0, np.empty(len(w.case))
    for i, (c, coil, on) in enumerate(zip(wall.tolist(), cold.tolist(), w.compressor.tolist(), strict=True)):
        settled = max((vapour - c) / grow, -film)
        film += settled
        vapour += (10.0 - vapour) / leak - on * max(vapour - coil, 0.0) / dry - bound * settled
        out[i] = film
    return out


def pin_in_its_slot(w: World, rng: np.random.Generator) -> FloatArray:
    """A plate of aluminium outgrows a slow table of steel until its pin meets either end of the slot and bends it."""
    plate, table = follows(w.case, log_uniform(rng, 100, 500)), follows(w.case, log_uniform(rng, 2500, 9000))
    grown = 23.6 * (plate - 24.0) - 12.0 * (table - 24.0)
    return np.asarray(np.maximum(grown - rng.uniform(50, 500), 0.0) + np.minimum(grown + rng.uniform(50, 500), 0.0))


def stratified_air(w: World, rng: np.random.Generator) -> FloatArray:
    """The heater layers the chamber's air; the evaporator, and air that is colder than the unit, mix it again."""
    tau, falls, mixes = log_uniform(rng, 300, 1500), rng.uniform(1, 4), rng.uniform(0.5, 2)
    mixing = (1.0 + falls * np.maximum(w.case - w.air, 0.0) / 10.0 + mixes * w.compressor) / tau
    layered, out = 0.0, np.empty(len(w.case))
    for i, (heat, mixed) in enumerate(zip(w.heater.tolist(), mixing.tolist(), strict=True)):
        layered += heat / tau - layered * mixed
        out[i] = layered
    return follows(out, log_uniform(rng, 100, 600))


def fan_past_a_mode_of_the_fixture(w: World, rng: np.random.Generator) -> FloatArray:
    """The fan slips less in thin warm air, its foot softens with heat: shaking passes a resonance and is rectified."""
    foot = follows(w.case, log_uniform(rng, 600, 3000))
    speed = 1.0 - rng.uniform(0.03, 0.08) * (298.15 / (w.air + KELVIN) - 1.0)
    ratio = rng.uniform(0.96, 1.04) * speed / (1.0 - rng.uniform(5e-4, 1.5e-3) * (foot - 25.0))
    damped = rng.uniform(0.03, 0.08)
    return np.asarray(1.0 / ((1.0 - ratio**2) ** 2 + (2.0 * damped * ratio) ** 2))
