"""Which column of a foreign table is which channel, and in what unit: from a column map, or from obvious headers."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import chain, groupby
from typing import Any

from pydantic import BaseModel, Field, create_model, model_validator

from bench.acquisition.importer.table import Table
from bench.acquisition.importer.units import conversion, examples
from bench.base import CHANNELS, INSTRUMENTS, OUTPUTS, RATES, STRICT, THERMOMETERS, InputError, PlacedError, nearest
from drivers.units import Conversion, is_unit

_SYNONYMS = {
    "time": "time zeit uhrzeit clock t timestamp elapsed seconds timesec timens timems час время 时间 時間",
    "rate": "rate drehrate gyro gyrox gyroy gyroz gx gy gz g omega angularrate rateoutput zro bias wx wy wz ratex "
    "ratey ratez ω ωx ωy ωz кутовашвидкість угловаяскорость 角速度 角速率 зміщення зміщеннянуля смещение "
    "смещениенуля 零偏",
    "temperature": "temperature temperatur temp tmp tgyro gyrotemp tempkreisel tmpkreisel kreiseltemperatur "
    "gyrotemperature temperaturegyro sensortemperature unittemperature температура 温度 溫度",
    "frequency": "frequency freq resonancefrequency resonance drivefrequency f0",
    "drive": "drive driveamplitude antinode excitation amplitude",
    "quadrature": "quadrature quad quadratureamplitude",
    "supply": "supply supplyvoltage vdd vcc vsupply vbat vbatt ubat ubatt",
    "chamber_temperature": "chambertemperature chambertemp tchamber airtemperature chamber air "
    "температуракамери температуракамеры 箱温 温箱温度",
    "chamber_setpoint": "chambersetpoint setpoint",
    "compressor": "compressor",
    "applied_rate": "appliedrate tablerate ratetable referencerate",
}
_INSTRUMENTS = {name.replace("_", ""): name for name in INSTRUMENTS} | {
    "rh": "humidity",
    "relativehumidity": "humidity",
}
_UNITLESS = ("supply", "humidity")
"""Measured by instruments, and known without a unit."""
_BY_WORD = _INSTRUMENTS | {word: channel for channel, words in _SYNONYMS.items() for word in words.split()}
FOREIGN_WORDS = tuple(word for words in _SYNONYMS.values() for word in words.split() if not word.isascii())
"""Headers by which the encoding of a table shows."""
_AXES = {
    f"{word}{axis}": f"{channel}_{axis}"
    for channel, words in {
        "rate": "gyro g w ω rate omega angularrate angularvelocity",
        "acceleration": "acc accel a acceleration accelerometer linearacceleration",
    }.items()
    for word in words.split()
    for axis in "xyz"
}
"""Headers of the axes of a unit that has three."""
_COUNTERS = {"sample", "samples", "samplenumber", "index", "n", "i", "row", "counter", "samplecounter"}


_WIDE = str.maketrans("（）［］【】，／", "()[][],/")
"""Brackets and signs of Chinese keyboards."""


class TimeSource(BaseModel):
    """Where time comes from: a column of times, a column of sample numbers with their interval, or the interval."""

    model_config = STRICT

    column: str | None = None
    """Column of times, or of sample numbers where an interval or a rate is given."""
    unit: str | None = None
    """Unit of a column of times: s, ms, us, ns, min, h."""
    interval_s: float | None = Field(default=None, gt=0)
    """Time from one sample to the next."""
    rate_hz: float | None = Field(default=None, gt=0)
    """Samples in one second."""

    @model_validator(mode="after")
    def _one_way(self) -> TimeSource:
        ways = sum(value is not None for value in (self.unit, self.interval_s, self.rate_hz))
        if ways > 1:
            raise ValueError("give one of unit (a column of times), interval_s or rate_hz")
        if ways == 0 and self.column is None:
            raise ValueError("give a column of times, or interval_s, or rate_hz")
        return self

    @property
    def step_s(self) -> float | None:
        """Interval of the samples [s]; None when the column holds times."""
        return 1.0 / self.rate_hz if self.rate_hz is not None else self.interval_s


class ChannelSource(BaseModel):
    """The column of one channel."""

    model_config = STRICT

    column: str
    """Its name in the table."""
    unit: str | None = None
    """Its unit, such as deg/s, rad/s, mdps, degF, K; left out: as its header says, or the channel's own."""


