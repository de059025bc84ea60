"""Fields of a text table as numbers: decimal points or commas, dates and times of day, gaps."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from bench.base import FloatArray

if TYPE_CHECKING:
    import pandas as pd

GAPS = ("", "nan", "na", "n/a", "null", "none", "-nan", "#n/a", "#nv", "-", "--", "---")
"""What stands where there is no value, in small letters."""
_ON, _OFF = ("on", "true", "yes"), ("off", "false", "no")
_SHOWN = 60
"""Characters of a value in a message."""
_COMMA = r"[+-]?\d+(,\d+)?([eE][+-]?\d+)?"
_THOUSANDS = r"[+-]?\d{1,3}([,'’\s]\d{3})+([.,]\d*)?|[+-]?\d{1,3}(\.\d{3})+(,\d*)?"
_CLOCK = r"\d{1,2}:\d{2}(:\d{2}([.,]\d+)?)?"
_ISO = rf"\d{{4}}-\d{{2}}-\d{{2}}[T ]{_CLOCK}|\d{{8}}T\d{{4,6}}([.,]\d+)?"
_DATE = r"\d{4}-\d{2}-\d{2}|\d{1,2}[./]\d{1,2}[./]\d{4}"
_ZONE = r"\s?(Z|[+-]\d{2}:?\d{2})"
_DOTS = rf"\d{{1,2}}\.\d{{1,2}}\.\d{{4}}[ T]{_CLOCK}"
_SLASHES = rf"(\d{{1,2}})/(\d{{1,2}})/\d{{4}} {_CLOCK}( ?[AaPp][Mm])?"
_LIKE_A_TIME = r"\d+[-./]\d+[-./]\d+|\d{1,2}:\d{2}"
_DAY_S = 86400.0


@dataclass(frozen=True, eq=False)
class Column:
    """A column as numbers (n,), NaN in gaps; or None, the `reason` and the `row` of the first that is none."""

    values: FloatArray | None
    unit: str = ""
    notes: tuple[str, ...] = ()
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
    texts = pc.replace_substring(texts, "\N{MINUS SIGN}", "-")
    try:
        return Column(texts.cast(pa.float64()).to_numpy())
    except pa.ArrowInvalid:
        pass
    whole = pc.match_substring_regex(texts, f"^{_COMMA}$")
    if pc.all(whole).as_py():
        points = pc.replace_substring(texts, ",", ".")
        return Column(points.cast(pa.float64()).to_numpy(), notes=("its decimal commas were read as points",))
    lower = pc.utf8_lower(texts)
    on = pc.is_in(lower, pa.array(_ON))
    if pc.all(pc.or_(on, pc.is_in(lower, pa.array((None, *_OFF))))).as_py():
        switched = pc.if_else(pc.is_null(texts), None, on.cast(pa.float64()))
        return Column(switched.to_numpy(), notes=(f"'{name}' was read as 1 and 0 (on and off)",))
    return _times(name, texts.to_pandas()) or _no_numbers(name, texts.to_pylist())


def joined_dates(names: list[str], columns: list[Any]) -> tuple[list[str], list[Any]]:
    """The same with a column of dates put before the times of day of another one, where there is one of each."""
    import pyarrow as pa
    import pyarrow.compute as pc

    found: dict[str, list[int]] = {_DATE: [], _CLOCK: []}
    for at, column in enumerate(columns):
        if pa.types.is_string(column.type):
            first = next((text for text in column.slice(0, 1).to_pylist() if text), "").strip()
            found = {like: [*where, *[at] * bool(re.fullmatch(like, first))] for like, where in found.items()}
    if any(len(where) != 1 for where in found.values()):
        return names, columns
    date, clock = found[_DATE][0], found[_CLOCK][0]
    both = pc.binary_join_element_wise(*(pc.utf8_trim_whitespace(columns[at]) for at in (date, clock)), " ")
    joined = [both if at == clock else column for at, column in enumerate(columns)]
    return [name for at, name in enumerate(names) if at != date], [c for at, c in enumerate(joined) if at != date]


def _times(name: str, texts: pd.Series[Any]) -> Column | None:
    """Times in seconds since the first; None where the first value is none."""
    import pandas as pd

    first = next(iter(texts.dropna()), "")
    zoned = re.fullmatch(f"({_ISO}){_ZONE}", first) is not None
    notes = [f"'{name}' begins at {first.strip()}"]
    if not zoned:
        notes.append(f"'{name}' has no time zone: its clock must not change to or from summer time in the record")
    plain = texts.str.replace(",", ".", regex=False)
    if zoned or re.fullmatch(_ISO, first):
        moments = pd.to_datetime(plain, format="ISO8601", utc=zoned, errors="coerce")
        if zoned:  # without their zone others would pass for UTC
            moments = moments.where(plain.str.fullmatch(f".*{_ZONE}").fillna(False).astype(bool))
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
        return _checked(name, texts, _past_midnight(np.asarray(clock.dt.total_seconds(), np.float64)), notes)
    else:
        return None
    return _checked(name, texts, np.asarray((moments - moments.dropna().iloc[0]).dt.total_seconds(), np.float64), notes)


def _checked(name: str, texts: pd.Series[Any], seconds: FloatArray, notes: Sequence[str]) -> Column:
    wrong = np.flatnonzero(np.isnan(seconds) & texts.notna().to_numpy())
    if wrong.size:
        reason = f"'{name}' is '{_short(texts.iloc[wrong[0]])}', no time as in the rows before"
        return Column(None, reason=reason, row=int(wrong[0]))
    return Column(np.array(seconds, dtype=np.float64), "s", tuple(notes))


def _past_midnight(seconds: FloatArray) -> FloatArray:
    """Times of day [s] as a clock that goes on after midnight."""
    steps = np.diff(seconds, prepend=seconds[:1])
    return np.asarray(seconds + _DAY_S * np.cumsum(np.nan_to_num(steps) < -0.5 * _DAY_S))


def _no_numbers(name: str, texts: list[str | None]) -> Column:
    wrong = [i for i, text in enumerate(texts) if text is not None and number(text) is None]
    row = next((i for i in wrong if re.fullmatch(_COMMA, texts[i] or "") is None), wrong[0])
    shown = texts[row] or ""
    reason = f"'{name}' is '{_short(shown)}', not a number"
    if number(shown.replace(",", ".")) is not None:
        reason += ": decimal commas in some rows and points in others; export with one of them"
    elif re.fullmatch(_THOUSANDS, shown):
        reason += ": separators of thousands? export without them"
    elif re.match(_LIKE_A_TIME, shown):
        reason = f"'{name}' is '{_short(shown)}', no time as it is known; export times as 2026-01-31T14:00:00+01:00"
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
