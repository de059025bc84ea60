"""The formulas that are searched where the catalogue does not explain what is left: products of measured channels.

A *block* is what a formula multiplies: a channel, its memory (lag, play), a window in temperature. Blocks have
parameters (time constants, widths, places); these are tried on a coarse grid here and refined continuously afterwards.
A *formula* is a product of blocks with one amplitude, one that changes with temperature, or a sine and cosine pair. It
grows by a further block, by what one of its blocks becomes with one parameter more (`variants`), or by an amplitude.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from bench.analysis.diagnosis.blocks import Block, Formula, lagged, lags, loop, times_within, unit_of
from bench.analysis.diagnosis.candidates import Theta
from bench.analysis.diagnosis.memories import memories
from bench.analysis.diagnosis.ranges import Ranges, inner
from bench.analysis.diagnosis.states import clock, hops, latch, states
from bench.base import BoolArray
from bench.record import Dataset

_INNER_S = (60.0, 120.0, 220.0, 400.0)
_MOST_DEGREE = 4  # of an amplitude, in the temperature
_PLACES = 11  # of a window, over the range of the channel
_ROOM_DEGC = 23.0  # to begin with
_PERIODS = 48  # of a line over temperature
_TURNS = (-1.0, -0.75, -0.5, -0.25, 0.25, 0.5, 0.75, 1.0)  # by which its phase moves within a run
_PACE = 0.05  # degC/min, within which a rate is passed
_SLOPE = Block("dT_dt", "dT/dt", "degC/min")
_ONE_WAY = Block("above(direction)", "heating alone", ""), Block("above(-direction)", "cooling alone", "")


class Grammar:
    """Blocks for the channels that these runs have and move, and the formulas that are made of them."""

    def __init__(self, records: Sequence[Dataset], masks: Sequence[BoolArray]) -> None:
        """`masks` (n,) are the rows that are searched."""
        self.ranges = Ranges(records, masks)

    def singles(self) -> list[Formula]:
        """Formulas of one block."""
        drivers = self.drivers()
        bent = [bent for block in drivers for bent in block.bent()]
        # What yields by a high power is next to nothing of what is seen where little happens.
        bent += [one for block in drivers if block.most and block.bounds for one in (block.squared(), block.raised())]
        # Of what begins somewhere little may be seen at once that lasts.
        bent += [block.memory(self.ranges.length_s, every=2) for block in drivers if block.places]
        # A curve of the temperature is the model's own; one of the temperature of a part inside is not.
        inside = [block for block in self._inside((self._bend(), *self.modifiers())) if block.places]
        own = (*drivers, *bent, *states(self.ranges), *memories(self.ranges), *self.bends(), *self._fanned(), *inside)
        alone = [Formula((block,)) for block in own]
        lines = [Formula((block,), pair=True) for block in self.lines()]
        # Up and down the same way its rate of change leaves nothing of the sine alone, which could grow to it.
        changing = replace(lines[0], blocks=(*lines[0].blocks, _SLOPE))
        return [*alone, *lines, changing]

    def pairs(self) -> list[Formula]:
        """Products of a block that drives with one that modifies it, or with an amplitude that changes."""
        others = [self._centred(name) for name in self.ranges.moved]
        found: dict[str, Formula] = {}
        drivers, modifiers = self.drivers(), self.modifiers()
        for driver in drivers:
            thermal = "dT_dt" in driver.text or "temperature" in driver.text
            for along in (self._centred("temperature"), *(others if thermal else ())):
                formula = Formula((driver,), degree=1, along=along)
                found[formula.text(formula.names)] = formula
        drifts = [Block("time", "time", "s"), *(replace(block, grid=block.grid[::2]) for block in self.bends())]
        for driver in (*drivers, *drifts):
            for modifier in modifiers:
                if modifier.text != driver.text:
                    formula = Formula((driver, modifier))
                    key = "*".join(sorted((driver.text, modifier.text)))
                    found.setdefault(key, formula)
        # What acts at once at a place in a temperature that lags: of the same without the lag little may be seen.
        at_once = {"dT_dt", *self.ranges.switched, *(self._gap(name).text for name in self.ranges.apart)}
        at_once |= {self._centred(name).text for name in self.ranges.moved}
        inside = self._inside(modifiers)
        late = [Formula((one, place)) for one in drivers if one.text in at_once for place in inside]
        return [*found.values(), *late]

    def grown(self, formula: Formula, values: Theta) -> Iterator[tuple[Formula, tuple[Theta, ...]]]:
        """A formula with one block or parameter more, and the parameters to try: those of other blocks stay."""
        have = {block.text for block in formula.blocks}
        if formula.pair:
            yield from self._hopping(formula, values)
            yield from self._clocked(formula, values)
        if not formula.pair and formula.degree < _MOST_DEGREE:
            along = formula.along or self._centred("temperature")
            yield replace(formula, degree=formula.degree + 1, along=along), (values,)
        # What disturbs with a period of its own may come from the chamber's heater, or from its cooling.
        switched = self._chamber()[::2] if formula.pair and self.ranges.gap else []
        for modifier in (*self.modifiers(), *switched):
            for block in (modifier, modifier.looser):
                if block and block.text not in have:
                    longer = replace(formula, blocks=(*formula.blocks, block))
                    yield longer, tuple((*values, *one) for one in block.grid)
        for number, block in enumerate(formula.blocks):
            if formula.pair and number == 0:
                continue
            first, end = formula.own[number].start, formula.own[number].stop
            for variant in block.variants(self.ranges.length_s, self.ranges.switched):
                blocks = (*formula.blocks[:number], variant, *formula.blocks[number + 1 :])
                # Its own parameters may have stood for the one that it lacked: they are tried anew, too.
                new = next(i for i, bound in enumerate(variant.bounds) if bound not in block.bounds)
                kept = ((*values[first : first + new], one[new], *values[first + new : end]) for one in variant.grid)
                own = dict.fromkeys((*kept, *variant.grid))
                yield replace(formula, blocks=blocks), tuple((*values[:first], *one, *values[end:]) for one in own)

    def _hopping(self, formula: Formula, values: Theta) -> Iterator[tuple[Formula, tuple[Theta, ...]]]:
        """What a sine over temperature is the first harmonic of: a growth that jumps back at every period."""
        sine, *others = formula.blocks
        for late, plain in zip(hops(self.ranges), ("sin(2*pi*temperature/", "sin(2*pi*lag(temperature,"), strict=True):
            if sine.text.startswith(plain):
                *tau, period = values[: len(sine.bounds)]
                low, rest = self.ranges.temperature[0], values[len(sine.bounds) :]
                tried = tuple((*tau, low + share * period, period, *rest) for share in np.arange(0.0, 1.0, 0.0625))
                yield Formula((late, *others)), tried

    @staticmethod
    def _clocked(formula: Formula, values: Theta) -> Iterator[tuple[Formula, tuple[Theta, ...]]]:
        """What a sine over time is the first harmonic of: what a clock switches."""
        sine, *others = formula.blocks
        if sine.text.startswith("sin(2*pi*time/"):
            period_s, *rest = values
            block = clock(dict(sine.bounds)["period_s"], period_s)
            yield Formula((block, *others)), tuple((*one, *rest) for one in block.grid)

    def beside(self, formula: Formula, values: Theta) -> Iterator[tuple[Formula, tuple[Theta, ...]]]:
        """What may stand beside a formula: what it would become with a block more, its square, overtones of a sine."""
        yield from self.grown(formula, values)
        if not formula.pair:
            yield Formula(tuple(block.squared() for block in formula.blocks)), (values,)
        first, *others = formula.blocks
        for times in ("4", "6") if formula.pair else ():
            text = first.text.replace("2*pi", f"{times}*pi")
            faster = replace(first, text=text, words=f"an overtone of {first.words}")
            yield replace(formula, blocks=(faster, *others)), (values,)

    def drivers(self) -> list[Block]:
        """What may act by itself: the rate of change and its memory, the loop, the gap to the air, each channel."""
        blocks = [
            replace(_SLOPE, most=self.ranges.fastest),
            Block("abs(dT_dt)", "|dT/dt|", "degC/min"),
            Block("above(dT_dt)", "dT/dt of heating alone", "degC/min"),
            Block("above(-dT_dt)", "dT/dt of cooling alone", "degC/min"),
            Block("dT_dt**2", "the square of dT/dt", "(degC/min)^2"),
            *_ONE_WAY,
            replace(lagged("dT_dt", "dT/dt", "degC/min", self.ranges.length_s), most=self.ranges.fastest),
            lagged("abs(dT_dt)", "|dT/dt|", "degC/min", self.ranges.length_s, every=2),
            lagged("direction", "the direction of change", "", self.ranges.length_s),
            lagged("abs(direction)", "any change of temperature", "", self.ranges.length_s, every=2),
            self._calm(),
            loop("temperature", self.ranges.temperature, "degC"),
        ]
        for name in self.ranges.apart:
            gap, most = self._gap(name), self.ranges.widest(name)
            memory = lagged(gap.text, gap.words, "degC", self.ranges.length_s, every=2)
            blocks += [replace(gap, most=most), replace(memory, most=most), *self._covers(name)]
        if self.ranges.gap:
            blocks += self._chamber()
        for name in self.ranges.moved:
            blocks += self._channel(name)
        blocks += self._resonances()
        for name in self.ranges.switched:
            blocks += [Block(name, f"the {name}", ""), lagged(name, f"the {name}", "", self.ranges.length_s, every=2)]
        return [replace(block, drives=True) for block in blocks]

    def _calm(self) -> Block:
        """The memory of a change faster than a rate."""
        fast = self._paced()[0]
        tried = tuple((*one, *tau) for one in fast.grid for tau in lags(self.ranges.length_s / 4.0, 2))
        bounds = (*fast.bounds, ("tau_s", times_within(self.ranges.length_s, 2)))
        return replace(fast, text=f"lag({fast.text}, {{tau_s}})", words=f"the memory of {fast.words}", bounds=bounds,
                       grid=tried)  # fmt: skip

    @staticmethod
    def _gap(name: str) -> Block:
        what = "air" if name == "chamber_temperature" else name
        return Block(f"({name} - temperature)", f"the gap between {what} and unit", "degC")

    def _covers(self, name: str) -> list[Block]:
        """The gaps of a part that follows the air, or another thermometer, to what it follows and to the unit."""
        what, part = "air" if name == "chamber_temperature" else name, f"lag({name}, {{tau_s}})"
        bounds = (("tau_s", times_within(self.ranges.length_s, 4)),)
        tried = lags(self.ranges.length_s / 4.0, 2)
        gaps = (
            (f"({name} - {part})", f"the gap between {what} and a part that follows it"),
            (f"({part} - temperature)", f"the gap between unit and a part that follows {what}"),
        )
        return [Block(text, words, "degC", bounds, tried) for text, words in gaps]

    def _fanned(self) -> list[Block]:
        """The same where what is switched, such as a fan, changes how fast the part follows.

        Without it little of them is seen, and they would not grow to it.
        """
        covers = [replace(block, drives=True) for name in self.ranges.apart for block in self._covers(name)]
        variants = [one for block in covers for one in block.variants(self.ranges.length_s, self.ranges.switched)]
        slower = [f"{{slower}} * {name})" for name in self.ranges.switched]
        return [one for one in variants if any(text in one.text for text in slower)]

    @staticmethod
    def _inside(modifiers: Sequence[Block]) -> list[Block]:
        """Places in the temperature of a part that lags, of these modifiers."""
        loose = (block.looser for block in modifiers if block.looser)
        return [block for block in loose if "lag(temperature" in block.text]

    def _bend(self) -> Block:
        low, high = self.ranges.temperature
        bounds, tried = (("centre", (low, high)),), inner(low, high, 9)
        words = "the distance from a value of a temperature"
        return self._placed(Block("abs(temperature - {centre})", words, "degC", bounds, tried, places=1))

    def _chamber(self) -> list[Block]:
        """What the chamber's heater and its cooling give, which no channel records: the heat balance of the air.

        Its change within a minute, and its loss to the room in this time, have to come from one of them.
        """
        air = "chamber_temperature"
        heated = f"above({air} - lag({air}, 60) + {{loss}} * ({air} - {{room}}))"
        cooled = f"above(lag({air}, 60) - {air} - {{loss}} * ({air} - {{room}}))"
        bounds = (("loss", (0.002, 0.5)), ("room", (0.0, 50.0)))
        tried = tuple((loss, _ROOM_DEGC) for loss in (0.01, 0.05))
        blocks = []
        for given, words in ((heated, "the chamber's heating"), (cooled, "the chamber's cooling")):
            one = Block(given, words, "degC", bounds, tried)
            slow = lagged(one.text, words, "degC", self.ranges.length_s, every=2)
            grid = tuple((*own, *tau) for own in tried for tau in slow.grid)
            blocks += [one, replace(slow, bounds=(*bounds, *slow.bounds), grid=grid)]
        return blocks

    def _resonances(self) -> list[Block]:
        """A mode that the frequency meets: its size and its phase over the distance from it."""
        if "frequency" not in self.ranges.moved:
            return []
        low, high = self.ranges.of("frequency")
        span = high - low
        away = "((frequency - {centre})/{width})"
        tried = tuple((*one, share * span) for one in inner(low, high, 11) for share in (0.05, 0.15))
        bounds = (("centre", (low, high)), ("width", (0.01 * span, 0.5 * span)))
        return [
            Block(f"1/(1 + {away}**2)", "a mode that the frequency meets", "", bounds, tried, places=1),
            Block(f"{away}/(1 + {away}**2)", "the phase of a mode that the frequency meets", "", bounds, tried,
                  places=1),
        ]  # fmt: skip

    def _channel(self, name: str) -> list[Block]:
        low, high = self.ranges.of(name)
        half = 0.5 * (high - low)
        unit = unit_of(name)
        lag = f"({name} - lag({name}, {{tau_s}}))"
        ends = (("tau_s", times_within(self.ranges.length_s, 2, low=30.0)),)
        return [
            self._centred(name),
            Block(f"({name} - {{centre}})**2", f"the {name} squared, from a value", f"{unit}^2",
                  (("centre", (low - half, high + half)),), tuple((float(c),) for c in np.linspace(low, high, 5))),
            Block(f"abs({name} - {{centre}})", f"the {name}'s distance from a value", unit,
                  (("centre", (low, high)),), inner(low, high, 7), places=1),
            *(self._beyond(name, sign, words) for sign, words in (("+", "above"), ("-", "below"))),
            Block(f"tanh(({name} - {{centre}})/{max(half / 8.0, 1e-12):.3g})", f"a step over the {name}", "",
                  (("centre", (low, high)),), inner(low, high, 9), places=1),
            lagged(f"({name} - {0.5 * (low + high):.6g})", f"the {name}", unit, self.ranges.length_s / 2.0, every=2),
            Block(lag, f"the change of the {name} in the last while", unit, ends, lags(self.ranges.length_s / 2.0, 2)),
        ]  # fmt: skip

    def _beyond(self, name: str, sign: str, words: str) -> Block:
        """A channel beyond a value; with a soft edge if that pays."""
        low, high = self.ranges.of(name)
        own, away = (("centre", (low, high)),), f"({name} - {{centre}})"
        soft = ("soft", (0.005 * (high - low), 0.3 * (high - low)))
        grid = tuple((*one, share * (high - low)) for one in inner(low, high, 9) for share in (0.02, 0.1))
        words, unit = f"the {name} {words} a value", unit_of(name)
        looser = Block(f"(sqrt({away}**2 + {{soft}}**2) {sign} {away})", words, unit, (*own, soft), grid, places=1)
        beyond = f"above({name} - {{centre}})" if sign == "+" else f"above({{centre}} - {name})"
        return Block(beyond, words, unit, own, inner(low, high, 9), places=1, looser=looser)

    def _centred(self, name: str) -> Block:
        """A channel from the middle of its range, or from a value that is searched."""
        low, high = self.ranges.of(name)
        middle, span = 0.5 * (low + high), high - low
        words, unit = f"the {name}", unit_of(name)
        bounds = (("centre", (low - 3.0 * span, high + 3.0 * span)),)
        grid = tuple((float(middle + d * span),) for d in (-2.0, -0.6, -0.2, 0.2, 0.6, 2.0))
        looser = Block(f"({name} - {{centre}})", f"{words}, from a value", unit, bounds, grid)
        return Block(f"({name} - {middle:.6g})", words, unit, looser=looser)

    def bends(self) -> list[Block]:
        """Functions of time that are no line: the start."""
        bounds = (("tau_s", times_within(self.ranges.length_s, low=120.0)),)
        grid = lags(self.ranges.length_s / 2.0, 1)[1:] or ((0.5 * self.ranges.length_s,),)
        return [Block("exp(-time/{tau_s})", "a decay from the start", "", bounds, grid)]

    def lines(self) -> list[Block]:
        """Sines: over temperature on a grid; over time where a periodogram finds them (`line`)."""
        low, high = self.ranges.temperature
        span = high - low
        # From the finest that the thermometer's rows follow to half of the range, evenly in frequency.
        frequencies = np.linspace(2.0 / span, 0.5 * _PERIODS / span, _PERIODS)
        grid = tuple((float(1.0 / f),) for f in frequencies)
        bounds = (("period_degc", (float(1.0 / frequencies[-1]), 0.6 * span)),)
        both = (("tau_s", (20.0, 4000.0)), *bounds)
        # A lag that is a good part of a period apart between heating and cooling leaves nothing of the plain sine.
        many = tuple((tau_s, *one) for tau_s in (*_INNER_S, 800.0, 1600.0) for one in grid)
        inner = Block("sin(2*pi*lag(temperature, {tau_s})/{period_degc})", "a sine over a temperature that lags", "",
                      both, many)  # fmt: skip
        # Of one that moves by half a period nothing is left of the plain sine, either.
        hours = self.ranges.length_s / 3600.0
        moving = (("drift", (-0.5 * span / hours, 0.5 * span / hours)), *bounds)
        moved = tuple((turns * period / hours, period) for turns in _TURNS for (period,) in grid)
        drifting = Block("sin(2*pi*(temperature + {drift} * time/3600)/{period_degc})",
                         "a sine over temperature that drifts with time", "", moving, moved)  # fmt: skip
        plain = Block("sin(2*pi*temperature/{period_degc})", "a sine over temperature", "", bounds, grid)
        found = [plain, inner, drifting]
        for name in self.ranges.moved:
            low, high = self.ranges.of(name)
            periods = tuple((float((high - low) / turns),) for turns in np.linspace(1.0, 8.0, 15))
            ends = (("period", (periods[-1][0], 2.0 * periods[0][0])),)
            found.append(Block(f"sin(2*pi*{name}/{{period}})", f"a sine over the {name}", "", ends, periods))
        return found

    def line(self, periods_s: Sequence[float]) -> Formula:
        """A sine over time with these periods to try."""
        bounds = (("period_s", (0.8 * min(periods_s), 1.25 * max(periods_s))),)
        block = Block("sin(2*pi*time/{period_s})", "a sine over time", "", bounds, tuple((p,) for p in periods_s))
        return Formula((block,), pair=True)

    def snaps(self, heated: Sequence[float], cooled: Sequence[float]) -> list[Formula]:
        """What snaps over above one of these temperatures, and back below one of the others [degC]."""
        grid = tuple((0.5 * (up + down), 0.5 * (up - down)) for up in heated for down in cooled if up > down)
        return [Formula((replace(latch(self.ranges), grid=grid),))] if grid else []

    def _paced(self) -> list[Block]:
        """Whether the temperature changes faster than a rate, or slower."""
        most = self.ranges.fastest
        either = tuple((share * most,) for share in (0.1, 0.35, 0.7))
        both = tuple((-pace,) for (pace,) in reversed(either)) + either
        return [
            Block(f"(1 {sign} tanh(({rate} - {{pace}})/{_PACE}))", words, "", (("pace", (low, most)),), tried, places=1)
            for rate, low, tried, said in (
                ("abs(dT_dt)", 0.0, either, ("a change faster than a rate", "rest, or a change slower than a rate")),
                ("dT_dt", -most, both, ("heating faster than a rate", "cooling faster than a rate")),
            )
            for sign, words in zip("+-", said, strict=True)
        ]

    def _snapped(self) -> list[Block]:
        """Whether it has snapped over, or has not."""
        low, high = self.ranges.temperature
        tried = tuple((*one, share * (high - low)) for one in inner(low, high, 4) for share in (0.08, 0.2))
        snap = replace(latch(self.ranges), grid=tried)
        return [snap, replace(snap, text=f"(1 - {snap.text})")]

    def _placed(self, block: Block) -> Block:
        """A place in temperature; or in that of a part inside the unit, which lags."""
        late = block.text.replace("temperature", "lag(temperature, {tau_s})")
        ends = ("tau_s", times_within(self.ranges.length_s, 4))
        tried = tuple((tau_s, *one) for one in block.grid for tau_s in _INNER_S[1::2])
        looser = replace(block, text=late, words=f"{block.words} that lags", bounds=(ends, *block.bounds), grid=tried)
        return replace(block, looser=looser)

    def modifiers(self) -> list[Block]:
        """What may scale a driver: temperature, windows and steps in it, every channel, the direction, time."""
        low, high = self.ranges.temperature
        middle, span = 0.5 * (low + high), high - low
        centres = np.linspace(low, high, _PLACES)
        bounds = (("centre", (low, high)), ("width", (0.02 * span, 0.5 * span)))
        window = tuple((float(c), w) for c in centres for w in (0.05 * span, 0.15 * span))
        inner, lagging = (("tau_s", times_within(self.ranges.length_s, 4)),), ((300.0,), (900.0,), (2700.0,))
        warmer, warmth = (("warmer", (-0.2, 0.2)),), ((-0.06,), (-0.025,), (0.025,), (0.06,))
        places = (
            ("exp(-((temperature - {centre})/{width})**2)", "a window in temperature", window),
            ("(1 + tanh((temperature - {centre})/{width}))", "a step over temperature", window[2:-2:2]),
            ("(1 - tanh((temperature - {centre})/{width}))", "a step down over temperature", window[2:-2:2]),
        )
        blocks = [
            self._centred("temperature"),
            Block(f"(temperature - {middle:.4g})**2", "temperature squared", "degC^2"),
            *(self._placed(Block(text, words, "", bounds, tried, places=1)) for text, words, tried in places),
            Block("exp({warmer} * (temperature - 25))", "an exponential of a temperature", "", warmer, warmth,
                  looser=Block("exp({warmer} * (lag(temperature, {tau_s}) - 25))",
                               "an exponential of a temperature that lags", "", (*warmer, *inner),
                               tuple((*one, *tau) for one in warmth for tau in lagging[:2]))),
            Block(f"lag((temperature - {middle:.4g}), {{tau_s}})", "a temperature that lags", "degC", inner, lagging,
                  looser=Block("(lag(temperature, {tau_s}) - {centre})", "a temperature that lags, from a value",
                               "degC", (*inner, ("centre", (low - span, high + span))),
                               tuple((*one, c) for one in lagging for c in (low - 0.5 * span, low, high)))),
            *(self._beyond("temperature", sign, words) for sign, words in (("+", "above"), ("-", "below"))),
            _SLOPE,
            Block("abs(dT_dt)", "|dT/dt|", "degC/min"),
            Block("(1 + direction)", "heating (half at rest)", ""),
            Block("(1 - direction)", "cooling (half at rest)", ""),
            *_ONE_WAY,
            *self._paced(),
            *self._snapped(),
            Block("time", "time", "s"),
        ]  # fmt: skip
        blocks += map(self._gap, self.ranges.apart)
        for name in self.ranges.moved:
            low, high = self.ranges.of(name)
            blocks.append(self._centred(name))
            if low * high < 0.0 or abs(high - low) > 0.05 * abs(high + low):  # else it is a constant, and not a factor
                blocks.append(Block(name, f"the {name}", unit_of(name)))
        blocks += [Block(name, f"the {name}", "") for name in self.ranges.switched]
        return [*blocks, *self._resonances()]
