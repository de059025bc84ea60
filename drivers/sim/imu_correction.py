"""Arithmetic of a simulated inertial unit: reads its image as docs/eeprom.md defines it, and compensates samples.

Written from that document, independently of the code that makes images. Numbers are float32, as there.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from drivers.sim.correction import FLAG_NO_VALUE, RefusedImageError, SingleArray
from drivers.sim.truth.base import FloatArray

MAGIC = 0x49425447
_HEADER, _AXIS, _AXES = 16, 19, 6
_F = np.float32


@dataclass(frozen=True)
class _Axis:
    thermometer: int
    low: float
    high: float
    curves: tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class ImuCorrection:
    """An accepted image."""

    CHANNELS: ClassVar[tuple[str, ...]] = tuple(f"{what}_{a}" for what in ("rate", "acceleration") for a in "xyz")

    axes: tuple[_Axis, ...]

    @classmethod
    def read(cls, content: bytes, serial: int, room_words: int) -> ImuCorrection:
        """The image in these bytes; RefusedImageError by the rules of the document."""
        words = struct.unpack(f"<{len(content) // 4}I", content[: len(content) // 4 * 4])
        singles = struct.unpack(f"<{len(words)}f", content[: 4 * len(words)])
        size = _HEADER + _AXES * _AXIS + words[10] + 1 if len(words) > _HEADER else 0
        for wrong, why in (
            (not size or words[0] != MAGIC, "no image"),
            (bool(size) and words[1] != 1, "format version"),
            (words[3:4] != (size,) or not size == len(words) <= room_words, "length"),
            (bool(size) and zlib.crc32(content[: 4 * size - 4]) != words[-1], "CRC"),
            (bool(size) and (words[4] != serial or words[6] != _AXES), "serial number or axes"),
            (bool(size) and (words[9] > 9 or words[11] > 12), "too large"),
        ):
            if wrong:
                raise RefusedImageError(why)
        axes = []
        for i in range(_AXES):
            at, curves = _HEADER + _AXIS * i, []
            for slot in range(8):
                count, first = words[at + 3 + 2 * slot : at + 5 + 2 * slot]
                if count > words[11] + 1 or first + count > words[10]:
                    raise RefusedImageError(f"coefficients of axis {i}")
                begin = _HEADER + _AXIS * _AXES + first
                curves.append(singles[begin : begin + count])
            if words[at] >= words[9] or not singles[at + 1] <= singles[at + 2]:
                raise RefusedImageError(f"thermometer or range of axis {i}")
            axes.append(_Axis(words[at], singles[at + 1], singles[at + 2], tuple(curves)))
        if not np.isfinite(singles[_HEADER + _AXIS * _AXES : -1]).all():
            raise RefusedImageError("a coefficient is not finite")
        return cls(tuple(axes))

    def apply(self, signals: Mapping[str, FloatArray]) -> tuple[dict[str, FloatArray], int]:
        """Channels (n,) as the unit sends them, rates in deg/h and forces in m/s^2, and the flags of all samples."""
        names = self.CHANNELS
        raw = np.stack([np.asarray(signals[name], dtype=_F) for name in names], axis=1)
        raw[:, :3] /= _F(3600.0)
        curves, flags = self._curves(signals, len(raw))
        y, own = raw[:, 3:], curves[:, 3:]
        d = _less(own, y, own[:, :, 0])
        for _ in range(3):
            d = _less(own, y, own[:, :, 0] + own[:, :, 7] * (y - d) ** 2)
        force = y - d
        y, own = raw[:, :3], curves[:, :3]
        rate = y - _less(own, y, own[:, :, 0] + np.einsum("nij,nj->ni", own[:, :, 4:7], force))
        there = np.asarray(np.isfinite(raw).all(axis=1)).reshape(-1, 1)
        out = np.where(there, np.hstack([_F(3600.0) * rate, force]), _F(0.0)).astype(np.float64)
        flags |= 0 if there.all() else FLAG_NO_VALUE
        return {**signals, **{name: out[:, i] for i, name in enumerate(names)}}, flags

    def _curves(self, signals: Mapping[str, FloatArray], rows: int) -> tuple[SingleArray, int]:
        out, flags = np.zeros((rows, _AXES, 8), dtype=_F), 0
        for i, axis in enumerate(self.axes):
            name = f"temperature_{axis.thermometer + 1}"
            degc = np.asarray(signals.get(name, signals.get("temperature", np.full(rows, np.nan))), dtype=_F)
            middle = _F(0.5 * (axis.low + axis.high))
            if not np.isfinite(degc).all():
                flags |= FLAG_NO_VALUE
            degc = np.where(np.isfinite(degc), degc, middle)
            if ((degc < axis.low) | (degc > axis.high)).any():
                flags |= 1 << i
            width = _F(axis.high - axis.low) or _F(1.0)
            z = (2.0 * np.clip(degc, axis.low, axis.high) - _F(axis.low) - _F(axis.high)) / width
            for slot, curve in enumerate(axis.curves):
                last, before = np.ones(rows, dtype=_F), z
                for k, c in enumerate(curve):
                    out[:, i, slot] += _F(c) * last
                    last, before = (z, _F(2.0) * z * z - _F(1.0)) if k == 0 else (before, _F(2.0) * z * before - last)
        return out, flags


def _less(own: SingleArray, y: SingleArray, rest: SingleArray) -> SingleArray:
    """Output less input (n, 3): (1 + M)^-1 (M y + rest)."""
    added = np.einsum("nij,nj->ni", own[:, :, 1:4], y) + rest
    return np.asarray(np.linalg.solve(np.eye(3, dtype=_F) + own[:, :, 1:4], added[..., None])[..., 0])
