"""python-can interface `blocks`: a bus inside one process that carries frames in numpy blocks.

Any python-can program can use it; `Bus.send` and `Bus.recv` behave as on the `virtual` interface. `send_block` and
`recv_block` transfer whole FRAME arrays, which costs nanoseconds per frame instead of microseconds per Message.
"""

from __future__ import annotations

import threading
import time
from collections import defaultdict, deque
from collections.abc import Iterator
from typing import Any

import can
import numpy as np

from drivers.can_record import CLASSICAL_BYTES, FD_BYTES
from drivers.frames import NO_FRAMES, joined, to_frames, to_messages, to_record
from drivers.journal import FLAG_EXTENDED, FrameArray

_members: defaultdict[str, list[BlockBus]] = defaultdict(list)
_members_lock = threading.Lock()


class BlockBus(can.BusABC):
    """One connection to a named channel; all other connections receive its frames in order, without loss.

    A block keeps the time stamps of its sender; a Message gets the time of sending, as on `virtual`, unless
    `preserve_timestamps` is set.
    """

    def __init__(
        self,
        channel: Any = "channel-0",
        can_filters: Any = None,
        receive_own_messages: bool = False,
        preserve_timestamps: bool = False,
        fd: bool = False,
        **_: Any,
    ) -> None:
        self._room = FD_BYTES if fd else CLASSICAL_BYTES
        self.channel_id = str(channel)
        self.channel_info = f"Block bus channel {self.channel_id}"
        self.receive_own_messages = receive_own_messages
        self.preserve_timestamps = preserve_timestamps
        self._blocks: deque[FrameArray] = deque()
        self._messages: Iterator[can.Message] = iter(())
        self._unread = 0  # messages of the block that `recv` is in
        self._block = NO_FRAMES
        self._arrived = threading.Condition()
        super().__init__(channel=channel, can_filters=can_filters)
        with _members_lock:
            _members[self.channel_id].append(self)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send one message; CanOperationError for one that is too long, or on a closed bus."""
        t_s = msg.timestamp if self.preserve_timestamps else time.time()
        try:
            record = to_record(msg, round(t_s * 1e9), 0, self._room)
        except ValueError as error:
            raise can.CanOperationError(str(error)) from None
        self.send_block(to_frames([record]))

    def send_block(self, frames: FrameArray) -> None:
        """Send FRAME records (n,) with their own time stamps; CanOperationError on a closed bus."""
        self._check_open()
        if not len(frames):
            return
        block = frames if not frames.flags.writeable else frames.copy()
        block.flags.writeable = False
        with _members_lock:
            receivers = [bus for bus in _members[self.channel_id] if bus is not self or self.receive_own_messages]
        for bus in receivers:
            with bus._arrived:
                bus._blocks.append(block)
                bus._arrived.notify_all()

    def recv_block(self, timeout: float | None = 0.0) -> FrameArray:
        """All frames that have arrived, (n,), waiting up to `timeout` [s] for the first; filters apply."""
        self._check_open()
        with self._arrived:
            rest = self._block[len(self._block) - self._unread :]
            self._messages, self._block, self._unread = iter(()), NO_FRAMES, 0
            if not len(rest):
                self._arrived.wait_for(lambda: bool(self._blocks), timeout)
            blocks = [rest, *self._blocks] if len(rest) else list(self._blocks)
            self._blocks.clear()
        if not blocks:
            return NO_FRAMES
        frames = joined(blocks)
        return frames[self._accepted(frames)] if self.filters else frames

    def shutdown(self) -> None:
        """Leave the channel; a second call does nothing."""
        with _members_lock:
            members = _members.get(self.channel_id, [])
            if self in members:
                members.remove(self)
            if not members:
                _members.pop(self.channel_id, None)
        super().shutdown()

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        self._check_open()
        with self._arrived:
            if not self._unread:
                self._arrived.wait_for(lambda: bool(self._blocks), timeout)
                if not self._blocks:
                    return None, False
                self._block = self._blocks.popleft()
                self._unread = len(self._block)
                self._messages = to_messages(self._block, self.channel_id)
            self._unread -= 1
            return next(self._messages), False

    def _accepted(self, frames: FrameArray) -> Any:
        accepted = np.zeros(len(frames), dtype=bool)
        extended = frames["flags"] & FLAG_EXTENDED != 0
        for rule in self.filters or ():
            hit = (frames["id"] ^ np.uint32(rule["can_id"])) & np.uint32(rule["can_mask"]) == 0
            accepted |= hit & (extended == rule["extended"]) if "extended" in rule else hit
        return accepted

    def _check_open(self) -> None:
        if self._is_shutdown:
            raise can.CanOperationError(f"{self.channel_info} is closed")
