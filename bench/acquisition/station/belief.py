"""Whether what a live unit says can be believed: for guards and for the operator. Tables are judged when a run ends."""

from __future__ import annotations

from collections.abc import Iterator

from bench.acquisition.recording.physics import Pace
from bench.acquisition.recording.validity import JUMP_DEGC, SLOPE_DEGC_PER_S
from drivers.block import GyroBlock
from drivers.gyro import GyroDecoder

STILL_S = 10
"""A noisy sensor that repeats one value bit for bit for so many seconds stands still."""
NOISY = 0.9
"""Share of the seconds in which a sensor that is called noisy changes."""


class Belief:
    """Follows the temperature and the complaints of one unit, a block a second."""

    def __init__(self, decoder: GyroDecoder) -> None:
        thermometer = decoder.thermometer
        self._channel = "" if thermometer is None else thermometer.channel
        self._limits = (thermometer.lowest_degc, thermometer.highest_degc) if thermometer else (0.0, 0.0)
        self._pace = Pace(max(JUMP_DEGC, 3.0 * (thermometer.step_degc if thermometer else 0.0)), SLOPE_DEGC_PER_S)
        self._blocks = self._changing = self._still = 0
        self._value = 0.0
        self._out_of_range = self._ill = False
        self._faults: set[str] = set()
        self._said: set[str] = set()

    def take(self, block: GyroBlock, now_s: float) -> None:
        """Take in what came since the last call, at bench time `now_s` [s]."""
        self._faults = set(block.faults)
        if any(block.beats.why):
            ill, self._ill = self._ill, all(block.beats.why)
            if ill:  # one alone may be a flipped bit
                self._faults |= {why for why in block.beats.why if why}
        elif len(block.beats.index):
            self._ill = False
        series = block.slow.get(self._channel)
        if series is None or not len(series.value):
            return
        value = series.value
        self._pace.take(now_s, value)
        low, high = self._pace.span
        self._out_of_range = not (low >= self._limits[0] and high <= self._limits[1])
        still = low == high == self._value
        self._value = low
        self._still = self._still + 1 if still else 0
        if self._still < STILL_S:
            self._blocks, self._changing = self._blocks + 1, self._changing + (low != high)

    @property
    def wrong(self) -> str:
        """Why its temperature must not be believed; empty: it may."""
        if self._out_of_range:
            return "it is at the end of its range"
        if self._pace.bad:
            return "it moved faster than it can"
        noisy = self._changing > NOISY * self._blocks and self._blocks > STILL_S
        return "it repeats the same value bit for bit" if noisy and self._still >= STILL_S else ""

    def news(self) -> Iterator[str]:
        """What it says, or what is wrong with it, that was not told before."""
        found = self._faults | ({f"its temperature is not believed: {self.wrong}"} if self.wrong else set())
        for text in sorted(found - self._said):
            self._said.add(text)
            yield f"{text}; such samples are left out"
