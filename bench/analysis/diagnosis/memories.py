"""Blocks of a formula that forget: what follows the temperature, what a change adds and what fades, in many ways."""

from __future__ import annotations

from dataclasses import replace

from bench.analysis.diagnosis.blocks import Block, lags, times_within
from bench.analysis.diagnosis.ranges import Ranges, inner

_CHANGES = (("above(dT_dt)", "heating"), ("above(-dT_dt)", "cooling"), ("abs(dT_dt)", "any change"), ("dT_dt", "dT/dt"))


def memories(ranges: Ranges) -> list[Block]:
    """All of them, for the channels that these runs have."""
    blocks = [
        _vapour(ranges, "temperature", "temperature"),
        *_relaxing(ranges),
        _uneven(ranges),
        _spreading(ranges),
        _opposed(ranges),
        _shaken(ranges),
        _turned(ranges, "temperature", "temperature"),
        *_warmed(ranges),
        _yielding(ranges),
        *_kicked(ranges),
        *_annealed(ranges),
        *_activated(ranges),
    ]
    if ranges.gap:
        blocks += [
            _vapour(ranges, "chamber_temperature", "air's temperature"),
            _turned(ranges, "chamber_temperature", "air's temperature"),
            *_loaded(ranges),
        ]
    blocks += [_tiring(ranges, name) for name in ranges.switched]
    return [replace(block, drives=True) for block in blocks]


def _vapour(ranges: Ranges, name: str, called: str) -> Block:
    """What is taken up and given off by its pressure, which is an exponential of a temperature."""
    tried = tuple((faster, *one) for faster in (-0.06, 0.06) for one in lags(ranges.length_s / 2.0, 2))
    bounds = (("faster", (-0.2, 0.2)), ("tau_s", times_within(ranges.length_s, 2)))
    words = f"the memory of an exponential of the {called}"
    return Block(f"lag(exp({{faster}} * ({name} - 25)), {{tau_s}})", words, "", bounds, tried)


def _relaxing(ranges: Ranges) -> list[Block]:
    """What follows the temperature; and what does so faster or slower when it is warm."""
    tau, tried = ("tau_s", times_within(ranges.length_s)), lags(ranges.length_s, 1)
    words = "a part that follows the temperature"
    faster = Block("(temperature - lag(temperature, {tau_s} * exp({faster} * (25 - temperature))))",
                   f"{words}, faster when it is warm", "degC", (tau, ("faster", (-0.2, 0.2))),
                   tuple((*one, faster) for one in tried for faster in (-0.03, 0.03, 0.06)))  # fmt: skip
    strained = Block("exp({steep} * (temperature - lag(temperature, {tau_s})))",
                     f"an exponential of the gap to {words}", "", (("steep", (-0.5, 0.5)), tau),
                     tuple((steep, *one) for one in tried for steep in (-0.2, -0.07, 0.07, 0.2)))  # fmt: skip
    plain = Block("(temperature - lag(temperature, {tau_s}))", words, "degC", (tau,), tried, looser=faster)
    spread = " + ".join(f"lag(temperature, {times}{{tau_s}})" for times in ("", "5 * ", "25 * "))
    heated = Block(f"(temperature - ({spread})/3)", "a body into which heat spreads", "degC", (tau,), tried)
    resting = Block("(temperature - lag(temperature, {tau_s} * (1 + {slower} * abs(direction))))",
                    f"{words}, not as fast at rest", "degC", (tau, ("slower", (-0.9, 50.0))),
                    tuple((*one, slower) for one in tried for slower in (3.0, 20.0)))  # fmt: skip
    low, high = ranges.temperature
    # Its time constant is 100 s at the temperature that defines a glass transition.
    glass = Block("(temperature - lag(temperature, 100 * exp({faster} * ({centre} - temperature))))",
                  f"{words} and freezes in below a temperature", "degC",
                  (("faster", (0.05, 0.6)), ("centre", (low, high + 0.5 * (high - low)))),
                  tuple((faster, *at) for at in inner(low, high + 0.25 * (high - low), 9)
                        for faster in (0.1, 0.2, 0.35)),
                  places=1)  # fmt: skip
    return [plain, faster, strained, heated, resting, glass]


