"""The third group of mechanisms, in parts that were counted before the grammar was changed for them."""

from __future__ import annotations

import numpy as np

from bench.base import FloatArray
from benchmarks.mechanisms.world import World, follows, log_uniform


def warped_board(w: World, rng: np.random.Generator) -> FloatArray:
    """A board of two materials warps with its temperature, and a screw lets it slide beyond a force."""
    board, force = follows(w.case, log_uniform(rng, 100, 500)), rng.uniform(8.0, 20.0)
    spring, last, bent = 0.0, float(board[0]), np.empty(len(board))
    for second, value in enumerate(board.tolist()):
        spring = min(max(spring + value - last, -force), force)
        bent[second], last = spring, value
    return bent


def breathing_case(w: World, rng: np.random.Generator) -> FloatArray:
    """A case breathes through a filter: the pressure over that outside follows the rate of warming of its air."""
    inside, tau_s = (follows(w.air, 120.0) + 273.15) / 298.15, log_uniform(rng, 200, 900)
    over, last, pressure = 0.0, float(inside[0]), np.empty(len(inside))
    for second, value in enumerate(inside.tolist()):
        over += value - last - over / tau_s
        pressure[second], last = over, value
    return np.sign(pressure) * np.sqrt(np.abs(pressure))


def softened_mount(w: World, rng: np.random.Generator) -> FloatArray:
    """Rubber transmits the compressor's shaking while it is stiff, in the cold."""
    stiff = 1.0 / (1.0 + np.exp((follows(w.case, 300.0) - rng.uniform(-15.0, 5.0)) / rng.uniform(4.0, 8.0)))
    return np.asarray(stiff * follows(w.compressor, 10.0))


def regulator_foldback(w: World, rng: np.random.Generator) -> FloatArray:
    """A regulator that is warm from its own load gives less; the heat is that of drive and supply together."""
    load = (w.drive / w.constant(np.mean(w.drive))) * (w.supply / w.constant(np.mean(w.supply)))
    warm = follows(w.case, 200.0) + 30.0 * (follows(load, log_uniform(rng, 300, 900)) - 1.0)
    return np.maximum(warm - rng.uniform(30.0, 50.0), 0.0)


def bubble_in_the_gel(w: World, rng: np.random.Generator) -> FloatArray:
    """A bubble in the potting swells as its gas warms, and creeps back by the flow of the gel, faster when warm."""
    tau_s, warm, moved, size = log_uniform(rng, 1000, 5000), rng.uniform(20.0, 40.0), 0.0, np.empty(len(w.case))
    last = float(w.case[0])
    for second, case in enumerate(w.case.tolist()):
        moved += (case - last) / 300.0 - moved * np.exp((case - 25.0) / warm) / tau_s
        size[second], last = moved, case
    return size * (1.0 + size / max(w.constant(np.max(np.abs(size))), 1e-9))


def corner_of_the_plate(w: World, rng: np.random.Generator) -> FloatArray:
    """The plate lifts off its corner while it cools faster than the frame, and lies flat otherwise."""
    gradient = follows(w.case, log_uniform(rng, 40, 120)) - follows(w.case, log_uniform(rng, 400, 1200))
    return np.minimum(gradient + rng.uniform(0.0, 0.2) * w.constant(np.max(np.abs(gradient))), 0.0)


def pumped_heat(w: World, rng: np.random.Generator) -> FloatArray:
    """Each start of the compressor sends a slug of cold fluid through the plate: a pulse that spreads."""
    starts = np.maximum(np.diff(w.compressor, prepend=w.compressor[:1]), 0.0)
    spread = log_uniform(rng, 40, 150)
    return follows(follows(starts, spread), spread)


def beating_drive(w: World, rng: np.random.Generator) -> FloatArray:
    """The quadrature loop's error is rectified where the drive is weak."""
    weak = np.maximum(w.constant(np.quantile(w.drive, rng.uniform(0.4, 0.7))) - w.drive, 0.0)
    return weak * np.abs(w.quadrature - w.constant(np.median(w.quadrature)))


def memory_of_the_hottest(w: World, rng: np.random.Generator) -> FloatArray:
    """Stress is taken out at the hottest so far, and comes back in days: part of it returns within the run."""
    tau_s, hottest, out = log_uniform(rng, 15_000, 60_000), float(w.case[0]), np.empty(len(w.case))
    for second, case in enumerate(w.case.tolist()):
        hottest = max(hottest + (25.0 - hottest) / tau_s, case)
        out[second] = hottest
    return out


