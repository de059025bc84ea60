"""What a physical effect is, once for all of them: columns of a linear model, computed from the whole record.

A model of the bias is one constant plus the sum of its effects. An effect either *adds terms* or *moves the abscissa*
(the temperature that all terms see). Its amplitudes are linear and solved exactly; what is not linear (a time constant,
a width, a time of jump) is a `Parameter`, searched within its bounds.

The life of an effect in a fit:  options (frozen dataclass fields)  ->  `prepare(records)` fixes scales, knots, sources
to the rows that are fitted  ->  `columns(record, theta)` of any whole record  ->  `physical()` translates the scaled
amplitudes into coefficients with units. Columns carry no constant and are scaled to order one, so that T^5 and a
14 kHz frequency that moves by 1e-3 are well conditioned.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import MISSING, Field, dataclass, fields
from fractions import Fraction
from math import comb
from typing import Any, ClassVar, TypeVar, cast

import numpy as np

from bench.analysis.thresholds import LEAST_RANGE_DEGC, ON_BOUND
from bench.base import CHANNELS, FloatArray, InputError
from bench.record import Dataset

_T = TypeVar("_T")

Theta = Mapping[str, float]
"""Nonlinear parameters of one effect by name, in their units."""


@dataclass(frozen=True)
class Parameter:
    """One nonlinear parameter: searched between `low` and `high`, on a logarithmic scale where `log`."""

    name: str
    unit: str
    low: float
    high: float
    start: float
    log: bool = False
    meaning: str = ""
    change_point: bool = False
    """A place in time or temperature where something begins: chance finds one easily, so rankings charge one more."""
    jump: bool = False
    """Whether the effect jumps there: its interval is then wider than the curvature of the likelihood says."""

    def on_bound(self, value: float) -> bool:
        """Whether a search ended at an end of the range, to a thousandth of it: the data do not determine the value."""
        low, high, at = np.log([self.low, self.high, value]) if self.log else (self.low, self.high, value)
        return bool(min(at - low, high - at) <= ON_BOUND * (high - low))


@dataclass(frozen=True)
class Physical:
    """Translation of scaled amplitudes into physical coefficients: `matrix` (p, 1 + k) @ [constant, amplitudes].

    Column 0 is what the model's one constant adds (1 in the row of a0); the model uses it for the first effect that
    has such a row and leaves it out for the others, so that the sum is counted once.
    """

    labels: tuple[str, ...]
    units: tuple[str, ...]
    matrix: FloatArray


class Effect:
    """Base of every effect: a frozen dataclass derives from it, gives its `name`, and changes what is not the default.

    The fields of the dataclass are the options in a model file. An effect that adds terms needs `columns` and the
    `amplitudes` of these columns; one that moves the abscissa needs `abscissa` alone. `warm_up.py` is a short example.
    """

    name: ClassVar[str]
    """Name in models and reports; of a built-in effect the file's name."""

    by_clock: ClassVar[bool] = False
    """Whether it depends on the time since the start of the run alone: within a run, anything slow resembles it."""

    @property
    def rarity(self) -> float:
        """Further parameters that a ranking counts for a cause that is rarer than its look-alikes: of two that fit
        equally the usual one comes first, and the other is named beside it.
        """
        return 0.0

    @property
    def family(self) -> str:
        """The cause that several shapes share, such as the hysteresis loops: rankings name it once, not each shape."""
        return self.name

    @property
    def needs(self) -> tuple[str, ...]:
        """Channels without which there are no columns; the fit's validity covers exactly these."""
        return ()

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Nonlinear parameters, () where the effect is linear."""
        return ()

    @property
    def amplitudes(self) -> tuple[tuple[str, str], ...]:
        """Name and unit of each column's amplitude, where the columns are physical as they stand."""
        return ()

    @property
    def of_each_run(self) -> tuple[int, ...]:
        """Columns whose amplitude each run has for itself, such as a state in which it began: of a run that no fit saw,
        it is not known.
        """
        return ()

    @property
    def moves_abscissa(self) -> bool:
        """Whether the effect replaces the temperature that all terms see, instead of adding terms."""
        return type(self).abscissa is not Effect.abscissa

    def prepare(self, records: Sequence[Dataset]) -> Effect:
        """The same effect with scales fixed to these rows; InputError where a channel is missing or constant."""
        return self

    def columns(self, record: Dataset, theta: Theta) -> FloatArray:
        """Regressors (n, k) of the whole record, without a constant; NaN where a channel has a gap."""
        return np.empty((len(record), 0))

    def abscissa(self, record: Dataset, theta: Theta) -> FloatArray:
        """Temperature (n,) [degC] that all terms see, from the whole record (a lag, another thermometer)."""
        return record.channel("temperature")

    def physical(self) -> Physical:
        """Coefficients with units; by default amplitude i is coefficient i, and none is a constant."""
        count = len(self.amplitudes)
        labels, units = (tuple(pair[i] for pair in self.amplitudes) for i in (0, 1))
        return Physical(labels, units, np.eye(count, 1 + count, 1))

    def state(self) -> dict[str, Any]:
        """What `prepare` fixed, for calibration.json: scales, knots."""
        return {}

    def demand(self, records: Sequence[Dataset]) -> None:
        """InputError where these rows cannot determine the prepared effect, with what to do.

        Asked of the final fit only: refusing trial parameters would push a time constant away from its true value.
        """

    def choices(self) -> tuple[Effect, ...]:
        """Variants of an automatic option, which the fit settles by leaving contiguous blocks out; () where none is."""
        return ()

    def beside(self, others: Sequence[Effect]) -> Effect:
        """The same effect without the term that one of the others has already: twice, no data could tell them apart."""
        taken = self.shared and any(other.shared == self.shared for other in others)
        return self.without_shared() if taken else self

    def replaces(self, other: Effect) -> bool:
        """Whether a model that gets this effect leaves the other one out, as no data could tell them apart."""
        return False

    @property
    def shared(self) -> str:
        """Name of the term that other effects may have as well; empty where there is none."""
        return ""

    def without_shared(self) -> Effect:
        """The same effect without that term."""
        return self

    def suited(self, records: Sequence[Dataset]) -> Effect:
        """The same effect, before any fit, with its parameters searched within what the runs visit."""
        return self

    def shapes(self) -> tuple[Effect, ...]:
        """The effect in each of its shapes, the simplest first: rankings try all and count the best as one effect."""
        return (self,)


