"""Numbers and lists as people read them: a value to the digits that its uncertainty leaves it; a, b and c."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from math import floor, isfinite, log10


def finite(value: float, decimals: int | None = None) -> float | None:
    """The number (to so many decimals), for JSON and for what leaves a gap; None where it does not exist."""
    if not isfinite(value):
        return None
    return float(value) if decimals is None else round(float(value), decimals)


def number(value: float | None, digits: int = 3) -> str:
    """A measured value to significant digits, a dash where there is none."""
    if value is None or not isfinite(value):
        return "–"
    if value == 0:
        return "0"
    exponent = floor(log10(abs(value)))
    if not -4 <= exponent < 7:
        return f"{value:.{digits - 1}e}"
    return f"{value:.{max(0, digits - 1 - exponent)}f}"


def measured(value: float | None, high: float | None) -> str:
    """A measured value that cannot be negative; where the data do not tell it from zero, what it is below (95 %)."""
    undetermined = value == 0 and high is not None and isfinite(high) and high > 0
    return f"below {number(high, 2)}" if undetermined else number(value)


def ends(low: float, high: float, digits: int = 3) -> tuple[str, str]:
    """Both ends of a range to as many significant digits as tell them apart."""
    span, largest = abs(high - low), max(abs(low), abs(high))
    if isfinite(span) and span > 0:
        digits = max(digits, min(15, floor(log10(largest)) - floor(log10(span)) + 2))
    return number(low, digits), number(high, digits)


def bound(value: float | None) -> str:
    """An end of a range; an ellipsis for an open one."""
    return "…" if value is None else f"{value:g}"


def with_uncertainty(value: float, uncertainty: float) -> tuple[str, str]:
    """Value and standard uncertainty [same unit], both to the last of two significant digits of the uncertainty."""
    if value == 0 and uncertainty == 0:
        return "0 (by constraint)", "–"
    if not (isfinite(value) and isfinite(uncertainty) and uncertainty > 0):
        return number(value, 6), number(uncertainty, 2)
    last = floor(log10(uncertainty)) - 1
    size = floor(log10(abs(value))) if value else last
    if max(size, last) < 6 and last >= -6:
        decimals = max(0, -last)
        return f"{value:.{decimals}f}", f"{uncertainty:.{decimals}f}"
    return f"{value:.{max(0, size - last)}e}", f"{uncertainty:.1e}"


def capital(text: str) -> str:
    """A text as a sentence begins."""
    return text[:1].upper() + text[1:]


def listed(names: Sequence[str]) -> str:
    """Names as a sentence lists them."""
    return " and ".join(filter(None, [", ".join(names[:-1]), *names[-1:]]))


_IN_PRINT = (("degC", "°C"), ("sqrt(h)", "√h"), ("^2", "²"), ("^3", "³"), ("^4", "⁴"), ("^5", "⁵"))


def in_print(unit: str) -> str:
    """A unit as people write it: deg/h/degC^2 is deg/h/°C²."""
    for code, sign in _IN_PRINT:
        unit = unit.replace(code, sign)
    return unit


def moment(created: object) -> str:
    """A date of a manifest (ISO 8601) to the minute in UTC; as it is where it is none."""
    try:
        at = datetime.fromisoformat(str(created))
    except ValueError:
        return str(created)
    return f"{at:%Y-%m-%d %H:%M}" if at.tzinfo is None else f"{at.astimezone(UTC):%Y-%m-%d %H:%M} UTC"


def clock(seconds: float) -> str:
    """A duration as h:mm:ss."""
    if not isfinite(seconds):
        return "–"
    whole = round(seconds)
    return f"{whole // 3600}:{whole // 60 % 60:02d}:{whole % 60:02d}"


def counted(number: int, what: str) -> str:
    """`1 unit`, `2 units`: a number of things whose plural ends in s."""
    return f"{number:,} {what}{'' if number == 1 else 's'}"