def _uneven(ranges: Ranges) -> Block:
    """What takes up fast and gives off slowly, or the other way round: gas through a valve, charge, water."""
    times = lags(ranges.length_s, 2)
    ends = times_within(ranges.length_s)
    return Block("(temperature - uneven_lag(temperature, {rise_s}, {fall_s}))",
                 "a part that follows the temperature up and down with different time constants", "degC",
                 (("rise_s", ends), ("fall_s", ends)),
                 tuple((*up, *down) for up in times for down in times if up != down))  # fmt: skip


def _spreading(ranges: Ranges) -> Block:
    """What two parts that follow the rate of change one after the other are apart."""
    return Block("(dT_dt - lag(dT_dt, {tau_s}))", "the change of dT/dt in the last while", "degC/min",
                 (("tau_s", times_within(ranges.length_s, 4)),), lags(ranges.length_s / 4.0, 1))  # fmt: skip


def _opposed(ranges: Ranges) -> Block:
    """Two parts that follow the temperature, one against the other: each alone may leave next to nothing."""
    times = [tau for (tau,) in lags(ranges.length_s, 1)]
    tried = tuple(
        (fast, share, slow) for n, fast in enumerate(times) for slow in times[n + 2 :] for share in (0.3, 0.8)
    )
    ends = times_within(ranges.length_s)
    fast, slow = ("(temperature - lag(temperature, {" + name + "}))" for name in ("tau_s", "slow_s"))
    return Block(f"({fast} - {{share}} * {slow})", "two parts that follow the temperature, one against the other",
                 "degC", (("tau_s", ends), ("share", (-1.0, 1.5)), ("slow_s", ends)), tried,
                 most=0.5 * (ranges.temperature[1] - ranges.temperature[0]))  # fmt: skip


def _shaken(ranges: Ranges) -> Block:
    """What each change of the rate of temperature leaves for a while, up or down."""
    ends = (("fast_s", (20.0, 1000.0)), ("tau_s", times_within(ranges.length_s, 2)))
    tried = tuple((60.0, *tau) for tau in lags(ranges.length_s / 2.0, 1))
    return Block("lag(abs(dT_dt - lag(dT_dt, {fast_s})), {tau_s})", "the memory of each change of dT/dt", "degC/min",
                 ends, tried)  # fmt: skip


def _yielding(ranges: Ranges) -> Block:
    """A strain that yields by a power of the stress, as Norton's law has it for solder, and recovers."""
    tried = tuple((power, *one) for power in (2.0, 4.0) for one in lags(ranges.length_s / 2.0, 2))
    bounds = (("power", (1.0, 8.0)), ("tau_s", times_within(ranges.length_s)))
    return Block("lag(sign(dT_dt) * abs(dT_dt)**{power}, {tau_s})", "the memory of a power of dT/dt", "", bounds, tried)


def _kicked(ranges: Ranges) -> list[Block]:
    """What each turn of the temperature sets off: impulses where the last direction changes, which rests keep.

    Whether the first change of a run is a turn depends on what was before it.
    """
    bounds = ("fast_s", (20.0, 600.0)), ("tau_s", times_within(ranges.length_s, 2))
    tried = tuple((fast_s, *tau) for fast_s in (30.0, 120.0) for tau in lags(ranges.length_s / 2.0, 1))
    found = []
    for sign, first in (("", "rise"), ("-", "fall")):
        way = f"latch(lag({sign}dT_dt, {{fast_s}}), 0.1, -0.1)"
        words = f"what each turn of the temperature sets off, a first {first} too"
        found.append(Block(f"lag({way} - lag({way}, 20), {{tau_s}})", words, "", bounds, tried))
    return found


