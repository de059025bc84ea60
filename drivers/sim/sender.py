"""A simulated unit whose frames somebody else's function makes: firmware under test in the place of our own unit."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TypeAlias

import can
import numpy as np

from drivers.can_record import CLASSICAL_BYTES
from drivers.errors import ConfigError
from drivers.frames import to_frames, to_messages, to_record
from drivers.sim.resonator import Environment


@dataclass(frozen=True, slots=True)
class Moment:
    """What surrounds a unit at one of its samples."""

    index: int
    """Number of the sample since power-on."""
    t_s: float
    """Bench time [s]."""
    temperature_degc: float
    """Temperature of the unit's case [degC]."""
    rate_dps: float
    """Rate of the rate table about its axis [deg/s]."""


Frames: TypeAlias = Callable[[Moment], Iterable[can.Message | tuple[int, bytes]]]
"""What a unit sends at a moment: python-can messages, or pairs of a CAN identifier and payload."""


class Sender:
    """Unit on an open python-can bus that sends every `sample_s` [s] what `frames` returns."""

    serial = 0

    def __init__(self, bus: can.BusABC, frames: Frames, sample_s: float, *, room: int = 8) -> None:
        """`room` is how many bytes its longest frame has."""
        self.bus, self.sample_s, self._make, self._room = bus, sample_s, frames, room
        self._index = 0

    def advance(self, environment: Environment) -> list[Moment]:
        """The moments of a piece of time."""
        count = environment.samples
        share = np.arange(count) / count
        temperatures = np.interp(share, (0.0, 1.0), environment.fixture_temperature)
        rates = np.asarray(environment.applied_rate_dps, dtype=np.float64)
        applied = np.interp(share, np.linspace(0.0, 1.0, len(rates)), rates)
        times = environment.t0_s + self.sample_s * np.arange(count)
        rows = zip(times.tolist(), temperatures.tolist(), applied.tolist(), strict=True)
        return [Moment(self._index + place, *row) for place, row in enumerate(rows)]

    def send(self, t0_s: float, signals: list[Moment]) -> None:
        """Send the frames of these moments."""
        records = []
        for moment in signals:
            for made in self._make(moment):
                try:
                    records.append(to_record(self._message(made), round(moment.t_s * 1e9), 0, self._room))
                except ValueError as error:
                    raise ConfigError(f"frame of sample {moment.index}: {error}") from None
        self._index += len(signals)
        if not records:
            return
        frames = to_frames(records)
        if hasattr(self.bus, "send_block"):
            self.bus.send_block(frames)
            return
        for one in to_messages(frames):
            self.bus.send(one)

    def reboot(self) -> None:
        """Count the samples from 0 again."""
        self._index = 0

    def _message(self, made: can.Message | tuple[int, bytes]) -> can.Message:
        if isinstance(made, can.Message):
            return made
        identifier, data = made
        return can.Message(
            arbitration_id=identifier,
            data=data,
            is_extended_id=identifier > 0x7FF,
            is_fd=self._room > CLASSICAL_BYTES,
        )
