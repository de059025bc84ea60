"""Mechanisms inside gyroscopes and their electronics, counted before anything was changed."""

from __future__ import annotations

import numpy as np

from bench.base import FloatArray
from benchmarks.mechanisms.world import World, dragged, follows, log_uniform, unevenly


def error_of_the_carrier(w: World, rng: np.random.Generator) -> FloatArray:
    """A phase-locked loop lags behind a resonance that moves: its phase error leaks quadrature."""
    f = w.frequency
    moved = (f - follows(f, log_uniform(rng, 100, 600))) / w.constant(float(np.ptp(f)))
    return np.asarray(moved * w.quadrature)


def phase_of_a_warm_filter(w: World, rng: np.random.Generator) -> FloatArray:
    """The phase of a filter drifts with the temperature of its board and rotates quadrature into the output."""
    board = follows(w.case, log_uniform(rng, 200, 900))
    phase = (board - rng.uniform(0, 50)) * rng.uniform(0.004, 0.012)
    return np.asarray(np.sin(phase) * w.quadrature)


def gas_in_the_cavity(w: World, rng: np.random.Generator) -> FloatArray:
    """Damping of the mode by the gas pressure, which follows the heat of the cap; the drive makes up for it."""
    cap = follows(w.air, log_uniform(rng, 300, 1500)) + 273.15
    return np.asarray(np.sqrt(cap / 298.15) * (w.drive - w.constant(float(np.mean(w.drive)))))


def gain_control_at_its_end(w: World, rng: np.random.Generator) -> FloatArray:
    """The drive's amplitude control has no reserve beyond a value of the drive."""
    mid, wide = w.constant(float(np.mean(w.drive))), w.constant(float(np.ptp(w.drive)))
    return np.maximum(w.drive - mid - rng.uniform(-0.1, 0.2) * wide, 0.0)


def die_on_soft_glue(w: World, rng: np.random.Generator) -> FloatArray:
    """Stress between die and package relaxes in the glue, the faster the nearer it is to its glass transition."""
    tg, wide, slow = rng.uniform(50, 90), rng.uniform(15, 30), log_uniform(rng, 1500, 8000)
    stress, last, out = 0.0, float(w.case[0]), np.empty(len(w.case))
    for i, c in enumerate(w.case.tolist()):
        stress += c - last - stress / slow * (0.05 + 1.0 / (1.0 + np.exp((tg - c) / wide)))
        last = c
        out[i] = stress
    return out


def shupe_of_two_layers(w: World, rng: np.random.Generator) -> FloatArray:
    """The rate of the temperature of two layers of a fibre coil of unlike depth."""
    outer = follows(w.case, log_uniform(rng, 30, 120))
    inner = follows(outer, log_uniform(rng, 200, 800))
    return np.asarray(np.gradient(outer) - rng.uniform(0.3, 0.9) * np.gradient(inner)) * 60.0


def wavelength_of_the_source(w: World, rng: np.random.Generator) -> FloatArray:
    """The wavelength of a source with a cooler of its own is off only where the cooler has no power left."""
    hot = rng.uniform(45, 65)
    chip = follows(w.case, log_uniform(rng, 60, 400))
    return np.maximum(chip - hot, 0.0) ** 1.5


def polarisation(w: World, rng: np.random.Generator) -> FloatArray:
    """Two polarisations interfere: a period over the temperature whose visibility falls towards one end."""
    period, at = rng.uniform(9, 20), rng.uniform(-0.02, 0.02)
    return np.asarray(np.sin(2 * np.pi * w.case / period + rng.uniform(0, 6)) * np.exp(at * w.case))


def lock_in(w: World, rng: np.random.Generator) -> FloatArray:
    """The lock-in threshold of a laser gyro rises with backscatter, a period over the length of the path."""
    path = follows(w.case, log_uniform(rng, 100, 600))
    scatter = np.abs(np.cos(np.pi * path / rng.uniform(10, 22) + rng.uniform(0, 3)))
    return np.asarray(scatter)


def flow_in_the_discharge(w: World, rng: np.random.Generator) -> FloatArray:
    """Gas flows in a discharge from its warm end to its cold end, less when the gas is thin (warm)."""
    hot, cold = follows(w.case, log_uniform(rng, 60, 200)), follows(w.case, log_uniform(rng, 400, 1500))
    return np.asarray((hot - cold) / (1.0 + (w.case + 60.0) / rng.uniform(40, 120)))


def charge_of_the_dielectric(w: World, rng: np.random.Generator) -> FloatArray:
    """Charge creeps onto a dielectric from power on, faster when it is warm, and saturates."""
    q, tau, e = 0.0, log_uniform(rng, 3000, 15000), rng.uniform(0.02, 0.05)
    out = np.empty(len(w.case))
    for i, c in enumerate(w.case.tolist()):
        q += (1.0 - q) / tau * np.exp(e * (c - 25.0))
        out[i] = q
    return out


def spring_of_the_anchor(w: World, rng: np.random.Generator) -> FloatArray:
    """An anchor bends by the gradient through the package; what it does to the rate falls with its stiffness."""
    gap = w.case - follows(w.case, log_uniform(rng, 60, 500))
    return np.asarray(gap / (1.0 + np.exp((w.case - rng.uniform(20, 60)) / rng.uniform(8, 20))))


def clock_of_the_converter(w: World, rng: np.random.Generator) -> FloatArray:
    """A line of the converter's clock beats with the resonance: a period over the frequency."""
    f = w.frequency
    share = (f - w.constant(float(f.min()))) / w.constant(float(np.ptp(f)))
    return np.asarray(np.sin(2 * np.pi * share * rng.uniform(3, 8) + rng.uniform(0, 6)))