def two_paths_of_light(w: World, rng: np.random.Generator) -> FloatArray:
    """Interference of two paths whose difference grows with a lagging temperature, in a beam that fades when warm."""
    phase = follows(w.case, log_uniform(rng, 60, 300)) / rng.uniform(6.0, 14.0)
    return np.asarray(np.sin(2.0 * np.pi * phase + rng.uniform(0.0, 6.28)) * np.exp(-w.case / rng.uniform(40.0, 90.0)))


def skin_of_ice(w: World, rng: np.random.Generator) -> FloatArray:
    """Moisture freezes onto the case while the air is colder than it and below zero, and melts at once above zero."""
    grows_s, ice, skin = log_uniform(rng, 2000, 6000), 0.0, np.empty(len(w.case))
    for second, (air, case) in enumerate(zip(w.air.tolist(), w.case.tolist(), strict=True)):
        ice = max(ice + ((case - air) / 10.0 * (1.0 - ice) / grows_s if air < 0.0 else -1.0 / 300.0), 0.0)
        skin[second] = ice
    return skin


def sagging_reference(w: World, rng: np.random.Generator) -> FloatArray:
    """A reference follows the supply with a memory that is longer in the cold, in proportion to the quadrature."""
    level, sag = float(w.supply[0]), np.empty(len(w.supply))
    tau_s, cold = log_uniform(rng, 200, 1000), rng.uniform(25.0, 50.0)
    for second, (volts, case) in enumerate(zip(w.supply.tolist(), w.case.tolist(), strict=True)):
        level += (volts - level) * np.exp((case - 25.0) / cold) / tau_s
        sag[second] = volts - level
    return sag * w.quadrature


def wetted_epoxy(w: World, rng: np.random.Generator) -> FloatArray:
    """Epoxy takes up moisture from cold air and gives it off to warm air, faster when the case is warm."""
    tau_s, dry, warm = log_uniform(rng, 2000, 8000), rng.uniform(15.0, 40.0), rng.uniform(20.0, 45.0)
    level, wet = float(np.exp(-w.air[0] / dry)), np.empty(len(w.case))
    for second, (air, case) in enumerate(zip(w.air.tolist(), w.case.tolist(), strict=True)):
        level += (np.exp(-air / dry) - level) * np.exp((case - 25.0) / warm) / tau_s
        wet[second] = level
    return wet


def magnet_of_the_drive(w: World, rng: np.random.Generator) -> FloatArray:
    """A magnet deep in the unit weakens as it warms; its force is in proportion to the drive."""
    magnet = follows(follows(w.case, log_uniform(rng, 200, 600)), log_uniform(rng, 200, 600))
    return (magnet - 25.0) * (w.drive - w.constant(np.mean(w.drive)))


def thermocouple_of_two_solders(w: World, rng: np.random.Generator) -> FloatArray:
    """Two joints of different mass are a thermocouple whose voltage is not linear."""
    apart = follows(w.case, log_uniform(rng, 30, 90)) - follows(w.case, log_uniform(rng, 300, 900))
    return apart * (1.0 + rng.uniform(0.3, 0.8) * apart / w.constant(np.max(np.abs(apart))))


def soaked_dielectric(w: World, rng: np.random.Generator) -> FloatArray:
    """A dielectric soaks up charge from the supply in two steps of different length."""
    fast, slow = follows(w.supply, log_uniform(rng, 60, 200)), follows(w.supply, log_uniform(rng, 800, 3000))
    return w.supply - 0.5 * fast - 0.5 * slow


def valve_of_the_cooler(w: World, rng: np.random.Generator) -> FloatArray:
    """A valve opens where the air is far below the case, shuts where it is not any more; its flow cools one side."""
    wide, narrow = rng.uniform(4.0, 7.0), rng.uniform(0.5, 2.0)
    is_open, flow = False, np.empty(len(w.case))
    for second, apart in enumerate((w.case - w.air).tolist()):
        is_open = apart > (narrow if is_open else wide)
        flow[second] = float(is_open)
    return follows(flow, log_uniform(rng, 60, 240))


