"""Gyros on a data acquisition device: a package of others opens it and delivers its samples in blocks.

A package announces how its devices are opened as an entry point of the group `bench.daq`. Each sample becomes a
datagram of a packet line: the sample's number in 8 bytes, then a float64 for each column, all little endian. So what is
missing is counted by the number, and journal, check, doctor and runs are those of every other line.
"""

from __future__ import annotations

import struct
import time
from collections import deque
from collections.abc import Callable
from importlib.metadata import entry_points
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from drivers.errors import ConfigError, one_line

GROUP = "bench.daq"
"""Group of the entry points."""
SCHEME = "daq:"
"""What a channel begins with: daq:NAME/DEVICE."""
COUNTER_BYTES, COLUMN_BYTES = 8, 8


class SampleBlock(NamedTuple):
    """Samples that follow each other without a gap."""

    first: int
    """Number of the first one, counted from 0 by the device; a gap to the block before is what was lost."""
    values: NDArray[np.float64]
    """Shape (n, columns), in whatever unit the mapping of the unit states."""
    t_s: float | None = None
    """Time of the last one, as `time.time()` gives it [s]; None: now."""


class SampleSource(Protocol):
    """An open device. It runs from when it is opened; one thread of a process of its own calls it."""

    sample_s: float
    """Time from one sample to the next [s]."""

    def read(self, timeout_s: float | None) -> SampleBlock | None:
        """The next block, waiting up to a time [s], or without end for None; None: nothing came.

        OSError when the device failed; it is closed and opened again then.
        """

    def close(self) -> None:
        """Stop and release it."""


Opener = Callable[..., SampleSource]
"""What an entry point names: called with the device, and with the `options` of the bus as keywords."""


def open_source(channel: str, options: dict[str, Any]) -> SampleSource:
    """The device of a channel `daq:NAME/DEVICE`; ConfigError where no package offers it, OSError where it fails."""
    name, _, device = channel.removeprefix(SCHEME).partition("/")
    found = {entry.name: entry for entry in entry_points(group=GROUP)}
    if name not in found:
        known = ", ".join(sorted(found)) or "none"
        text = f"no installed package offers {name!r} in the group {GROUP}; known: {known}"
        raise ConfigError(f"channel {channel}: {text}")
    try:
        opener: Opener = found[name].load()
    except Exception as error:  # whatever the package of others raises
        raise ConfigError(f"channel {channel}: {found[name].value} cannot be loaded: {one_line(error)}") from error
    return opener(device, **options)


class DaqLine:
    """A device as a line: each sample is a datagram."""

    def __init__(self, channel: str, options: dict[str, Any], length: int | None) -> None:
        """`length`: bytes of a datagram, by the framing; ConfigError where a block is of another width."""
        self._channel, self._length = channel, length
        self._source = open_source(channel, options)
        self._waiting: deque[tuple[bytes, float]] = deque()

    def read(self, timeout: float | None) -> tuple[bytes, float] | None:
        """The next datagram and its time [s], within a time [s]; None: nothing. OSError when the device failed."""
        if not self._waiting:
            try:
                block = self._source.read(timeout)
            except OSError:
                raise
            except Exception as error:  # whatever the package of others raises
                raise OSError(f"{self._channel}: {type(error).__name__}: {one_line(error)}") from error
            if block is not None:
                self._take(block)
        return self._waiting.popleft() if self._waiting else None

    def close(self) -> None:
        """Release the device."""
        self._source.close()

    def _take(self, block: SampleBlock) -> None:
        values = np.asarray(block.values, dtype="<f8")
        if values.ndim != 2 or COUNTER_BYTES + COLUMN_BYTES * values.shape[1] != self._length:
            text = f"{self._channel}: a block has the shape {values.shape}, the framing says `length: {self._length}`"
            raise OSError(f"{text}; it is {COUNTER_BYTES} + {COLUMN_BYTES} for each column of a block (n, columns)")
        last_s = time.time() if block.t_s is None else block.t_s
        for row, sample in enumerate(values):
            t_s = last_s - (len(values) - 1 - row) * self._source.sample_s
            self._waiting.append((struct.pack("<Q", block.first + row) + sample.tobytes(), t_s))