@dataclass(frozen=True)
class Scale:
    """Affine map of [low, high] to [-1, 1]."""

    low: float
    high: float

    @classmethod
    def of(cls, records: Sequence[Dataset], channel: str, least: float = 0.0) -> Scale:
        """Range of a channel over the rows; InputError where it moves by no more than `least` or has no value."""
        values = np.concatenate([record.channel(channel) for record in records])
        values = values[np.isfinite(values)]
        if values.size == 0:
            raise InputError(f"channel '{channel}' has no value in the rows to fit")
        return cls.spanning(channel, float(values.min()), float(values.max()), least)

    @classmethod
    def spanning(cls, channel: str, low: float, high: float, least: float = 0.0) -> Scale:
        """Range of a channel from its ends; InputError where it moves by no more than `least`."""
        unit = CHANNELS[channel].unit if channel in CHANNELS else ""
        if high - low <= max(least, 1e-12 * max(abs(low), abs(high))):
            raise InputError(
                f"{channel} moves by {high - low:.3g} {unit} only ({low:.6g} to {high:.6g}): its effect cannot be "
                f"determined, more than {least:g} {unit} is needed; fit a run that changes it, or leave the effect out"
            )
        return cls(low, high)

    @property
    def centre(self) -> float:
        """Value that maps to 0."""
        return 0.5 * (self.low + self.high)

    @property
    def half(self) -> float:
        """Half of the range."""
        return 0.5 * (self.high - self.low)

    def unit(self, values: FloatArray) -> FloatArray:
        """Values mapped to [-1, 1] inside the range."""
        return (values - self.centre) / self.half


REFERENCE_DEGC = 25.0
"""Temperature to which coefficients of products with temperature refer [degC]."""


def least_range(channel: str) -> float:
    """Range of a channel at or below which it carries no effect, in its unit."""
    return LEAST_RANGE_DEGC if channel == "temperature" else 0.0