def ratchet_of_the_screw(w: World, rng: np.random.Generator) -> FloatArray:
    """Each warming tightens a screw by a part of what is left, and cooling never loosens it."""
    left, tight = 1.0, np.empty(len(w.case))
    share, last = 1.0 / rng.uniform(40.0, 150.0), float(w.case[0])
    for second, case in enumerate(w.case.tolist()):
        left -= left * share * max(case - last, 0.0)
        tight[second], last = 1.0 - left, case
    return tight


def seal_that_leaks(w: World, rng: np.random.Generator) -> FloatArray:
    """Gas in a sealed case leaks through an orifice: by the root of the pressure, so that small ones stay."""
    over, last, pressure = 0.0, float(w.case[0]), np.empty(len(w.case))
    leak = 1.0 / rng.uniform(60.0, 300.0)
    for second, case in enumerate(w.case.tolist()):
        over += case - last
        over -= np.sign(over) * min(leak * abs(over) ** 0.5, abs(over))
        pressure[second], last = over, case
    return pressure


def stiff_grease(w: World, rng: np.random.Generator) -> FloatArray:
    """A part is dragged through grease that is stiff in the cold, by how fast the case expands or shrinks."""
    speed = follows(np.gradient(w.case) * 60.0, log_uniform(rng, 40, 160))
    return speed * np.exp(-w.case / rng.uniform(18.0, 40.0))


def hopping_laser(w: World, rng: np.random.Generator) -> FloatArray:
    """A laser drifts with its lagging temperature and hops back by a mode."""
    node, mode = follows(w.case, log_uniform(rng, 40, 200)), rng.uniform(14.0, 26.0)
    return (node / mode + rng.uniform(0.0, 1.0)) % 1.0


def overdriven_heater(w: World, rng: np.random.Generator) -> FloatArray:
    """A guard acts on what the heater gave for long, beyond a threshold, and lets go slowly."""
    given = follows(w.heater, log_uniform(rng, 200, 600))
    return follows(np.maximum(given - w.constant(np.quantile(given, 0.6)), 0.0), log_uniform(rng, 100, 400))


def ripple_of_the_oscillator(w: World, rng: np.random.Generator) -> FloatArray:
    """What the supply adds to an oscillator is in proportion to how far its frequency is from the loop's centre."""
    ripple = w.supply - follows(w.supply, log_uniform(rng, 100, 500))
    return ripple * (w.frequency - w.constant(np.median(w.frequency)))


def preload_that_slips(w: World, rng: np.random.Generator) -> FloatArray:
    """A clamped plate slides where its strain exceeds the friction, which is larger in the cold."""
    most, warm, bent, last, out = (
        rng.uniform(4.0, 10.0),
        rng.uniform(60.0, 140.0),
        0.0,
        float(w.case[0]),
        np.empty(len(w.case)),
    )
    for second, case in enumerate(w.case.tolist()):
        friction = most * (1.0 + (25.0 - case) / warm)
        bent = min(max(bent + case - last, -friction), friction)
        out[second], last = bent, case
    return out


def table_of_the_circuit(w: World, rng: np.random.Generator) -> FloatArray:
    """A circuit corrects a curved bias from a table, straight between its entries; its own sensor lags."""
    sensor, every = follows(w.case, log_uniform(rng, 40, 300)), rng.uniform(12.0, 30.0)
    entries = np.arange(-80.0, 140.0, every)
    return np.interp(sensor, entries, (entries / 50.0) ** 2) - (sensor / 50.0) ** 2


def field_of_the_heater(w: World, rng: np.random.Generator) -> FloatArray:
    """The field of the heater's leads goes with its current, the root of its power, and saturates a shield."""
    current = follows(np.sqrt(np.maximum(w.heater, 0.0)), rng.uniform(10.0, 60.0))
    return np.tanh(current / (rng.uniform(0.5, 1.5) * w.constant(np.max(current))))


def draught(w: World, rng: np.random.Generator) -> FloatArray:
    """A thin wall follows the air, faster while the compressor's fan blows."""
    slow, share = log_uniform(rng, 300, 1200), rng.uniform(0.3, 0.7)
    wall, level = np.empty(len(w.case)), float(w.air[0])
    for second, (air, blows) in enumerate(zip(w.air.tolist(), w.compressor.tolist(), strict=True)):
        level += (air - level) / (slow * (1.0 - share * blows))
        wall[second] = level
    return wall - w.case


