"""Which samples of a run are no measurements: what the unit says of itself, and what its sensors cannot do.

Judged once, here, from the frames and readings of the journals: when a run ends, is recovered, goes on, or is assembled
again, the answer is the same. Nothing is repaired. What is not valid becomes a gap, is counted by reason, and is told.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bench.acquisition.recording.physics import Frozen, Pace, UnitExcess
from bench.base import OUTPUTS, THERMOMETERS, BoolArray, FloatArray, IntArray
from drivers.block import GyroBlock, Series
from drivers.gyro import GyroDecoder

JUMP_DEGC = 2.0
"""A unit's temperature that is further from where it can be by now is not believed …"""
SLOPE_DEGC_PER_S = 20.0 / 60.0
"""… when nothing in a chamber moves a unit faster than this."""
AIR_JUMP_DEGC, AIR_SLOPE_DEGC_PER_S = 8.0, 1.0
"""The same for the chamber's air, which an open door moves."""
SILENT_S = 1.0
"""Rate samples further than this (and three of its cycles) from the next temperature have none."""
BEATS_MISSED = 5
"""Heartbeats that may be missing while rate samples come."""
MARGIN_DEGC, LAG_MIN = 15.0, 60.0
"""A unit further outside all that the air was, within this lag, is not believed; journals carry what a run was told."""

TWINS_S = 10
"""Two units under one number are certain after some seconds."""

RATE, TEMPERATURE, AIR = "rate", "temperature", "chamber_temperature"


@dataclass(frozen=True)
class Spell:
    """A stretch that is left out: sample indices [first, end). Without a valid temperature the rate goes with it."""

    why: str
    channel: str
    first: int
    end: int


class Spells:
    """Stretches by reason, joined where they follow each other."""

    def __init__(self) -> None:
        self.found: dict[tuple[str, str], list[list[int]]] = {}

    def rows(self, why: str, channel: str, index: IntArray, every: int = 1) -> None:
        """Samples (k,) that stand for `every` sample indices each."""
        if not len(index):
            return
        cuts = np.flatnonzero(np.diff(index) > every) + 1
        for part in np.split(index, cuts):
            self.span(why, channel, int(part[0]), int(part[-1]) + every)

    def span(self, why: str, channel: str, first: int, end: int) -> None:
        """All samples in [first, end)."""
        spans = self.found.setdefault((why, channel), [])
        if spans and spans[-1][0] <= first <= spans[-1][1]:
            spans[-1][1] = max(spans[-1][1], end)
        elif end > first:
            spans.append([first, end])

    def all(self) -> list[Spell]:
        """In order of time."""
        found = [Spell(why, channel, *span) for (why, channel), spans in self.found.items() for span in spans]
        return sorted(found, key=lambda spell: (spell.first, spell.end, spell.why))