_SOURCES: dict[str, Any] = {name: (ChannelSource | None, None) for name in CHANNELS if name != "table_angle"}
_Channels = create_model("_Channels", __config__=STRICT, **{**_SOURCES, "time": (TimeSource | None, None)})


class ColumnMap(_Channels):
    """A column map: for every channel of the bench the column of the table that holds it."""

    time: TimeSource | None = None
    encoding: str | None = None
    """Encoding of a text table, such as cp1251, cp1252 or gb18030; left out: UTF-8, UTF-16, or as its words show."""

    @model_validator(mode="after")
    def _encodes(self) -> ColumnMap:
        try:
            "".encode(self.encoding or "utf-8")
        except LookupError:
            text = f"{self.encoding!r} is no encoding; cp1251, cp1252, gb18030, big5, shift_jis and koi8-u are some"
            raise PlacedError(text, ("encoding",)) from None
        return self

    def channel(self, name: str) -> ChannelSource | None:
        """Source of one channel other than time."""
        source: ChannelSource | None = getattr(self, name)
        return source


IMPORTED = tuple(name for name in CHANNELS if name in ColumnMap.model_fields)
"""Channels that a table may hold: `rate` of a unit with one output, or rates and accelerations by axis."""


def column_map(table: Table, columns: Mapping[str, str], units: Mapping[str, str]) -> ColumnMap:
    """Column map from a column's name and a unit by channel, as a program gives them.

    A channel with a unit and without a column takes the column that its header makes obvious. Raises InputError: a
    channel that does not exist, or a unit for a channel that no column is.
    """
    obvious = guess(table)
    for channel in (*columns, *units):
        if channel not in IMPORTED:
            text = f"'{channel}' is not a channel{nearest(channel, IMPORTED)}; known are {', '.join(IMPORTED)}"
            raise InputError(text, table.path)
    unclear = [channel for channel in units if channel not in {**columns, **obvious}]
    if unclear:
        has = ", ".join(table.columns)
        raise InputError(f"no column is {unclear[0]}, which a unit was given for; name one of {has}", table.path)
    named = {channel: columns.get(channel) or obvious[channel] for channel in (*columns, *units)}
    return ColumnMap.model_validate(
        {
            channel: {"column": column, **({"unit": units[channel]} if channel in units else {})}
            for channel, column in named.items()
        }
    )


@dataclass(frozen=True)
class Mapped:
    """One channel as it was understood."""

    channel: str
    column: str
    unit: str
    convert: Conversion
    how: str
    """map, header, or assumed: where the unit comes from."""


@dataclass
class Unclear:
    """What neither a column map nor a header says: by channel a problem and an advice, or a column without a unit."""

    problems: dict[str, tuple[str, str]] = field(default_factory=dict)
    without_unit: dict[str, str] = field(default_factory=dict)

    @property
    def channels(self) -> set[str]:
        """Those whose column or unit nobody said."""
        return {*self.problems, *self.without_unit}

    def texts(self) -> Iterator[tuple[str, str]]:
        """Each problem with its advice; columns that may have the same units are one."""
        yield from self.problems.values()
        for units, channels in groupby(self.without_unit, examples):
            columns = {channel: self.without_unit[channel] for channel in channels}
            some = len(columns) > 1
            names = ", ".join(map(repr, columns.values()))
            said = f"{names} do not say their units" if some else f"{names} does not say its unit"
            sources = ", ".join(f"{channel}: {{column: {column}, unit: …}}" for channel, column in columns.items())
            yield (
                f"{said}, which may be {', '.join(units)}",
                f"say {'them' if some else 'it'} in a column map, `{sources}`",
            )


class UnclearColumnError(InputError):
    """Neither the column map nor a header says which columns or units are meant; `problem` says so without the advice.

    `several`: more than one is to be chosen. `columns` are those that are clear by channel, whatever their units.
    """

    def __init__(self, unclear: Unclear, table: Table, columns: Mapping[str, str]) -> None:
        texts = [*unclear.texts()]
        super().__init__("; ".join(chain.from_iterable(texts)), table.path)
        self.problem = "; ".join(problem for problem, _ in texts)
        self.several = len(unclear.channels) > 1
        self.columns = columns


