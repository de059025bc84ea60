"""What the decoder of a gyro hands out: samples of a block of frames, heartbeats, and counts of what was lost."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from drivers.samples import FloatArray, IntArray
from drivers.states import BoolArray
from drivers.wire import Signal


@dataclass(frozen=True)
class Losses:
    """What happened to the frames of one unit. Each count but `received` and `out_of_order` left a gap in the data."""

    received: int = 0  # frames of this unit, all messages
    lost: int = 0  # rate samples for which no sound frame arrived
    slow_lost: int = 0  # slow samples for which no sound frame arrived
    corrupt: int = 0  # wrong CRC, wrong length, or a counter that fits nothing
    repeated: int = 0  # the same sample again
    late: int = 0  # arrived too long after its sample was taken
    out_of_order: int = 0  # overtaken by a later frame; put back in its place when its block was still open
    invalid: int = 0  # the unit itself says so, or the rate is at the end of its range
    resets: int = 0  # the unit started anew

    def as_dict(self) -> dict[str, int]:
        """Counts by name."""
        return dict(vars(self))


@dataclass(frozen=True)
class Series:
    """A slow channel: `value` (m,) in the unit of the channel, sampled with the rate samples `index` (m,)."""

    index: IntArray
    value: FloatArray


@dataclass(frozen=True)
class Beats:
    """Heartbeats (m,): the newest rate sample `index` (m,) when each came, and what they say is wrong."""

    index: IntArray
    why: Sequence[str] = ()
    """(m,); empty where all is well."""


@dataclass(frozen=True)
class Thermometer:
    """The unit's own temperature on its wire."""

    channel: str
    """Its channel: `temperature`, or `temperature_1`."""
    lowest_degc: float
    highest_degc: float
    """Values outside are no measurements [degC]."""
    step_degc: float
    every: int | None
    """A sample after so many rate samples; None: the DBC does not say."""


@dataclass(frozen=True)
class Code:
    """A channel on its wire: value = (raw * scale + offset) * factor, in the unit of the channel."""

    bits: int
    """Of the raw value; 0: it is no integer."""
    signed: bool
    scale: float
    offset: float
    factor: float

    @classmethod
    def of(cls, signal: Signal, factor: float) -> Code:
        """That of a signal of the DBC."""
        return cls(0 if signal.is_float else signal.length, signal.signed, signal.scale, signal.offset, factor)


@dataclass(frozen=True)
class GyroBlock:
    """Samples of one block of frames; indices increase strictly, over blocks too. What is missing is a gap."""

    index: IntArray  # sample index (n,)
    t_ns: IntArray  # bench time of arrival [ns] (n,)
    rate_dph: FloatArray  # [deg/h] (n,), NaN where not valid
    valid: BoolArray  # (n,)
    slow: Mapping[str, Series]  # by channel name, see bench.base.channels
    faults: Mapping[str, BoolArray] = field(default_factory=dict)  # samples (n,) that are not valid, by reason
    corrected: BoolArray | None = None  # samples (n,) that the unit corrected itself; None: none
    beats: Beats = field(default_factory=lambda: Beats(np.zeros(0, dtype=np.int64)))
