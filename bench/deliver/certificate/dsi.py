r"""Units as the D-SI 2.1 writes them (PTB; BIPM SI brochure): deg/h/degC is \degree\hour\tothe{-1}\kelvin\tothe{-1}."""

from __future__ import annotations

import re

_NAMES = {
    "deg": r"\degree",
    "h": r"\hour",
    "min": r"\minute",
    "s": r"\second",
    "degC": r"\kelvin",
    "V": r"\volt",
    "Hz": r"\hertz",
    "m": r"\metre",
    "mrad": r"\milli\radian",
    "ppm": r"\ppm",
    "%": r"\percent",
}
"""A difference of temperatures is in kelvin; a temperature by itself is in degrees Celsius."""
_ALONE = {"1": r"\one", "degC": r"\degreecelsius"}
_FACTOR = re.compile(r"(sqrt\()?(deg|degC|h|min|s|V|Hz|mrad|m|ppm|%)\)?(?:\^(\d+))?")
_SUFFIXES = {
    "dph": "deg/h",
    "dps": "deg/s",
    "degc": "degC",
    "percent": "%",
    "ppm": "ppm",
    "s": "s",
    "min": "min",
    "dprh": "deg/sqrt(h)",
    "dphrh": "deg/h/sqrt(h)",
}


def dsi(unit: str) -> str | None:
    """The unit in D-SI; None where it is not one of those that the bench knows."""
    if unit in _ALONE:
        return _ALONE[unit]
    written = ""
    for i, group in enumerate(unit.split(" per ")):
        for k, text in enumerate(group.split("/")):
            found = _FACTOR.fullmatch(text)
            if found is None:
                return None
            power = float(found[3] or 1) / (2 if found[1] else 1) * (-1 if k else 1) * (-1 if i else 1)
            written += _NAMES[found[2]] + ("" if power == 1 else f"\\tothe{{{power:g}}}")
    return written


def unit_of(key: str) -> str:
    """Unit that the end of a key names, as in `span_dph`; 1 where it names none."""
    return _SUFFIXES.get(key.rpartition("_")[2], "1") if "_" in key else "1"
