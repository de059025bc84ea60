"""Which channels an effect without memory is a function of, and which block follows it exactly."""

from __future__ import annotations

from dataclasses import dataclass

from bench.analysis import Effect
from bench.base import InputError
from bench.deliver.export.delivery import Shape

_MOST_PIECES = 200
_REASONS = {
    "aging": "it follows the time since the run began, which a unit does not know",
    "warm_up": "it follows the time since power-on of one run",
    "bias_jump": "it happened at one time of one run; it calibrates nothing",
    "compressor": "it is the chamber's compressor, which the unit leaves behind",
    "frost": "it comes with humidity, not with the unit; dry the chamber instead",
    "expression": "a formula of your own has no form in the image",
}


@dataclass(frozen=True)
class Part:
    """One block over one or two channels; `n` is its order, or its number of pieces."""

    shape: Shape
    channels: tuple[str, ...]
    n: int


def channels_of(effect: Effect) -> tuple[str, ...]:
    """Channels that the effect's columns are a function of."""
    if effect.name == "surface":
        return (str(getattr(effect, "over", "applied_rate")), "temperature")
    return effect.needs


def parts_of(effect: Effect) -> tuple[Part, ...]:
    """Blocks whose sum is the effect; InputError where there are none."""
    order, temperature = int(getattr(effect, "order", 0)), ("temperature",)
    forms: dict[str, tuple[Part, ...]] = {
        "polynomial": (Part(Shape.SERIES, temperature, order),),
        "resonance_frequency": (Part(Shape.SERIES, ("frequency",), order),),
        "drive_amplitude": (Part(Shape.SERIES, ("drive",), order),),
        "supply_voltage": (Part(Shape.SERIES, ("supply",), 1),),
        "regression": tuple(Part(Shape.SERIES, (channel,), order) for channel in effect.needs),
        "quadrature_leakage": (Part(Shape.SURFACE, ("quadrature", "temperature"), 2),),
        "surface": (Part(Shape.SURFACE, channels_of(effect), order),),
        "scale_factor_temperature": (Part(Shape.SURFACE, effect.needs, order + 1),),
        "scale_factor_nonlinearity": (Part(Shape.SURFACE, (*effect.needs, *temperature), order),),
        "spline": (Part(Shape.SPLINE, temperature, getattr(effect, "intervals", 1)),),
        "bias_kink": (Part(Shape.SPLINE, temperature, _MOST_PIECES),),
    }
    if effect.name not in forms:
        reason = _REASONS.get(effect.name, "an effect of your own has no form in the image")
        raise InputError(f"{effect.name}: cannot be delivered: {reason}; leave it out of the delivered model")
    return forms[effect.name]
