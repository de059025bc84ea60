"""Fields of a text table as numbers: decimal points or commas, dates and times of day, gaps."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from bench.base import FloatArray

if TYPE_CHECKING:
    import pandas as pd

GAPS = ("", "nan", "na", "n/a", "null", "none", "-nan", "#n/a", "#nv", "-", "--", "---")
"""What stands where there is no value, in small letters."""
_SHOWN = 60
"""Characters of a value in a message."""
_COMMA = r"[+-]?\d+(,\d+)?([eE][+-]?\d+)?"
_THOUSANDS = r"[+-]?\d{1,3}([,' ]\d{3})+(\.\d*)?|[+-]?\d{1,3}(\.\d{3})+(,\d*)?"
_CLOCK = r"\d{1,2}:\d{2}(:\d{2}([.,]\d+)?)?"
_ISO = rf"\d{{4}}-\d{{2}}-\d{{2}}[T ]{_CLOCK}"
_ZONE = r"\s?(Z|[+-]\d{2}:?\d{2})"
_DOTS = rf"\d{{1,2}}\.\d{{1,2}}\.\d{{4}}[ T]{_CLOCK}"
_SLASHES = rf"(\d{{1,2}})/(\d{{1,2}})/\d{{4}} {_CLOCK}( ?[AaPp][Mm])?"
_DAY_S = 86400.0


@dataclass(frozen=True, eq=False)
class Column:
    """A column as numbers (n,), NaN in gaps; or None, the `reason` and the `row` of the first that is none."""

    values: FloatArray | None
    unit: str = ""
    note: str = ""
    reason: str = ""
    row: int = 0


def numbers(name: str, column: Any) -> Column:
    """Numbers of an Arrow column of numbers or texts; dates and times of day in seconds since the first."""
    import pyarrow as pa

    if pa.types.is_floating(column.type):
        return Column(column.to_numpy())
    import pyarrow.compute as pc  # takes memory, which a plain table does not need

    texts = pc.utf8_trim_whitespace(column)
    texts = pc.if_else(pc.is_in(pc.utf8_lower(texts), pa.array(GAPS)), None, texts)
    try:
        return Column(texts.cast(pa.float64()).to_numpy())
    except pa.ArrowInvalid:
        pass
    whole = pc.match_substring_regex(texts, f"^{_COMMA}$")
    if pc.all(whole).as_py():
        points = pc.replace_substring(texts, ",", ".")
        return Column(points.cast(pa.float64()).to_numpy(), note="its decimal commas were read as points")
    return _times(name, texts.to_pandas()) or _no_numbers(name, texts.to_pylist())


def _times(name: str, texts: pd.Series[Any]) -> Column | None:
    """Times in seconds since the first; None where the first value is none."""
    import pandas as pd

    first = next(iter(texts.dropna()), "")
    zoned = re.fullmatch(_ISO + _ZONE, first) is not None
    note = "" if zoned else f"'{name}' has no time zone: its clock must not change to or from summer time in the record"
    plain = texts.str.replace(",", ".", regex=False)
    if zoned or re.fullmatch(_ISO, first):
        moments = pd.to_datetime(plain, format="ISO8601", utc=zoned, errors="coerce")
    elif re.fullmatch(_DOTS, first):
        moments = pd.to_datetime(plain, format="mixed", dayfirst=True, errors="coerce")
    elif re.fullmatch(_SLASHES, first):
        parts = texts.str.extract(r"^(\d+)/(\d+)/").astype(float).max()
        if (parts > 12).sum() != 1:
            reason = f"'{name}' is '{first}': the day or the month first? export times as 2026-01-31 14:00:00"
            return Column(None, reason=reason)
        moments = pd.to_datetime(plain, format="mixed", dayfirst=bool(parts[0] > 12), errors="coerce")
    elif re.fullmatch(_CLOCK, first):
        clock = pd.to_timedelta(plain.where(plain.str.count(":") == 2, plain + ":00"), errors="coerce")
        return _checked(name, texts, _past_midnight(np.asarray(clock.dt.total_seconds(), np.float64)), "")
    else:
        return None
    return _checked(name, texts, np.asarray((moments - moments.dropna().iloc[0]).dt.total_seconds(), np.float64), note)


def _checked(name: str, texts: pd.Series[Any], seconds: FloatArray, note: str) -> Column:
    wrong = np.flatnonzero(np.isnan(seconds) & texts.notna().to_numpy())
    if wrong.size:
        reason = f"'{name}' is '{_short(texts.iloc[wrong[0]])}', no time as in the rows before"
        return Column(None, reason=reason, row=int(wrong[0]))
    return Column(np.array(seconds, dtype=np.float64), "s", note)


def _past_midnight(seconds: FloatArray) -> FloatArray:
    """Times of day [s] as a clock that goes on after midnight."""
    steps = np.diff(seconds, prepend=seconds[:1])
    return np.asarray(seconds + _DAY_S * np.cumsum(np.nan_to_num(steps) < -0.5 * _DAY_S))


def _no_numbers(name: str, texts: list[str | None]) -> Column:
    row = next(i for i, text in enumerate(texts) if text is not None and number(text) is None)
    shown = texts[row] or ""
    reason = f"'{name}' is '{_short(shown)}', not a number"
    if number(shown.replace(",", ".")) is not None:
        reason += ": decimal commas in some rows and points in others; export with one of them"
    elif re.fullmatch(_THOUSANDS, shown):
        reason += ": separators of thousands? export without them"
    elif shown == name:
        reason += ": the header stands again; delete that line"
    else:
        reason += "; leave a field empty where there is no value, and begin a line that is no row with #"
    return Column(None, reason=reason, row=row)


def _short(text: str) -> str:
    return text if len(text) <= _SHOWN else text[:_SHOWN] + "…"


def number(text: str) -> float | None:
    """The number that a text is, if it is one: of ASCII digits, as tables are read."""
    try:
        return float(text) if "_" not in text and text.isascii() else None
    except ValueError:
        return None
