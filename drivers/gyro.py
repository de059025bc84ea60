"""Gyro on CAN: converts blocks of captured frames to samples, and counts every frame that it rejects.

cantools reads the layout from the DBC once; numpy decodes the frames. A DBC describes a family by the names of its
signals:

* `Rate`, `SampleCounter` in one message: one sample of the rate
* `Temperature`, `ResonanceFrequency`, `DriveAmplitude`, `QuadratureAmplitude`, `SupplyVoltage` in slower messages, each
  with a `SlowCounter`: the low bits of `SampleCounter` at the moment of sampling
* `Serial`, `Firmware`, `CoefficientSet`, `State` in a heartbeat
* `Crc8` as last byte: CRC-8/SAE-J1850 over the bytes before it and the low byte of the identifier
* status signals in any of these messages: see `drivers.states`
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from drivers.block import Beats, GyroBlock, Losses, Series, Thermometer
from drivers.errors import ConfigError
from drivers.identity import Identity, Impostors
from drivers.journal import FLAG_EXTENDED, FrameArray
from drivers.samples import CounterTrack, FloatArray, IntArray, SampleClock
from drivers.slow import Reference, SlowMessage, check_simple, factor_of, is_slow
from drivers.states import BoolArray, States
from drivers.wire import ByteArray, Message, load_dbc

__all__ = ["Beats", "GyroBlock", "GyroDecoder", "Identity", "Losses", "SampleClock", "Series", "Thermometer"]

_WORD = np.dtype("<u8")
_HEAD, _IDENTIFIED = np.uint64(0xFFFF_FFFF_FFFF), np.uint64(0xFF_FFFF_FFFF)
"""Masks of the second word of a FRAME record: identifier, flags and length; identifier and flags."""
WordArray = npt.NDArray[np.uint64]
BOOT_UP = 0


class GyroDecoder:
    """Decodes the frames of unit `number` of a gyro family. Stateful: pass the blocks in the order of capture.

    `losses` counts since the start, `identity` is that of the last heartbeat (None before the first), `last` holds
    the latest value of each slow channel, `samples` the number of rate samples delivered.
    """

    def __init__(self, dbc: str | Path, number: int, *, late_s: float = 0.5) -> None:
        messages = load_dbc(dbc)
        self._counts: dict[str, int] = {}
        self._losses: Losses | None = Losses()
        self.identity: Identity | None = None
        self.last: dict[str, float] = {}
        self.samples = 0
        self._number = number
        self._rate = _one_with(messages, dbc, "Rate", "SampleCounter")
        if self._rate.cycle_ms is None:
            raise ConfigError(f"DBC {dbc}: {self._rate.name} has no cycle time (GenMsgCycleTime [ms])")
        self.interval_s = self._rate.cycle_ms * 1e-3
        self._interval_ns = round(self._rate.cycle_ms * 1e6)
        self._impostors = Impostors(number, self._interval_ns)
        self._heartbeat = _one_with(messages, dbc, "Serial", "State")
        self._rate_factor = factor_of("rate", self._rate, "Rate")
        self.rate_step_dph = self._rate.signals["Rate"].scale * self._rate_factor
        self._states = {name: States(self._rate if name == "rate" else self._heartbeat) for name in ("rate", "beat")}
        self.tells_correction = self._states["rate"].tells_correction
        """Whether each sample says if the unit corrected it."""
        low, high = self._rate.signals["Rate"].measured
        self._measured = low * self._rate_factor, high * self._rate_factor
        self._slow = [SlowMessage(message, self.interval_s) for message in messages.values() if is_slow(message)]
        self.thermometer = next((found for slow in self._slow if (found := _thermometer(slow))), None)
        self.beat_every = round((self._heartbeat.cycle_ms or 0.0) * 1e-3 / self.interval_s)
        """Rate samples between heartbeats; 0: the DBC does not say."""
        self.counter_bits = self._rate.signals["SampleCounter"].length
        self._track = CounterTrack(self.counter_bits, self._interval_ns, late_s)
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

    def decode(self, frames: FrameArray) -> GyroBlock:
        """Samples of FRAME records in the order of capture; frames of other units are ignored."""
        words = np.ascontiguousarray(frames).view(_WORD).reshape(-1, 3)
        self._sort(words)
        boot = self._read_heartbeat(words)
        at, data = self._sound(words, self._rate)
        t_ns = words[at, 0].view(np.int64)
        counter = self._rate.signals["SampleCounter"].unpack(data).astype(np.int64)
        if self._impostors.twins is not None:  # whose samples these are, nobody knows
            self._count(corrupt=len(counter))
            at, counter, data, t_ns = at[:0], counter[:0], data[:0], t_ns[:0]
        placed = self._track.unwrap(counter, t_ns, self._boot_rows(at, boot))
        slow = self._read_slow(words, at, Reference(placed.index, counter, t_ns))
        self._impostors.arrived(t_ns, placed.index, data.view(np.int64)[:, 0])
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
        beats = self._placed_beats(at[rows], index)
        self._newest = int(index[-1]) if len(index) else self._newest
        if self._impostors.twins is not None and self.twins_at is None:
            self.twins_at = max(self._newest - len(index), 0)
        return GyroBlock(index, t_ns[rows], rate_dph, valid, slow, faults, corrected, beats)

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
        heads = words[:, 1] & _HEAD
        if (pattern := heads.tobytes()) == self._heads:
            return
        self._heads = pattern
        for message in (self._rate, self._heartbeat, *(slow.message for slow in self._slow)):
            head = message.id + self._number | FLAG_EXTENDED * message.extended << 32
            at = np.flatnonzero(heads & _IDENTIFIED == np.uint64(head))
            whole = heads[at] >> np.uint64(40) == np.uint64(message.length)
            self._rows[message.name] = len(at), at if whole.all() else at[whole]

    def _sound(self, words: WordArray, message: Message) -> tuple[IntArray, ByteArray]:
        """Positions (n,) and payloads (n, 8) of the frames of a message whose length and CRC are right."""
        received, at = self._rows[message.name]
        data = words[at, 2].view(np.uint8).reshape(-1, 8)
        if "Crc8" in message.signals:
            sound = message.crc(data, message.id + self._number) == data[:, message.length - 1]
            if not sound.all():
                at, data = at[sound], data[sound]
        self._count(received=received, corrupt=received - len(at))
        return at, data

    def _read_heartbeat(self, words: WordArray) -> IntArray:
        """Update the identity; returns positions of boot-up heartbeats."""
        at, data = self._sound(words, self._heartbeat)
        self._beats = at, self._states["beat"].read(data)[0]
        if not len(at):
            return at
        payload = data.tobytes()
        if payload == self._unchanged:
            self._impostors.heard(self.serials[-1:])
            return at[:0]
        raw = {name: signal.unpack(data) for name, signal in self._heartbeat.signals.items()}
        one = self._impostors.heard(raw["Serial"].tolist())
        absent = np.zeros(len(at), dtype=np.int64)
        fields = (raw.get(name, absent).tolist() for name in ("Serial", "Firmware", "CoefficientSet"))
        for claim in zip(*fields, strict=True):  # a changed one may be a flipped bit, until it is repeated
            sure = self.identity is None or claim == self._claim
            self._claim = claim
            if sure:
                serial, firmware, coefficient_set = claim
                self.identity = Identity(serial, firmware, coefficient_set, int(raw["State"][-1]))
        boot: IntArray = at[raw["State"] == BOOT_UP]
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
        """Rate (n,) [deg/h], NaN where not valid; which are valid, why the others are not, and which are corrected."""
        rate_dph = self._rate.signals["Rate"].physical(data) * self._rate_factor
        valid = np.ones(len(rate_dph), dtype=np.bool_)
        faults, corrected = self._states["rate"].read(data)
        low, high = self._measured
        if len(rate_dph) and not (rate_dph.min() >= low and rate_dph.max() <= high):  # NaN is not a measurement either
            faults = {**faults, "rate outside its range": ~((rate_dph >= low) & (rate_dph <= high))}
        for wrong in faults.values():
            valid &= ~wrong
        if faults:
            rate_dph[~valid] = np.nan
        return rate_dph, valid, faults, corrected

    def _read_slow(self, words: WordArray, rate_at: IntArray, rate: Reference) -> dict[str, Series]:
        """Slow channels, assigned to the rate samples by the low bits of the counter."""
        before = self._reference
        if before is not None:
            rate = Reference(*(np.concatenate(pair) for pair in zip(before, rate, strict=True)))
            rate_at = np.concatenate(([-1], rate_at))
        series: dict[str, Series] = {}
        for slow in self._slow:
            at, data = self._sound(words, slow.message)
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
                value = slow.message.signals[signal].physical(data) * factor
                series[name] = Series(index, value)
                if len(value):
                    self.last[name] = float(value[-1])
        self._reference = Reference(*(part[-1:] for part in rate)) if len(rate_at) else None
        return series


def _thermometer(slow: SlowMessage) -> Thermometer | None:
    if "temperature" not in slow.channels:
        return None
    name, factor = slow.channels["temperature"]
    signal = slow.message.signals[name]
    low, high = signal.measured
    return Thermometer(low * factor, high * factor, abs(signal.scale) * factor, slow.every or None)


def _one_with(messages: Mapping[str, Message], dbc: str | Path, *signals: str) -> Message:
    found = [message for message in messages.values() if set(signals) <= set(message.signals)]
    if len(found) != 1:
        raise ConfigError(f"DBC {dbc}: {len(found)} messages with {' and '.join(signals)}, must be exactly one")
    check_simple(found[0])
    return found[0]
