"""Formulas of a diagnosis, and what they are made of: blocks with parameters, which may become others with one more."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import accumulate, pairwise, product

from bench.analysis.diagnosis.candidates import Theta
from bench.analysis.effects.base import Parameter
from bench.analysis.effects.expression import Expression, bounded
from bench.base import CHANNELS

_LAGS_S = (60.0, 150.0, 400.0, 1000.0, 2500.0, 6000.0, 15000.0)
_WIDTHS = (0.0056, 0.012, 0.024, 0.048, 0.096, 0.2)  # of a play, over the range of what it follows

_SIGNED = re.compile(r"(?<![(-])dT_dt|(?<=\blag\()dT_dt")  # a rate of change that counts up and down alike
_UNEVEN = (-0.5, 0.5)  # how much more it may count while it rises
_MEMORY, _OF = ", {tau_s})", "the memory of "
_NEXT_TO_NOTHING = {"tau_s", "fast_s", "rise_s", "fall_s", "memory_s", "late_s", "limit", "soft"}
"""Parameters whose lower bound stands for none at all: what follows at once, a sign, a sharp edge."""

Bounds = tuple[float, float]


@dataclass(frozen=True)
class Block:
    """A factor of a formula: its text with `{name}` for each parameter, their bounds and the grid that is tried.

    Bounds are in the order in which the text has the parameters. `unit` is that of its value, `words` says what it is.
    """

    text: str
    words: str
    unit: str
    bounds: tuple[tuple[str, Bounds], ...] = ()
    grid: tuple[tuple[float, ...], ...] = ((),)
    places: int = 0
    """Parameters that are a place where something begins: each costs one count more."""
    looser: Block | None = None
    """The same with its reference value as a parameter."""
    drives: bool = False
    """Whether it may act late, through a memory, or by another power of itself."""
    most: float = 0.0
    """Size that it reaches about 0, where it may also have limits, a dead zone or play."""

    def variants(self, length_s: float, switched: Sequence[str] = ()) -> list[Block]:
        """The block with one parameter more; `length_s` is that of the longest run.

        A time constant may change with channels that are `switched`.
        """
        found = [] if self.looser is None else [self.looser]
        if not self.drives:
            return found
        if "{tau_s})" in self.text:
            warm = self.text.replace("{tau_s}", "{tau_s} * exp({faster} * (25 - temperature))")
            found.append(self._with("faster", (-0.2, 0.2), (-0.03, 0.03, 0.06), warm,
                                    f"{self.words}, faster when it is warm"))  # fmt: skip
            for name, words in (("direction", "not the same heating and cooling"),
                                *((name, f"faster or slower by the {name}") for name in switched)):  # fmt: skip
                turned = self.text.replace("{tau_s}", f"{{tau_s}} * (1 + {{slower}} * {name})")
                found.append(self._with("slower", (-0.9, 0.9), (-0.5, 0.5), turned, f"{self.words}, {words}"))
        if "play(temperature, {width})" in self.text:
            softer = self.text.replace("{width}", "{width} * exp({softer} * (25 - temperature))")
            found.append(self._with("softer", (-0.2, 0.2), (-0.03, 0.015, 0.03, 0.06), softer,
                                    f"{self.words}, whose width falls when it is warm"))  # fmt: skip
        if "{tau_s})" in self.text and (self.text.startswith("lag(") or self.text.count("lag(") == 1):
            uneven = self.text.replace("lag(", "uneven_lag(", 1).replace("{tau_s})", "{tau_s}, {fall_s})")
            found.append(self._with("fall_s", dict(self.bounds)["tau_s"], tuple(t for (t,) in lags(length_s / 2.0, 2)),
                                    uneven, f"{self.words}, not the same up and down"))  # fmt: skip
        found += [
            *self.bent(),
            self.memory(length_s),
            self._with("late_s", (0.0, min(3000.0, 0.2 * length_s)), tuple(0.02 * length_s * i for i in (0.2, 0.7, 2)),
                       f"delay({self.text}, {{late_s}})", f"{self.words}, late"),
            self.raised(),
            self._with("power", (0.3, 4.0), (1.0, 2.0), f"abs({self.text})**{{power}}",
                       f"a power of the size of {self.words}"),
        ]  # fmt: skip
        return [one for one in found if len(dict(one.bounds)) == len(one.bounds)]  # it may have such a parameter

    def memory(self, length_s: float, every: int = 1) -> Block:
        """The memory of the block; `every` thins its grid."""
        tried = tuple(tau for (tau,) in lags(length_s / 2.0, every))
        text, words = f"lag({self.text}, {{memory_s}})", f"{_OF}{self.words}"
        return self._with("memory_s", times_within(length_s), tried, text, words)

    def bent(self) -> list[Block]:
        """The block through what is no straight line, if it has a size: limits, a dead zone, play, a switch."""
        if not self.most:
            return []
        ends, tried = (0.01 * self.most, 2.0 * self.most), tuple(share * self.most for share in (0.1, 0.3, 0.6))
        inner = ends[0], 0.9 * self.most
        at = self._with("at", (-self.most, self.most), (-0.2 * self.most, 0.2 * self.most), f"({self.text} - {{at}})",
                        self.words)  # fmt: skip
        uneven = at._with("zone", inner, tried, f"dead_zone({at.text}, {{zone}})",
                          f"{self.words} outside a dead zone that is not about 0")  # fmt: skip
        dead = self._with(
            "zone", inner, tried, f"dead_zone({self.text}, {{zone}})", f"{self.words} outside a dead zone"
        )
        return [
            self._with("limit", ends, tried, f"tanh({self.text}/{{limit}})", f"{self.words}, limited"),
            replace(dead, looser=uneven),
            self._with("width", inner, tried, f"play({self.text}, {{width}})", f"{self.words} with play"),
            self._with(
                "level",
                inner,
                tried,
                f"latch({self.text}, {{level}}, -{{level}})",
                f"a state that {self.words} switches one way and back",
            ),
        ]

    def raised(self) -> Block:
        """The block to a power, with its sign."""
        text = f"sign({self.text}) * abs({self.text})**{{power}}"
        return self._with("power", (0.2, 4.0), (0.5, 2.0, 3.0), text, f"a power of {self.words}")

    def squared(self) -> Block:
        """The square of the block."""
        return replace(self, text=f"({self.text})**2", words=f"the square of {self.words}",
                       unit=f"({self.unit})^2" if self.unit else "", looser=None, drives=False)  # fmt: skip

    @property
    def at_once(self) -> Block | None:
        """What the block is the memory of."""
        if not (self.text.startswith("lag(") and self.text.endswith(_MEMORY) and self.words.startswith(_OF)):
            return None
        return replace(self, text=self.text.removeprefix("lag(").removesuffix(_MEMORY), words=self.words[len(_OF) :],
                       bounds=self.bounds[:-1], grid=tuple(dict.fromkeys(one[:-1] for one in self.grid)))  # fmt: skip

    def _with(self, name: str, ends: Bounds, tried: Sequence[float], text: str, words: str) -> Block:
        """One parameter more; what is made of it grows no further."""
        bounds = (*self.bounds, (name, ends))
        order = sorted(range(len(bounds)), key=lambda i: text.index(f"{{{bounds[i][0]}}}"))
        grid = tuple(tuple((*own, value)[i] for i in order) for own in self.grid for value in tried)
        unit = "" if name in {"power", "limit", "level"} else self.unit
        return replace(self, text=text, words=words, unit=unit, bounds=tuple(bounds[i] for i in order), grid=grid,
                       looser=None, drives=False)  # fmt: skip


def lagged(text: str, words: str, unit: str, length_s: float, every: int = 1) -> Block:
    """The memory of something; `every` thins its grid."""
    bounds = (("tau_s", times_within(length_s)),)
    return Block(f"lag({text}{_MEMORY}", f"{_OF}{words}", unit, bounds, lags(length_s, every))


def lags(below_s: float, every: int) -> tuple[tuple[float, ...], ...]:
    """Time constants to try, below the longest that is searched."""
    return tuple((t,) for t in _LAGS_S[::every] if t < below_s) or ((_LAGS_S[0],),)


def times_within(length_s: float, parts: int = 1, low: float = 20.0) -> Bounds:
    """Bounds [s] of a time constant: up to this part of the longest run."""
    return low, max(length_s / parts, 200.0)


def loop(name: str, span: Bounds, unit: str) -> Block:
    """What a play in a channel leaves behind; `span` is the range of the channel."""
    wide = span[1] - span[0]
    return Block(f"({name} - play({name}, {{width}}))", f"the play of the {name}", unit,
                 (("width", (0.0016 * wide, 0.45 * wide)),), tuple((w * wide,) for w in _WIDTHS))  # fmt: skip


def unit_of(name: str) -> str:
    """Unit of a channel."""
    return CHANNELS[name].unit


@dataclass(frozen=True)
class Formula:
    """A product of blocks; `pair` adds the same with a cosine for the sine of its first block, as its own amplitude.

    Its amplitude is a polynomial of this `degree` in `along`.
    """

    blocks: tuple[Block, ...]
    pair: bool = False
    degree: int = 0
    along: Block | None = None

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters in the formula, each once: a number follows where two blocks share one."""
        given = [name for block in self.blocks for name, _ in block.bounds]
        return tuple(
            name if given.count(name) == 1 else f"{name}{given[:i].count(name) + 1}" for i, name in enumerate(given)
        )

    @cached_property
    def bounds(self) -> dict[str, Bounds]:
        """Bounds of its parameters by their names."""
        pairs = (bounds for block in self.blocks for _, bounds in block.bounds)
        return dict(zip(self.names, pairs, strict=True))

    @property
    def vanishing(self) -> tuple[bool, ...]:
        """Of each parameter whether its lower bound stands for none at all; so does the width of a step, not that of a
        window or a play.
        """
        return tuple(
            name in _NEXT_TO_NOTHING or (name == "width" and "tanh(" in block.text)
            for block in self.blocks
            for name, _ in block.bounds
        )

    @property
    def jagged(self) -> bool:
        """Whether its value jumps, so that its likelihood jumps with each row that a parameter passes."""
        return any(word in block.text for block in self.blocks for word in ("sawtooth(", "latch("))

    @cached_property
    def places(self) -> int:
        """Parameters that are places."""
        return sum(block.places for block in self.blocks)

    def grid(self) -> tuple[Theta, ...]:
        """Parameters to try."""
        return tuple(tuple(x for part in one for x in part) for one in product(*(block.grid for block in self.blocks)))

    def product(self, values: Sequence[str]) -> str:
        """The product with these texts for its parameters."""
        given, parts = iter(values), []
        for block in self.blocks:
            parts.append(block.text.format(**{name: next(given) for name, _ in block.bounds}))
        return " * ".join(parts).replace("- -", "+ ")

    def text(self, values: Sequence[str], amplitude: str = "k") -> str:
        """The formula with these texts for its parameters."""
        one = self.product(values)
        if self.pair:
            return f"{amplitude} * {one} + {amplitude}_cos * {one.replace('sin(', 'cos(', 1)}"
        if self.along is None:
            return f"{amplitude} * {one}"
        powers = [f"{amplitude}_{n} * {self.along.text}{_power(n)}" for n in range(1, self.degree + 1)]
        return f"({' + '.join([amplitude, *powers])}) * {one}"

    def expression(self, amplitude: str = "k") -> Expression:
        """The effect of a model file, its parameters searched within their bounds."""
        return Expression(self.text(self.names, amplitude), self.bounds)

    def near(self, theta: Theta, amplitude: str = "k") -> Expression:
        """The effect with bounds about these values, so that a fit begins there."""
        bounds = {
            parameter.name: _about(parameter, value) for parameter, value in zip(self.parameters, theta, strict=True)
        }
        return Expression(self.text(self.names, amplitude), {name: list(ends) for name, ends in bounds.items()})

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """Its parameters as the engine searches them."""
        return tuple(bounded(name, *ends) for name, ends in self.bounds.items())

    @cached_property
    def own(self) -> tuple[slice, ...]:
        """Where the parameters of each block are among those of the formula."""
        ends = accumulate((len(block.bounds) for block in self.blocks), initial=0)
        return tuple(slice(first, end) for first, end in pairwise(ends))

    def at_once(self, theta: Theta) -> tuple[Formula, Theta] | None:
        """The formula without the memories that are as short as is searched, and its parameters; None without any."""
        blocks, values = list[Block](), list[float]()
        for block, at in zip(self.blocks, self.own, strict=True):
            pairs = list(zip(self.parameters[at], theta[at], strict=True))
            short = any(p.on_bound(value) and value < 2 * _LAGS_S[0] for p, value in pairs[-1:])
            kept = (block.at_once if short else None) or block
            blocks.append(kept)
            values += theta[at][: len(kept.bounds)]
        shorter = replace(self, blocks=tuple(blocks))
        return None if shorter.blocks == self.blocks else (shorter, tuple(values))

    def shorter(self, theta: Theta) -> list[tuple[Formula, Theta]]:
        """The formula without each of its blocks, but for the sine of a pair, and its parameters, where one remains."""
        if len(self.blocks) < 2:
            return []
        return [
            (replace(self, blocks=(*self.blocks[:i], *self.blocks[i + 1 :])), (*theta[: at.start], *theta[at.stop :]))
            for i, at in enumerate(self.own)
            if i or not self.pair
        ]

    def within(self, other: Formula) -> bool:
        """Whether the other is this formula with further blocks, or with an amplitude that changes more."""
        own, others = ({block.text for block in one.blocks} for one in (self, other))
        return (own < others or (own == others and self.degree < other.degree)) and self.pair == other.pair

    def one_way(self, theta: Theta) -> list[tuple[Formula, tuple[Theta, ...]]]:
        """The formula of heating alone, of cooling alone, and of both by different amounts, where it is of both alike,
        with parameters to try: runs that pass each temperature once up and once down hardly tell them apart.
        """
        both = [i for i, block in enumerate(self.blocks) if _SIGNED.search(block.text)]
        if not both or self.along:
            return []
        found = [
            (self._signed(both, f"above({sign}dT_dt)", f"dT/dt of {words} alone"), (theta,))
            for sign, words in (("", "heating"), ("-", "cooling"))
        ]
        first = both[0]
        uneven = self._signed(both[:1], "(dT_dt + {uneven} * abs(dT_dt))", "dT/dt, not as large heating and cooling")
        block, at = uneven.blocks[first], self.own[first].start
        bounds = (("uneven", (-1.0, 1.0)), *block.bounds)  # the rate of change comes first in the text
        block = replace(block, bounds=bounds, grid=tuple((share, *one) for one in block.grid for share in _UNEVEN))
        blocks = (*self.blocks[:first], block, *self.blocks[first + 1 :])
        tried = tuple((*theta[:at], share, *theta[at:]) for share in _UNEVEN)
        return [*found, (replace(self, blocks=blocks), tried)]

    def _signed(self, numbers: Sequence[int], text: str, words: str) -> Formula:
        """The formula with this text for the rate of change in these blocks, and these words for its words."""
        blocks = list(self.blocks)
        for number in numbers:
            block = blocks[number]
            blocks[number] = replace(block, text=_SIGNED.sub(text, block.text),
                                     words=block.words.replace("dT/dt", words))  # fmt: skip
        return replace(self, blocks=tuple(blocks))

    @property
    def amplitudes(self) -> tuple[tuple[str, str], ...]:
        """End of the name, and unit, of each amplitude."""
        factors = [block.unit for block in self.blocks if block.unit]
        unit = self.along.unit if self.along else ""
        more = [[*factors, unit + (f"^{n}" if n > 1 else "")] for n in range(1, self.degree + 1)]
        units = [f"deg/h per ({' * '.join(of)})" if of else "deg/h" for of in (factors, *more)]
        if self.pair:
            return ("", units[0]), ("_cos", units[0])
        return tuple((f"_{n}" if n else "", own) for n, own in enumerate(units))

    @property
    def words(self) -> str:
        """What it is."""
        words = " times ".join(block.words for block in self.blocks)
        return f"{words}, its size changing with {self.along.words}" if self.along else words


def _power(exponent: int) -> str:
    return f"**{exponent}" if exponent > 1 else ""


def _about(parameter: Parameter, value: float) -> Bounds:
    """Bounds with the value in their middle, as a fit takes it for its start."""
    if parameter.name.startswith("period"):
        return float(f"{0.9 * value:.8g}"), float(f"{1.1 * value:.8g}")
    if parameter.log:
        return float(f"{value / 4.0:.6g}"), float(f"{4.0 * value:.6g}")
    half = 0.1 * (parameter.high - parameter.low)
    return float(f"{value - half:.8g}"), float(f"{value + half:.8g}")
