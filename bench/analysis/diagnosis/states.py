"""Blocks of a formula that act by a state of their own: what adds up, snaps over, drags along, runs into limits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bench.analysis.diagnosis.blocks import Block, Bounds, lagged, lags, loop, times_within, unit_of
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
        replace(snap, text=snap.text.replace("temperature", "lag(temperature, {tau_s})"), drives=True,
                words=f"{snap.words}, of a temperature that lags", bounds=(("tau_s", (20.0, 2000.0)), *snap.bounds),
                grid=tuple((tau, *one) for one in snap.grid for tau in (120.0, 350.0))),
        replace(snap, text=f"lag({snap.text}, {{tau_s}})", words=f"the memory of {snap.words}",
                bounds=(*snap.bounds, ("tau_s", times_within(length_s, 2))),
                grid=tuple((*one, tau) for one in snap.grid for tau in (200.0, 800.0))),
        *_extreme(ranges),
        *_lost(ranges),
        Block("total(abs(dT_dt))", "all change of temperature so far", "degC/min h"),
        Block("exp(-total(exp({faster} * (temperature - 25))) * {per_h})", "a loss that is faster when it is warm",
              "", (("faster", (0.0, 0.15)), ("per_h", (0.01, 5.0))), rates),
    ]  # fmt: skip
    blocks += [
        _behind(ranges),
        _transition(ranges),
        *_fading(ranges),
        *hops(ranges),
        *_gaping(ranges),
        *_held(ranges),
    ]
    if ranges.gap:
        blocks += [
            _hinge(ranges),
            loop("chamber_temperature", ranges.of("chamber_temperature"), "degC"),
        ]
        blocks.append(_film("(chamber_temperature - temperature)", "the air is warmer than the unit"))
        blocks.append(_film("(temperature - chamber_temperature)", "the unit is warmer than the air"))
    for name in ranges.switched:
        late = f"delay({name}, 30)"
        for words, text in (("starts", f"{name} - {late}"), ("stops", f"{late} - {name}")):
            blocks.append(lagged(f"above({text})", f"the {words} of the {name}", "", length_s))
    blocks.append(_wound(ranges, "temperature"))
    for name in ranges.moved:
        low, high = ranges.of(name)
        fast = f"({name} - lag({name}, {{tau_s}}))**2"
        ends, tried = (("tau_s", times_within(length_s, 4, low=30.0)),), lags(length_s / 4.0, 2)
        blocks += [
            _wound(ranges, name),
            _counted(ranges, name),
            loop(name, (low, high), unit_of(name)),
            Block(fast, f"the square of what is fast of the {name}", f"{unit_of(name)}^2", ends, tried),
        ]  # fmt: skip
    # Powers of what is on or off, or jumps back, are the same or no other cause.
    jumps = "sawtooth(", "latch("
    return [block if any(word in block.text for word in jumps) else replace(block, drives=True) for block in blocks]


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


def _behind(ranges: Ranges) -> Block:
    """What a part that follows the temperature no faster than at some rate is behind it."""
    most = ranges.fastest
    words = "how far a part that follows the temperature at a limited rate is behind"
    tried = tuple((share * most,) for share in (0.2, 0.35, 0.5, 0.65, 0.8, 0.95))
    text = "(temperature - slew(temperature, {per_min}))"
    return Block(text, words, "degC", (("per_min", (0.02 * most, most)),), tried)


def _extreme(ranges: Ranges) -> list[Block]:
    """The most extreme temperature so far, or how far it has been beyond a value."""
    ends, tried = (("centre", ranges.temperature),), inner(*ranges.temperature, 9)
    beyond = (("above", "above(highest(temperature) - {centre})"), ("below", "above({centre} - lowest(temperature))"))
    return [
        *(Block(f"{which}(temperature)", f"the {which} temperature so far", "degC") for which in ("highest", "lowest")),
        *(Block(text, f"how far it has been {side} a temperature", "degC", ends, tried, places=1)
          for side, text in beyond),
    ]  # fmt: skip


def _lost(ranges: Ranges) -> list[Block]:
    """All cooling so far below a temperature, all heating above one: what each swing takes away for good."""
    ends, tried = (("centre", ranges.temperature),), inner(*ranges.temperature, 9)
    return [
        Block(f"total(above({rate}) * (1 {sign} tanh((temperature - {{centre}})/2)))",
              f"all {words} a temperature so far", "degC/min h", ends, tried, places=1)
        for rate, sign, words in (("-dT_dt", "-", "cooling below"), ("dT_dt", "+", "heating above"))
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


def _counted(ranges: Ranges, name: str) -> Block:
    """What a converter or a loop that moves in steps leaves of a channel."""
    low, high = ranges.of(name)
    tried = tuple((low + phase * step, step) for step in ((high - low) / np.arange(2.0, 12.1)).tolist()
                  for phase in (0.0, 0.25, 0.5, 0.75))  # fmt: skip
    bounds = (("at", (low, high)), ("step", (0.03 * (high - low), 0.6 * (high - low))))
    return Block(f"sawtooth(({name} - {{at}})/{{step}})", f"what steps of the {name} leave of it", "", bounds, tried,
                 places=1)  # fmt: skip


def clock(bounds: Bounds, period_s: float) -> Block:
    """What a clock of its own switches on for a part of each period, as a sine over time with this period shows it."""
    text = "(1 + tanh((sin(2*pi*(time - {start_s})/{period_s}) - {level})/0.15))"
    tried = tuple(
        (share * period_s, period_s, level) for share in np.arange(0.0, 1.0, 0.0625) for level in (-0.5, 0.0, 0.5)
    )
    ends = (("start_s", (-bounds[1], 2.0 * bounds[1])), ("period_s", bounds), ("level", (-0.95, 0.95)))
    return Block(text, "what is switched by a clock of its own", "", ends, tried, places=1)


def _gaping(ranges: Ranges) -> list[Block]:
    """What comes off at one temperature, and closes steadily towards another: a crack, a contact that sticks."""
    snap = latch(ranges)
    return [
        replace(snap, text=text.format(snap=snap.text), unit="degC",
                words=f"a gap that opens at one temperature and closes steadily towards a {other} one")
        for text, other in (("{snap} * (temperature - {{centre}} + {{width}})", "lower"),
                            ("(1 - {snap}) * ({{centre}} + {{width}} - temperature)", "higher"))
    ]  # fmt: skip


def _held(ranges: Ranges) -> list[Block]:
    """What holds the temperature of a part inside, as an oven does, until it has nothing left to give, or to take."""
    low, high = ranges.temperature
    bounds = ("centre", (low, high)), ("width", (0.02 * (high - low), 0.6 * (high - low)))
    tried = tuple((*one, share * (high - low)) for one in inner(low, high, 7) for share in (0.06, 0.14, 0.26))
    late, times = ("tau_s", times_within(ranges.length_s, 4)), (150.0, 400.0, 1000.0)
    inside = "lag(temperature, {tau_s}) - {centre}"
    words = "a part inside that is held at a temperature, within the limits of what holds it"
    first = tuple((*one, tau) for one in tried for tau in times)
    last = tuple((tau, *one) for one in tried for tau in times)
    return [
        Block("lag(dead_zone(temperature - {centre}, {width}), {tau_s})", words, "degC", (*bounds, late), first,
              places=1),
        Block(f"({inside} - dead_zone({inside}, {{width}}))", "a temperature that lags, between two limits", "degC",
              (late, *bounds), last, places=1),
    ]  # fmt: skip


def _hinge(ranges: Ranges) -> Block:
    """What the gap between air and unit drags along with play."""
    wide = 2.0 * ranges.widest()
    words = "what the gap between air and unit drags along with play"
    bounds, tried = (("width", (0.002 * wide, 0.45 * wide)),), tuple((w * wide,) for w in (0.05, 0.1, 0.2))
    return Block("play((chamber_temperature - temperature), {width})", words, "degC", bounds, tried)


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