def split_header(name: str, stated: str | None = None) -> tuple[str, str | None]:
    """Name and unit of a header such as `gx_dph`, `T (°C)`, `T, °C`, `T/K`; None where it has no unit."""
    name = name.translate(_WIDE)
    bracketed = re.fullmatch(r"\s*(.*?)[\s/]*(?:\[([^\[\]]+)\]|\(([^()]+)\)|\{([^{}]+)\})\s*", name)
    if stated:
        return (bracketed[1] if bracketed and bracketed[1] else name), stated
    if bracketed and bracketed[1]:
        return bracketed[1], next(filter(None, bracketed.groups()[1:])).strip()
    parts = re.split(r"[_\s]+", name)
    for size in (2, 1):  # deg_h before h
        unit = "_".join(parts[-size:])
        if len(parts) > size and is_unit(unit):
            return re.sub(r"[_/]*(_in)?$", "", "_".join(parts[:-size])), unit
    for sign in ",/":
        quantity, _, unit = name.partition(sign)
        if is_unit(unit):
            return quantity, unit.strip()
    return name, None


def find_columns(table: Table, columns: ColumnMap) -> tuple[TimeSource, dict[str, Mapped]]:
    """Where time comes from, and the other channels that the map names or a header makes obvious.

    Raises InputError with all that is unclear of what is needed.
    """
    unclear = Unclear()
    source = _find_time(table, columns, unclear)
    found = _find_channels(table, columns, unclear)
    needed = (("time", ("time",)), ("rate", RATES), ("temperature", THERMOMETERS))
    clear = {*found, *unclear.channels, *(["time"] if source else [])}
    if missing := [channel for channel, some in needed if not {*some} & clear]:
        advice = f"name it in a column map, `{missing[0]}: {{column: …, unit: {examples(missing[0])[0]}}}`"
        other = " or `time: {rate_hz: …}`" if missing[0] == "time" else ""
        text = f"no column is {' or '.join(missing)}; {_has(table)}"
        unclear.problems |= {missing[0]: (text, advice + other)}
    if unclear.channels or source is None:
        columns_of = {channel: one.column for channel, one in found.items()}
        raise UnclearColumnError(unclear, table, columns_of)
    return source, found


def _find_channels(table: Table, columns: ColumnMap, unclear: Unclear) -> dict[str, Mapped]:
    named = {name: columns.channel(name) for name in IMPORTED if name != "time"}
    found = {name: _mapped(table, name, source, unclear) for name, source in named.items() if source is not None}
    taken = {mapped.column for mapped in found.values()} | {columns.time.column if columns.time else None}
    obvious = _obvious(table, taken)
    if not {*RATES} & {*found}:
        found |= _triads(table, taken, obvious, unclear)
    for channel, candidates in obvious.items():
        if channel in found or channel == "time" or (channel in RATES and {*RATES} & {*found}):
            continue
        if len(candidates) > 1:
            if CHANNELS[channel].required:
                names = ", ".join(candidates)
                advice = f"choose one in a column map, `{channel}: {{column: {candidates[0]}}}`"
                unclear.problems[channel] = (f"several columns could be {channel}: {names}", advice)
            continue
        found[channel] = _mapped(table, channel, ChannelSource(column=candidates[0]), unclear)
    return {channel: found[channel] for channel in IMPORTED if channel in found}


def _triads(
    table: Table, taken: set[str | None], obvious: Mapping[str, list[str]], unclear: Unclear
) -> dict[str, Mapped]:
    """Three rates that only their axis tells apart, and three accelerations beside them whose unit is stated."""
    named: dict[str, list[str]] = {}
    for name in table.columns:
        channel = _AXES.get(_word(split_header(name, table.units.get(name))[0]))
        if channel is not None and name not in taken:
            named.setdefault(channel, []).append(name)
    found: dict[str, Mapped] = {}
    for kind in ("rate", "acceleration"):
        own = {channel: names[0] for channel, names in named.items() if channel.startswith(kind) and len(names) == 1}
        stated = all(split_header(name, table.units.get(name))[1] for name in own.values())
        if len(own) < 3 or (kind == "rate" and len(obvious.get("rate", ())) not in {0, 3}):
            continue
        if kind == "rate" or (found and stated):
            found |= {
                channel: _mapped(table, channel, ChannelSource(column=name), unclear) for channel, name in own.items()
            }
    return found


