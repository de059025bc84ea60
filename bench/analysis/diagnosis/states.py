"""Blocks of a formula that act by a state of their own: what adds up, snaps over, relaxes, runs into limits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bench.analysis.diagnosis.blocks import Block, Bounds, lagged, lags, loop, unit_of
from bench.analysis.diagnosis.ranges import Ranges, inner

_SET_POINTS = (0.15, 0.35, 0.45, 0.5, 0.55, 0.65, 0.85)  # quantiles of a channel that a loop may hold


def states(ranges: Ranges) -> list[Block]:
    """What acts by itself and is scaled by nothing: starts, exposure that adds up, what is fast of a channel."""
    length_s, (low, high) = ranges.length_s, ranges.temperature
    rates = tuple((f, h) for f in (0.02, 0.05, 0.1) for h in (0.05, 0.2, 0.8))
    snap = latch(ranges)
    blocks = [
        Block(f"total((temperature - {0.5 * (low + high):.4g}))", "time spent warm", "degC h"),
        Block("total(above(temperature - {centre}))", "time spent above a temperature",
              "degC h", (("centre", (low, high)),), inner(low, high, 9), places=1),
        snap,
        replace(snap, text=f"lag({snap.text}, {{tau_s}})", words=f"the memory of {snap.words}",
                bounds=(*snap.bounds, ("tau_s", (20.0, max(length_s / 2.0, 100.0)))),
                grid=tuple((*one, tau) for one in snap.grid for tau in (200.0, 800.0))),
        *_extreme(ranges),
        Block("total(abs(dT_dt))", "all change of temperature so far", "degC/min h"),
        Block("exp(-total(exp({faster} * (temperature - 25))) * {per_h})", "a loss that is faster when it is warm",
              "", (("faster", (0.0, 0.15)), ("per_h", (0.01, 5.0))), rates),
    ]  # fmt: skip
    blocks += [
        _vapour(ranges, "temperature", "temperature"),
        _behind(ranges),
        *_relaxing(ranges),
        _uneven(ranges),
        _spreading(ranges),
        _opposed(ranges),
        _shaken(ranges),
        _turned(ranges, "temperature", "temperature"),
        _transition(ranges),
        *_warmed(ranges),
        *_fading(ranges),
        *hops(ranges),
        _yielding(ranges),
    ]
    if ranges.gap:
        blocks += [
            _vapour(ranges, "chamber_temperature", "air's temperature"),
            _hinge(ranges),
            _turned(ranges, "chamber_temperature", "air's temperature"),
            loop("chamber_temperature", ranges.of("chamber_temperature"), "degC"),
        ]
        blocks.append(_film("(chamber_temperature - temperature)", "the air is warmer than the unit"))
        blocks.append(_film("(temperature - chamber_temperature)", "the unit is warmer than the air"))
    for name in ranges.switched:
        late = f"delay({name}, 30)"
        for words, text in (("starts", f"{name} - {late}"), ("stops", f"{late} - {name}")):
            blocks.append(replace(lagged(f"above({text})", f"the {words} of the {name}", "", length_s), drives=True))
    for name in ranges.moved:
        low, high = ranges.of(name)
        fast = f"({name} - lag({name}, {{tau_s}}))**2"
        ends, tried = (("tau_s", (30.0, max(length_s / 4.0, 100.0))),), lags(length_s / 4.0, 2)
        blocks += [
            _wound(ranges, name),
            replace(loop(name, (low, high), unit_of(name)), drives=True),
            Block(fast, f"the square of what is fast of the {name}", f"{unit_of(name)}^2", ends, tried,
                  drives=True),
        ]  # fmt: skip
    return blocks


def latch(ranges: Ranges) -> Block:
    """What snaps over above one temperature, and back below a lower one."""
    low, high = ranges.temperature
    span = high - low
    shares = (0.03, 0.09, 0.15, 0.21, 0.27, 0.36)
    grid = tuple((*one, share * span) for one in inner(low, high, 15) for share in shares)
    ends = (("centre", (low, high)), ("width", (0.005 * span, 0.5 * span)))
    return Block(
        "latch(temperature, {centre} + {width}, {centre} - {width})",
        "a state that changes above one temperature, and back below another",
        "",
        ends,
        grid,
        places=2,
    )


def _vapour(ranges: Ranges, name: str, called: str) -> Block:
    """What is taken up and given off by its pressure, which is an exponential of a temperature."""
    tried = tuple((faster, *one) for faster in (-0.06, 0.06) for one in lags(ranges.length_s / 2.0, 2))
    bounds = (("faster", (-0.12, 0.12)), ("tau_s", (20.0, max(ranges.length_s / 2.0, 100.0))))
    words = f"the memory of an exponential of the {called}"
    return Block(f"lag(exp({{faster}} * ({name} - 25)), {{tau_s}})", words, "", bounds, tried)


def _behind(ranges: Ranges) -> Block:
    """What a part that follows the temperature no faster than at some rate is behind it."""
    most = ranges.fastest
    words = "how far a part that follows the temperature at a limited rate is behind"
    tried = tuple((share * most,) for share in (0.2, 0.35, 0.5, 0.65, 0.8, 0.95))
    text = "(temperature - slew(temperature, {per_min}))"
    return Block(text, words, "degC", (("per_min", (0.02 * most, most)),), tried)


def _relaxing(ranges: Ranges) -> list[Block]:
    """What follows the temperature; and what does so faster or slower when it is warm."""
    tau, tried = ("tau_s", (20.0, max(ranges.length_s, 200.0))), lags(ranges.length_s, 1)
    words = "a part that follows the temperature"
    faster = Block("(temperature - lag(temperature, {tau_s} * exp({faster} * (25 - temperature))))",
                   f"{words}, faster when it is warm", "degC", (tau, ("faster", (-0.12, 0.12))),
                   tuple((*one, faster) for one in tried for faster in (-0.03, 0.03, 0.06)))  # fmt: skip
    strained = Block("exp({steep} * (temperature - lag(temperature, {tau_s})))",
                     f"an exponential of the gap to {words}", "", (("steep", (-0.5, 0.5)), tau),
                     tuple((steep, *one) for one in tried for steep in (-0.2, -0.07, 0.07, 0.2)))  # fmt: skip
    plain = Block("(temperature - lag(temperature, {tau_s}))", words, "degC", (tau,), tried, looser=faster)
    spread = " + ".join(f"lag(temperature, {times}{{tau_s}})" for times in ("", "5 * ", "25 * "))
    heated = Block(f"(temperature - ({spread})/3)", "a body into which heat spreads", "degC", (tau,), tried)
    return [plain, faster, strained, heated]


def _uneven(ranges: Ranges) -> Block:
    """What takes up fast and gives off slowly, or the other way round: gas through a valve, charge, water."""
    times = lags(ranges.length_s, 2)
    ends = (20.0, max(ranges.length_s, 200.0))
    return Block("(temperature - uneven_lag(temperature, {rise_s}, {fall_s}))",
                 "a part that follows the temperature up and down with different time constants", "degC",
                 (("rise_s", ends), ("fall_s", ends)),
                 tuple((*up, *down) for up in times for down in times if up != down))  # fmt: skip


def _spreading(ranges: Ranges) -> Block:
    """What two parts that follow the rate of change one after the other are apart."""
    return Block("(dT_dt - lag(dT_dt, {tau_s}))", "the change of dT/dt in the last while", "degC/min",
                 (("tau_s", (20.0, max(ranges.length_s / 4.0, 100.0))),), lags(ranges.length_s / 4.0, 1))  # fmt: skip


def _opposed(ranges: Ranges) -> Block:
    """Two parts that follow the temperature, one against the other: each alone may leave next to nothing."""
    times = [tau for (tau,) in lags(ranges.length_s, 1)]
    tried = tuple(
        (fast, share, slow) for n, fast in enumerate(times) for slow in times[n + 2 :] for share in (0.3, 0.8)
    )
    ends = (20.0, max(ranges.length_s, 200.0))
    fast, slow = ("(temperature - lag(temperature, {" + name + "}))" for name in ("tau_s", "slow_s"))
    return Block(f"({fast} - {{share}} * {slow})", "two parts that follow the temperature, one against the other",
                 "degC", (("tau_s", ends), ("share", (-1.0, 1.5)), ("slow_s", ends)), tried)  # fmt: skip


def _shaken(ranges: Ranges) -> Block:
    """What each change of the rate of temperature leaves for a while, up or down."""
    ends = (("fast_s", (20.0, 1000.0)), ("tau_s", (20.0, max(ranges.length_s / 2.0, 100.0))))
    tried = tuple((60.0, *tau) for tau in lags(ranges.length_s / 2.0, 1))
    return Block("lag(abs(dT_dt - lag(dT_dt, {fast_s})), {tau_s})", "the memory of each change of dT/dt", "degC/min",
                 ends, tried)  # fmt: skip


def _extreme(ranges: Ranges) -> list[Block]:
    """The most extreme temperature so far, or how far it has been beyond a value."""
    ends, tried = (("centre", ranges.temperature),), inner(*ranges.temperature, 9)
    beyond = (("above", "above(highest(temperature) - {centre})"), ("below", "above({centre} - lowest(temperature))"))
    return [
        *(Block(f"{which}(temperature)", f"the {which} temperature so far", "degC") for which in ("highest", "lowest")),
        *(Block(text, f"how far it has been {side} a temperature", "degC", ends, tried, places=1)
          for side, text in beyond),
    ]  # fmt: skip


def _fading(ranges: Ranges) -> list[Block]:
    """The most extreme temperature so far, of which a part is forgotten within the run."""
    ends, tried = (0.125 * ranges.length_s, 8.0 * ranges.length_s), (0.3 * ranges.length_s, 1.5 * ranges.length_s)
    return [
        Block(f"exp(-time/{{tau_s}}) * {which}((temperature - 25) * exp(time/{{tau_s}}))",
              f"the {which} temperature so far, slowly forgotten", "degC", (("tau_s", ends),),
              tuple((tau,) for tau in tried))
        for which in ("highest", "lowest")
    ]  # fmt: skip


def hops(ranges: Ranges) -> list[Block]:
    """What grows with the temperature, or one that lags, and jumps back at every so many degrees."""
    low, high = ranges.temperature
    span = high - low
    steps = span / np.arange(2.0, 14.1, 0.5)  # evenly in their number, as the lines of a spectrum
    tried = tuple((low + phase * step, step) for step in steps.tolist() for phase in (0.0, 0.25, 0.5, 0.75))
    bounds = (("at", (low, high)), ("step", (0.02 * span, 0.6 * span)))
    words = "what jumps back at every so many degrees"
    late = Block("sawtooth((lag(temperature, {tau_s}) - {at})/{step})", f"{words} of a temperature that lags", "",
                 (("tau_s", (20.0, 2000.0)), *bounds), tuple((tau, *one) for tau in (60.0, 200.0) for one in tried),
                 places=1)  # fmt: skip
    return [Block("sawtooth((temperature - {at})/{step})", words, "", bounds, tried, places=1), late]


def clock(bounds: Bounds, period_s: float) -> Block:
    """What a clock of its own switches on for a part of each period, as a sine over time with this period shows it."""
    text = "(1 + tanh((sin(2*pi*(time - {start_s})/{period_s}) - {level})/0.15))"
    tried = tuple(
        (share * period_s, period_s, level) for share in np.arange(0.0, 1.0, 0.0625) for level in (-0.5, 0.0, 0.5)
    )
    ends = (("start_s", (-bounds[1], 2.0 * bounds[1])), ("period_s", bounds), ("level", (-0.95, 0.95)))
    return Block(text, "what is switched by a clock of its own", "", ends, tried, places=1)


def _yielding(ranges: Ranges) -> Block:
    """A strain that yields by a power of the stress, as Norton's law has it for solder, and recovers."""
    tried = tuple((power, *one) for power in (2.0, 4.0) for one in lags(ranges.length_s / 2.0, 2))
    bounds = (("power", (1.0, 8.0)), ("tau_s", (20.0, max(ranges.length_s, 200.0))))
    return Block("lag(sign(dT_dt) * abs(dT_dt)**{power}, {tau_s})", "the memory of a power of dT/dt", "", bounds, tried)


