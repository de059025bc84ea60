"""A CAN bus with faults: wraps any python-can bus and injects named faults into its frames.

Works on whole FRAME arrays, so it serves the lock-step simulation (`recv_block`) and single messages (`recv`) alike;
on the sending side it can wrap the bus of a simulated unit (`send_block`). Time is that of the frames, not wall time.
The same seed and the same frames give the same faults.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import can
import numpy as np

from drivers.frames import NO_FRAMES, joined, to_frames, to_messages, to_record
from drivers.journal import FLAG_ERROR, FRAME, FrameArray
from drivers.sim.faults.named import ON_BUS
from drivers.sim.faults.units import Layout


@dataclass
class Fault:
    """A fault that is switched on, and the frames that it holds back."""

    name: str
    share: float
    seconds: float
    held: FrameArray
    until_ns: int | None = None


class FaultyBus(can.BusABC):
    """Wraps a bus with faults; `layout` and `number` name the unit that `reset` and `twin` affect.

    `counts` is the number of frames that each fault has affected, `struck` the same by fault and identifier.
    Closing this bus closes the wrapped one.
    """

    def __init__(self, bus: can.BusABC, *, seed: int = 1, layout: str | Path = "vibratory", number: int = 0) -> None:
        self.bus = bus
        self.counts: Counter[str] = Counter()
        self.struck: Counter[tuple[str, int]] = Counter()
        self.channel_info = f"{bus.channel_info} with faults"
        self._layout = Layout(layout, number)
        self._rng = np.random.default_rng(seed)
        self._faults: list[Fault] = []
        self._released: list[FrameArray] = []
        self._restarted: int | None = None  # what the counter of the unit read at its last reset
        self._messages: deque[can.Message] = deque()
        super().__init__(channel=self.channel_info)

    def inject(self, name: str, *, share: float = 1.0, seconds: float = 0.0) -> None:
        """Switch a fault on; several faults are applied in the order in which they were switched on."""
        if name not in ON_BUS:
            raise ValueError(f"fault {name!r} on a CAN bus: must be one of {', '.join(ON_BUS)}")
        self._faults.append(Fault(name, share, seconds, NO_FRAMES))

    def clear(self, name: str | None = None) -> None:
        """Switch this fault off, or all; frames held back arrive with the next ones. A reset cannot be undone."""
        for fault in [fault for fault in self._faults if name in (None, fault.name)]:
            self._faults.remove(fault)
            self._released.append(fault.held)

    def recv_block(self, timeout: float | None = 0.0) -> FrameArray:
        """Frames that arrived, (n,); CanOperationError while the bus is off."""
        self._check("receive")
        if hasattr(self.bus, "recv_block"):
            return self._spoil(self.bus.recv_block(timeout))
        records = []
        while (message := self.bus.recv(timeout)) is not None:
            records.append(to_record(message, round(message.timestamp * 1e9)))
            timeout = 0.0
        return self._spoil(to_frames(records) if records else NO_FRAMES)

    def send_block(self, frames: FrameArray) -> None:
        """Send FRAME records (n,) with faults; CanOperationError while the bus is off."""
        self._check("send")
        self._forward(self._spoil(frames))

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send one message with faults; CanOperationError while the bus is off."""
        self._check("send")
        self._forward(self._spoil(to_frames([to_record(msg, round(msg.timestamp * 1e9))])))

    def shutdown(self) -> None:
        """Close this bus and the wrapped one."""
        super().shutdown()
        self.bus.shutdown()

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        self._check("receive")
        if not self._messages:
            message = self.bus.recv(timeout)
            if message is not None:
                record = to_record(message, round(message.timestamp * 1e9))
                self._messages.extend(to_messages(self._spoil(to_frames([record]))))
        return (self._messages.popleft() if self._messages else None), False

    def _forward(self, frames: FrameArray) -> None:
        if hasattr(self.bus, "send_block"):
            self.bus.send_block(frames)
            return
        for message in to_messages(frames):
            self.bus.send(message)

    def _check(self, what: str) -> None:
        if any(fault.name == "bus_off" for fault in self._faults):
            self.counts["bus_off"] += 1
            raise can.CanOperationError(f"cannot {what}: bus off")

    # ---- frames in, frames out --------------------------------------------------------------------------------------

    def _spoil(self, frames: FrameArray) -> FrameArray:
        self._layout.listen(frames)
        if self._restarted is not None:
            frames = self._layout.counted_from(frames, -self._restarted)
        for fault in list(self._faults):
            spoil: Callable[[Fault, FrameArray], FrameArray] = getattr(self, f"_{fault.name}")
            frames = spoil(fault, frames)
        if self._released and len(frames):
            now_ns = frames["t_ns"][0]
            frames = joined([*(_stamped(part, now_ns) for part in self._released), frames])
            self._released.clear()
        return frames

    def _struck(self, fault: Fault, frames: FrameArray) -> Any:
        """Frames (n,) that the fault affects."""
        hit = self._rng.random(len(frames)) < fault.share
        self._count(fault, frames[hit])
        return hit

    def _count(self, fault: Fault, frames: FrameArray) -> None:
        self.counts[fault.name] += len(frames)
        for identifier, number in zip(*np.unique(frames["id"], return_counts=True), strict=True):
            self.struck[fault.name, int(identifier)] += int(number)

    def _loss(self, fault: Fault, frames: FrameArray) -> FrameArray:
        kept: FrameArray = frames[~self._struck(fault, frames)]
        return kept

    def _silence(self, fault: Fault, frames: FrameArray) -> FrameArray:
        self._count(fault, frames)
        return frames[:0]

    def _duplicate(self, fault: Fault, frames: FrameArray) -> FrameArray:
        return np.repeat(frames, 1 + self._struck(fault, frames))

    def _corrupt(self, fault: Fault, frames: FrameArray) -> FrameArray:
        rows = np.flatnonzero(self._struck(fault, frames) & (frames["len"] > 0))
        frames = frames.copy()
        byte = self._rng.integers(0, 256, len(rows)) % frames["len"][rows]
        frames["data"][rows, byte] ^= np.uint8(1) << self._rng.integers(0, 8, len(rows), dtype=np.uint8)
        return frames

    def _reorder(self, fault: Fault, frames: FrameArray) -> FrameArray:
        if not len(frames):
            return frames
        hit = self._struck(fault, frames)
        place = np.arange(len(frames)) + 1.5 * hit
        stays = place < len(frames)  # a last frame that is overtaken waits for the next block
        order = np.argsort(place[stays], kind="stable")
        kept = frames[stays][order]
        out = joined((kept[:1], fault.held, kept[1:]))
        fault.held = frames[~stays] if len(kept) else joined((fault.held, frames))
        out["t_ns"] = np.maximum.accumulate(out["t_ns"])  # stamped when it arrives
        return out if len(kept) else frames[:0]

    def _burst(self, fault: Fault, frames: FrameArray) -> FrameArray:
        held = joined((fault.held, frames))
        if not len(held):
            return held
        if fault.until_ns is None:
            fault.until_ns = int(held["t_ns"][0]) + round(fault.seconds * 1e9)
        late = held["t_ns"] < fault.until_ns
        if late.all():
            fault.held = held
            return held[:0]
        self.counts[fault.name] += int(np.count_nonzero(late))
        held["t_ns"][late] = fault.until_ns
        self._faults.remove(fault)
        return held

    def _error_frames(self, fault: Fault, frames: FrameArray) -> FrameArray:
        rows = np.flatnonzero(self._struck(fault, frames))
        errors = np.zeros(len(rows), dtype=FRAME)
        errors["t_ns"], errors["flags"], errors["len"] = frames["t_ns"][rows], FLAG_ERROR, 8
        out: FrameArray = np.insert(frames, rows, errors)
        return out

    def _reset(self, fault: Fault, frames: FrameArray) -> FrameArray:
        return self._restart(fault, frames, announced=True)

    def _silent_reset(self, fault: Fault, frames: FrameArray) -> FrameArray:
        return self._restart(fault, frames, announced=False)

    def _restart(self, fault: Fault, frames: FrameArray, *, announced: bool) -> FrameArray:
        mine = self._layout.is_unit(frames)
        if not mine.any():
            return frames
        if fault.until_ns is None:
            fault.until_ns = int(frames["t_ns"][mine][0]) + round(fault.seconds * 1e9)
        first = self._layout.first_rate(frames, fault.until_ns)
        if first is None:
            self.counts[fault.name] += int(np.count_nonzero(mine))
            return frames[~mine]
        self.counts[fault.name] += int(np.count_nonzero(mine[:first]))
        counter = self._layout.counter(frames[first : first + 1])
        self._restarted = (self._restarted or 0) + counter
        self._faults.remove(fault)
        after = self._layout.counted_from(frames[first:], -counter)
        boot = self._layout.boot(frames[first]) if announced else frames[:0]
        return np.concatenate((frames[:first][~mine[:first]], boot, after))

    def _twin(self, fault: Fault, frames: FrameArray) -> FrameArray:
        other = self._layout.twin(frames)
        self.counts[fault.name] += len(other)
        both = np.concatenate((frames, other))
        return both[np.argsort(both["t_ns"], kind="stable")]


def _stamped(frames: FrameArray, not_before_ns: int) -> FrameArray:
    frames = frames.copy()
    frames["t_ns"] = np.maximum(frames["t_ns"], not_before_ns)
    return frames