def _find_time(table: Table, columns: ColumnMap, unclear: Unclear) -> TimeSource | None:
    """Where time comes from; None when neither the map nor a header says."""
    if columns.time is not None:
        source = columns.time
        if source.column is not None:
            _existing(table, "time", source.column)
            stated = source.unit or source.step_s or split_header(source.column, table.units.get(source.column))[1]
            if not stated and _word(source.column) in _COUNTERS:
                unclear.problems["time"] = _counter(source.column)
        return source
    candidates = _obvious(table, set()).get("time", [])
    if len(candidates) == 1:
        _existing(table, "time", candidates[0])
        return TimeSource(column=candidates[0])
    if candidates:
        advice = f"choose one in a column map, `time: {{column: {candidates[0]}}}`"
        unclear.problems["time"] = (f"several columns could be time: {', '.join(candidates)}", advice)
        return None
    counters = [name for name in table.columns if _word(name) in _COUNTERS]
    if counters:
        unclear.problems["time"] = _counter(counters[0])
    return None


def _counter(name: str) -> tuple[str, str]:
    advice = f"say it in a column map, `time: {{column: {name}, interval_s: …}}`"
    return f"'{name}' counts samples, and nothing says how long one takes", advice


def time_conversion(table: Table, source: TimeSource) -> Conversion:
    """From a column of times into seconds."""
    header = split_header(source.column or "", table.units.get(source.column or ""))[1]
    return _convert(table, source.unit or header or "s", "time")


def guess(table: Table) -> dict[str, str]:
    """For every channel the one column whose header names it: a beginning, where the whole is not clear yet."""
    return {channel: names[0] for channel, names in _obvious(table, set()).items() if len(names) == 1}


def _obvious(table: Table, taken: set[str | None]) -> dict[str, list[str]]:
    """Columns by the channel that their header names."""
    found: dict[str, list[str]] = {}
    for name in (*table.columns, *table.unread):
        word, unit = split_header(name, table.units.get(name))
        channel = next((each for each in (name, word.lower()) if each in IMPORTED), _BY_WORD.get(_word(word)))
        if channel == "time" and unit is not None and _measures(unit, "temperature"):
            channel = "temperature"  # T in degC is no time
        if channel in INSTRUMENTS and channel not in _UNITLESS and (unit is None or not _measures(unit, channel)):
            continue  # a pressure in no unit, or a current in mV: of something else
        if channel is not None and name not in taken:
            found.setdefault(channel, []).append(name)
    for channel, names in (("temperature", THERMOMETERS), ("rate", RATES), ("time", ("time",))):
        if not {*names} & {*found}:  # the only one left, by its unit, or such as imu_temp
            known = {name for names in found.values() for name in names} | taken
            left = [name for name in table.columns if name not in known and _is_of(table, name, channel)]
            found |= {channel: left} if len(left) == 1 else {}
    exact = {channel: [channel] for channel in found if channel in found[channel]}
    return {**found, **exact}


def _has(table: Table) -> str:
    unread = [f"{name!r} (no numbers)" for name in table.unread]
    return f"the table has {', '.join([*map(repr, table.columns), *unread])}"


def _is_of(table: Table, name: str, channel: str) -> bool:
    unit = split_header(name, table.units.get(name))[1]
    return (channel == "temperature" and "temp" in name.lower()) or (unit is not None and _measures(unit, channel))


def _measures(unit: str, channel: str) -> bool:
    try:
        conversion(unit, channel)
    except InputError:
        return False
    return True


def _word(name: str) -> str:
    return re.sub(r"[\W_]", "", name.rstrip(". ").rsplit(".", 1)[-1].lower())


def _mapped(table: Table, channel: str, source: ChannelSource, unclear: Unclear) -> Mapped:
    _existing(table, channel, source.column)
    header = split_header(source.column, table.units.get(source.column))[1]
    unit, how = source.unit or header, "column map" if source.unit else "header"
    if unit is None:
        if channel in OUTPUTS and source.column != channel:
            unclear.without_unit[channel] = source.column
        unit, how = CHANNELS[channel].unit, "assumed"
    return Mapped(channel, source.column, unit, _convert(table, unit, channel), how)


def _convert(table: Table, unit: str, channel: str) -> Conversion:
    try:
        return conversion(unit, channel)
    except InputError as error:
        raise InputError(str(error), table.path) from None


def _existing(table: Table, channel: str, column: str) -> None:
    if column in table.unread:
        reason, line = table.unread[column]
        raise InputError(reason, table.path, line)
    if column not in table.columns:
        known: Mapping[str, object] = table.columns
        raise InputError(f"column '{column}' for {channel} does not exist{nearest(column, known)}; it has "
                         f"{', '.join(known)}", table.path)  # fmt: skip
