"""A unit while it is being captured: its newest values, and whether it can go on."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from bench.acquisition.profile.guards import Signal
from bench.acquisition.profile.standing import DOUBTED_S
from bench.acquisition.recording.assemble import Decoded
from bench.acquisition.recording.trace import Envelope
from bench.acquisition.station.belief import Belief
from bench.acquisition.station.settings.unit import UnitSettings
from bench.base import ACCELERATIONS, FloatArray, InputError
from drivers.clock import Clock
from drivers.journal import FrameArray
from drivers.samples import SampleClock

RESETS_S, MOST_RESETS = 60.0, 5
"""A unit that starts anew this often within this time has a counter that means nothing."""
MISFITS_S, MOST_MISFITS = 10.0, 0.3
"""So has one of whose frames more than this share are corrupt or repeat a sample over this time: when each comes twice,
half of them do."""
IDENTITY_DOUBT_S = 3.0
"""Heartbeats come once a second and a wrong one counts when it comes again: frames this long before may be another
unit's already."""


@dataclass(frozen=True)
class Trouble:
    """Why a unit cannot go on, and up to which bench time its data are its own."""

    reason: str
    sound_until_s: float


class Level:
    """Mean of the samples since it was taken last."""

    __slots__ = ("_count", "_sum")

    def __init__(self) -> None:
        self._sum, self._count = 0.0, 0

    def add(self, values: FloatArray) -> None:
        """Take in samples (n,); NaN is none."""
        present = values[np.isfinite(values)]
        self._sum += float(present.sum())
        self._count += present.size

    def take(self) -> float:
        """Mean of what was added since the last call, NaN without any."""
        mean = self._sum / self._count if self._count else math.nan
        self._sum, self._count = 0.0, 0
        return mean


