"""Interlocks: what must hold while equipment moves, with trip and release thresholds, delays and staleness.

A guard watches one signal. It trips when the signal is beyond its threshold for `delay_s`, when the signal changes
faster than `rate_per_min`, and when the signal is missing or older than `max_age_s`: silence is never taken for good
news. It releases when the signal has been back inside the release thresholds for `release_delay_s`. Guards are
evaluated before anything starts and at every tick. Software is never the safety device: an independent limit
controller is.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

Action = Literal["hold", "abort"]

SIGNALS = {
    "chamber_temperature": "chamber air [degC]",
    "unit_temperature": "the unit's own sensor [degC]",
    "sensor_disagreement": "absolute difference of chamber air and unit sensor [degC]",
    "frame_age": "age of the newest frame of the unit [s]",
    "disk_free_mb": "free space where the run is written [MB]",
    "alarm": "1 while the chamber reports an alarm",
}


class GuardSettings(BaseModel):
    """One guard as written in a station or profile file."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str
    signal: Literal[
        "chamber_temperature", "unit_temperature", "sensor_disagreement", "frame_age", "disk_free_mb", "alarm"
    ]
    above: float | None = Field(None, description="trips above this value")
    below: float | None = Field(None, description="trips below this value")
    rate_per_min: float | None = Field(None, gt=0, description="trips when the signal changes faster than this")
    release_above: float | None = Field(None, description="after a `below` trip: released above this value")
    release_below: float | None = Field(None, description="after an `above` trip: released below this value")
    delay_s: float = Field(0.0, ge=0, description="how long the condition must last before it trips")
    release_delay_s: float = Field(10.0, ge=0, description="how long the signal must be good before it releases")
    max_age_s: float = Field(10.0, gt=0, description="a signal older than this trips the guard")
    action: Action = "abort"

    @model_validator(mode="after")
    def _watches_something(self) -> GuardSettings:
        if self.above is None and self.below is None and self.rate_per_min is None:
            raise ValueError("a guard needs at least one of above, below, rate_per_min")
        if self.above is not None and self.release_below is not None and self.release_below > self.above:
            raise ValueError(f"release_below ({self.release_below}) must not exceed above ({self.above})")
        if self.below is not None and self.release_above is not None and self.release_above < self.below:
            raise ValueError(f"release_above ({self.release_above}) must not be less than below ({self.below})")
        return self


DEFAULT_GUARDS = (
    GuardSettings(name="unit silent", signal="frame_age", above=5.0, max_age_s=10.0, action="abort"),
    GuardSettings(name="chamber alarm", signal="alarm", above=0.5, delay_s=2.0, max_age_s=30.0, action="abort"),
    GuardSettings(name="disk nearly full", signal="disk_free_mb", below=100.0, max_age_s=120.0, action="abort"),
)
"""Guards of every run, whatever the station file says."""


@dataclass(frozen=True)
class Signal:
    """The newest value of something that a guard may watch."""

    value: float
    t_s: float


@dataclass(frozen=True)
class Trip:
    """A guard tripped or released at `t_s`; `text` carries the numbers."""

    guard: GuardSettings
    tripped: bool
    t_s: float
    text: str


@dataclass
class _Guard:
    settings: GuardSettings
    tripped: bool = False
    bad_since: float | None = None
    good_since: float | None = None
    last: Signal | None = None

    def evaluate(self, signal: Signal | None, now_s: float) -> Trip | None:
        reason = self._reason(signal, now_s)
        if self.last is None or signal is None or signal.t_s > self.last.t_s:
            self.last = signal or self.last
        if reason is not None:
            self.good_since = None
            self.bad_since = now_s if self.bad_since is None else self.bad_since
            if not self.tripped and now_s - self.bad_since >= self.settings.delay_s:
                self.tripped = True
                return Trip(self.settings, True, now_s, f"{self.settings.name}: {reason}")
            return None
        self.bad_since = None
        if self.tripped:
            self.good_since = now_s if self.good_since is None else self.good_since
            if now_s - self.good_since >= self.settings.release_delay_s:
                self.tripped = False
                value = math.nan if signal is None else signal.value
                return Trip(
                    self.settings, False, now_s, f"{self.settings.name}: {value:.6g} is inside its limits again"
                )
        return None

    def _reason(self, signal: Signal | None, now_s: float) -> str | None:
        rule = self.settings
        if signal is None or math.isnan(signal.value):
            return f"{rule.signal} is missing"
        if now_s - signal.t_s > rule.max_age_s:
            return f"{rule.signal} is stale: {now_s - signal.t_s:.1f} s old, {rule.max_age_s:g} s allowed"
        above = rule.release_below if self.tripped and rule.release_below is not None else rule.above
        if above is not None and signal.value > above:
            return f"{rule.signal} = {signal.value:.6g} is above {above:g}"
        below = rule.release_above if self.tripped and rule.release_above is not None else rule.below
        if below is not None and signal.value < below:
            return f"{rule.signal} = {signal.value:.6g} is below {below:g}"
        if rule.rate_per_min is not None and self.last is not None and signal.t_s > self.last.t_s:
            rate = abs(signal.value - self.last.value) / (signal.t_s - self.last.t_s) * 60
            if rate > rule.rate_per_min:
                return f"{rule.signal} changes by {rate:.6g} per minute, {rule.rate_per_min:g} allowed"
        return None


@dataclass
class Guards:
    """All guards of a run; `evaluate` returns what changed, `holding` and `aborting` what is in force."""

    settings: Sequence[GuardSettings]
    _guards: list[_Guard] = field(init=False)

    def __post_init__(self) -> None:
        self._guards = [_Guard(settings) for settings in self.settings]

    def evaluate(self, signals: Mapping[str, Signal], now_s: float) -> list[Trip]:
        """Trips and releases at `now_s`, in the order of the settings."""
        trips = (guard.evaluate(signals.get(guard.settings.signal), now_s) for guard in self._guards)
        return [trip for trip in trips if trip is not None]

    def in_force(self, action: Action) -> list[str]:
        """Names of the tripped guards that demand `action`."""
        return [g.settings.name for g in self._guards if g.tripped and g.settings.action == action]
