"""The formulas that are searched where the catalogue does not explain what is left: products of measured channels.

A *block* is what a formula multiplies: a channel, its memory (lag, play), a window in temperature. Blocks have
parameters (time constants, widths, places); these are tried on a coarse grid here and refined continuously afterwards.
A *formula* is a product of blocks with one amplitude, one that changes with temperature, or a sine and cosine pair. It
grows by a further block, by what one of its blocks becomes with one parameter more (`variants`), or by an amplitude.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from bench.analysis.diagnosis.blocks import Block, Bounds, Formula, lagged, lags, loop, unit_of
from bench.analysis.diagnosis.candidates import Theta
from bench.base import INSTRUMENTS, BoolArray, FloatArray
from bench.record import Dataset

_INNER_S = (60.0, 120.0, 220.0, 400.0)
_MOST_DEGREE = 2  # of an amplitude, in the temperature
_PLACES = 11  # of a window, over the range of the channel
_SET_POINTS = (0.15, 0.35, 0.45, 0.5, 0.55, 0.65, 0.85)  # quantiles of a channel that a loop may hold
_PERIODS = 48  # of a line over temperature
_FURTHER = ("frequency", "drive", "quadrature", "supply", "applied_rate",
            *(name for name in INSTRUMENTS[1:] if "temperature" not in name))  # fmt: skip
"""Not thermometers: each would be a look-alike of the unit's own."""
_SWITCHED = ("compressor",)