class LiveUnit:
    """A unit while it is being captured: newest values for guards, settling and the display."""

    def __init__(self, settings: UnitSettings, clock: Clock) -> None:
        self.settings = settings
        self.decoder = settings.decoder()
        self.sample_clock = SampleClock(self.decoder.interval_s)
        self.temperature: Signal | None = None
        self.newest_frame_s: float | None = None
        self.rates = Envelope()
        """Of all samples since an onlooker took them [deg/h]."""
        self.level = Level()
        self.thermometer = "" if self.decoder.thermometer is None else self.decoder.thermometer.channel
        """Channel of its temperature; empty: it has none."""
        self._forces = {name: Level() for name in ACCELERATIONS if name in self.decoder.outputs}
        self._belief = Belief(self.decoder)
        self._doubted_s: float | None = None
        self._clock = clock
        self._next_reset, self._doubted = 1, False
        self._counts: deque[tuple[float, int, int, int]] = deque()  # bench time [s], resets, misfits, received

    @property
    def serial(self) -> str:
        """Serial number in the station file."""
        return self.settings.serial

    def take(self, frames: FrameArray) -> None:
        """Decode newly captured frames of this unit's bus."""
        block = self.decoder.decode(frames)
        self.sample_clock.add(block.index, block.t_ns)
        self._belief.take(block, self._clock.now())
        if not self._belief.wrong:
            self._doubted_s = None
        elif self._doubted_s is None:
            self._doubted_s = self._clock.now()
        self.rates.add(block.rate_dph)
        self.level.add(block.rate_dph)
        for name, level in self._forces.items():
            if name == self.decoder.output:
                level.add(block.rate_dph)
            elif name in block.slow:
                level.add(block.slow[name].value)
        if len(block.t_ns):
            self.newest_frame_s = float(block.t_ns[-1]) * 1e-9
        own = block.slow.get(self.thermometer)
        if own is not None and len(own.value):
            at_s = self.newest_frame_s if self.newest_frame_s is not None else self._clock.now()
            self.temperature = Signal(float(own.value[-1]), at_s)

    def force(self) -> FloatArray | None:
        """Mean specific force (3,) [m/s^2] since the last call, NaN where not heard; None without accelerometers."""
        if len(self._forces) < 3:
            return None
        return np.array([self._forces[name].take() for name in ACCELERATIONS])

    def expect_power_on(self) -> None:
        """Its power, which was switched off on purpose, comes back now."""
        self.decoder.power_on()

    @property
    def doubted_s(self) -> float:
        """How long its temperature has not been believed [s]."""
        return 0.0 if self._doubted_s is None else self._clock.now() - self._doubted_s

    def missing(self) -> str | None:
        """What was not heard of the unit yet; None when it is there."""
        if self.newest_frame_s is None:
            return "no sound rate frame"
        if self.thermometer and self.temperature is None:
            return "no temperature"
        if self.settings.identity is not None and self.decoder.identity is None:
            return "no heartbeat with its serial number"
        return None

    def check_identity(self) -> None:
        """InputError when the unit on the bus is not the one that the station file names."""
        if text := self._stranger():
            raise InputError(f"{text}; connect the right unit or name the one that is there with --unit")

    def trouble(self, silent_s: float) -> Trouble | None:
        """Why this unit cannot go on with the run; None when it can. Call it once a tick."""
        now_s = self._clock.now()
        if text := self._stranger():
            return Trouble(text, now_s - IDENTITY_DOUBT_S)
        for what, heard_s in (
            ("sound rate frame", self.newest_frame_s),
            ("temperature", self.temperature.t_s if self.temperature is not None else None),
        ):
            if heard_s is not None and now_s - heard_s > silent_s:
                return Trouble(f"no {what} for {now_s - heard_s:.1f} s, {silent_s:g} s allowed", now_s)
        if self.doubted_s > DOUBTED_S:
            return Trouble(f"its temperature has not been believed for {self.doubted_s:.0f} s", now_s)
        if text := self._wild(now_s):
            return Trouble(text, now_s)
        return None

    def news(self) -> Iterator[str]:
        """What happened to the unit since it was asked last and the run goes on with; seldom, when it happens often."""
        resets, doubt = self.decoder.losses.resets, self.decoder.conflict or ""
        if resets >= self._next_reset:
            self._next_reset = 2 * resets
            yield f"unit {self.serial} started anew, {resets} in all"
        yield from (f"unit {self.serial}: {text}" for text in self._belief.news())
        if doubt and not self._doubted:
            self._doubted = True
            yield f"unit {self.serial}: {doubt}"

    def _stranger(self) -> str | None:
        found, wanted = self.decoder.identity, self.settings.identity
        if found is None or wanted is None or found.serial == wanted:
            return f"unit {self.serial}: {self.decoder.conflict}" if self.decoder.impostor else None
        return (
            f"unit {self.serial}: {found.serial} answers as number {self.settings.number}, the station file says"
            f" identity {wanted}"
        )

    def _wild(self, now_s: float) -> str | None:
        """Whether the sample counter has lost its meaning: it starts anew all the time, or fits nothing."""
        losses, counts = self.decoder.losses, self._counts
        counts.append((now_s, losses.resets, losses.corrupt + losses.repeated, losses.received))
        while len(counts) > 1 and counts[1][0] <= now_s - RESETS_S:
            counts.popleft()
        if losses.resets - counts[0][1] >= MOST_RESETS:
            return f"sample counter gone wild: started anew {losses.resets - counts[0][1]} times within a minute"
        before = next((count for count in reversed(counts) if count[0] <= now_s - MISFITS_S), None)
        if before is None or losses.received == before[3]:
            return None
        share = (counts[-1][2] - before[2]) / (losses.received - before[3])
        text = f"{share:.0%} of its frames in {MISFITS_S:g} s are corrupt or repeat a sample"
        return text if share > MOST_MISFITS else None

    def decoded(self) -> Decoded:
        """What live decoding found, for `assemble`."""
        return Decoded(self.decoder, self.sample_clock)