def _hinge(ranges: Ranges) -> Block:
    """What the gap between air and unit drags along with play."""
    wide = 2.0 * ranges.widest()
    words = "what the gap between air and unit drags along with play"
    bounds, tried = (("width", (0.002 * wide, 0.45 * wide)),), tuple((w * wide,) for w in (0.05, 0.1, 0.2))
    return Block("play((chamber_temperature - temperature), {width})", words, "degC", bounds, tried)


def _turned(ranges: Ranges, name: str, called: str) -> Block:
    """What changes over at one temperature, and takes its time."""
    low, high = ranges.of(name)
    span = high - low
    tried = tuple((*one, share * span, *tau) for one in inner(low, high, 11) for share in (0.02, 0.1)
                  for tau in lags(ranges.length_s / 4.0, 2))  # fmt: skip
    bounds = (("centre", (low, high)), ("width", (0.005 * span, 0.4 * span)),
              ("tau_s", (20.0, max(ranges.length_s / 2.0, 100.0))))  # fmt: skip
    words = f"the memory of a step over the {called}"
    return Block(f"lag(tanh(({name} - {{centre}})/{{width}}), {{tau_s}})", words, "", bounds, tried, places=1,
                 drives=True)  # fmt: skip


def _transition(ranges: Ranges) -> Block:
    """What changes over a range of temperature, later while it is heated than while it is cooled: a change of phase, a
    magnet. A latch is the sharp one.
    """
    low, high = ranges.temperature
    span = high - low
    tried = tuple((*one, share * span, late) for one in inner(low, high, 7) for share in (0.1, 0.25)
                  for late in (0.1, 0.3, 0.6))  # fmt: skip
    bounds = (("centre", (low, high)), ("width", (0.02 * span, 0.5 * span)), ("limit", (0.01, 0.95)))
    words = "a change of state over a range of temperature, with hysteresis"
    return Block("play(tanh((temperature - {centre})/{width}), {limit})", words, "", bounds, tried, places=1)


