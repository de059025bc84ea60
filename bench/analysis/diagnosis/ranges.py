"""What the channels of some runs reach, and which of them move."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property

import numpy as np

from bench.analysis.diagnosis.blocks import Bounds
from bench.base import INSTRUMENTS, OTHERS, THERMOMETERS, BoolArray, FloatArray
from bench.record import Dataset

_FURTHER = ("frequency", "drive", "quadrature", "supply", "applied_rate",
            *(name for name in INSTRUMENTS[1:] if "temperature" not in name), *OTHERS)  # fmt: skip
"""Not thermometers: each would be a look-alike of the unit's own."""
_SWITCHED = ("compressor",)
_THERMOMETERS = (*THERMOMETERS[1:], *(name for name in INSTRUMENTS if "temperature" in name))
UNCATALOGUED = frozenset({*THERMOMETERS[1:], *INSTRUMENTS[1:], *OTHERS})
"""Channels that no effect of the catalogue rests on."""
_LEAST_APART = 0.01  # of the range of temperature


class Ranges:
    """Ranges of the channels that these runs have and move, at the rows that are searched."""

    def __init__(self, records: Sequence[Dataset], masks: Sequence[BoolArray]) -> None:
        """`masks` (n,) are the rows that are searched."""
        self._records, self._masks = records, masks
        self.temperature = self.of("temperature")
        self.moved = tuple(name for name in _FURTHER if self._moves(name))
        self.switched = tuple(name for name in _SWITCHED if self._moves(name))
        self.gap = self._moves("chamber_temperature")
        self.apart = (*(["chamber_temperature"] if self.gap else []), *filter(self._differs, _THERMOMETERS))
        self.length_s = max(float(np.ptp(record.time)) for record in records)

    @cached_property
    def fastest(self) -> float:
        """The largest |dT/dt| [degC/min]."""
        return max(float(np.nanmax(np.abs(part))) for part in self._parts(lambda record: record.dT_dt))

    def widest(self, name: str = "chamber_temperature") -> float:
        """The largest gap between another thermometer, that of the air by default, and the unit's [degC]."""
        gaps = self._parts(lambda record: record.channels[name] - record.channel("temperature"))
        return max(float(np.max(np.abs(part))) for part in gaps)

    def of(self, name: str) -> Bounds:
        """Least and largest value of a channel."""
        values = self.values(name)
        return float(np.nanmin(values)), float(np.nanmax(values))

    def values(self, name: str) -> FloatArray:
        """Values of a channel in all runs, one after the other."""
        return np.concatenate(self._parts(lambda record: record.channel(name)))

    def _parts(self, values: Callable[[Dataset], FloatArray]) -> list[FloatArray]:
        """Values of each record at the rows that are searched."""
        return [values(record)[mask] for record, mask in zip(self._records, self._masks, strict=True)]

    def _differs(self, name: str) -> bool:
        """Whether a thermometer moves otherwise than the unit's."""
        if not self._moves(name):
            return False
        gap = self.values(name) - self.values("temperature")
        low, high = self.temperature
        return bool(np.ptp(gap) > _LEAST_APART * (high - low))

    def _moves(self, name: str) -> bool:
        if not all(name in record.channels for record in self._records):
            return False
        if not all(np.all(np.isfinite(r.channels[name][m])) for r, m in zip(self._records, self._masks, strict=True)):
            return False
        low, high = self.of(name)
        return high - low > 1e-9 * max(abs(low), abs(high), 1e-9)


def inner(low: float, high: float, count: int) -> tuple[tuple[float], ...]:
    """Values to try, evenly spaced without the two ends."""
    return tuple((float(c),) for c in np.linspace(low, high, count)[1:-1])