def magnet_that_fades(w: World, rng: np.random.Generator) -> FloatArray:
    """A magnet loses a part at each new highest temperature beyond a value; what is left scales the drive's error."""
    lost = np.maximum.accumulate(np.maximum(w.case - rng.uniform(20.0, 45.0), 0.0))
    return lost * (w.drive - rng.uniform(0.2, 0.8) * w.constant(w.drive.max()))


def regulator_without_headroom(w: World, rng: np.random.Generator) -> FloatArray:
    """A regulator drops out where the supply is below what it needs, which is more in the warm."""
    needs = w.supply - w.constant(np.quantile(w.supply, 0.6))
    most = w.constant(np.ptp(w.supply)) / 60.0
    return follows(np.maximum(most * (w.case - rng.uniform(0.0, 40.0)) - needs, 0.0), log_uniform(rng, 20, 200))


def logarithm_of_heat(w: World, rng: np.random.Generator) -> FloatArray:
    """A resistor ages with the logarithm of what heat it has seen."""
    warm, dose, aged = rng.uniform(12.0, 25.0), 0.0, np.empty(len(w.case))
    size = log_uniform(rng, 500, 5000)
    for second, case in enumerate(w.case.tolist()):
        dose += np.exp((case - 25.0) / warm) / size
        aged[second] = np.log1p(dose)
    return aged


def gas_through_two_walls(w: World, rng: np.random.Generator) -> FloatArray:
    """A gas of the glue reaches the cavity through a second volume; its pressure is exponential."""
    pressure = np.exp((w.case - 25.0) / rng.uniform(18.0, 35.0))
    return follows(follows(pressure, log_uniform(rng, 600, 2500)), log_uniform(rng, 600, 2500))


def clamp_that_walks(w: World, rng: np.random.Generator) -> FloatArray:
    """A clamp walks while the gap between air and case is large, back more slowly, and springs back by a part."""
    most, share, at, walked = rng.uniform(2.0, 6.0), rng.uniform(0.2, 0.6), 0.0, np.empty(len(w.case))
    for second, gap in enumerate((w.air - w.case).tolist()):
        beyond = max(gap - most, 0.0) - share * max(-gap - most, 0.0)
        at += beyond / 3000.0 - at / 9000.0
        walked[second] = at
    return walked


def softening(w: World, rng: np.random.Generator) -> FloatArray:
    """The quadrature's control voltage, squared, softens the mode, the more the nearer it is to another one."""
    control = w.quadrature - rng.uniform(0.2, 0.8) * w.constant(w.quadrature.max())
    return control**2 / (1.0 + ((w.frequency - w.constant(np.quantile(w.frequency, 0.3))) / 8.0) ** 2)


def start_after_a_rest(w: World, rng: np.random.Generator) -> FloatArray:
    """Each start of the compressor is a shock, the larger the longer it stood; it rings down slowly."""
    rests_s, settles_s = log_uniform(rng, 300, 1500), log_uniform(rng, 200, 900)
    stood, before, level, shaken = 0.0, float(w.compressor[0]), 0.0, np.empty(len(w.case))
    for second, runs in enumerate(w.compressor.tolist()):
        if runs > 0.5 >= before:
            level += 1.0 - np.exp(-stood / rests_s)
            stood = 0.0
        stood += runs <= 0.5
        level *= 1.0 - 1.0 / settles_s
        shaken[second], before = level, runs
    return shaken


def potting_that_sets(w: World, rng: np.random.Generator) -> FloatArray:
    """A potting's inner temperature follows the case, ever more slowly below its glass transition."""
    sets, width = rng.uniform(0.0, 25.0), rng.uniform(6.0, 15.0)
    tau_s, inner, strain = log_uniform(rng, 200, 800), float(w.case[0]), np.empty(len(w.case))
    for second, case in enumerate(w.case.tolist()):
        inner += (case - inner) / (tau_s * (1.0 + np.exp(np.clip((sets - case) / width, -30.0, 6.0))))
        strain[second] = case - inner
    return strain


def cooler_by_the_room(w: World, rng: np.random.Generator) -> FloatArray:
    """The cooler's load shakes the table, only while it has to pump below the room's temperature."""
    load = w.compressor * np.maximum(rng.uniform(10.0, 25.0) - w.air, 0.0)
    return follows(load, log_uniform(rng, 60, 400)) * (1.0 + 0.02 * (w.case - 25.0))
