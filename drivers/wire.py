"""The wire format of a CAN unit: layouts read from a DBC once, signals packed and unpacked for whole blocks by numpy.

Driver, simulator and importer share it, so it contains only bits and units. It supports CAN and CAN FD, and signals of
up to 64 bits at any position in either byte order: integers, floats, multiplexed ones. cantools only reads the file.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from drivers.errors import ConfigError, LimitError

ByteArray = npt.NDArray[np.uint8]
"""Payloads, shape (n, 8), or as many bytes as the message is long; those beyond its length are zero."""
IntArray = npt.NDArray[np.int64]

_LITTLE, _BIG, _WORD = np.dtype("<u8"), np.dtype(">u8"), np.dtype("<u2")
_DBC_FOLDER = Path(__file__).parent / "gyros"


@dataclass(frozen=True)
class Signal:
    """One signal: physical value [unit] = raw * scale + offset.

    Its first 64 bits lie in the eight bytes from `first` on; read as one number of its byte order, `shift_up` bits are
    above it. At most 7 bits more are in the byte after them: `shift_up` is negative by as many in little endian.
    `choice`: the signal is present only where another signal has one of these raw values.
    """

    name: str
    unit: str
    shift_up: int
    length: int
    big_endian: bool
    signed: bool
    is_float: bool
    scale: float
    offset: float
    first: int = 0
    choice: tuple[str, tuple[int, ...]] | None = None
    bounds: tuple[float, float] | None = None
    """Lowest and highest physical value that the DBC allows; None: it does not say."""
    names: Mapping[int, str] = field(default_factory=dict)
    """What raw values mean."""
    attributes: Mapping[str, str] = field(default_factory=dict)
    """What else the DBC says of the signal."""

    @property
    def measured(self) -> tuple[float, float]:
        """Lowest and highest physical value [unit] that is a measurement.

        The ends of the code are none: there a value is saturated (many units clip at -(2^n - 1)) or not available. Half
        a step is allowed for rounding.
        """
        low, high = -math.inf, math.inf
        if not self.is_float:
            first = 2 - (1 << self.length - 1) if self.signed else 0
            last = (1 << self.length - self.signed) - 2
            low, high = sorted((first * self.scale + self.offset, last * self.scale + self.offset))
        if self.bounds is not None:
            low, high = max(low, self.bounds[0]), min(high, self.bounds[1])
        slack = 0.0 if self.is_float else 0.5 * abs(self.scale)
        return low - slack, high + slack

    @property
    def is_plain(self) -> bool:
        """Whether the raw value is the value itself."""
        return not self.is_float and self.scale == 1.0 and self.offset == 0.0

    def unpack(self, data: ByteArray) -> npt.NDArray[Any]:
        """Raw values (n,) of contiguous payloads: int64, uint64, or the float type of the signal."""
        word = self._lifted(data)
        if self.is_float:
            bits = (word >> np.uint64(64 - self.length)).astype(f"u{self.length // 8}")
            return bits.view(f"f{self.length // 8}")
        if self.signed:
            return word.view(np.int64) >> np.int64(64 - self.length)
        return word >> np.uint64(64 - self.length)

    def _lifted(self, data: ByteArray) -> npt.NDArray[np.uint64]:
        """The signal in the highest bits of a word (n,); the bits below it are undefined."""
        window = data if data.shape[1] == 8 else np.ascontiguousarray(data[:, self.first : self.first + 8])
        word = window.view(_BIG if self.big_endian else _LITTLE)[:, 0].astype(np.uint64, copy=False)
        below = self.shift_up + self.length - 64 if self.big_endian else -self.shift_up
        if below <= 0:
            return word << np.uint64(self.shift_up)
        last = data[:, self.first + 8].astype(np.uint64)
        if self.big_endian:
            return word << np.uint64(self.shift_up) | last >> np.uint64(8 - self.shift_up)
        room = np.uint64(64 - self.length)
        return word >> (room + np.uint64(below)) << room | last << np.uint64(64 - below)

    def physical(self, data: ByteArray) -> npt.NDArray[np.float64]:
        """Physical values [unit], (n,), of contiguous payloads."""
        if self.is_float:
            with np.errstate(invalid="ignore", over="ignore"):  # any bit pattern may arrive, signalling NaN too
                scaled: npt.NDArray[np.float64] = self.unpack(data).astype(np.float64) * self.scale + self.offset
            return scaled
        values: npt.NDArray[np.float64] = self.unpack(data).astype(np.float64)
        if self.scale != 1.0:
            values *= self.scale
        if self.offset != 0.0:
            values += self.offset
        return values

    def raw(self, values: npt.ArrayLike) -> npt.NDArray[Any]:
        """Nearest raw values of physical values [unit]; LimitError where one does not fit, nothing is clipped."""
        physical = np.asarray(values)
        if self.is_float:
            scaled = (physical.astype(np.float64) - self.offset) / self.scale
            return scaled.astype(f"f{self.length // 8}")
        if physical.dtype.kind in "iub" and self.is_plain:
            raw = physical
        else:
            raw = physical.astype(np.float64)
            if self.offset != 0.0:
                raw -= self.offset
            if self.scale != 1.0:
                raw /= self.scale
            raw = np.rint(raw)
        low = -(1 << self.length - 1) if self.signed else 0
        high = low + (1 << self.length) - 1
        # Python compares an int with a float exactly; numpy would round `high` to a float first. NaN never fits.
        if raw.size and not (
            np.minimum.reduce(raw, None).item() >= low and np.maximum.reduce(raw, None).item() <= high
        ):
            wrong = next(v for v, r in zip(physical.flat, raw.flat, strict=True) if not low <= r.item() <= high)
            limits = f"{low * self.scale + self.offset:g} to {high * self.scale + self.offset:g}"
            raise LimitError(f"{self.name} = {wrong:g} [{self.unit}] does not fit its signal ({limits})")
        return raw.astype(np.int64 if self.signed else np.uint64)

    @property
    def places(self) -> IntArray:
        """Where its bits are in the message, the most significant first (length,); bit 7 of byte 0 is number 0."""
        if self.big_endian:
            return 8 * self.first + self.shift_up + np.arange(self.length)
        low = 8 * self.first + 64 - self.shift_up - self.length  # the least significant one, as a DBC counts
        places = low + np.arange(self.length)[::-1]
        return 8 * (places // 8) + 7 - places % 8

    def bits(self, raw: int) -> int:
        """The eight bytes, as a little-endian number, that contain only `raw`."""
        word = (raw & (1 << self.length) - 1) << 64 - self.length >> self.shift_up
        return int.from_bytes(word.to_bytes(8, "big"), "little") if self.big_endian else word


class Column(NamedTuple):
    """Physical values [unit] of one signal, and the rows that have it: None for every row."""

    values: npt.NDArray[np.float64]
    rows: IntArray | None


@dataclass(frozen=True)
class Message:
    """One message of the DBC; `cycle_ms` is None when it is not sent periodically."""

    name: str
    id: int
    extended: bool
    length: int
    cycle_ms: float | None
    signals: Mapping[str, Signal]

    @cached_property
    def is_simple(self) -> bool:
        """At most 8 bytes, every signal in every frame: what numpy packs as one word."""
        return self.length <= 8 and all(signal.choice is None for signal in self.signals.values())

    @property
    def width(self) -> int:
        """Bytes of a row of payloads."""
        return max(self.length, 8)

    def decode(self, data: ByteArray) -> dict[str, Column]:
        """Every signal of contiguous payloads (n, width)."""
        if self.is_simple:
            return {name: Column(signal.physical(data), None) for name, signal in self.signals.items()}
        raw: dict[str, npt.NDArray[Any]] = {}
        columns: dict[str, Column] = {}
        for name, signal in self.signals.items():
            present = self._present(signal, data, raw)
            rows = None if present is None or present.all() else np.flatnonzero(present)
            columns[name] = Column(signal.physical(data if rows is None else data[rows]), rows)
        return columns

    def present(self, signal: Signal, data: ByteArray) -> npt.NDArray[np.bool_] | None:
        """Which payloads (n, width) carry a signal; None: all do."""
        return self._present(signal, data, {})

    def _present(
        self, signal: Signal, data: ByteArray, raw: dict[str, npt.NDArray[Any]]
    ) -> npt.NDArray[np.bool_] | None:
        """Rows in which a signal is present (n,), None for all; `raw` keeps the selectors that were unpacked."""
        if signal.choice is None:
            return None
        name, choices = signal.choice
        if name not in raw:
            raw[name] = self.signals[name].unpack(data)
        chosen: npt.NDArray[np.bool_] = np.isin(raw[name], np.array(choices, dtype=raw[name].dtype))
        before = self._present(self.signals[name], data, raw)
        return chosen if before is None else chosen & before

    def pack(self, count: int, values: Mapping[str, npt.ArrayLike]) -> ByteArray:
        """Payloads (count, width) from physical values, scalars or (count,); every signal but Crc8 must be given.

        ConfigError for a message that is multiplexed.
        """
        if not self.is_simple:
            return self._pack_wide(count, values)
        known = self.signals.keys()
        if wrong := (known - values.keys() - {"Crc8"}) | (values.keys() - known):
            raise ConfigError(f"{self.name}: signals missing or unknown: {', '.join(sorted(wrong))}")
        little, big, constant = np.zeros(count, dtype=_LITTLE), None, 0
        for name, value in values.items():
            signal = self.signals[name]
            if isinstance(value, int) and signal.is_plain and 0 <= value < 1 << signal.length - signal.signed:
                constant |= signal.bits(value)
                continue
            raw = signal.raw(value)
            lifted = raw.view(_LITTLE) if raw.itemsize == 8 else raw.view(f"u{raw.itemsize}").astype(np.uint64)
            lifted = lifted << np.uint64(64 - signal.length)
            lifted >>= np.uint64(signal.shift_up)
            if signal.big_endian:
                big = lifted if big is None else big | lifted
            else:
                little |= lifted
        if big is not None:
            little |= np.broadcast_to(big, count).astype(_BIG).view(_LITTLE)
        little |= np.uint64(constant)
        return little.view(np.uint8).reshape(count, 8)

    def _pack_wide(self, count: int, values: Mapping[str, npt.ArrayLike]) -> ByteArray:
        """The same of a message longer than 8 bytes."""
        if any(signal.choice is not None for signal in self.signals.values()):
            raise ConfigError(f"{self.name}: is multiplexed; the bench sends no such messages")
        bits = np.zeros((count, 8 * self.width), dtype=np.uint8)
        for name, value in values.items():
            signal = self.signals[name]
            raw = np.broadcast_to(signal.raw(value), count)
            words = np.ascontiguousarray(
                raw.astype(">i8" if raw.dtype.kind == "i" else f">{raw.dtype.kind}{raw.itemsize}")
            )
            own = np.unpackbits(words.view(np.uint8).reshape(count, -1), axis=1)[:, -signal.length :]
            bits[:, signal.places] = own
        return np.packbits(bits, axis=1)

    def crc(self, data: ByteArray, data_id: int) -> ByteArray:
        """CRC-8/SAE-J1850 (n,) over the bytes before the last one of the message, then the data identifier."""
        tables, start = _crc_tables(self.length)
        words = data.view(_WORD)
        crc = tables[0].take(words[:, 0]) if tables else np.zeros(len(data), dtype=np.uint8)
        crc ^= np.uint8(start ^ int(_CRC_TABLE[data_id & 0xFF]))
        for column, table in enumerate(tables[1:], 1):
            crc ^= table.take(words[:, column])
        return crc


def load_dbc(path_or_name: str | Path) -> dict[str, Message]:
    """Messages of a DBC file, or of a gyro family shipped with the bench ("vibratory"), by name.

    Raises ConfigError when the file is missing, not a DBC, or cannot be decoded by the bench.
    """
    path = Path(path_or_name)
    if path.suffix.lower() != ".dbc":
        path = _DBC_FOLDER / f"{path_or_name}.dbc"
        if not path.is_file():
            raise ConfigError(f"no gyro {str(path_or_name)!r} is shipped: {_shipped()}; a DBC of your own ends in .dbc")
    path = path.resolve()
    changed = path.stat() if path.is_file() else None
    return dict(_load(path, None if changed is None else (changed.st_mtime_ns, changed.st_size)))


def _shipped() -> str:
    """Names of the shipped gyros."""
    return ", ".join(sorted(file.stem for file in _DBC_FOLDER.glob("*.dbc")))


def read_layouts(path: Path) -> dict[str, Message]:
    """Messages of any file that cantools reads, by name; ConfigError when it cannot."""
    import cantools  # slow to import; a station without CAN never needs it

    logging.getLogger("cantools").addHandler(logging.NullHandler())  # what is wrong is said once, by us
    try:
        database: Any = cantools.database.load_file(path, strict=True)
    except OSError as error:
        raise ConfigError(f"DBC {path}: {error.strerror} (shipped families: {_shipped()})") from None
    except Exception as error:  # cantools raises its own errors and those of its parsers
        text = " ".join(str(error).split()).removeprefix("DBC: ").strip('"')
        raise ConfigError(f"DBC {path}: {text}") from error
    if not isinstance(database, cantools.database.Database):
        raise ConfigError(f"DBC {path}: describes diagnostics, not frames")
    seen: dict[tuple[int, bool], str] = {}
    for message in database.messages:
        other = seen.setdefault((message.frame_id, message.is_extended_frame), message.name)
        if other != message.name:
            text = f"{other} and {message.name} have the same identifier 0x{message.frame_id:X}"
            raise ConfigError(f"DBC {path}: {text}; give each message its own")
    if len({message.name for message in database.messages}) < len(database.messages):
        raise ConfigError(f"DBC {path}: two messages have the same name; give each its own")
    return {message.name: _message(message) for message in database.messages}


@lru_cache(maxsize=16)
def _load(path: Path, changed: tuple[int, int] | None) -> dict[str, Message]:
    """The messages as long as the file does not change; `changed` is when it last did, and its size."""
    return read_layouts(path)


def described(signals: Sequence[Mapping[str, Any]]) -> dict[str, Message]:
    """Messages of signals that no DBC describes, by name `0x123`; ConfigError where they do not fit.

    Each has `id`, `start` and `length` as a DBC counts them, and may have `extended` (left out: above 0x7FF), `order`
    (little or big), `type` (unsigned, signed or float), `scale`, `offset`, `unit`, `low` and `high`, `cycle_ms`, and
    `bytes` of the message (left out: as many as the signals need). Signals are named `bit<start>`.
    """
    from cantools.database import can
    from cantools.database.conversion import BaseConversion

    groups: dict[tuple[int, bool], list[Mapping[str, Any]]] = {}
    for one in signals:
        groups.setdefault((one["id"], bool(one.get("extended", one["id"] > 0x7FF))), []).append(one)
    found = {}
    for (identifier, extended), members in groups.items():
        parts = [
            can.Signal(
                f"bit{one['start']}",
                one["start"],
                one["length"],
                byte_order="big_endian" if one.get("order") == "big" else "little_endian",
                is_signed=one.get("type") == "signed",
                conversion=BaseConversion.factory(
                    one.get("scale", 1.0), one.get("offset", 0.0), is_float=one.get("type") == "float"
                ),
                minimum=one.get("low"),
                maximum=one.get("high"),
                unit=one.get("unit", ""),
            )
            for one in {one["start"]: one for one in members}.values()
        ]
        stated = {int(one["bytes"]) for one in members if "bytes" in one}
        length = max(stated) if stated else _fitting(max(_last_byte(part) for part in parts) + 1)
        cycles = {float(one["cycle_ms"]) for one in members if "cycle_ms" in one}
        name = f"0x{identifier:X}"
        try:
            message = can.Message(identifier, name, length, parts, is_extended_frame=extended, strict=True)
        except Exception as error:  # cantools raises its own errors
            raise ConfigError(f"signals of {name}: {' '.join(str(error).split())}") from error
        found[name] = replace(_message(message), cycle_ms=min(cycles) if cycles else None)
    return found


LENGTHS = (*range(9), 12, 16, 20, 24, 32, 48, 64)
"""Bytes that a frame can have; more than 8 with CAN FD (ISO 11898-1)."""


def _fitting(count: int) -> int:
    return next((length for length in LENGTHS if length >= count), count)


def _last_byte(signal: Any) -> int:
    """The last byte that a signal touches; a big-endian one starts at its most significant bit."""
    if signal.byte_order == "little_endian":
        return int((signal.start + signal.length - 1) // 8)
    inside = 7 - signal.start % 8
    return int(signal.start // 8 + (inside + signal.length - 1) // 8)


def _message(message: Any) -> Message:
    width = max(message.length, 8)
    return Message(
        name=message.name,
        id=message.frame_id,
        extended=message.is_extended_frame,
        length=message.length,
        cycle_ms=message.cycle_time or None,
        signals={signal.name: _signal(signal, width) for signal in message.signals},
    )


def _signal(signal: Any, width: int) -> Signal:
    big_endian = signal.byte_order == "big_endian"
    first = min(signal.start // 8, width - 8)
    inside = signal.start - 8 * first
    # Bits to the left of the signal once its eight bytes are read as one 64-bit word of its own byte order.
    above = 8 * (inside // 8) + 7 - inside % 8 if big_endian else 64 - inside - signal.length
    chosen_by = signal.multiplexer_signal
    low, high = signal.minimum, signal.maximum
    return Signal(
        name=signal.name,
        unit=signal.unit or "",
        shift_up=above,
        length=signal.length,
        big_endian=big_endian,
        signed=signal.is_signed,
        is_float=signal.is_float,
        scale=float(signal.scale),
        offset=float(signal.offset),
        first=first,
        choice=None if chosen_by is None else (chosen_by, tuple(signal.multiplexer_ids or ())),
        bounds=(float(low), float(high)) if low is not None and high is not None and low < high else None,
        names={int(raw): str(name) for raw, name in (signal.choices or {}).items()},
        attributes={name: str(said.value) for name, said in _attributes(signal).items()},
    )


def _attributes(signal: Any) -> Mapping[str, Any]:
    """Attributes that a DBC gives to a signal; other kinds of files have none."""
    return {} if signal.dbc is None else dict(signal.dbc.attributes)


def _crc_table(polynomial: int = 0x1D) -> ByteArray:
    table = np.arange(256)
    for _ in range(8):
        table = np.where(table & 0x80, (table << 1) ^ polynomial, table << 1) & 0xFF
    return table.astype(np.uint8)


_CRC_TABLE = _crc_table()


@lru_cache(maxsize=8)
def _crc_tables(length: int) -> tuple[list[ByteArray], int]:
    """Contribution of each 16-bit word of a message to its CRC, and the CRC of zeros: the code is linear.

    Byte k passes through the register once, then once more for each byte after it and for the data identifier.
    """
    start, parts = 0xFF, []
    for _ in range(length):
        start = int(_CRC_TABLE[start])
    for position in range(length - 1):
        part = np.arange(256, dtype=np.uint8)
        for _ in range(length - position):
            part = _CRC_TABLE[part]
        parts.append(part)
    parts += [np.zeros(256, dtype=np.uint8)] * 2  # the CRC itself, and a pad to whole words
    pairs = [(parts[k + 1][:, None] ^ parts[k][None, :]).ravel() for k in range(0, length - 1, 2)]
    return pairs, start ^ 0xFF