def _annealed(ranges: Ranges) -> list[Block]:
    """What something adds and what fades faster or slower when it is warm: stress, charge, water."""
    fades = "exp({faster} * (25 - temperature))"
    ends = ("faster", (-0.2, 0.2)), ("tau_s", times_within(ranges.length_s))
    placed = [
        (f"above({beyond})", f"a temperature {side} a value", "degC", (("centre", ranges.of(name)),),
         inner(*ranges.of(name), 9)[1::2])
        for name in ("temperature", *(["chamber_temperature"] if ranges.gap else []))
        for beyond, side in ((f"{name} - {{centre}}", "above"), (f"{{centre}} - {name}", "below"))
    ]  # fmt: skip
    air = (("chamber_temperature - temperature", "warmer"), ("temperature - chamber_temperature", "colder"))
    gaps = [(f"above({gap})", f"a gap to the {side} air", "degC", (), ((),)) for gap, side in air if ranges.gap]
    # Of dT/dt itself it is the part that follows the temperature faster when it is warm.
    rates = [(rate, words, "degC/min", (), ((),)) for rate, words in _CHANGES[:-1]]
    return [
        Block(f"lag({added} * {fades}, {{tau_s}} * {fades})",
              f"what {words} adds and what fades faster when it is warm",
              unit, (*own, *ends),
              tuple((*at, faster, *tau) for at in tried for faster in (-0.03, 0.03, 0.06)
                    for tau in lags(ranges.length_s, 2 if own else 1)),
              places=len(own))
        for added, words, unit, own, tried in (*rates, *gaps, *placed)
    ]  # fmt: skip


def _activated(ranges: Ranges) -> list[Block]:
    """What a change of temperature adds, the more the warmer it is, and what fades: wear, charge."""
    bounds = ("warmer", (-0.2, 0.2)), ("tau_s", times_within(ranges.length_s))
    tried = tuple((warmer, *tau) for warmer in (-0.03, 0.03, 0.06) for tau in lags(ranges.length_s, 1))
    return [
        Block(f"lag({rate} * exp({{warmer}} * (temperature - 25)), {{tau_s}})",
              f"the memory of what {words} adds, the more the warmer it is", "degC/min", bounds, tried)
        for rate, words in _CHANGES
    ]  # fmt: skip


def _warmed(ranges: Ranges) -> list[Block]:
    """What is driven above, or below, one temperature, and takes its time: softening, release, freezing."""
    bounds = (("centre", ranges.temperature), ("tau_s", times_within(ranges.length_s, 2)))
    tried = tuple((*one, *tau) for one in inner(*ranges.temperature, 11) for tau in lags(ranges.length_s / 2.0, 2))
    return [
        Block(f"lag(above({beyond}), {{tau_s}})", f"the memory of the temperature {words} a value", "degC", bounds,
              tried, places=1)
        for beyond, words in (("temperature - {centre}", "above"), ("{centre} - temperature", "below"))
    ]  # fmt: skip


def _turned(ranges: Ranges, name: str, called: str) -> Block:
    """What changes over at one temperature, and takes its time."""
    low, high = ranges.of(name)
    span = high - low
    tried = tuple((*one, share * span, *tau) for one in inner(low, high, 11) for share in (0.02, 0.1)
                  for tau in lags(ranges.length_s / 4.0, 2))  # fmt: skip
    bounds = (("centre", (low, high)), ("width", (0.005 * span, 0.4 * span)),
              ("tau_s", times_within(ranges.length_s, 2)))  # fmt: skip
    words = f"the memory of a step over the {called}"
    return Block(f"lag(tanh(({name} - {{centre}})/{{width}}), {{tau_s}})", words, "", bounds, tried,
                 places=1)  # fmt: skip


def _loaded(ranges: Ranges) -> list[Block]:
    """What a machine gives only where the air is beyond a temperature, through a memory."""
    low, high = ranges.of("chamber_temperature")
    bounds = ("centre", (low, high)), ("tau_s", times_within(ranges.length_s, 4))
    tried = tuple((*one, *tau) for one in inner(low, high, 9) for tau in lags(ranges.length_s / 4.0, 2))
    sides = ("{centre} - chamber_temperature", "colder"), ("chamber_temperature - {centre}", "warmer")
    return [
        Block(f"lag({name} * above({beyond}), {{tau_s}})", f"the memory of the {name} in air {words} than a value",
              "degC", bounds, tried, places=1)
        for name in ranges.switched
        for beyond, words in sides
    ]  # fmt: skip


def _tiring(ranges: Ranges, name: str) -> Block:
    """What a machine does while it runs, less and less; it comes back while it rests."""
    ends = times_within(ranges.length_s, 4)
    tried = tuple((tires, rests) for tires in (80.0, 250.0) for rests in (100.0, 400.0, 1500.0))
    return Block(f"{name} * (1 - uneven_lag({name}, {{rise_s}}, {{fall_s}}))",
                 f"the {name}, which does less the longer it runs", "", (("rise_s", ends), ("fall_s", ends)),
                 tried)  # fmt: skip
