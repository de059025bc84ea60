"""Units as data sheets, DBC files and tables of laboratories spell them: a factor and an offset, by pint."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.errors import ConfigError

USUAL: Mapping[str, tuple[str, ...]] = {
    "deg/h": ("deg/h", "deg/s", "mdps", "rad/s"),
    "deg/s": ("deg/h", "deg/s", "mdps", "rad/s"),
    "m/s^2": ("m/s^2", "g", "mg"),
    "degC": ("degC", "K", "degF"),
    "s": ("s", "ms", "us", "ns", "min", "h"),
    "Hz": ("Hz", "kHz"),
    "V": ("V", "mV"),
    "A": ("A", "mA"),
    "ohm": ("ohm", "kohm"),
    "hPa": ("hPa", "kPa", "bar"),
    "%": ("%",),
}
"""Units that a quantity is usually given in, by the unit that the bench keeps it in."""

_SPELLINGS = {
    "c": "degC", "°c": "degC", "deg_c": "degC", "degc": "degC", "celsius": "degC",
    "gradc": "degC", "grad_c": "degC", "gradcelsius": "degC",
    "f": "degF", "°f": "degF", "degf": "degF", "k": "kelvin", "deg/s": "degree/second", "°/s": "degree/second",
    "deg/h": "degree/hour", "°/h": "degree/hour", "rad/s": "radian/second",
    "dph": "degree/hour", "dps": "degree/second", "mdps": "millidegree/second", "udps": "microdegree/second",
    "radps": "radian/second", "rads": "radian/second", "rad_s": "radian/second", "urad/s": "microradian/second",
    "deg_h": "degree/hour", "deg_hr": "degree/hour", "deg/hr": "degree/hour", "deg_s": "degree/second",
    "mv": "millivolt", "v": "volt", "uv": "microvolt", "hz": "hertz", "khz": "kilohertz", "mhz": "",
    "s": "second", "sec": "second", "ms": "millisecond", "us": "microsecond", "ns": "nanosecond", "min": "minute",
    "mps2": "meter/second**2", "m_s2": "meter/second**2", "m/s2": "meter/second**2", "m/s/s": "meter/second**2",
    "h": "hour", "hr": "hour", "grad": "", "grad/s": "", "grad/h": "", "grad/sec": "", "grad/min": "", "grad_s": "",
}  # fmt: skip
"""Spellings of the trade where pint reads something else (C is coulomb to it) or nothing; "" is ambiguous."""
_WORDS = {
    "deg": "град 度", "s": "с сек 秒", "ms": "мс 毫秒", "us": "мкс 微秒", "min": "хв мин 分", "h": "год ч 小时",
    "rad": "рад 弧度", "degC": "摄氏度", "degF": "华氏度", "K": "к 开", "V": "в 伏", "mV": "мв 毫伏", "Hz": "гц 赫兹",
}  # fmt: skip
_WORD = {word: latin for latin, words in _WORDS.items() for word in words.split()}
"""Units as they are written in Ukrainian, Russian and Chinese."""
_FOREIGN = re.compile(r"[\u0400-\u04ff]+|[\u4e00-\u9fff]+")
_PER = re.compile(r"(\S+?)(?:\s*[*·.]\s*|\s+)([^\W\d]+)(?:\^|\*\*)?\(?[-−⁻]([1-9¹²³])\)?")
"""A product with a negative power, such as deg s-1, °·s⁻¹ or m s^-2."""
_SIGNS = re.compile(r"[\w°µ/*^()·⁻¹²³%. -]+")
"""What units consist of; pint leaves out other signs, and would read °/√h as °/h."""

_PLAIN = {"degC", "degF", "K", "mA", "ohm", "kohm", "Pa", "hPa", "kPa", "mbar", "bar", "%"}
"""Units that end a header behind an underscore; A and g are letters of names as well."""
_FORCES = {"g": "standard_gravity", "mg": "millistandard_gravity", "ug": "microstandard_gravity", "m/s²": "m/s^2"}
"""Spellings of accelerations; the gram is none."""
_MEANINGS = {"grad": ": degree, or gon, the 400th part of a turn (gon/s)", "mhz": ": mHz or MHz"}
_GOALS = {"degC": "degC", "deg/h": "degree/hour", "deg/s": "degree/second", "Hz": "hertz", "V": "volt", "s": "second",
          "m/s^2": "meter/second**2", "A": "ampere", "ohm": "ohm", "hPa": "hectopascal", "%": "percent"}  # fmt: skip
_AT_ONCE = {("deg/s", "deg/h"): 3600.0, ("rad/s", "deg/h"): 3600.0 * 180.0 / np.pi, ("mV", "V"): 1e-3,
            ("kHz", "Hz"): 1e3, ("g", "m/s^2"): 9.80665, ("mg", "m/s^2"): 9.80665e-3, ("m/s²", "m/s^2"): 1.0,
            ("ms", "s"): 1e-3, ("us", "s"): 1e-6, ("µs", "s"): 1e-6, ("ns", "s"): 1e-9}  # fmt: skip
"""Factors that need no pint, which takes a second to load."""


@dataclass(frozen=True)
class Conversion:
    """value [kept unit] = factor * value [given unit] + offset."""

    factor: float = 1.0
    offset: float = 0.0

    def __call__(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Values in the unit that is kept, shape of the input."""
        return values * self.factor + self.offset