class Validity:
    """Looks at the blocks of one unit, in order."""

    def __init__(self, decoder: GyroDecoder, raw: bool = True) -> None:
        """`raw`: the run is about the raw rate; else about the one that the unit corrects."""
        self._decoder = decoder
        self._raw, self._thermometer, self._beat_every = raw, decoder.thermometer, decoder.beat_every
        self._corrects, self._interval_s = decoder.tells_correction, decoder.interval_s
        self._second = max(round(1.0 / decoder.interval_s), 1)
        self.spells, self._output = Spells(), Spells()
        self._rate, self._temperature = Frozen(), Frozen()
        step = 0.0 if self._thermometer is None else self._thermometer.step_degc
        self._pace = Pace(max(JUMP_DEGC, 3.0 * step), SLOPE_DEGC_PER_S)
        self._waiting = Series(np.zeros(0, dtype=np.int64), np.zeros(0))
        self._levels: list[tuple[int, float]] = []  # the temperature of each second that is believed
        self._count = 0  # rate samples so far
        self._newest = -1
        self._last_temperature = self._last_beat = (0, 0)  # its index, and the rate samples before it
        self._ill, self._doubt = "", (0, "")  # what the heartbeats say; the newest one that says something else

    def take(self, block: GyroBlock) -> None:
        """Take in one block."""
        index = block.index
        for why, rows in block.faults.items():
            self.spells.rows(why, RATE, index[rows])
        if self._corrects and len(index) and (block.corrected is not None or not self._raw):
            corrected = np.zeros(len(index), dtype=np.bool_) if block.corrected is None else block.corrected
            wrong = corrected if self._raw else ~corrected
            self._output.rows(
                "the unit corrects its rate" if self._raw else "the unit sends its raw rate", RATE, index[wrong]
            )
        sound = slice(None) if not block.faults else block.valid
        self._rate.take(index[sound], block.rate_dph[sound])
        if self._thermometer is not None and self._thermometer.channel in block.slow:
            self._take_temperature(block, block.slow[self._thermometer.channel])
        self._take_beats(block)
        if len(index):
            self._count, self._newest = self._count + len(index), int(index[-1])

    def _take_temperature(self, block: GyroBlock, series: Series) -> None:
        thermometer = self._thermometer
        assert thermometer is not None
        at, value, every = series.index, series.value, thermometer.every or 1
        self._miss_temperature(at, np.searchsorted(block.index, at) + self._count, every)
        measured = (value >= thermometer.lowest_degc) & (value <= thermometer.highest_degc)
        if not measured.all():
            self.spells.rows("temperature outside the range of its code", TEMPERATURE, at[~measured], every)
            at, value = at[measured], value[measured]
        self._temperature.take(at, value)
        at, value = np.concatenate((self._waiting.index, at)), np.concatenate((self._waiting.value, value))
        if not len(at):
            return
        second = at // self._second
        whole = int(np.searchsorted(second, second[-1]))
        self._waiting = Series(at[whole:], value[whole:])
        self._follow(at[:whole], value[:whole], second[:whole], every)

    def _follow(self, at: IntArray, value: FloatArray, second: IntArray, every: int) -> None:
        """Whole seconds of temperatures (m,)."""
        starts = np.flatnonzero(np.diff(second, prepend=-1)) if len(at) else at
        for start, end in zip(starts.tolist(), [*starts[1:].tolist(), len(at)], strict=False):
            wrong = self._pace.take(float(second[start]), value[start:end])
            if wrong is not None:
                self.spells.rows("temperature moves faster than it can", TEMPERATURE, at[start:end][wrong], every)
            if wrong is None or not wrong.all():
                good = value[start:end] if wrong is None else value[start:end][~wrong]
                self._levels.append((int(second[start]), float(good.mean())))

    def _miss_temperature(self, at: IntArray, before: IntArray, every: int) -> None:
        """Stretches with rate samples and without a temperature."""
        if not len(at):
            return
        most = max(self._second * SILENT_S, 3 * every)
        index, count = np.append(self._last_temperature[0], at), np.append(self._last_temperature[1], before)
        for row in np.flatnonzero(np.diff(count) > most).tolist():
            self.spells.span("no temperature", TEMPERATURE, int(index[row]) + every, int(index[row + 1]))
        self._last_temperature = int(index[-1]), int(count[-1])

    def _take_beats(self, block: GyroBlock) -> None:
        beats = block.beats
        for index, why in zip(beats.index.tolist(), beats.why, strict=True):
            before = self._count + int(np.searchsorted(block.index, index, side="right"))
            self._miss_beat(index, before)
            if bool(why) == bool(self._ill):
                self._doubt = 0, ""
            elif not self._doubt[0]:  # one that differs may be a flipped bit, until it comes again
                self._doubt = index, why
            else:
                if self._ill:
                    self.spells.span(self._ill, RATE, self._last_ill, self._doubt[0])
                self._last_ill, self._ill, self._doubt = self._doubt[0], why, (0, "")

    _last_ill = 0

    def _miss_beat(self, index: int, before: int) -> None:
        last, count = self._last_beat
        if self._beat_every and count and before - count > BEATS_MISSED * self._beat_every:
            self.spells.span("no heartbeat", RATE, last + self._beat_every, index)
        self._last_beat = index, before

    def close(
        self, window: tuple[int, int], air: tuple[IntArray, FloatArray], margin: tuple[float, float]
    ) -> list[Spell]:
        """All that is to be left out, when the last block was taken in.

        `window`: sample indices of the profile [first, end); before and after it the bench switches the unit's own
        correction. `air`: the chamber's air (r,) [degC] and the sample indices where it was read. `margin`: how far a
        unit may be outside all that the air was [K], and its lag [min].
        """
        end = self._newest + 1
        waiting, thermometer = self._waiting, self._thermometer
        if thermometer is not None:
            every = thermometer.every or 1
            self._follow(waiting.index, waiting.value, waiting.index // self._second, every)
            self._miss_temperature(np.array([end]), np.array([self._count]), every)
        if self._beat_every and self._last_beat[1]:
            self._miss_beat(end, self._count)
        if self._ill:
            self.spells.span(self._ill, RATE, self._last_ill, end)
        for why, channel, found in (
            ("rate frozen", RATE, self._rate.spans()),
            ("temperature frozen", TEMPERATURE, self._temperature.spans()),
        ):
            for first, last in found:
                self.spells.span(why, channel, first, last + 1)
        self._beside_air(air, margin)
        if self._decoder.twins_at is not None:
            self.spells.span(
                "two units on one number", TEMPERATURE, self._decoder.twins_at - TWINS_S * self._second, end
            )
        for (why, channel), spans in self._output.found.items():
            for first, stop in spans:
                self.spells.span(why, channel, max(first, window[0]), min(stop, window[1]))
        return self.spells.all()

    def _beside_air(self, air: tuple[IntArray, FloatArray], margin: tuple[float, float]) -> None:
        """Seconds in which the unit is outside all that the air was within its lag."""
        at, degc = air
        if not len(at) or not self._levels:
            return
        excess = UnitExcess(margin[1])
        seconds = np.array([second for second, _ in self._levels])
        nearest = np.clip(np.searchsorted(at // self._second, seconds, side="right") - 1, 0, len(at) - 1)
        wrong = [
            second
            for (second, level), here in zip(self._levels, degc[nearest].tolist(), strict=True)
            if excess.take(second * self._second * self._interval_s, here, [level]) > margin[0]
        ]
        self.spells.rows(
            "unit far from the air of its chamber", TEMPERATURE, np.array(wrong, dtype=np.int64) * self._second,
            self._second,
        )  # fmt: skip


class Cleaner:
    """Takes what is to be left out from the blocks of one unit; counts what it takes."""

    def __init__(self, spells: Sequence[Spell]) -> None:
        self.spells = spells
        self._first, self._end = (np.array([getattr(s, name) for s in spells], np.int64) for name in ("first", "end"))
        self.samples = [0] * len(spells)
        """Rate samples in each of the spells."""
        self.nulled = 0
        """Rate samples that the decoder had taken for valid."""

    def clean(self, blocks: Iterable[GyroBlock]) -> Iterator[GyroBlock]:
        """The same blocks with gaps."""
        for block in blocks:
            yield self._cleaned(block)

    def _cleaned(self, block: GyroBlock) -> GyroBlock:
        indices = (block.index, *(series.index for series in block.slow.values()))
        ends = [index[[0, -1]] for index in indices if len(index)]
        here = self._first <= np.max(ends) if ends else np.zeros(len(self.spells), dtype=np.bool_)
        here = here & (self._end > np.min(ends)) if ends else here
        if not here.any():
            return block
        rate, slow = block.rate_dph.copy(), dict(block.slow)
        for number in np.flatnonzero(here).tolist():
            spell = self.spells[number]
            first, end = np.searchsorted(block.index, (spell.first, spell.end))
            self.samples[number] += int(end - first)
            self.nulled += int(np.count_nonzero(np.isfinite(rate[first:end])))
            rate[first:end] = np.nan
            gone = OUTPUTS if spell.channel == RATE else (*OUTPUTS, *THERMOMETERS)
            slow |= {name: _outside(slow[name], spell) for name in gone if name in slow}
        return replace(block, rate_dph=rate, slow=slow)


def _outside(series: Series, spell: Spell) -> Series:
    kept = (series.index < spell.first) | (series.index >= spell.end)
    return series if kept.all() else Series(series.index[kept], series.value[kept])


def sound_air(t_s: FloatArray, degc: FloatArray) -> BoolArray:
    """Which readings (r,) of the chamber's air can be: the others jumped, and are left out as long as they do."""
    pace = Pace(AIR_JUMP_DEGC, AIR_SLOPE_DEGC_PER_S)
    sound = np.isfinite(degc)
    for row in np.flatnonzero(sound).tolist():
        sound[row] = pace.take(float(t_s[row]), degc[row : row + 1]) is None
    return sound
