"""What the formulas of a diagnosis are made of: blocks with parameters, and what a block may become with one more."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from bench.base import CHANNELS

_LAGS_S = (60.0, 150.0, 400.0, 1000.0, 2500.0, 6000.0, 15000.0)
_WIDTHS = (0.0056, 0.012, 0.024, 0.048, 0.096, 0.2)  # of a play, over the range of what it follows

Bounds = tuple[float, float]


@dataclass(frozen=True)
class Block:
    """A factor of a formula: its text with `{name}` for each parameter, their bounds and the grid that is tried.

    `unit` is the unit of its value, `words` says what it is.
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

    def variants(self, length_s: float) -> list[Block]:
        """The block with one parameter more, which comes last in its text; `length_s` is that of the longest run."""
        found = [] if self.looser is None else [self.looser]
        if not self.drives:
            return found
        if self.text.startswith("lag(") and self.text.count("{") == 1:
            warm = "{tau_s} * exp(-{faster} * (temperature - 25))"
            turned = "{tau_s} * (1 + {slower} * direction)"
            found += [
                self._with("faster", (-0.12, 0.12), (-0.03, 0.03, 0.06), self.text.replace("{tau_s}", warm),
                           f"{self.words}, faster when it is warm"),
                self._with("slower", (-0.9, 0.9), (-0.5, 0.5), self.text.replace("{tau_s}", turned),
                           f"{self.words}, not the same heating and cooling"),
            ]  # fmt: skip
        memories = tuple(tau for (tau,) in lags(length_s / 2.0, 1))
        return [
            *found,
            self._with("memory_s", (20.0, max(length_s, 200.0)), memories, f"lag({self.text}, {{memory_s}})",
                       f"the memory of {self.words}"),
            self._with("late_s", (0.0, min(3000.0, 0.2 * length_s)), tuple(0.02 * length_s * i for i in (0.2, 0.7, 2)),
                       f"delay({self.text}, {{late_s}})", f"{self.words}, late"),
            self._with("power", (0.2, 4.0), (0.5, 2.0, 3.0), f"sign({self.text}) * abs({self.text})**{{power}}",
                       f"a power of {self.words}"),
            self._with("power", (0.3, 4.0), (1.0, 2.0), f"abs({self.text})**{{power}}",
                       f"a power of the size of {self.words}"),
        ]  # fmt: skip

    def _with(self, name: str, ends: Bounds, tried: Sequence[float], text: str, words: str) -> Block:
        """One parameter more; what is made of it grows no further."""
        grid = tuple((*own, value) for own in self.grid for value in tried)
        unit = "" if name == "power" else self.unit
        return replace(
            self, text=text, words=words, unit=unit, bounds=(*self.bounds, (name, ends)), grid=grid, looser=None,
            drives=False,
        )  # fmt: skip


def lagged(text: str, words: str, unit: str, length_s: float, every: int = 1) -> Block:
    """The memory of something; `every` thins its grid."""
    bounds = (("tau_s", (20.0, max(length_s, 200.0))),)
    return Block(f"lag({text}, {{tau_s}})", f"the memory of {words}", unit, bounds, lags(length_s, every))


def lags(below_s: float, every: int) -> tuple[tuple[float, ...], ...]:
    """Time constants to try, below the longest that is searched."""
    return tuple((t,) for t in _LAGS_S[::every] if t < below_s) or ((_LAGS_S[0],),)


def loop(name: str, span: Bounds, unit: str) -> Block:
    """What a play in a channel leaves behind; `span` is the range of the channel."""
    wide = span[1] - span[0]
    return Block(f"({name} - play({name}, {{width}}))", f"the play of the {name}", unit,
                 (("width", (0.0016 * wide, 0.45 * wide)),), tuple((w * wide,) for w in _WIDTHS))  # fmt: skip


def unit_of(name: str) -> str:
    """Unit of a channel."""
    return CHANNELS[name].unit