@dataclass(frozen=True)
class Series:
    """Power series of one channel without its constant, as Chebyshev polynomials of the scaled channel."""

    channel: str
    order: int
    scale: Scale

    @classmethod
    def of(cls, records: Sequence[Dataset], channel: str, order: int) -> Series:
        """Series with the scale of these rows."""
        return cls(channel, order, Scale.of(records, channel, least_range(channel)))

    def columns(self, record: Dataset) -> FloatArray:
        """T_1..T_order (n, order); outside the range the tangent at its end, never a wild polynomial."""
        x = self.scale.unit(record.channel(self.channel))
        inside = np.clip(x, -1.0, 1.0)
        table = [np.ones_like(x), inside]
        for _ in range(2, self.order + 1):
            table.append(2 * inside * table[-1] - table[-2])
        beyond = x - inside
        slope = [k * k * np.where(x < 0, (-1.0) ** (k + 1), 1.0) for k in range(1, self.order + 1)]
        return np.column_stack([table[k] + slope[k - 1] * beyond for k in range(1, self.order + 1)])

    def powers(self) -> FloatArray:
        """Matrix (order + 1, order): coefficient of channel^p in T_k, computed exactly and rounded once."""
        centre, half = Fraction(self.scale.centre), Fraction(self.scale.half)
        chebyshev = [[Fraction(1)], [Fraction(0), Fraction(1)]]
        while len(chebyshev) <= self.order:
            last, before = [Fraction(0), *(2 * c for c in chebyshev[-1])], chebyshev[-2]
            chebyshev.append([c - (before[i] if i < len(before) else 0) for i, c in enumerate(last)])
        matrix = np.zeros((self.order + 1, self.order))
        for k in range(1, self.order + 1):
            for p in range(k + 1):
                terms = (c / half**i * comb(i, p) * (-centre) ** (i - p) for i, c in enumerate(chebyshev[k]) if i >= p)
                matrix[p, k - 1] = float(sum(terms))
        return matrix


class StaticEffect(Effect):
    """Base of the static curves: fixed by the ranges of their channels alone, so that sums of rows can be fitted."""

    family = "static"

    def scaled(self, scales: Mapping[str, Scale]) -> Effect:
        """The same effect over these ranges of the channels that it needs."""
        raise NotImplementedError

    def prepare(self, records: Sequence[Dataset]) -> Effect:
        """The same effect over the ranges of these rows; InputError where a channel is missing or constant."""
        return self.scaled({name: Scale.of(records, name, least_range(name)) for name in self.needs})


def powers_unit(channel: str, power: int) -> str:
    """Unit of the coefficient of channel^power, for instance deg/h/degC^2."""
    return "deg/h" if power == 0 else f"deg/h/{CHANNELS[channel].unit}" + (f"^{power}" if power > 1 else "")


def prepared(fixed: _T | None) -> _T:
    """What `prepare` fixed; RuntimeError if it was not called."""
    if fixed is None:
        raise RuntimeError("prepare() comes before columns()")
    return fixed


def check_number(effect: str, option: str, value: object, low: float, high: float) -> None:
    """InputError unless the option is a number within [low, high]."""
    if not isinstance(value, int | float) or isinstance(value, bool) or not low <= value <= high:
        raise InputError(f"{effect}: {option} is {value!r}, allowed is a number from {low:g} to {high:g}")


def check_choice(effect: str, option: str, value: object, allowed: Sequence[object]) -> None:
    """InputError unless the option is one of these."""
    if not any(value == one and type(value) is type(one) for one in allowed):
        raise InputError(f"{effect}: {option} is {value!r}, allowed are {', '.join(map(str, allowed))}")


def check_whole(effect: str, option: str, value: object, low: int, high: int) -> None:
    """InputError unless the option is a whole number within [low, high]."""
    if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
        raise InputError(f"{effect}: {option} is {value!r}, allowed is a whole number from {low} to {high}")


def _default(item: Field[Any]) -> Any:
    return item.default_factory() if item.default_factory is not MISSING else item.default


def options_of(effect: Effect) -> dict[str, Any]:
    """Options of an effect that differ from their defaults (what a model file has to say)."""
    return {
        item.name: getattr(effect, item.name)
        for item in fields(cast(Any, effect))
        if not item.metadata.get("fitted") and getattr(effect, item.name) != _default(item)
    }
