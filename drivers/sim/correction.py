"""Arithmetic of a simulated gyro: reads an image as docs/eeprom.md defines it, and corrects samples block by block.

Written from that document, independently of the code that makes images. Integers are int64, floats float32, as there.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]
FloatArray = npt.NDArray[np.float64]
SingleArray = npt.NDArray[np.float32]

MAGIC, VERSION = 0x43425447, 1
FLOAT32, FIXED, SPLIT, SPLIT_FIXED = range(4)
CHANNEL, LAG, PLAY, PARABOLA, BEHIND = range(5)
SERIES, SURFACE, SPLINE = 1, 2, 3
RATE = 0
_CHANNELS = {0, 1, 2, 3, 4, 5, 8}
_ONE = 1 << 30
_NO_VALUE = -(1 << 31)
"""Count of a sample without a value."""
_HEADER, _SIGNAL, _BLOCK = 24, 10, 5
FLAG_NO_VALUE = 1 << 31


class RefusedImageError(Exception):
    """The unit does not accept an image; the text states the reason."""


@dataclass
class _Signal:
    kind: int
    source: int
    low: int
    high: int
    centre: int
    recip: int
    shift: int
    p0: int
    p1: int
    p2: int
    behind: int = 0
    last: int = 0
    started: bool = False


@dataclass(frozen=True)
class _Block:
    kind: int
    a: int
    b: int
    n: int
    first: int

    @property
    def size(self) -> int:
        return {SERIES: self.n + 1, SURFACE: (self.n + 1) * (self.n + 2) // 2, SPLINE: 4 * self.n}[self.kind]


@dataclass
class Correction:
    """An accepted image with the states of its signals."""

    form: int
    gain: tuple[int, int]
    gain_f32: np.float32
    fraction_bits: int
    step: tuple[int, int]
    signals: list[_Signal]
    blocks: list[_Block]
    integers: IntArray
    singles: SingleArray = field(default_factory=lambda: np.zeros(0, dtype=np.float32))

    @classmethod
    def read(cls, content: bytes, serial: int, room_words: int) -> Correction:
        """The image in these bytes; RefusedImageError by the rules of the document."""
        words = _checked(content, serial, room_words)
        s, k, n = words[12:15]
        signed = [w - (1 << 32) if w >> 31 else w for w in words]
        at = _HEADER
        signals = []
        for i in range(s):
            kind, source = words[at : at + 2]
            low, high, centre, recip, shift, *p = signed[at + 2 : at + 10]
            signals.append(_Signal(kind, source, low, high, centre, recip, shift, p[0], p[1], p[2]))
            _refuse(kind > BEHIND or words[at + 6] > 62, f"signal {i} of kind {kind}, shift {words[at + 6]}")
            _refuse(kind in {LAG, BEHIND} and not 0 <= signed[at + 8] <= 62, f"signal {i}: shift {signed[at + 8]}")
            _refuse(source not in _CHANNELS if kind == CHANNEL else source >= i, f"signal {i} from {source}")
            at += _SIGNAL
        blocks = []
        for i in range(k):
            block = _Block(*words[at : at + _BLOCK])
            _refuse(block.kind not in {SERIES, SURFACE, SPLINE}, f"block {i} of kind {block.kind}")
            _refuse(max(block.a, block.b) >= s, f"block {i} of signals {block.a}, {block.b}")
            _refuse(block.first + block.size > n, f"block {i}: coefficients to {block.first + block.size} of {n}")
            _refuse(block.n > words[21] if block.kind != SPLINE else block.n == 0, f"block {i} of order {block.n}")
            blocks.append(block)
            at += _BLOCK
        stored = content[4 * at : 4 * (at + n)]
        singles = np.frombuffer(stored, dtype="<f4").astype(np.float32)
        floats = words[2] in {FLOAT32, SPLIT}
        _refuse(floats and not np.isfinite(singles).all(), "a coefficient is not finite")
        return cls(
            form=words[2],
            gain=(signed[15], words[16]),
            gain_f32=np.frombuffer(content[68:72], dtype="<f4")[0],
            fraction_bits=words[18],
            step=(signed[19], words[20]),
            signals=signals,
            blocks=blocks,
            integers=np.frombuffer(stored, dtype="<i4").astype(np.int64),
            singles=singles,
        )

    def apply(self, counts: Mapping[int, IntArray]) -> tuple[FloatArray, int]:
        """Corrected rate [deg/s] (n,) of the next n samples, inputs in counts by channel; flags of all of them."""
        raw = counts[RATE]
        z, flags = self._signals(counts, len(raw))
        given = raw != _NO_VALUE
        if not given.all():
            flags |= FLAG_NO_VALUE
        return np.where(given, self._output(np.where(given, raw, 0), z), 0.0), flags

    def _output(self, raw: IntArray, z: list[IntArray]) -> FloatArray:
        if self.form in {FLOAT32, SPLIT}:
            single = self._floats(z, len(raw))
            if self.form == FLOAT32:
                return (raw.astype(np.float32) * self.gain_f32 - single).astype(np.float64)
            pico = _r(raw * self.gain[0], self.gain[1]) - (single * np.float32(1e12)).astype(np.int64)
            return np.asarray(pico * 1e-12)
        total = _r(self._sum(z, len(raw)), 30)
        nominal = _r(raw * self.gain[0], self.gain[1])
        if self.form == FIXED:
            return np.asarray(np.clip(nominal - total, -(1 << 31), (1 << 31) - 1) * 2.0**-self.fraction_bits)
        return np.asarray((nominal - _r(total * self.step[0], self.step[1])) * 1e-12)

    def _signals(self, counts: Mapping[int, IntArray], n: int) -> tuple[list[IntArray], int]:
        z: list[IntArray] = []
        known: list[BoolArray] = []
        flags = 0
        for number, signal in enumerate(self.signals):
            if signal.kind == CHANNEL:
                source = counts.get(signal.source, np.full(n, _NO_VALUE, dtype=np.int64))
                there = source != _NO_VALUE
                flags |= 0 if there.all() else FLAG_NO_VALUE
            else:
                source, there = z[signal.source], known[signal.source]
            v = _value(signal, source[there])  # a sample without a value does not change states
            inside = np.minimum(np.maximum(v, signal.low), signal.high)
            if (inside != v).any():
                flags |= 1 << number
            unit = _r((inside - signal.centre) * signal.recip, signal.shift)
            answer = np.zeros(n, dtype=np.int64)
            answer[there] = np.minimum(np.maximum(unit, -_ONE), _ONE)
            z.append(answer)
            known.append(there)
        return z, flags

    def _sum(self, z: list[IntArray], n: int) -> IntArray:
        total = np.zeros(n, dtype=np.int64)
        for block in self.blocks:
            own = self.integers[block.first : block.first + block.size]
            if block.kind == SERIES:
                for c, t in zip(own, _polynomials(z[block.a], block.n), strict=True):
                    total += c * t
            elif block.kind == SURFACE:
                one, two = _polynomials(z[block.a], block.n), _polynomials(z[block.b], block.n)
                for c, (i, j) in zip(own, _pairs(block.n), strict=True):
                    total += c * _r(one[i] * two[j], 30)
            else:
                piece, place = _piece(z[block.a], block.n)
                for k, t in enumerate(_polynomials(place, 3)):
                    total += own[4 * piece + k] * t
        return total

    def _floats(self, z: list[IntArray], n: int) -> SingleArray:
        total = np.zeros(n, dtype=np.float32)
        for block in self.blocks:
            own, part = self.singles[block.first : block.first + block.size], np.zeros(n, dtype=np.float32)
            if block.kind == SERIES:
                for c, t in zip(own, _single_polynomials(z[block.a], block.n), strict=True):
                    part += c * t
            elif block.kind == SURFACE:
                one, two = _single_polynomials(z[block.a], block.n), _single_polynomials(z[block.b], block.n)
                for c, (i, j) in zip(own, _pairs(block.n), strict=True):
                    part += (c * one[i]) * two[j]
            else:
                piece, place = _piece(z[block.a], block.n)
                for k, t in enumerate(_single_polynomials(place, 3)):
                    part += own[4 * piece + k] * t
            total += part
        return total


def _refuse(wrong: bool, why: str) -> None:
    if wrong:
        raise RefusedImageError(why)


def _checked(content: bytes, serial: int, room_words: int) -> list[int]:
    """Words of an image; RefusedImageError unless its header and CRC are valid."""
    words = list(struct.unpack(f"<{len(content) // 4}I", content[: len(content) // 4 * 4]))
    _refuse(len(words) <= _HEADER or words[0] != MAGIC, "no image")
    _refuse(words[1] != VERSION, f"format version {words[1]}")
    _refuse(words[2] > SPLIT_FIXED, f"form {words[2]}")
    size = _HEADER + _SIGNAL * words[12] + _BLOCK * words[13] + words[14] + 1
    _refuse(not words[3] == size == len(words) <= room_words, f"length {words[3]}, counts give {size}")
    _refuse(zlib.crc32(content[: 4 * size - 4]) != words[-1], "CRC")
    _refuse(words[4] != serial, f"serial number {words[4]}")
    _refuse(words[10] != 0, "output is not a rate")
    _refuse(words[12] > 16 or words[13] > 16 or words[21] > 12, "too large")
    _refuse(words[16] > 62 or words[20] > 62 or words[18] > 62, "shift above 62")
    return words


def _r(v: IntArray, s: int) -> IntArray:
    """Divide by 2^s, half away from zero."""
    if s == 0:
        return v
    rounded: IntArray = np.sign(v) * ((np.abs(v) + (1 << (s - 1))) >> s)
    return rounded


def _value(signal: _Signal, source: IntArray) -> IntArray:
    """Raw value v of samples without gaps; states continue from the block before."""
    if signal.kind == CHANNEL or not source.size:
        return source
    if signal.kind == PARABOLA:
        t2 = _r(2 * source * source, 30) - _ONE
        return _r(signal.p0 * _ONE + signal.p1 * source + signal.p2 * t2, 30)
    if signal.kind == PLAY:
        return _play(signal, source)
    behind = _r(_filtered(signal, source), 8)
    return source + behind if signal.kind == LAG else behind


def _play(signal: _Signal, source: IntArray) -> IntArray:
    """A play changes only when its source changes, so only the changes are computed."""
    changes = np.flatnonzero(np.diff(source, prepend=source[0] - 1))
    at, width = signal.last if signal.started else int(source[0]), signal.p0
    places = []
    for now in source[changes].tolist():
        if at < now - width:
            at = now - width
        elif at > now + width:
            at = now + width
        places.append(at)
    signal.last, signal.started = at, True
    return source - np.repeat(np.array(places, dtype=np.int64), np.diff(changes, append=len(source)))


def _filtered(signal: _Signal, source: IntArray) -> IntArray:
    """State of a lag after each sample [2^-38]."""
    if not signal.started:
        signal.last, signal.started = int(source[0]), True
    behind, last, fade, bits, push = signal.behind, signal.last, signal.p0, signal.p1, signal.p2
    half, half_push = (1 << bits) >> 1, 1 << 21
    states = []
    for now in source.tolist():
        faded = behind * fade
        step = (faded + half) >> bits if faded >= 0 else -((half - faded) >> bits)
        behind -= step
        if now != last:
            pushed = (now - last) * push
            behind += (pushed + half_push) >> 22 if pushed >= 0 else -((half_push - pushed) >> 22)
            last = now
        states.append(behind)
    signal.behind, signal.last = behind, last
    return np.array(states, dtype=np.int64)


def _pairs(n: int) -> list[tuple[int, int]]:
    """Orders of a surface: by total degree, then falling power of the first."""
    return [(degree - j, j) for degree in range(n + 1) for j in range(degree + 1)]


def _piece(z: IntArray, n: int) -> tuple[IntArray, IntArray]:
    w = (z + _ONE) * n
    piece = np.minimum(w >> 31, n - 1)
    return piece, w - (piece << 31) - _ONE


def _polynomials(z: IntArray, n: int) -> list[IntArray]:
    terms = [np.full(len(z), _ONE, dtype=np.int64), z]
    for k in range(1, n):
        terms.append(_r(2 * z * terms[k], 30) - terms[k - 1])
    return terms[: n + 1]


def _single_polynomials(z: IntArray, n: int) -> list[SingleArray]:
    unit = z.astype(np.float32) * np.float32(2.0**-30)
    twice = np.float32(2.0) * unit
    terms = [np.ones(len(z), dtype=np.float32), unit]
    for k in range(1, n):
        terms.append(twice * terms[k] - terms[k - 1])
    return terms[: n + 1]