@lru_cache(maxsize=1000)  # every reading of an instrument asks, and pint would parse the same unit again
def conversion(unit: str, kept: str, what: str) -> Conversion:
    """From `unit` into one of `USUAL`; ConfigError, which names `what`, for an unknown one or one of something else."""
    spelled, unit = unit, _usual(unit)
    if unit in {kept, ""}:
        return Conversion()
    if (unit, kept) in _AT_ONCE:
        return Conversion(_AT_ONCE[unit, kept])
    given, allowed = _parse(unit, kept), ", ".join(USUAL[kept])
    if given is None and _SPELLINGS.get(_plain(unit)) == "":
        raise ConfigError(
            f"'{spelled}' has two meanings{_MEANINGS.get(unit.lower()[:4], '')}; {what} may be in {allowed}"
        )
    if given is None:
        raise ConfigError(f"'{spelled}' is not a unit that is known; {what} may be in {allowed}")
    registry = _registry()
    goal = registry.Unit(_GOALS[kept])
    # Roots, not dimensions: the radian has none, and would let Hz pass for a rate.
    if registry.get_root_units(given)[1] != registry.get_root_units(goal)[1]:
        raise ConfigError(f"'{spelled}' does not measure {what}; it may be in {allowed}")
    zero = float(registry.Quantity(0.0, given).to(goal).magnitude)
    large = float(registry.Quantity(1e6, given).to(goal).magnitude)
    return Conversion((large - zero) / 1e6, zero)  # far from the offset: keeps all digits


def is_unit(text: str) -> bool:
    """The text is the unit of something that the bench keeps."""
    text = _usual(text)
    if _plain(text) in _SPELLINGS:
        return _SPELLINGS[_plain(text)] != "" or text == "MHz"
    return text in _PLAIN or bool(re.fullmatch(r"[a-zA-Zµμ°]+/[a-zA-Z]+", text))


def _parse(unit: str, kept: str) -> Any:
    """Pint's unit, or None."""
    own = _FORCES if kept == "m/s^2" else {}
    spelled = own.get(unit.lower()) or _SPELLINGS.get(_plain(unit), unit.replace("°", "deg"))
    if unit == "MHz":
        spelled = "megahertz"
    if not _SIGNS.fullmatch(unit):
        return None
    try:
        return _registry().Unit(spelled) if spelled else None
    except Exception:  # pint, its parser and its tokenizer fail in many ways at text that is no unit
        return None


def _usual(unit: str) -> str:
    """The same in Latin letters, with a slash before what it is divided by."""
    # A DBC in UTF-8 may be read as Windows-1252; keyboards have other signs that look like that of the degree.
    unit = re.sub("Â°|º|˚", "°", unit.strip(" ").replace("℃", "°C").replace("℉", "°F"))
    unit = re.sub("° ?[Сс](?![\u0400-\u04ff])", "°C", unit)  # a Cyrillic letter that looks like that of Celsius
    unit = _FOREIGN.sub(lambda found: _WORD.get(found[0].lower(), found[0]), unit)
    product = _PER.fullmatch(unit)
    if product is None:
        return unit
    power = product[3].translate(str.maketrans("¹²³", "123"))
    return f"{product[1]}/{product[2]}" + ("" if power == "1" else f"^{power}")


def _plain(unit: str) -> str:
    """As the spellings of the trade are listed."""
    return re.sub(r"\s", "", unit.lower())


@cache
def _registry() -> Any:
    """Loaded on first use: it takes a second."""
    import pint

    return pint.UnitRegistry(autoconvert_offset_to_baseunit=True)