class Grammar:
    """Blocks for the channels that these runs have and move, and the formulas that are made of them."""

    def __init__(self, records: Sequence[Dataset], masks: Sequence[BoolArray]) -> None:
        """`masks` (n,) are the rows that are searched."""
        self._records, self._masks = records, masks
        self.temperature = self._range("temperature")
        self.moved = tuple(name for name in _FURTHER if self._moves(name))
        self.switched = tuple(name for name in _SWITCHED if self._moves(name))
        self.gap = self._moves("chamber_temperature")
        self.length_s = max(float(np.ptp(record.time)) for record in records)

    def singles(self) -> list[Formula]:
        """Formulas of one block."""
        drivers = self.drivers()
        bent = [bent for block in drivers for bent in block.bent()]
        bent += [block.squared() for block in drivers if block.most and block.bounds]
        alone = [Formula((block,)) for block in (*drivers, *bent, *self.alone(), *self.bends())]
        return [*alone, *(Formula((block,), pair=True) for block in self.lines())]

    def pairs(self) -> list[Formula]:
        """Products of a block that drives with one that modifies it, or with an amplitude that changes."""
        others = [self._centred(name) for name in self.moved]
        found: dict[str, Formula] = {}
        for driver in self.drivers():
            thermal = "dT_dt" in driver.text or "temperature" in driver.text
            for along in (self._centred("temperature"), *(others if thermal else ())):
                formula = Formula((driver,), degree=1, along=along)
                found[formula.text(formula.names)] = formula
        modifiers = self.modifiers()
        drifts = [Block("time", "time", "s"), *(replace(block, grid=block.grid[::2]) for block in self.bends())]
        for driver in (*self.drivers(), *drifts):
            for modifier in modifiers:
                if modifier.text != driver.text:
                    formula = Formula((driver, modifier))
                    key = "*".join(sorted((driver.text, modifier.text)))
                    found.setdefault(key, formula)
        return list(found.values())

    def grown(self, formula: Formula, values: Theta) -> Iterator[tuple[Formula, tuple[Theta, ...]]]:
        """A formula with one block or parameter more, and the parameters to try: those of other blocks stay."""
        have = {block.text for block in formula.blocks}
        if not formula.pair and formula.degree < _MOST_DEGREE:
            along = formula.along or self._centred("temperature")
            yield replace(formula, degree=formula.degree + 1, along=along), (values,)
        for modifier in self.modifiers():
            for block in (modifier, modifier.looser):
                if block and block.text not in have:
                    longer = replace(formula, blocks=(*formula.blocks, block))
                    yield longer, tuple((*values, *one) for one in block.grid)
        for number, block in enumerate(formula.blocks):
            if formula.pair and number == 0:
                continue
            end = sum(len(one.bounds) for one in formula.blocks[: number + 1])
            first = end - len(block.bounds)
            for variant in block.variants(self.length_s, self.switched):
                blocks = (*formula.blocks[:number], variant, *formula.blocks[number + 1 :])
                # Its own parameters may have stood for the one that it lacked: they are tried anew, too.
                own = dict.fromkeys((*((*values[first:end], one[-1]) for one in variant.grid), *variant.grid))
                yield replace(formula, blocks=blocks), tuple((*values[:first], *one, *values[end:]) for one in own)

    def beside(self, formula: Formula, values: Theta) -> Iterator[tuple[Formula, tuple[Theta, ...]]]:
        """What may stand beside a formula: what it would become with a block more, and overtones of a sine."""
        yield from self.grown(formula, values)
        first, *others = formula.blocks
        for times in ("4", "6") if formula.pair else ():
            text = first.text.replace("2*pi", f"{times}*pi")
            faster = replace(first, text=text, words=f"an overtone of {first.words}")
            yield replace(formula, blocks=(faster, *others)), (values,)

    def drivers(self) -> list[Block]:
        """What may act by itself: the rate of change and its memory, the loop, the gap to the air, each channel."""
        blocks = [
            Block("dT_dt", "dT/dt", "degC/min", most=self._fastest),
            Block("abs(dT_dt)", "|dT/dt|", "degC/min"),
            Block("(dT_dt + abs(dT_dt))", "dT/dt of heating alone", "degC/min"),
            Block("(dT_dt - abs(dT_dt))", "dT/dt of cooling alone", "degC/min"),
            Block("dT_dt**2", "(dT/dt)^2", "(degC/min)^2"),
            replace(lagged("dT_dt", "dT/dt", "degC/min", self.length_s), most=self._fastest),
            lagged("abs(dT_dt)", "|dT/dt|", "degC/min", self.length_s, every=2),
            loop("temperature", self.temperature, "degC"),
        ]
        if self.gap:
            gap, words, most = "(chamber_temperature - temperature)", "the gap between air and unit", self._widest
            blocks += [
                Block(gap, words, "degC", most=most),
                replace(lagged(gap, words, "degC", self.length_s, every=2), most=most),
            ]
        for name in self.moved:
            blocks += self._channel(name)
        blocks += self._resonances()
        for name in self.switched:
            blocks += [Block(name, f"the {name}", ""), lagged(name, f"the {name}", "", self.length_s, every=2)]
        return [replace(block, drives=True) for block in blocks]

    def alone(self) -> list[Block]:
        """What acts by itself and is scaled by nothing: starts, exposure that adds up, what is fast of a channel."""
        length_s, (low, high) = self.length_s, self.temperature
        rates = tuple((f, h) for f in (0.02, 0.05, 0.1) for h in (0.05, 0.2, 0.8))
        latch = self._latch()
        blocks = [
            Block(f"total((temperature - {0.5 * (low + high):.4g}))", "time spent warm", "degC h"),
            Block("total((temperature - {centre}) + abs(temperature - {centre}))", "time spent above a temperature",
                  "degC h", (("centre", (low, high)),), _inner(low, high, 9), places=1),
            latch,
            replace(latch, text=f"lag({latch.text}, {{tau_s}})", words=f"the memory of {latch.words}",
                    bounds=(*latch.bounds, ("tau_s", (20.0, max(length_s / 2.0, 100.0)))),
                    grid=tuple((*one, tau) for one in latch.grid for tau in (200.0, 800.0))),
            Block("highest(temperature)", "the highest temperature so far", "degC"),
            Block("lowest(temperature)", "the lowest temperature so far", "degC"),
            Block("total(abs(dT_dt))", "all change of temperature so far", "degC/min h"),
            Block("exp(-total(exp({faster} * (temperature - 25))) * {per_h})", "a loss that is faster when it is warm",
                  "", (("faster", (0.0, 0.15)), ("per_h", (0.01, 5.0))), rates),
        ]  # fmt: skip
        blocks += [
            self._vapour("temperature", "temperature"),
            self._behind(),
            self._relaxing(),
            self._turned("temperature", "temperature"),
        ]
        if self.gap:
            blocks += [
                self._vapour("chamber_temperature", "air's temperature"),
                self._hinge(),
                self._turned("chamber_temperature", "air's temperature"),
            ]
            blocks.append(self._film("(chamber_temperature - temperature)", "the air is warmer than the unit"))
            blocks.append(self._film("(temperature - chamber_temperature)", "the unit is warmer than the air"))
        for name in self.switched:
            late = f"delay({name}, 30)"
            for words, text in (("starts", f"({name} - {late})"), ("stops", f"({late} - {name})")):
                rises = f"({text} + abs({text}))"
                blocks.append(replace(lagged(rises, f"the {words} of the {name}", "", length_s), drives=True))
        for name in self.moved:
            low, high = self._range(name)
            fast = f"({name} - lag({name}, {{tau_s}}))**2"
            ends, tried = (("tau_s", (30.0, max(length_s / 4.0, 100.0))),), lags(length_s / 4.0, 2)
            blocks += [
                self._wound(name),
                replace(loop(name, (low, high), unit_of(name)), drives=True),
                Block(fast, f"the square of what is fast of the {name}", f"{unit_of(name)}^2", ends, tried,
                      drives=True),
            ]  # fmt: skip
        return blocks

    def _latch(self) -> Block:
        """What snaps over above one temperature, and back below a lower one."""
        low, high = self.temperature
        span = high - low
        shares = (0.03, 0.09, 0.15, 0.21, 0.27, 0.36)
        grid = tuple((*one, share * span) for one in _inner(low, high, 15) for share in shares)
        ends = (("centre", (low, high)), ("width", (0.005 * span, 0.5 * span)))
        return Block(
            "latch(temperature, {centre} + {width}, {centre} - {width})",
            "a state that changes above one temperature, and back below another",
            "",
            ends,
            grid,
            places=2,
        )

    def _vapour(self, name: str, called: str) -> Block:
        """What is taken up and given off by its pressure, which is an exponential of a temperature."""
        tried = tuple((faster, *one) for faster in (-0.06, 0.06) for one in lags(self.length_s / 2.0, 2))
        bounds = (("faster", (-0.12, 0.12)), ("tau_s", (20.0, max(self.length_s / 2.0, 100.0))))
        words = f"the memory of an exponential of the {called}"
        return Block(f"lag(exp({{faster}} * ({name} - 25)), {{tau_s}})", words, "", bounds, tried)

    def _behind(self) -> Block:
        """What a part that follows the temperature no faster than at some rate is behind it."""
        most = self._fastest
        words = "how far a part that follows the temperature at a limited rate is behind"
        tried = tuple((share * most,) for share in (0.2, 0.35, 0.5, 0.65, 0.8, 0.95))
        text = "(temperature - slew(temperature, {per_min}))"
        return Block(text, words, "degC", (("per_min", (0.02 * most, most)),), tried)

    def _relaxing(self) -> Block:
        """What follows the temperature, faster or slower when it is warm."""
        tried = tuple((*one, faster) for one in lags(self.length_s, 1) for faster in (-0.03, 0.03, 0.06))
        bounds = (("tau_s", (20.0, max(self.length_s, 200.0))), ("faster", (-0.12, 0.12)))
        return Block("(temperature - lag(temperature, {tau_s} * exp({faster} * (25 - temperature))))",
                     "a part that follows the temperature, faster when it is warm", "degC", bounds, tried)  # fmt: skip

    def _hinge(self) -> Block:
        """What the gap between air and unit drags along with play."""
        wide = 2.0 * self._widest
        words = "what the gap between air and unit drags along with play"
        bounds, tried = (("width", (0.002 * wide, 0.45 * wide)),), tuple((w * wide,) for w in (0.05, 0.1, 0.2))
        return Block("play((chamber_temperature - temperature), {width})", words, "degC", bounds, tried)

    @cached_property
    def _fastest(self) -> float:
        """The largest |dT/dt| [degC/min]."""
        return max(float(np.nanmax(np.abs(part))) for part in self._parts(lambda record: record.dT_dt))

    @cached_property
    def _widest(self) -> float:
        """The largest gap between air and unit [degC]."""
        gaps = self._parts(lambda record: record.channels["chamber_temperature"] - record.channel("temperature"))
        return max(float(np.max(np.abs(part))) for part in gaps)

    def _turned(self, name: str, called: str) -> Block:
        """What changes over at one temperature, and takes its time."""
        low, high = self._range(name)
        span = high - low
        tried = tuple((*one, share * span, *tau) for one in _inner(low, high, 11) for share in (0.02, 0.1)
                      for tau in lags(self.length_s / 4.0, 2))  # fmt: skip
        bounds = (("centre", (low, high)), ("width", (0.005 * span, 0.4 * span)),
                  ("tau_s", (20.0, max(self.length_s / 2.0, 100.0))))  # fmt: skip
        words = f"the memory of a step over the {called}"
        return Block(f"lag(tanh(({name} - {{centre}})/{{width}}), {{tau_s}})", words, "", bounds, tried, places=1,
                     drives=True)  # fmt: skip

    def _wound(self, name: str) -> Block:
        """An integral of a channel that runs into its limits: a loop integrates what is left about its set point."""
        low, high = self._range(name)
        points = np.quantile(np.concatenate(self._parts(lambda record: record.channel(name))), _SET_POINTS)
        summed = f"total(({name} - {{centre}}))"
        most = (high - low) * self.length_s / 3600.0
        ends = (0.0002 * most, 0.5 * most)
        tried = tuple((float(c), share * most) for c in points for share in (0.002, 0.006, 0.02, 0.08))
        bounds = (("centre", (low, high)), ("width", ends))
        return Block(f"({summed} - play({summed}, {{width}}))", f"an integral of the {name} between two limits",
                     f"{unit_of(name)} h", bounds, tried, places=1)  # fmt: skip

    @staticmethod
    def _film(gap: str, words: str) -> Block:
        """What grows with a difference, and is lost faster or slower by the opposite one until nothing is left."""
        flow = f"total({gap} + {{loss}} * ({gap} - abs({gap})))"
        return Block(f"({flow} - lowest({flow}))", f"a film that grows while {words}", "degC h",
                     (("loss", (-0.45, 5.0)),), ((-0.25,), (0.0,), (0.5,), (2.0,)))  # fmt: skip

    def _resonances(self) -> list[Block]:
        """A mode that the frequency meets: its size and its phase over the distance from it."""
        if "frequency" not in self.moved:
            return []
        low, high = self._range("frequency")
        span = high - low
        away = "((frequency - {centre})/{width})"
        tried = tuple((*one, share * span) for one in _inner(low, high, 11) for share in (0.05, 0.15))
        bounds = (("centre", (low, high)), ("width", (0.01 * span, 0.5 * span)))
        return [
            Block(f"1/(1 + {away}**2)", "a mode that the frequency meets", "", bounds, tried, places=1),
            Block(f"{away}/(1 + {away}**2)", "the phase of a mode that the frequency meets", "", bounds, tried,
                  places=1),
        ]  # fmt: skip

    def _channel(self, name: str) -> list[Block]:
        low, high = self._range(name)
        half = 0.5 * (high - low)
        unit = unit_of(name)
        lag = f"({name} - lag({name}, {{tau_s}}))"
        ends = (("tau_s", (30.0, max(self.length_s / 2.0, 100.0))),)
        return [
            self._centred(name),
            Block(f"({name} - {{centre}})**2", f"the {name} squared, from a value", f"{unit}^2",
                  (("centre", (low - half, high + half)),), tuple((float(c),) for c in np.linspace(low, high, 5))),
            Block(f"abs({name} - {{centre}})", f"the {name}'s distance from a value", unit,
                  (("centre", (low, high)),), _inner(low, high, 7), places=1),
            *(self._beyond(name, sign, words) for sign, words in (("+", "above"), ("-", "below"))),
            Block(f"tanh(({name} - {{centre}})/{max(half / 8.0, 1e-12):.3g})", f"a step over the {name}", "",
                  (("centre", (low, high)),), _inner(low, high, 9), places=1),
            lagged(f"({name} - {0.5 * (low + high):.6g})", f"the {name}", unit, self.length_s / 2.0, every=2),
            Block(lag, f"the change of the {name} in the last while", unit, ends, lags(self.length_s / 2.0, 2)),
        ]  # fmt: skip

    def _beyond(self, name: str, sign: str, words: str) -> Block:
        """A channel beyond a value; with a soft edge if that pays."""
        low, high = self._range(name)
        own, away = (("centre", (low, high)),), f"({name} - {{centre}})"
        soft = ("soft", (0.005 * (high - low), 0.3 * (high - low)))
        grid = tuple((*one, share * (high - low)) for one in _inner(low, high, 9) for share in (0.02, 0.1))
        words, unit = f"the {name} {words} a value", unit_of(name)
        looser = Block(f"(sqrt({away}**2 + {{soft}}**2) {sign} {away})", words, unit, (*own, soft), grid, places=1)
        return Block(f"(abs{away} {sign} {away})", words, unit, own, _inner(low, high, 9), places=1, looser=looser)

    def _centred(self, name: str) -> Block:
        """A channel from the middle of its range, or from a value that is searched."""
        low, high = self._range(name)
        middle, span = 0.5 * (low + high), high - low
        words, unit = f"the {name}", unit_of(name)
        bounds = (("centre", (low - 3.0 * span, high + 3.0 * span)),)
        grid = tuple((float(middle + d * span),) for d in (-2.0, -0.6, -0.2, 0.2, 0.6, 2.0))
        looser = Block(f"({name} - {{centre}})", f"{words}, from a value", unit, bounds, grid)
        return Block(f"({name} - {middle:.6g})", words, unit, looser=looser)

    def bends(self) -> list[Block]:
        """Functions of time that are no line: the start."""
        bounds = (("tau_s", (120.0, max(self.length_s, 200.0))),)
        grid = lags(self.length_s / 2.0, 1)[1:] or ((0.5 * self.length_s,),)
        return [Block("exp(-time/{tau_s})", "a decay from the start", "", bounds, grid)]

    def lines(self) -> list[Block]:
        """Sines: over temperature on a grid; over time where a periodogram finds them (`line`)."""
        low, high = self.temperature
        span = high - low
        # From the finest that the thermometer's rows follow to half of the range, evenly in frequency.
        frequencies = np.linspace(2.0 / span, 0.5 * _PERIODS / span, _PERIODS)
        grid = tuple((float(1.0 / f),) for f in frequencies)
        bounds = (("period_degc", (float(1.0 / frequencies[-1]), 0.6 * span)),)
        both = (("tau_s", (20.0, 2000.0)), *bounds)
        # A lag that is a good part of a period apart between heating and cooling leaves nothing of the plain sine.
        many = tuple((tau_s, *one) for tau_s in _INNER_S for one in grid)
        inner = Block("sin(2*pi*lag(temperature, {tau_s})/{period_degc})", "a sine over a temperature that lags", "",
                      both, many)  # fmt: skip
        found = [Block("sin(2*pi*temperature/{period_degc})", "a sine over temperature", "", bounds, grid), inner]
        for name in self.moved:
            low, high = self._range(name)
            periods = tuple((float((high - low) / turns),) for turns in np.linspace(1.0, 8.0, 15))
            ends = (("period", (periods[-1][0], 2.0 * periods[0][0])),)
            found.append(Block(f"sin(2*pi*{name}/{{period}})", f"a sine over the {name}", "", ends, periods))
        return found

    def line(self, periods_s: Sequence[float]) -> Formula:
        """A sine over time with these periods to try."""
        bounds = (("period_s", (0.8 * min(periods_s), 1.25 * max(periods_s))),)
        block = Block("sin(2*pi*time/{period_s})", "a sine over time", "", bounds, tuple((p,) for p in periods_s))
        return Formula((block,), pair=True)

    def modifiers(self) -> list[Block]:
        """What may scale a driver: temperature, windows and steps in it, every channel, the direction, time."""
        low, high = self.temperature
        middle, span = 0.5 * (low + high), high - low
        centres = np.linspace(low, high, _PLACES)
        bounds = (("centre", (low, high)), ("width", (0.02 * span, 0.5 * span)))
        window = tuple((float(c), w) for c in centres for w in (0.05 * span, 0.15 * span))
        inner, lagging = (("tau_s", (20.0, max(self.length_s / 4.0, 100.0))),), ((300.0,), (900.0,), (2700.0,))
        blocks = [
            self._centred("temperature"),
            Block(f"(temperature - {middle:.4g})**2", "temperature squared", "degC^2"),
            Block("exp(-((temperature - {centre})/{width})**2)", "a window in temperature", "", bounds, window,
                  places=1),
            Block("(1 + tanh((temperature - {centre})/{width}))", "a step over temperature", "", bounds, window[2:-2:2],
                  places=1),
            Block("(1 - tanh((temperature - {centre})/{width}))", "a step down over temperature", "", bounds,
                  window[2:-2:2], places=1),
            Block(f"lag((temperature - {middle:.4g}), {{tau_s}})", "a temperature that lags", "degC", inner, lagging,
                  looser=Block("(lag(temperature, {tau_s}) - {centre})", "a temperature that lags, from a value",
                               "degC", (*inner, ("centre", (low - span, high + span))),
                               tuple((*one, c) for one in lagging for c in (low - 0.5 * span, low, high)))),
            Block("dT_dt", "dT/dt", "degC/min"),
            Block("abs(dT_dt)", "|dT/dt|", "degC/min"),
            Block("(1 + direction)", "heating", ""),
            Block("(1 - direction)", "cooling", ""),
            Block("time", "time", "s"),
        ]  # fmt: skip
        if self.gap:
            blocks.append(Block("(chamber_temperature - temperature)", "the gap between air and unit", "degC"))
        for name in self.moved:
            low, high = self._range(name)
            blocks.append(self._centred(name))
            if low * high < 0.0 or abs(high - low) > 0.05 * abs(high + low):  # else it is a constant, and not a factor
                blocks.append(Block(name, f"the {name}", unit_of(name)))
        blocks += [Block(name, f"the {name}", "") for name in self.switched]
        return [*blocks, *self._resonances()]

    def _parts(self, values: Callable[[Dataset], FloatArray]) -> list[FloatArray]:
        """Values of each record at the rows that are searched."""
        return [values(record)[mask] for record, mask in zip(self._records, self._masks, strict=True)]

    def _range(self, name: str) -> Bounds:
        values = np.concatenate(self._parts(lambda record: record.channel(name)))
        return float(np.nanmin(values)), float(np.nanmax(values))

    def _moves(self, name: str) -> bool:
        if not all(name in record.channels for record in self._records):
            return False
        if not all(np.all(np.isfinite(r.channels[name][m])) for r, m in zip(self._records, self._masks, strict=True)):
            return False
        low, high = self._range(name)
        return high - low > 1e-9 * max(abs(low), abs(high), 1e-9)


def _inner(low: float, high: float, count: int) -> tuple[tuple[float], ...]:
    """Values to try, evenly spaced without the two ends."""
    return tuple((float(c),) for c in np.linspace(low, high, count)[1:-1])
