"""A model as a unit evaluates it: integer signals from counts to [-1, 1], and blocks of Chebyshev coefficients.

docs/eeprom.md describes the format with the same names and numbers. Coefficients are still in double precision;
`bench.deliver.export.forms` rounds them to the numbers that a form stores.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from bench.base import FloatArray

ONE = 1 << 30
"""1.0 in the integers of the signals."""
NO_VALUE = -(1 << 31)
"""Count that stands for a missing value."""
MOST_SIGNALS, MOST_BLOCKS, MOST_ORDER = 16, 16, 12


class Kind(IntEnum):
    """How a signal gets its raw value."""

    CHANNEL = 0
    LAG = 1
    PLAY = 2
    PARABOLA = 3
    BEHIND = 4


class Shape(IntEnum):
    """What a block computes."""

    SERIES = 1
    SURFACE = 2
    SPLINE = 3


@dataclass(frozen=True)
class Input:
    """A channel in the counts of the unit: `count` is one count in `unit`."""

    id: int
    name: str
    unit: str
    count: float


INPUTS: dict[str, Input] = {
    entry.name: entry
    for entry in (
        Input(0, "rate", "deg/s", 1e-6),
        Input(1, "temperature", "degC", 1e-6),
        Input(2, "frequency", "Hz", 1e-5),
        Input(3, "drive", "V", 1e-8),
        Input(4, "quadrature", "V", 1e-8),
        Input(5, "supply", "V", 1e-8),
        Input(8, "acceleration", "m/s^2", 1e-6),
    )
}


@dataclass(frozen=True)
class Signal:
    """One signal, integers as stored: v is clamped to [low, high], then z = (v - centre) * recip / 2^shift."""

    kind: Kind
    source: int
    low: int
    high: int
    centre: int
    recip: int
    shift: int
    p: tuple[int, int, int] = (0, 0, 0)


@dataclass(frozen=True, eq=False)
class Block:
    """Part of the correction over one or two signals; `coefficients` (N,) [output unit] over Chebyshev polynomials."""

    shape: Shape
    a: int
    b: int
    n: int
    coefficients: FloatArray

    @property
    def bound(self) -> float:
        """Greatest value that the sum of the terms can reach [output unit]."""
        size = np.abs(self.coefficients)
        return float(size.reshape(self.n, 4).sum(axis=1).max() if self.shape is Shape.SPLINE else size.sum())


@dataclass(frozen=True, eq=False)
class Delivery:
    """A delivery before it is rounded to a form; `gain` is one count of the raw output [output unit]."""

    model: str
    signals: tuple[Signal, ...]
    blocks: tuple[Block, ...]
    gain: float = 1e-6
    full_scale: float = 300.0
    output: int = 0
    axis: int = 0
    period_ns: int = 0
    created: int = 0
    valid_until: int = 0

    @property
    def order(self) -> int:
        """Greatest order of a polynomial."""
        return max((3 if block.shape is Shape.SPLINE else block.n for block in self.blocks), default=0)
