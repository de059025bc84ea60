"""Units of other people's columns, by pint: a factor and an offset into the unit of a channel."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache
from typing import Any

from bench.base import CHANNELS, FloatArray, InputError

_SPELLINGS = {
    "c": "degC", "°c": "degC", "℃": "degC", "deg_c": "degC", "celsius": "degC",
    "f": "degF", "°f": "degF", "k": "kelvin",
    "dph": "degree/hour", "dps": "degree/second", "mdps": "millidegree/second", "udps": "microdegree/second",
    "radps": "radian/second", "rads": "radian/second", "rad_s": "radian/second", "urad/s": "microradian/second",
    "deg_h": "degree/hour", "deg_hr": "degree/hour", "deg/hr": "degree/hour", "deg_s": "degree/second",
    "mv": "millivolt", "v": "volt", "uv": "microvolt", "hz": "hertz", "khz": "kilohertz", "mhz": "",
    "s": "second", "sec": "second", "ms": "millisecond", "us": "microsecond", "ns": "nanosecond", "min": "minute",
    "h": "hour", "hr": "hour", "grad": "", "grad/s": "", "grad/h": "", "grad/sec": "", "grad/min": "", "grad_s": "",
}  # fmt: skip
"""Spellings of the trade where pint reads something else (C is coulomb to it) or nothing; "" is ambiguous."""

_MEANINGS = {"grad": ": degree, or gon, the 400th part of a turn (gon/s)", "mhz": ": mHz or MHz"}

_TARGETS = {"degC": "degC", "deg/h": "degree/hour", "deg/s": "degree/second", "Hz": "hertz", "V": "volt", "s": "second"}


@dataclass(frozen=True)
class Conversion:
    """value [channel's unit] = factor * value [given unit] + offset."""

    factor: float = 1.0
    offset: float = 0.0

    def __call__(self, values: FloatArray) -> FloatArray:
        """Values in the channel's unit, shape of the input."""
        return values * self.factor + self.offset


def conversion(unit: str, channel: str) -> Conversion:
    """From `unit` into the unit of `channel`; InputError when it is unknown or measures something else."""
    target = CHANNELS[channel].unit
    if unit in {target, ""} or target == "0/1":
        return Conversion()
    registry = _registry()
    goal = registry.Unit(_TARGETS[target])
    given = _parse(unit)
    if given is None and _SPELLINGS.get(unit.lower()) == "":
        raise InputError(f"'{unit}' has two meanings{_MEANINGS.get(unit.lower()[:4], '')}; {channel} may be in "
                         f"{', '.join(examples(channel))}")  # fmt: skip
    if given is None:
        raise InputError(f"'{unit}' is not a unit that is known; {channel} may be in {', '.join(examples(channel))}")
    # Roots, not dimensions: the radian has none, and would let Hz pass for a rate.
    if registry.get_root_units(given)[1] != registry.get_root_units(goal)[1]:
        raise InputError(f"'{unit}' does not measure {channel}; it may be in {', '.join(examples(channel))}")
    zero = float(registry.Quantity(0.0, given).to(goal).magnitude)
    large = float(registry.Quantity(1e6, given).to(goal).magnitude)
    return Conversion((large - zero) / 1e6, zero)  # far from the offset: keeps all digits


def is_unit(text: str) -> bool:
    """The text is the unit of some channel."""
    if text.lower() in _SPELLINGS:
        return _SPELLINGS[text.lower()] != "" or text == "MHz"
    return bool(re.fullmatch(r"[a-zA-Zµμ°]+(/[a-zA-Z]+)?", text)) and ("/" in text or text in {"degC", "degF", "K"})


def examples(channel: str) -> tuple[str, ...]:
    """Units that a channel is usually given in."""
    known = {
        "deg/h": ("deg/h", "deg/s", "mdps", "rad/s"),
        "deg/s": ("deg/h", "deg/s", "mdps", "rad/s"),
        "degC": ("degC", "K", "degF"),
        "s": ("s", "ms", "us", "ns", "min", "h"),
        "Hz": ("Hz", "kHz"),
        "V": ("V", "mV"),
    }
    return known.get(CHANNELS[channel].unit, ("0/1",))


def _parse(unit: str) -> Any:
    """Pint's unit, or None."""
    spelled = _SPELLINGS.get(unit.lower(), unit.replace("°", "deg"))
    if unit == "MHz":
        spelled = "megahertz"
    try:
        return _registry().Unit(spelled) if spelled else None
    except Exception:  # pint, its parser and its tokenizer fail in many ways at text that is no unit
        return None


@cache
def _registry() -> Any:
    """Loaded on first use: it takes a second."""
    import pint

    return pint.UnitRegistry(autoconvert_offset_to_baseunit=True)
