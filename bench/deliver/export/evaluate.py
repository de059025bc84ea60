"""Evaluates an image bit for bit as docs/eeprom.md defines it: the reference for the generated C code."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from bench.base import BoolArray, IntArray
from bench.deliver.export.chebyshev import orders
from bench.deliver.export.delivery import INPUTS, NO_VALUE, ONE, Kind, Shape, Signal
from bench.deliver.export.exact import Counts
from bench.deliver.export.image import Image
from bench.deliver.export.words import float_of, i32

SingleArray = npt.NDArray[np.float32]
FLAG_NO_VALUE = 1 << 31


@dataclass(frozen=True, eq=False)
class Evaluated:
    """Output as stored (float32, int32 or int64, (n,)), the same in output units, and the flags (n,)."""

    raw: npt.NDArray[np.generic]
    value: npt.NDArray[np.float64]
    flags: npt.NDArray[np.uint32]


def shifted(value: IntArray, bits: int) -> IntArray:
    """r(v, s) of the document: value / 2^bits, half away from zero."""
    if bits == 0:
        return value
    size = (np.abs(value) + (1 << (bits - 1))) >> bits
    return np.where(value >= 0, size, -size)


def evaluate(image: Image, counts: Counts, *, settled: bool = False) -> Evaluated:
    """Output for samples in time (n,), or for points each taken as a first sample (`settled`)."""
    z, flags = _signals(image, counts, settled)
    raw = counts[INPUTS["rate" if image.output == 0 else "acceleration"].id]
    given = raw != NO_VALUE
    flags |= np.where(given, 0, FLAG_NO_VALUE)
    total = _floats(image, z) if image.floats else _integers(image, z)
    output = _output(image, np.where(given, raw, 0), total)
    output = np.where(given, output, output.dtype.type(0))
    unit = {"float32": 1.0, "fixed": 2.0**-image.fraction_bits}.get(image.form, 1e-12)
    return Evaluated(output, output.astype(np.float64) * unit, flags.astype(np.uint32))


def _output(image: Image, raw: IntArray, total: npt.NDArray[np.generic]) -> npt.NDArray[np.generic]:
    if image.form == "float32":
        return raw.astype(np.float32) * np.float32(image.gain_f32) - total.astype(np.float32)
    nominal = shifted(raw * image.gain[0], image.gain[1])
    if image.form == "split":
        return nominal - (total.astype(np.float32) * np.float32(1e12)).astype(np.int64)
    sum30 = shifted(total.astype(np.int64), 30)
    if image.form == "fixed":
        held: IntArray = np.clip(nominal - sum30, -(1 << 31), (1 << 31) - 1)
        return held.astype(np.int32)
    return nominal - shifted(sum30 * image.correction[0], image.correction[1])


def _signals(image: Image, counts: Counts, settled: bool) -> tuple[list[IntArray], IntArray]:
    size = len(next(iter(counts.values())))
    flags = np.zeros(size, dtype=np.int64)
    z: list[IntArray] = []
    known: list[BoolArray] = []
    for i, signal in enumerate(image.signals):
        if signal.kind is Kind.CHANNEL:
            v = counts[signal.source].astype(np.int64)
            present: BoolArray = v != NO_VALUE
            flags |= np.where(present, 0, FLAG_NO_VALUE)
        else:
            present = known[signal.source]
            v = _derived(signal, z[signal.source], present, settled)
        inside = np.clip(v, signal.low, signal.high)
        flags |= np.where(present & (inside != v), 1 << i, 0)
        unit = np.clip(shifted((inside - signal.centre) * signal.recip, signal.shift), -ONE, ONE)
        z.append(np.where(present, unit, 0))
        known.append(present)
    return z, flags


def _derived(signal: Signal, source: IntArray, present: BoolArray, settled: bool) -> IntArray:
    p0, p1, p2 = signal.p
    if signal.kind is Kind.PARABOLA:
        t2 = shifted(2 * source * source, 30) - ONE
        return shifted(p0 * ONE + p1 * source + p2 * t2, 30)
    if signal.kind is Kind.PLAY:
        return np.zeros_like(source) if settled else _play(source, present, p0)
    behind = np.zeros_like(source) if settled else _behind(source, present, signal)
    return behind if signal.kind is Kind.BEHIND else source + behind


def _play(source: IntArray, present: BoolArray, width: int) -> IntArray:
    out, at = np.zeros_like(source), None
    for row, (now, there) in enumerate(zip(source.tolist(), present.tolist(), strict=True)):
        if there:
            at = now if at is None else min(max(at, now - width), now + width)
            out[row] = now - at
    return out


def _behind(source: IntArray, present: BoolArray, signal: Signal) -> IntArray:
    fade, bits, push = signal.p
    out, behind, last = np.zeros_like(source), 0, None
    for row, (now, there) in enumerate(zip(source.tolist(), present.tolist(), strict=True)):
        if there:
            last = now if last is None else last
            behind, last = behind - _shifted(behind * fade, bits) + _shifted((now - last) * push, 22), now
            out[row] = _shifted(behind, 8)
    return out


def _shifted(value: int, bits: int) -> int:
    """r(v, s) of one Python integer."""
    if bits == 0:
        return value
    size = (abs(value) + (1 << (bits - 1))) >> bits
    return size if value >= 0 else -size


def _integers(image: Image, z: list[IntArray]) -> IntArray:
    total = np.zeros(len(z[0]) if z else 0, dtype=np.int64)
    stored = np.array([i32(word) for word in image.coefficients], dtype=np.int64)
    for shape, a, b, n, first in image.blocks:
        own = stored[first:]
        if shape == Shape.SURFACE:
            one, two = _table(z[a], n), _table(z[b], n)
            for c, (i, j) in zip(own.tolist(), orders(n), strict=False):
                total += c * shifted(one[i] * two[j], 30)
        elif shape == Shape.SPLINE:
            piece, t = place(z[a], n)
            for k, row in enumerate(_table(t, 3)):
                total += own[4 * piece + k] * row
        else:
            for k, row in enumerate(_table(z[a], n)):
                total += own[k] * row
    return total


def place(z: IntArray, n: int) -> tuple[IntArray, IntArray]:
    """Piece of n and the place in it [ONE] of each z (n,)."""
    w = (z + ONE) * n
    piece = np.minimum(w >> 31, n - 1)
    return piece, w - (piece << 31) - ONE


def _table(z: IntArray, n: int) -> list[IntArray]:
    rows = [np.full_like(z, ONE), z]
    while len(rows) <= n:
        rows.append(shifted(2 * z * rows[-1], 30) - rows[-2])
    return rows[: n + 1]


def _floats(image: Image, z: list[IntArray]) -> SingleArray:
    total = np.zeros(len(z[0]) if z else 0, dtype=np.float32)
    stored = np.array([float_of(word) for word in image.coefficients], dtype=np.float32)
    for shape, a, b, n, first in image.blocks:
        own, part = stored[first:], np.zeros_like(total)
        if shape == Shape.SURFACE:
            one, two = _single_table(z[a], n), _single_table(z[b], n)
            for c, (i, j) in zip(own, orders(n), strict=False):
                part = part + (c * one[i]) * two[j]
        elif shape == Shape.SPLINE:
            piece, t = place(z[a], n)
            for k, row in enumerate(_single_table(t, 3)):
                part = part + own[4 * piece + k] * row
        else:
            for k, row in enumerate(_single_table(z[a], n)):
                part = part + own[k] * row
        total = total + part
    return total


def _single_table(z: IntArray, n: int) -> list[SingleArray]:
    unit = z.astype(np.float32) * np.float32(2.0**-30)
    rows = [np.ones_like(unit), unit]
    while len(rows) <= n:
        rows.append((np.float32(2.0) * unit) * rows[-1] - rows[-2])
    return rows[: n + 1]
