"""A unit on CAN: converts blocks of captured frames to samples, and counts every frame that it rejects.

cantools reads the DBC once; numpy decodes the frames. `drivers.layout` finds the signals: by a mapping, or in a DBC by
the names that the bench knows:

* `Rate`, `SampleCounter` in one message: one sample of the rate
* `Temperature`, `ResonanceFrequency`, `DriveAmplitude`, `QuadratureAmplitude`, `SupplyVoltage` in slower messages, each
  with a `SlowCounter`: the low bits of `SampleCounter` at the moment of sampling
* `Serial`, `Firmware`, `CoefficientSet`, `State` in a heartbeat
* `Crc8` as last byte: CRC-8/SAE-J1850 over the bytes before it and the low byte of the identifier
* status signals in any of these messages: see `drivers.states`

The message of the first output gives the samples; all other channels are placed beside them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from drivers.block import Beats, Code, GyroBlock, Losses, Series, Thermometer
from drivers.cycle import BITS, CycleCount, StampCount
from drivers.identity import Identity, Impostors
from drivers.journal import FLAG_ERROR, FLAG_EXTENDED, FLAG_REMOTE, FrameArray
from drivers.layout import OUTPUTS, THERMOMETERS, Layout, Source, layout_of
from drivers.samples import CounterTrack, FloatArray, IntArray, SampleClock
from drivers.slow import Beside, Reference
from drivers.states import BoolArray
from drivers.wire import ByteArray, Message, Signal

__all__ = ["Beats", "GyroBlock", "GyroDecoder", "Identity", "Losses", "SampleClock", "Series", "Thermometer"]

_WORD = np.dtype("<u8")
_KIND = (0xFF & ~(FLAG_EXTENDED | FLAG_REMOTE | FLAG_ERROR)) << 32
_HEAD, _IDENTIFIED = np.uint64(0xFFFF_FFFF_FFFF & ~_KIND), np.uint64(0xFF_FFFF_FFFF)
"""Masks of the second word of a record: identifier, flags and length; identifier and flags."""
WordArray = npt.NDArray[np.uint64]
BOOT_UP = 0


class GyroDecoder:
    """Decodes the frames of unit `number` of a gyro family. Stateful: pass the blocks in the order of capture.

    `losses` counts since the start, `identity` is that of the last heartbeat (None before the first), `last` holds
    the latest value of each slow channel, `samples` the number of rate samples delivered.
    """

    def __init__(
        self, dbc: str | Path | None, number: int, signals: Mapping[str, Any] | None = None, *, late_s: float = 0.5
    ) -> None:
        """`signals` is a mapping as in the station file; without one the DBC has the names that the bench knows."""
        self._describe(layout_of(dbc, signals))
        self._counts: dict[str, int] = {}
        self._losses: Losses | None = Losses()
        self.identity: Identity | None = None
        self.last: dict[str, float] = {}
        self.samples = 0
        self._number = number
        self._impostors = Impostors(number, self._interval_ns)
        self._made = _made_counter(self.layout, self._interval_ns)
        self._track = CounterTrack(self.counter_bits or BITS, self._interval_ns, late_s)
        self._heads = b"?"  # of the last block
        self._rows: dict[str, tuple[int, IntArray]] = {}  # by message: number of frames, rows of the right length
        self._reference: Reference | None = None  # the last intact rate frame
        self._unchanged = b""  # payload of the last heartbeats, while it does not change
        self._claim: tuple[int, ...] = ()  # identity in the last heartbeat
        self._booted = False  # a boot-up heartbeat arrived and no rate frame since
        self._beats: tuple[IntArray, Mapping[str, BoolArray]] = np.zeros(0, dtype=np.int64), {}
        self._newest = 0  # the newest sample
        self.twins_at: int | None = None
        """A sample before it was certain that two units send; of those afterwards none is taken."""

    def _describe(self, layout: Layout) -> None:
        """What the unit sends."""
        self.layout = layout
        self.output = layout.output
        """Channel of the first output."""
        self._first, self._rate = layout.first, layout.first.message
        self.interval_s = layout.interval_ms * 1e-3
        self._interval_ns = round(layout.interval_ms * 1e6)
        self._beat = layout.beat
        self._signal, self._rate_factor = self._first.channels[self.output]
        self.rate_step_dph = self._signal.scale * self._rate_factor
        self.tells_correction = self._first.states.tells_correction
        """Whether each sample says if the unit corrected it."""
        self._slow = [Beside(source, self.interval_s) for source in layout.others]
        self.codes = {name: Code.of(signal, factor) for name, (signal, factor) in layout.channels.items()}
        """What each channel is on the wire, by name."""
        self.outputs = tuple(name for name in OUTPUTS if name in self.codes)
        """Its outputs; those after the first are channels of `slow`, sampled as often or not."""
        self.thermometer = _thermometer(layout, self._slow)
        cycle_ms = (self._beat.message.cycle_ms if self._beat else None) or 0.0
        self.beat_every = round(cycle_ms * 1e-3 / self.interval_s)
        """Rate samples between heartbeats; 0: there is none, or the DBC does not say."""
        self.counter_bits = 0 if self._first.counter is None else self._first.counter.length
        """Of the unit's own sample counter; 0: it has none."""

    def decode(self, frames: FrameArray) -> GyroBlock:
        """Samples of FRAME records in the order of capture; frames of other units are ignored."""
        words = np.ascontiguousarray(frames).view(_WORD).reshape(-1, frames.dtype.itemsize // 8)
        self._sort(words)
        boot = self._read_heartbeat(words)
        sound = {self._rate.name: self._sound(words, self._rate)}
        at, data = self._of(self._first, *sound[self._rate.name])
        t_ns = words[at, 0].view(np.int64)
        counter = self._counted(data, t_ns)
        if self._impostors.twins is not None:  # whose samples these are, nobody knows
            self._count(corrupt=len(counter))
            at, counter, data, t_ns = at[:0], counter[:0], data[:0], t_ns[:0]
        placed = self._track.unwrap(counter, t_ns, self._boot_rows(at, boot))
        slow = self._read_slow(words, sound, at, Reference(placed.index, counter, t_ns))
        if self._made is None:  # two samples with one counter would be a second unit's
            self._impostors.arrived(t_ns, placed.index, np.ascontiguousarray(data[:, :8]).view(np.int64)[:, 0])
        rows = placed.take
        rate_dph, valid, faults, corrected = self._read_rate(data[rows])
        self._count(
            lost=placed.lost,
            repeated=placed.repeated,
            corrupt=placed.rogue,
            late=placed.late,
            out_of_order=placed.out_of_order,
            resets=placed.resets,
            invalid=len(valid) - int(np.count_nonzero(valid)),
        )
        self.samples += len(valid)
        if len(counter):
            self._impostors.counted(len(counter), placed.rogue + placed.repeated)
        index = placed.index[rows]
        slow |= self._read_same(index, data[rows], valid)
        beats = self._placed_beats(at[rows], index)
        self._newest = int(index[-1]) if len(index) else self._newest
        if self._impostors.twins is not None and self.twins_at is None:
            self.twins_at = max(self._newest - len(index), 0)
        return GyroBlock(index, t_ns[rows], rate_dph, valid, slow, faults, corrected, beats)

    def counter_step(self, frames: FrameArray) -> int:
        """By how much the unit's own counter grows most often from one of these frames to the next; 1 without one."""
        words = np.ascontiguousarray(frames).view(_WORD).reshape(-1, frames.dtype.itemsize // 8)
        self._sort(words)
        _, data = self._of(self._first, *self._sound(words, self._rate))
        if self._first.counter is None or len(data) < 2:
            return 1
        raw = self._first.counter.unpack(data).astype(np.int64)
        steps, times = np.unique(np.diff(raw) & ((1 << self.counter_bits) - 1), return_counts=True)
        return int(steps[times.argmax()])

    def power_on(self) -> None:
        """The unit is switched on again after it was switched off on purpose; call it between two blocks."""
        self._track.power_on()
        for slow in self._slow:
            slow.power_on()

    @property
    def restarts(self) -> int:
        """How often the unit started anew, planned or not."""
        return self.losses.resets + self._track.planned_resets

    @property
    def losses(self) -> Losses:
        """Counts since the start."""
        if self._losses is None:
            self._losses = Losses(**self._counts)
        return self._losses

    @property
    def conflict(self) -> str | None:
        """Text of a conflict: two units with one number, or another unit than before; None without a conflict."""
        return self._impostors.conflict

    @property
    def impostor(self) -> bool:
        """Whether the conflict is certain, so that the run cannot go on."""
        return self._impostors.certain

    @property
    def serials(self) -> Sequence[int]:
        """Serial numbers of the last heartbeats, one entry per change; a single one without a conflict."""
        return self._impostors.serials

    def _count(self, **more: int) -> None:
        self._losses = None
        for name, count in more.items():
            if count:
                self._counts[name] = self._counts.get(name, 0) + count

    def _sort(self, words: WordArray) -> None:
        """Find the frames of each message among FRAME records (n, 3); a block with the same heads is sorted once."""
        heads = words[:, 1] & _HEAD  # without the flags that say how a frame was sent
        if (pattern := heads.tobytes()) == self._heads:
            return
        self._heads = pattern
        for message in self.layout.messages:
            head = message.id + self._number | FLAG_EXTENDED * message.extended << 32
            at = np.flatnonzero(heads & _IDENTIFIED == np.uint64(head))
            whole = heads[at] >> np.uint64(40) == np.uint64(message.length)
            self._rows[message.name] = len(at), at if whole.all() else at[whole]

    def _sound(self, words: WordArray, message: Message) -> tuple[IntArray, ByteArray]:
        """Positions (n,) and payloads (n, width) of the frames of a message whose length and CRC are right."""
        received, at = self._rows[message.name]
        if 8 * (words.shape[1] - 2) < message.width:  # frames of a classical bus
            self._count(received=received, corrupt=received)
            return at[:0], np.zeros((0, message.width), dtype=np.uint8)
        if message.width == 8:
            data = words[at, 2].view(np.uint8).reshape(-1, 8)
        else:
            data = words[at, 2 : 2 + (message.width + 7) // 8].view(np.uint8)[:, : message.width]
        if "Crc8" in message.signals:
            sound = message.crc(data, message.id + self._number) == data[:, message.length - 1]
            if not sound.all():
                at, data = at[sound], data[sound]
        self._count(received=received, corrupt=received - len(at))
        return at, data

    def _of(self, source: Source, at: IntArray, data: ByteArray) -> tuple[IntArray, ByteArray]:
        """Those frames of a multiplexed message that carry the signals of a source."""
        if source.choice is None:
            return at, data
        present = source.message.present(source.choice, np.ascontiguousarray(data))
        return (at, data) if present is None else (at[present], data[present])

    def _counted(self, data: ByteArray, t_ns: IntArray) -> IntArray:
        """Counter (n,) of the samples: the unit's own, or one that is made."""
        if self._made is not None:
            return self._made.count(data, t_ns)
        assert self._first.counter is not None
        counter: IntArray = self._first.counter.unpack(data).astype(np.int64)
        return counter

    def _read_heartbeat(self, words: WordArray) -> IntArray:
        """Update the identity; returns positions of boot-up heartbeats."""
        if self._beat is None:
            return np.zeros(0, dtype=np.int64)
        at, data = self._sound(words, self._beat.message)
        self._beats = at, self._beat.states.read(data)[0]
        if not len(at):
            return at
        payload = data.tobytes()
        if payload == self._unchanged:
            self._impostors.heard(self.serials[-1:])
            return at[:0]
        raw = {name: signal.unpack(data) for name, signal in self._beat.signals.items()}
        one = "serial" not in raw or self._impostors.heard(raw["serial"].tolist())
        absent, sure = np.zeros(len(at), dtype=np.int64), True
        fields = (raw.get(name, absent).tolist() for name in ("serial", "firmware", "coefficient_set"))
        for claim in zip(*fields, strict=True) if "serial" in raw else ():  # a changed one may be a flipped bit
            sure = self.identity is None or claim == self._claim  # … until it is repeated
            self._claim = claim
            if sure:
                serial, firmware, number = claim
                told = number if "coefficient_set" in raw else None
                self.identity = Identity(serial, firmware, told, int(raw.get("state", absent)[-1]))
        boot: IntArray = at[raw["state"] == BOOT_UP] if "state" in raw else at[:0]
        self._unchanged = payload if one and sure and not len(boot) else b""
        return boot

    def _placed_beats(self, rate_at: IntArray, index: IntArray) -> Beats:
        """The heartbeats of this block among its samples, which came at these positions."""
        at, faults = self._beats
        known = np.concatenate(([self._newest], index))
        why = [""] * len(at)
        if faults:
            why = [", ".join(text for text, rows in faults.items() if rows[row]) for row in range(len(at))]
        return Beats(known[np.searchsorted(rate_at, at)], why)

    def _boot_rows(self, at: IntArray, boot: IntArray) -> IntArray:
        """Rows of the rate frames that follow a boot-up heartbeat, also one of an earlier block."""
        if not len(boot) and not self._booted:
            return boot
        rows = np.searchsorted(at, boot)
        if self._booted:
            rows = np.concatenate(([0], rows))
        self._booted = bool(np.any(rows == len(at)))
        return rows[rows < len(at)]

    def _read_rate(self, data: ByteArray) -> tuple[FloatArray, BoolArray, Mapping[str, BoolArray], BoolArray | None]:
        """First output (n,), NaN where not valid; which are valid, why the others are not, and which are corrected."""
        rate_dph = self._signal.physical(data) * self._rate_factor
        valid = np.ones(len(rate_dph), dtype=np.bool_)
        faults, corrected = self._first.states.read(data)
        sound = _measured(rate_dph, self._signal, self._rate_factor)
        if sound is not None:
            faults = {**faults, f"{self.output} outside its range": ~sound}
        for wrong in faults.values():
            valid &= ~wrong
        if faults:
            rate_dph[~valid] = np.nan
        return rate_dph, valid, faults, corrected

    def _read_same(self, index: IntArray, data: ByteArray, valid: BoolArray) -> dict[str, Series]:
        """Further channels (n,) in the frames of the first output; a sample that is not valid has none."""
        series = {}
        for name, (signal, factor) in self._first.channels.items():
            if name == self.output:
                continue
            value = signal.physical(data) * factor
            kept = valid
            if name in OUTPUTS and (sound := _measured(value, signal, factor)) is not None:
                kept = valid & sound
                self._count(invalid=int(np.count_nonzero(valid & ~sound)))
            series[name] = Series(index, value) if kept.all() else Series(index[kept], value[kept])
            if len(value):
                self.last[name] = float(value[-1])
        return series

    def _read_slow(
        self, words: WordArray, sound: dict[str, tuple[IntArray, ByteArray]], rate_at: IntArray, rate: Reference
    ) -> dict[str, Series]:
        """Channels of the other sources, assigned to the samples; `sound` are frames that were looked at already."""
        before = self._reference
        if before is not None:
            rate = Reference(*(np.concatenate(pair) for pair in zip(before, rate, strict=True)))
            rate_at = np.concatenate(([-1], rate_at))
        series: dict[str, Series] = {}
        for slow in self._slow:
            if slow.message.name not in sound:  # one that is multiplexed has several sources
                sound[slow.message.name] = self._sound(words, slow.message)
            at, data = self._of(slow.source, *sound[slow.message.name])
            if wrong := slow.states.read(data)[0]:
                valid = ~np.logical_or.reduce(list(wrong.values()))
                at, data = at[valid], data[valid]
            if len(rate_at):
                t_ns = words[at, 0].view(np.int64)
                index, rows, repeated, lost = slow.place(data, at, t_ns, rate_at, rate)
                self._count(repeated=repeated, slow_lost=lost)
                data = data[rows]
            else:
                index, data = np.zeros(0, dtype=np.int64), data[:0]  # before the first rate sample
            for name, (signal, factor) in slow.channels.items():
                value = signal.physical(data) * factor
                kept = _measured(value, signal, factor) if name in OUTPUTS else None
                if kept is not None:
                    self._count(invalid=int(np.count_nonzero(~kept)))
                series[name] = Series(index, value) if kept is None else Series(index[kept], value[kept])
                if len(value):
                    self.last[name] = float(value[-1])
        self._reference = Reference(*(part[-1:] for part in rate)) if len(rate_at) else None
        return series


def _made_counter(layout: Layout, interval_ns: int) -> StampCount | CycleCount | None:
    """What counts the samples of a unit that does not count them itself."""
    if layout.first.counter is not None:
        return None
    return CycleCount(interval_ns) if layout.stamp is None else StampCount(*layout.stamp, interval_ns)


def _measured(value: FloatArray, signal: Signal, factor: float) -> BoolArray | None:
    """Which values (n,) can be measurements; None: all. NaN is none."""
    low, high = signal.measured
    low, high = low * factor, high * factor
    if not len(value) or (value.min() >= low and value.max() <= high):
        return None
    return (value >= low) & (value <= high)


def _thermometer(layout: Layout, others: Sequence[Beside]) -> Thermometer | None:
    """The unit's own: `temperature`, or the first that it has."""
    named = sorted(name for name in layout.channels if THERMOMETERS.fullmatch(name))
    if not named:
        return None
    signal, factor = layout.channels[named[0]]
    low, high = signal.measured
    every = next((slow.every for slow in others if named[0] in slow.channels), 1)
    return Thermometer(named[0], low * factor, high * factor, abs(signal.scale) * factor, every or None)
