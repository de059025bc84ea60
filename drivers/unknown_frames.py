"""What frames that nobody described may contain: counters, check sums, and numbers in one byte order or the other.

Everything is judged by how the bytes change, in the manner of M. Marchetti and D. Stabili, READ: Reverse Engineering of
Automotive Data Frames, IEEE Trans. Inf. Forensics Security 14 (2019): within a number the bytes of less weight hold
more (entropy), a counter goes on by the same step, and a check sum follows from the bytes before it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, field
from functools import cache
from typing import Literal

import numpy as np
import numpy.typing as npt

from drivers.can_record import FLAG_EXTENDED, FrameArray
from drivers.framing import Framing

Bytes = npt.NDArray[np.uint8]
Floats = npt.NDArray[np.float64]
LEAST_FRAMES = 20
"""Fewer tell nothing."""
_SAME = 0.98
_WIDEST = 4
_MORE_BITS = 0.5
_SCALES = (0.01, 0.1, 0.005, 1.0 / 128.0, 1.0 / 256.0, 0.0625, 1.0)
"""Of thermometers, the usual ones first [degC]."""
_KELVIN = 273.15
_POLYNOMIALS = (0x1D, 0x2F, 0x07, 0x31, 0x9B, 0xD5)


@dataclass(frozen=True)
class Field:
    """A stretch of bytes of a message."""

    first: int
    """Its first byte."""
    size: int
    """Bytes."""
    big: bool
    """Big endian."""
    kind: Literal["counter", "number", "constant", "check sum"]
    signed: bool = False
    mean: float = 0.0
    """Of the raw values, and their scatter; the step of a counter."""
    scatter: float = 0.0

    @property
    def start(self) -> int:
        """First bit as in a DBC."""
        return 8 * self.first + (7 if self.big else 0)

    def bits(self, identifier: int) -> dict[str, object]:
        """As the mapping of a station file describes it."""
        order = {"order": "big"} if self.big else {}
        kind = {"type": "signed"} if self.signed else {}
        return {"id": identifier, "start": self.start, "length": 8 * self.size, **order, **kind}


@dataclass(frozen=True)
class Heard:
    """One identifier on a bus."""

    id: int
    extended: bool
    frames: int
    length: int
    """Bytes of the longest frame."""
    rate_hz: float
    fields: tuple[Field, ...]
    data: Bytes = field(repr=False, compare=False)
    """Bytes of the frames (n, length)."""

    def of_kind(self, kind: str) -> tuple[Field, ...]:
        """Its fields of one kind."""
        return tuple(one for one in self.fields if one.kind == kind)


def heard(frames: FrameArray, listened_s: float, framing: Framing | None = None) -> tuple[Heard, ...]:
    """What was heard on a bus in `listened_s` [s], the most frequent identifier first.

    On a line, `framing` says which bytes are known: header, check sum, number and length of a packet.
    """
    extended = (frames["flags"] & FLAG_EXTENDED) != 0
    found = []
    for identifier, long in sorted({*zip(frames["id"].tolist(), extended.tolist(), strict=True)}):
        own = frames[(frames["id"] == identifier) & (extended == long)]
        length = int(own["len"].max())
        own = own[own["len"] == length]
        data = np.ascontiguousarray(own["data"][:, :length])
        known = set() if framing is None else {byte for _, span in framing.taken(length) for byte in span}
        fields = tuple(_fields(data, known)) if len(own) >= LEAST_FRAMES and length else ()
        found.append(Heard(identifier, long, len(own), length, len(own) / listened_s, fields, data))
    return tuple(sorted(found, key=lambda one: -one.rate_hz))


def values(data: Bytes, first: int, size: int, *, big: bool, signed: bool) -> Floats:
    """Raw values (n,) of a stretch of bytes."""
    raw = _unsigned(data, first, size, big=big)
    wrapped = raw.astype(np.int64)
    if signed:
        wrapped = np.where(wrapped >= 1 << 8 * size - 1, wrapped - (1 << 8 * size), wrapped)
    return wrapped.astype(np.float64)


def _unsigned(data: Bytes, first: int, size: int, *, big: bool) -> npt.NDArray[np.uint64]:
    weights = range(size - 1, -1, -1) if big else range(size)
    raw = np.zeros(len(data), dtype=np.uint64)
    for place, weight in enumerate(weights, first):
        raw |= data[:, place].astype(np.uint64) << np.uint64(8 * weight)
    return raw


def _fields(data: Bytes, known: Set[int]) -> Iterator[Field]:
    taken = _counters(data, known)
    sums = [k for k in (data.shape[1] - 1, 0) if k not in known and _is_check_sum(data, k)][:1]
    taken += [Field(k, 1, False, "check sum") for k in sums]
    used = {*known, *(k for one in taken for k in range(one.first, one.first + one.size))}
    free = [k for k in range(data.shape[1]) if k not in used]
    rest = [min((_numbers(data, run, big=big) for big in (False, True)), key=_cost) for run in _runs(free)]
    yield from sorted([*taken, *(one for run in rest for one in run)], key=lambda one: one.first)


def _counters(data: Bytes, known: Set[int]) -> list[Field]:
    """Stretches beside the `known` bytes that go on by the same step in nearly every frame, the widest first."""
    found: list[Field] = []
    used = {*known}
    for size in (4, 2, 1):
        for first in range(data.shape[1] - size + 1):
            own = {*range(first, first + size)}
            if own & used or not all(np.ptp(data[:, k]) for k in own):
                continue
            steps = {big: step for big in (False, True) if (step := _step(_unsigned(data, first, size, big=big), size))}
            if steps:  # read in the wrong order it goes on by 256, as long as nothing is carried
                big = min(steps, key=lambda order: steps[order])
                found.append(Field(first, size, big and size > 1, "counter", mean=float(steps[big])))
                used |= own
    return found


def _step(raw: npt.NDArray[np.uint64], size: int) -> int:
    """The step of a counter; 0 where it is none."""
    known, counts = np.unique(np.diff(raw) & np.uint64((1 << 8 * size) - 1), return_counts=True)
    step = int(known[counts.argmax()])
    return step if counts.max() >= _SAME * counts.sum() and step < 1 << 8 * size - 1 else 0


def _is_check_sum(data: Bytes, at: int) -> bool:
    """Whether a byte follows from the others: a CRC-8 of any start and any bytes behind, or their sum."""
    if np.unique(data[:, at]).size < min(16, len(data) // 2):
        return False
    others = np.delete(data, at, axis=1)
    if np.unique((data[:, at] - others.sum(axis=1, dtype=np.uint8)).astype(np.uint8)).size == 1:
        return True
    for polynomial in _POLYNOMIALS:
        crc = np.zeros(len(data), dtype=np.uint8)
        for column in others.T:
            crc = _table(polynomial)[crc ^ column]
        for end in (crc, _table(polynomial)[crc]):
            if np.unique(end ^ data[:, at]).size == 1:
                return True
    return False


@cache
def _table(polynomial: int) -> Bytes:
    table = []
    for byte in range(256):
        for _ in range(8):
            byte = (byte << 1 ^ (polynomial if byte & 0x80 else 0)) & 0xFF  # noqa: PLW2901 - a register of shifts
        table.append(byte)
    return np.array(table, dtype=np.uint8)


def _runs(places: Sequence[int]) -> list[list[int]]:
    runs: list[list[int]] = []
    for place in places:
        if runs and place == runs[-1][-1] + 1:
            runs[-1].append(place)
        else:
            runs.append([place])
    return runs


def _numbers(data: Bytes, run: Sequence[int], *, big: bool) -> list[Field]:
    """The run cut where a byte holds more than the one of less weight before it."""
    holds = [_entropy(column) for column in data.T]
    order = list(run) if not big else list(reversed(run))  # from the least weight up
    groups: list[list[int]] = []
    for place in order:
        last = groups[-1] if groups else None
        if last is None or len(last) == _WIDEST or holds[place] > holds[last[-1]] + _MORE_BITS:
            groups.append([place])
        else:
            last.append(place)
    return [_number(data, min(group), len(group), big) for group in groups]


def _entropy(column: Bytes) -> float:
    """Bits that a byte holds."""
    share = np.unique(column, return_counts=True)[1] / column.size
    return float(-np.sum(share * np.log2(share)))


def _number(data: Bytes, first: int, size: int, big: bool) -> Field:
    if not np.ptp(data[:, first : first + size], axis=0).any():
        return Field(first, size, big, "constant", mean=float(_unsigned(data[:1], first, size, big=big)[0]))
    both = {signed: values(data, first, size, big=big, signed=signed) for signed in (True, False)}
    signed = bool(np.ptp(both[True]) <= np.ptp(both[False]))
    return Field(first, size, big, "number", signed, float(both[signed].mean()), float(both[signed].std()))


def _cost(fields: Sequence[Field]) -> tuple[int, float]:
    """Fewer numbers first, then those that scatter over less of what their bits can hold."""
    numbers = [one for one in fields if one.kind == "number"]
    return len(numbers), sum(one.scatter / 256.0**one.size for one in numbers)


def thermometers(
    found: Sequence[Heard], near_degc: float, within_degc: float = 3.0
) -> Mapping[tuple[int, int], tuple[Field, float, str]]:
    """Numbers of 16 bits that read within `within_degc` of a temperature, with the usual scale and unit of that.

    By identifier and first byte of the number among the fields.
    """
    plausible = {}
    for one in found:
        for number in one.of_kind("number"):
            for window in sorted(_windows(one, number), key=lambda window: window.big != number.big):
                steady = [scale for scale in _SCALES if window.scatter * scale < 0.5]
                near = (
                    (scale, unit)
                    for unit, zero in (("degC", 0.0), ("K", _KELVIN))
                    for scale in steady
                    if abs(window.mean * scale - zero - near_degc) < within_degc
                )
                if (known := next(near, None)) is not None:
                    plausible[one.id, number.first] = window, *known
                    break
    return plausible


def _windows(one: Heard, number: Field) -> Iterator[Field]:
    """The two bytes of either order whose least weight is the byte of a number that holds the most.

    A constant byte beside it may be its other half, or a field of its own.
    """
    least = max(range(number.first, number.first + number.size), key=lambda k: _entropy(one.data[:, k]))
    for first, big in ((least, False), (least - 1, True)):
        if 0 <= first <= one.length - 2:
            raw = values(one.data, first, 2, big=big, signed=True)
            yield Field(first, 2, big, "number", True, float(raw.mean()), float(raw.std()))
