"""A simulated unit with several outputs on its bus: any layout whose messages are not multiplexed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import can
import numpy as np

from drivers.can_record import CLASSICAL_BYTES, FLAG_EXTENDED, FLAG_FAST, FLAG_FD, FrameArray, frame_type
from drivers.errors import ConfigError
from drivers.frames import to_messages
from drivers.layout import Layout
from drivers.wire import Message

BOOT_UP, OPERATIONAL = 0, 5


def refuse_multiplexed(layout: Layout) -> None:
    """ConfigError for a layout with multiplexed messages."""
    if any(source.choice is not None for source in (layout.first, *layout.others)):
        raise ConfigError("a simulated unit sends no multiplexed messages")


class CanUnit:
    """Unit `number` on an open python-can bus; sends the values of its channels sample by sample."""

    def __init__(self, bus: can.BusABC, layout: Layout, number: int, serial: int, *, room: int = 8) -> None:
        """`room` is how many bytes its longest frame has. ConfigError for a layout with multiplexed messages."""
        refuse_multiplexed(layout)
        self.bus, self.layout, self.number, self.serial, self._room = bus, layout, number, serial, room
        self.sample_s = layout.interval_ms * 1e-3
        """True time between two samples [s]."""
        self.counter, self._booted = 0, False
        self.coefficient_set = self.status = 0
        """What the calibration memory says, where there is one; the layouts have no place for its status."""

    def reboot(self) -> None:
        """Start the sample counter again at 0, with a boot-up heartbeat before the next sample."""
        self.counter, self._booted = 0, False

    def go_on(self, samples: int) -> None:
        """Count on after so many samples, as a unit that has kept its power."""
        self.counter, self._booted = samples, True

    def send(self, t0_s: float, values: Mapping[str, np.ndarray[Any, Any]]) -> None:
        """Send the frames of samples (n,) by channel, in the units of the channels, from bench time `t0_s` [s] on."""
        count = len(next(iter(values.values())))
        parts = []
        if self.layout.beat is not None and not self._booted:
            parts.append(self._beat(np.zeros(1, dtype=np.int64), BOOT_UP))
        for message in self.layout.messages:
            due = self._due(message, count)
            if self.layout.beat is not None and message is self.layout.beat.message:
                parts.append(self._beat(due, OPERATIONAL))
            else:
                parts.append(self._frames(message, due, self._signals(message, due, values)))
        frames = np.concatenate(parts)
        frames = frames[np.argsort(frames["t_ns"], kind="stable")]
        frames["t_ns"] += round(t0_s * 1e9)
        self.counter, self._booted = self.counter + count, True
        if hasattr(self.bus, "send_block"):
            self.bus.send_block(frames)
            return
        for one in to_messages(frames):
            self.bus.send(one)

    def _due(self, message: Message, count: int) -> np.ndarray[Any, Any]:
        every = max(round((message.cycle_ms or self.layout.interval_ms) / self.layout.interval_ms), 1)
        return np.flatnonzero((self.counter + np.arange(count)) % every == 0)

    def _signals(
        self, message: Message, due: np.ndarray[Any, Any], values: Mapping[str, np.ndarray[Any, Any]]
    ) -> dict[str, Any]:
        """Physical values of the signals of a message; what nobody maps is 0, status signals say what is valid."""
        sample = self.counter + due
        found: dict[str, Any] = dict.fromkeys(message.signals, 0)
        for source in (self.layout.first, *self.layout.others):
            if source.message is message:
                found |= source.states.sound()
                found |= {signal.name: values[name][due] / factor for name, (signal, factor) in source.channels.items()}
                if source.counter is not None:
                    found[source.counter.name] = sample & (1 << source.counter.length) - 1
        if self.layout.stamp is not None and message is self.layout.first.message:
            signal, step_s = self.layout.stamp
            raw = np.rint(sample * self.sample_s / step_s).astype(np.int64) & (1 << signal.length) - 1
            found[signal.name] = raw * signal.scale + signal.offset
        return found

    def _beat(self, due: np.ndarray[Any, Any], state: int) -> FrameArray:
        beat = self.layout.beat
        assert beat is not None
        said = {"state": state, "serial": self.serial, "firmware": 0x0100, "coefficient_set": self.coefficient_set}
        values = dict.fromkeys(beat.message.signals, 0) | beat.states.sound()
        values |= {signal.name: said[what] for what, signal in beat.signals.items()}
        return self._frames(beat.message, due, values)

    def _frames(self, message: Message, due: np.ndarray[Any, Any], values: Mapping[str, Any]) -> FrameArray:
        given = {name: value for name, value in values.items() if name != "Crc8"}
        data = message.pack(len(due), given)
        if "Crc8" in message.signals:
            data[:, message.length - 1] = message.crc(data, message.id + self.number)
        frames = np.zeros(len(due), dtype=frame_type(self._room))
        frames["t_ns"] = np.rint(due * (self.sample_s * 1e9)).astype(np.int64)
        frames["id"], frames["len"] = message.id + self.number, message.length
        frames["flags"] = FLAG_EXTENDED * message.extended | (FLAG_FD | FLAG_FAST) * (self._room > CLASSICAL_BYTES)
        frames["data"][:, : message.length] = data[:, : message.length]
        return frames