def reference_with_thermal_loop(w: World, rng: np.random.Generator) -> FloatArray:
    """A voltage reference has a loop over temperature; it scales quadrature."""
    return np.asarray((w.case - dragged(w.case, rng.uniform(3, 9))) * w.quadrature)


def dielectric_absorption(w: World, rng: np.random.Generator) -> FloatArray:
    """A capacitor that remembers its voltage: what the supply was, over two decades of time."""
    parts = [follows(w.supply, tau) for tau in (100.0, 400.0, 1600.0)]
    return np.asarray(w.supply - (parts[0] + parts[1] + parts[2]) / 3.0)


def thermocouple_of_the_board(w: World, rng: np.random.Generator) -> FloatArray:
    """A thermoelectric voltage of the second order, between a board and the case."""
    board = follows(w.case, log_uniform(rng, 100, 900))
    at = rng.uniform(-10, 60)
    return np.asarray((w.case - at) ** 2 - (board - at) ** 2)


def water_in_the_mould(w: World, rng: np.random.Generator) -> FloatArray:
    """Moulding compound takes up water from cold air and gives it off when it is warm; it swells."""
    wet, dry = log_uniform(rng, 4000, 15000), log_uniform(rng, 1500, 6000)
    return unevenly(1.0 / (1.0 + np.exp((w.case - 30.0) / 12.0)), wet, dry, start=0.5)


def solder_that_creeps(w: World, rng: np.random.Generator) -> FloatArray:
    """Norton creep: stress by the distance from the last place at rest relaxes with its third power."""
    strain, last, k = 0.0, float(w.case[0]), 10 ** rng.uniform(-7.5, -6.0)
    out = np.empty(len(w.case))
    for i, c in enumerate(w.case.tolist()):
        strain += c - last
        strain -= k * strain**3
        last = c
        out[i] = strain
    return out


def hum_of_the_heater(w: World, rng: np.random.Generator) -> FloatArray:
    """What the heater's current induces, in proportion to the gain of a stage that warms up with it."""
    return np.asarray(w.heater * (1.0 + follows(w.heater, log_uniform(rng, 200, 1200)) * rng.uniform(0.5, 2.0)))


def screw_on_the_table(w: World, rng: np.random.Generator) -> FloatArray:
    """A screw loses its preload below a temperature and lets the foot tilt by the gap to the air."""
    loose = 1.0 / (1.0 + np.exp((follows(w.case, log_uniform(rng, 100, 500)) - rng.uniform(-15, 10)) / 2.0))
    return np.asarray(loose * follows(w.air - w.case, log_uniform(rng, 30, 200)))


def spurious_mode(w: World, rng: np.random.Generator) -> FloatArray:
    """A spurious mode meets the resonance at one frequency: a dispersive curve, larger with more drive."""
    f = w.frequency
    x = (f - w.constant(float(f.min())) - rng.uniform(0.25, 0.75) * w.constant(float(np.ptp(f)))) / w.constant(
        rng.uniform(0.05, 0.12) * float(np.ptp(f))
    )
    return np.asarray(x / (1.0 + x**2) * w.drive)


def vacuum_that_leaks(w: World, rng: np.random.Generator) -> FloatArray:
    """Pressure rises from the start, by desorption when it is warm, and the getter takes it back at a constant rate."""
    p, e, back = 0.0, rng.uniform(0.03, 0.06), rng.uniform(0.2, 0.8)
    out = np.empty(len(w.case))
    for i, c in enumerate(w.case.tolist()):
        p = max(p + (np.exp(e * (c - 40.0)) - back) / 3600.0, 0.0)
        out[i] = p
    return out


def latch_of_the_lid(w: World, rng: np.random.Generator) -> FloatArray:
    """A lid snaps in by the gradient through it, and back by the opposite gradient."""
    gap = w.case - follows(w.case, log_uniform(rng, 200, 800))
    limit = w.constant(rng.uniform(0.2, 0.5) * float(np.max(np.abs(gap))))
    state, out = 0.0, np.empty(len(w.case))
    for i, g in enumerate(gap.tolist()):
        state = 1.0 if g > limit else 0.0 if g < -limit else state
        out[i] = state
    return out


def friction_of_a_cable(w: World, rng: np.random.Generator) -> FloatArray:
    """A cable drags the foot: a spring in series with dry friction and a slow seal."""
    limit, seal = rng.uniform(2, 10), log_uniform(rng, 600, 3000)
    pull, last, out = 0.0, float(w.case[0]), np.empty(len(w.case))
    for i, c in enumerate(w.case.tolist()):
        pull = min(max(pull + c - last, -limit), limit)
        pull -= pull / seal
        last = c
        out[i] = pull
    return out


def regulator_that_warms(w: World, rng: np.random.Generator) -> FloatArray:
    """A regulator's own heat, by the supply above what it puts out, shifts a reference with the board's temperature."""
    own = follows((w.supply - w.constant(float(np.min(w.supply)))) ** 2, log_uniform(rng, 30, 300))
    return np.asarray(own * (w.case + rng.uniform(30, 80)))


def wind_of_the_fan(w: World, rng: np.random.Generator) -> FloatArray:
    """Cooling of one wall by moving air, in proportion to the gap, less what the far wall loses later."""
    gap = w.air - w.case
    near, far = follows(gap, log_uniform(rng, 20, 90)), follows(gap, log_uniform(rng, 200, 900))
    return np.asarray(near * np.abs(near) - far * np.abs(far))
