"""Channels of each effect without memory, and the blocks that represent it exactly."""

from __future__ import annotations

import ast
import re
from dataclasses import dataclass

from bench.analysis import Effect, Expression
from bench.base import InputError
from bench.deliver.export.delivery import INPUTS, MOST_ORDER, Shape

_MOST_PIECES = 200
_OF_A_MOMENT = tuple(name for name in INPUTS if name not in {"rate", "acceleration"})
"""Channels that a unit has beside its output."""
_REASONS = {
    "aging": "it depends on the time since the start of the run, which a unit does not have",
    "warm_up": "it depends on the time since power-on in one run",
    "bias_jump": "it occurred once in one run",
    "compressor": "it is caused by the chamber's compressor, not by the unit",
    "frost": "it is caused by humidity, not by the unit; dry the chamber instead",
}


@dataclass(frozen=True)
class Part:
    """One block over one or two channels; `n` is its order, or its number of pieces.

    `terms` are the amplitudes of a formula that it holds; empty: the block is a part of the whole effect.
    """

    shape: Shape
    channels: tuple[str, ...]
    n: int
    terms: tuple[int, ...] = ()


def channels_of(effect: Effect) -> tuple[str, ...]:
    """Channels that the effect's columns are a function of."""
    if effect.name == "surface":
        return (str(getattr(effect, "over", "applied_rate")), "temperature")
    return effect.needs


_BEHIND = re.compile(r"temperature - lag\(temperature, [\w.]+\)")
"""How far the temperature is ahead of its lag: `temperature_rate` without its factors."""


class UndeliverableError(InputError):
    """No unit can evaluate an effect; `why` is the reason alone."""

    def __init__(self, effect: str, why: str) -> None:
        super().__init__(f"{effect}: cannot be delivered: {why}; leave it out of the delivered model")
        self.why = why


def parts_of(effect: Effect) -> tuple[Part, ...]:
    """Blocks whose sum is the effect; InputError for an effect without such blocks."""
    if isinstance(effect, Expression):
        return _of_formula(effect)
    order, temperature = int(getattr(effect, "order", 0)), ("temperature",)
    forms: dict[str, tuple[Part, ...]] = {
        "polynomial": (Part(Shape.SERIES, temperature, order),),
        "resonance_frequency": (Part(Shape.SERIES, ("frequency",), order),),
        "drive_amplitude": (Part(Shape.SERIES, ("drive",), order),),
        "supply_voltage": (Part(Shape.SERIES, ("supply",), 1),),
        "regression": tuple(Part(Shape.SERIES, (channel,), order) for channel in effect.needs),
        "quadrature_leakage": (Part(Shape.SURFACE, ("quadrature", "temperature"), 2),),
        "surface": (Part(Shape.SURFACE, channels_of(effect), order),),
        "scale_factor": (Part(Shape.SURFACE, (*effect.needs, *temperature), 1),),
        "scale_factor_temperature": (Part(Shape.SURFACE, effect.needs, order + 1),),
        "scale_factor_nonlinearity": (Part(Shape.SURFACE, (*effect.needs, *temperature), order),),
        "spline": (Part(Shape.SPLINE, temperature, getattr(effect, "intervals", 1)),),
        "bias_kink": (Part(Shape.SPLINE, temperature, _MOST_PIECES),),
    }
    if effect.name not in forms:
        reason = _REASONS.get(effect.name, "this effect cannot be represented in the image")
        raise UndeliverableError(effect.name, reason)
    return forms[effect.name]


def _of_formula(effect: Expression) -> tuple[Part, ...]:
    """A block for the terms of the same channels; InputError for a term that needs more than one moment of two."""
    terms: dict[tuple[str, ...], list[int]] = {}
    for i, factor in enumerate(effect.parsed.factors):
        read = effect.parsed.read_by(factor)
        if len(read) > 2 or not set(read) <= set(_OF_A_MOMENT):
            if _BEHIND.fullmatch(term := ast.unparse(factor)):
                why = f"a unit takes '{term}' only as the effect temperature_rate with `filter_s`, which is the same "
                why += "but for a factor"
                raise UndeliverableError("expression", why)
            why = f"a unit evaluates terms of one or two of {', '.join(_OF_A_MOMENT)}, each at one moment, and "
            raise UndeliverableError("expression", f"{why}'{term}' needs {', '.join(read)}")
        terms.setdefault(read, []).append(i)
    forms = {1: (Shape.SPLINE, _MOST_PIECES), 2: (Shape.SURFACE, MOST_ORDER)}
    return tuple(Part(forms[len(read)][0], read, forms[len(read)][1], tuple(own)) for read, own in terms.items())