def _warmed(ranges: Ranges) -> list[Block]:
    """What is driven above, or below, one temperature, and takes its time: softening, release, freezing."""
    bounds = (("centre", ranges.temperature), ("tau_s", (20.0, max(ranges.length_s / 2.0, 100.0))))
    tried = tuple((*one, *tau) for one in inner(*ranges.temperature, 11) for tau in lags(ranges.length_s / 2.0, 2))
    return [
        Block(f"lag(above({beyond}), {{tau_s}})", f"the memory of the temperature {words} a value", "degC", bounds,
              tried, places=1, drives=True)
        for beyond, words in (("temperature - {centre}", "above"), ("{centre} - temperature", "below"))
    ]  # fmt: skip


def _wound(ranges: Ranges, name: str) -> Block:
    """An integral of a channel that runs into its limits: a loop integrates what is left about its set point."""
    low, high = ranges.of(name)
    points = np.quantile(ranges.values(name), _SET_POINTS)
    summed = f"total(({name} - {{centre}}))"
    most = (high - low) * ranges.length_s / 3600.0
    ends = (0.0002 * most, 0.5 * most)
    tried = tuple((float(c), share * most) for c in points for share in (0.002, 0.006, 0.02, 0.08))
    bounds = (("centre", (low, high)), ("width", ends))
    return Block(f"({summed} - play({summed}, {{width}}))", f"an integral of the {name} between two limits",
                 f"{unit_of(name)} h", bounds, tried, places=1)  # fmt: skip


def _film(gap: str, words: str) -> Block:
    """What grows with a difference, and is lost faster or slower by the opposite one until nothing is left."""
    flow = f"total({gap} - {{loss}} * above(-{gap}))"
    return Block(f"({flow} - lowest({flow}))", f"a film that grows while {words}", "degC h",
                 (("loss", (-0.9, 10.0)),), ((-0.5,), (0.0,), (1.0,), (4.0,)))  # fmt: skip
