"""Numbers and lists as people read them: a value to the digits that its uncertainty leaves it; a, b and c."""

from __future__ import annotations

from collections.abc import Sequence
from math import floor, isfinite, log10


def finite(value: float) -> float | None:
    """The number, for JSON and for what leaves a gap; None where it does not exist."""
    return float(value) if isfinite(value) else None


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


def with_uncertainty(value: float, uncertainty: float) -> tuple[str, str]:
    """Value and standard uncertainty [same unit], both to the last of two significant digits of the uncertainty."""
    if not (isfinite(value) and isfinite(uncertainty) and uncertainty > 0):
        return number(value, 6), number(uncertainty, 2)
    last = floor(log10(uncertainty)) - 1
    size = floor(log10(abs(value))) if value else last
    if max(size, last) < 6 and last >= -6:
        decimals = max(0, -last)
        return f"{value:.{decimals}f}", f"{uncertainty:.{decimals}f}"
    return f"{value:.{max(0, size - last)}e}", f"{uncertainty:.1e}"


def listed(names: Sequence[str]) -> str:
    """Names as a sentence lists them."""
    return " and ".join(filter(None, [", ".join(names[:-1]), *names[-1:]]))
