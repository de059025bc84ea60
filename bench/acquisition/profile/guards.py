"""Interlocks: what must hold while equipment moves, with trip and release thresholds, delays and staleness.

A guard watches one signal. It trips when the signal is beyond its threshold, or changes too fast, for `delay_s`, and
at once when the signal is missing or older than `max_age_s`: silence is never taken for good news. It releases when
the signal has been back inside the release thresholds for `release_delay_s`. Guards are evaluated before anything
starts and at every tick. Software is never the safety device: an independent limit controller is.

What a tripped guard does:

* `hold`: the chamber stays where it is until the guard releases, then the leg goes on; everything is recorded.
* `safe`: the profile ends there. The chamber is driven to ambient while everything goes on being recorded, as a
  segment of its own, and is then switched off. For trouble that the equipment itself does not share.
* `abort`: the run ends at this tick, recording with it. The set point goes to ambient and the chamber off; where it is
  cold inside and can still be trusted, it is warmed up first, so that nothing frosts.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection, Container, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Literal, get_args

from pydantic import BaseModel, Field, model_validator

from bench.base import CHANNELS, INSTRUMENTS, STRICT, InputError, Measured

Action = Literal["hold", "safe", "abort"]
Name = Literal[
    "chamber_temperature",
    "unit_temperature",
    "unit_coldest",
    "unit_excess",
    "unit_doubted_s",
    "setpoint_excess",
    "display_degf",
    "sensor_disagreement",
    "frame_age",
    "disk_free_mb",
    "alarm",
    "power",
    "frozen_s",
    "door",
    "sensor_break",
    "override",
    "chamber_silent_s",
    "bus_failed_s",
    Measured,
]
OF_UNITS: frozenset[str] = frozenset(
    {
        "unit_temperature",
        "unit_coldest",
        "unit_excess",
        "unit_doubted_s",
        "sensor_disagreement",
        "frame_age",
        "display_degf",
        "supply",
        "supply_current",
    }
)
"""Signals that come from units or their supply: guards on them do not watch while its power is off on purpose."""
OPTIONAL: frozenset[str] = frozenset({"power", "frozen_s", "door", "sensor_break", *INSTRUMENTS})
"""Signals that not every station tells."""
WORDS: Mapping[str, tuple[str, str]] = {
    "chamber_temperature": ("chamber air temperature", "degC"),
    "unit_temperature": ("unit temperature", "degC"),
    "unit_coldest": ("temperature of the coldest unit", "degC"),
    "unit_excess": ("distance of the unit from the air", "K"),
    "unit_doubted_s": ("time without a believed unit temperature", "s"),
    "setpoint_excess": ("distance of the air from its set point", "K"),
    "display_degf": ("display in degF", ""),
    "door": ("door open", ""),
    "sensor_disagreement": ("distance of the sensors", "K"),
    "frame_age": ("age of the newest frame", "s"),
    "disk_free_mb": ("free space of the disk", "MB"),
    "power": ("power", "%"),
    "frozen_s": ("time without a changed reading", "s"),
    "chamber_silent_s": ("silence of the chamber", "s"),
    "bus_failed_s": ("failure of the bus", "s"),
}
"""Signals in words, and their units; that of another is its name, without underscores, and the unit of its channel."""
YES_NO: frozenset[str] = frozenset({"display_degf", "alarm", "door", "sensor_break", "override"})
"""Signals that are 0 or 1."""
Seconds = Annotated[float, Field(ge=0)]
Positive = Annotated[float, Field(gt=0)]


class GuardSettings(BaseModel):
    """One guard as written in a station or profile file."""

    model_config = STRICT

    name: Annotated[str, Field(min_length=1)]
    """What the guard is called in events and messages."""
    signal: Name
    """Chamber air [degC], the unit's own sensor (the warmest, the coldest of several) [degC], how far a unit is outside
    all that the air was within its lag [K], how long a unit's temperature has not been
    believed [s], how much further the air is from its set point than the chamber's speed
    explains [K], 1 while the air reads as the units would in degF before the start, the absolute difference of air and
    unit [K], age of the unit's newest frame [s], free space where the run is written [MB], 1 while the chamber reports
    an alarm, its output [%] (heating positive), how long its temperature has not changed by a bit although its output
    is not 0 [s], 1 while its door is open, 1 while its sensor is broken, 1 while set point or mode are not ours, how
    long the chamber has not answered [s], how long the capture of a bus has failed [s]; or a channel that an instrument
    of the station measures, in the unit of the channel."""
    above: float | None = None
    """Trips above this value."""
    below: float | None = None
    """Trips below this value."""
    rate_per_min: Positive | None = None
    """Trips when the signal changes faster than this."""
    rate_over_s: Positive = 30.0
    """Time over which the rate is taken."""
    release_below: float | None = None
    """After an `above` trip: released below this value; left out: below `above`."""
    release_above: float | None = None
    """After a `below` trip: released above this value; left out: above `below`."""
    delay_s: Seconds = 0.0
    """How long the condition must last before it trips."""
    release_delay_s: Seconds = 10.0
    """How long the signal must be good before it releases."""
    max_age_s: Positive = 10.0
    """A signal older than this trips at once."""
    action: Action = "abort"
    """`hold` until the guard releases; `safe`: end the profile, record on the way to ambient; `abort`: end the run."""

    @property
    def watched(self) -> str:
        """The signal in words."""
        return self._words[0]

    def valued(self, value: float) -> str:
        """A value of the signal with its unit."""
        return f"{value:.6g} {self._words[1]}".rstrip()

    def says(self, signal: Signal) -> str:
        """The signal in words and its value."""
        return f"{self.watched} = {self.valued(signal.value)}"

    def answered(self, signal: Signal) -> str | None:
        """A signal that is yes or no in words, without what the guard's name says already; None: it is a number."""
        if self.signal not in YES_NO:
            return None
        answer = signal.detail or ("yes" if signal.value else "no")
        return answer if self.watched in self.name else f"{self.watched}: {answer}"

    @property
    def _words(self) -> tuple[str, str]:
        name = self.signal
        return WORDS.get(name) or (name.replace("_", " "), CHANNELS[name].unit if name in CHANNELS else "")

    @model_validator(mode="after")
    def _watches_something(self) -> GuardSettings:
        if self.above is None and self.below is None and self.rate_per_min is None:
            raise ValueError("a guard needs at least one of above, below, rate_per_min")
        for limit, release, sign in (("above", "release_below", 1), ("below", "release_above", -1)):
            trips, releases = getattr(self, limit), getattr(self, release)
            if releases is not None and trips is None:
                raise ValueError(f"{release} has no effect without `{limit}`; add it or remove {release}")
            if releases is not None and sign * (releases - trips) > 0:
                raise ValueError(f"{release} ({releases:g}) lies beyond {limit} ({trips:g})")
        return self


DEFAULT_GUARDS = (
    GuardSettings(name="unit silent", signal="frame_age", above=5.0),
    GuardSettings(name="chamber alarm", signal="alarm", above=0.5, delay_s=2.0, max_age_s=30.0),
    GuardSettings(name="operator override", signal="override", above=0.5, delay_s=3.0, max_age_s=30.0),
    GuardSettings(name="disk nearly full", signal="disk_free_mb", below=100.0, max_age_s=120.0),
    GuardSettings(name="frozen sensor", signal="frozen_s", above=1800.0, max_age_s=30.0),
    GuardSettings(name="sensor break", signal="sensor_break", above=0.5, max_age_s=30.0),
    GuardSettings(name="door open", signal="door", above=0.5, delay_s=2.0, max_age_s=30.0, action="hold"),
)
"""Guards of every run, those left out whose signal the controller does not tell. A guard of the station that bears the
name of one takes its place.
"""


def told_by(registers: Container[str]) -> Collection[str]:
    """The optional signals that a controller with this register map delivers."""
    told = {name for name in ("power", "door", "sensor_break") if name in registers}
    return told | ({"frozen_s"} if "power" in told else set())


def guards_of(
    station: Sequence[GuardSettings],
    profile: Sequence[GuardSettings],
    told: Collection[str],
    patience_s: float = 0.0,
    standing: Sequence[GuardSettings] = (),
) -> tuple[GuardSettings, ...]:
    """The guards of a run; `told` are the optional signals that this station delivers, `standing` guards stay always.

    A chamber that does not answer is judged by its link: the guards of every run wait at least `patience_s` for what it
    tells. Raises InputError for a guard that would watch a signal which never comes.
    """
    own = {guard.name for guard in station}
    for rule in (*station, *profile):
        if rule.name in {guard.name for guard in standing}:
            text = f"guard {rule.name!r} bears the name of one that every run has and no file replaces"
            raise InputError(f"{text}; give it another name")
    default = [
        rule.model_copy(update={"max_age_s": max(rule.max_age_s, patience_s)})
        for rule in (*standing, *DEFAULT_GUARDS)
        if rule.name not in own and _is_told(rule, told)
    ]
    for rule in (*station, *profile):
        if not _is_told(rule, told):
            known = ", ".join(sorted({*get_args(Name)} - OPTIONAL | {*told}))
            text = f"guard {rule.name!r} watches {rule.signal}, which nothing of this station tells"
            raise InputError(f"{text}; remove the guard or watch one of {known}")
    return (*default, *station, *profile)


def _is_told(rule: GuardSettings, told: Collection[str]) -> bool:
    return rule.signal not in OPTIONAL or rule.signal in told


@dataclass(frozen=True)
class Signal:
    """The newest value of something that a guard may watch, and its bench time [s]."""

    value: float
    t_s: float
    detail: str = ""
    """What stands behind the number, for events and messages."""


@dataclass(frozen=True)
class Trip:
    """A guard tripped or released at `t_s`; `text` carries the numbers."""

    guard: GuardSettings
    tripped: bool
    t_s: float
    text: str


@dataclass(frozen=True)
class Light:
    """A guard as a traffic light: `waiting` is trouble within its delay, `tripped` lasts until it releases."""

    name: str
    state: Literal["ok", "waiting", "tripped"]
    text: str
    """What is wrong; empty when nothing is."""
    action: Action
    signal: Name
    value: float | None
    """Of the signal when it was looked at last; None: never, or not a number."""
    per_min: float | None = None
    """Its rate of change, where nothing else is limited; None as well until it is known."""


@dataclass
class _Guard:
    settings: GuardSettings
    value: float | None = None
    tripped: bool = False
    trouble: str | None = None
    bad_since: float | None = None
    good_since: float | None = None
    history: deque[Signal] = field(default_factory=deque)

    def evaluate(self, signal: Signal | None, now_s: float) -> Trip | None:
        silent = self._silent(signal, now_s)
        self.value = None if signal is None else signal.value
        self.trouble = silent or (None if signal is None else self._beyond(signal))
        if self.trouble is None:
            self.bad_since = None
            return self._release(signal, now_s)
        self.good_since = None
        self.bad_since = now_s if self.bad_since is None else self.bad_since
        if self.tripped or (silent is None and now_s - self.bad_since < self.settings.delay_s):
            return None
        self.tripped = True
        return Trip(self.settings, True, now_s, f"{self.settings.name}: {self.trouble}")

    def light(self) -> Light:
        """What it shows now."""
        state: Literal["ok", "waiting", "tripped"] = "ok" if self.trouble is None else "waiting"
        text = self.trouble or ("waits for its release" if self.tripped else "")
        value = None if self.value is None or not math.isfinite(self.value) else self.value
        rule = self.settings
        only_rate = rule.above is None and rule.below is None
        per_min = self._rate_per_min(self.history[-1]) if only_rate and self.history else None
        return Light(rule.name, "tripped" if self.tripped else state, text, rule.action, rule.signal, value, per_min)

    def _release(self, signal: Signal | None, now_s: float) -> Trip | None:
        if not self.tripped or signal is None:
            return None
        self.good_since = now_s if self.good_since is None else self.good_since
        if now_s - self.good_since < self.settings.release_delay_s:
            return None
        self.tripped = False
        rule = self.settings
        text = rule.answered(signal) or f"{rule.says(signal)} is inside its limits again"
        return Trip(rule, False, now_s, f"{rule.name}: {text}")

    def _silent(self, signal: Signal | None, now_s: float) -> str | None:
        rule = self.settings
        if signal is None or math.isnan(signal.value):
            return f"{rule.watched} is missing"
        if now_s - signal.t_s > rule.max_age_s:
            return f"{rule.watched} is {now_s - signal.t_s:.1f} s old, {rule.max_age_s:g} s allowed"
        return None

    def _beyond(self, signal: Signal) -> str | None:
        rule = self.settings
        above = rule.release_below if self.tripped and rule.release_below is not None else rule.above
        below = rule.release_above if self.tripped and rule.release_above is not None else rule.below
        rate = self._rate_per_min(signal) if rule.rate_per_min is not None else 0.0
        if above is not None and signal.value > above:
            return rule.answered(signal) or f"{rule.says(signal)} is above {rule.valued(above)}{_because(signal)}"
        if below is not None and signal.value < below:
            return rule.answered(signal) or f"{rule.says(signal)} is below {rule.valued(below)}{_because(signal)}"
        if rule.rate_per_min is not None and rate > rule.rate_per_min:
            return f"{rule.watched} changes by {rule.valued(rate)} per minute, {rule.valued(rule.rate_per_min)} allowed"
        return None

    def _rate_per_min(self, signal: Signal) -> float:
        """Change over `rate_over_s`; a shorter history counts as that long, so that noise alone does not trip."""
        history, over_s = self.history, self.settings.rate_over_s
        if not history or signal.t_s > history[-1].t_s:
            history.append(signal)
        while len(history) > 2 and history[1].t_s <= signal.t_s - over_s:
            history.popleft()
        return 60.0 * abs(signal.value - history[0].value) / max(signal.t_s - history[0].t_s, over_s)


def _because(signal: Signal) -> str:
    return f": {signal.detail}" if signal.detail else ""


@dataclass
class Guards:
    """All guards of a run."""

    settings: Sequence[GuardSettings]
    _guards: list[_Guard] = field(init=False)

    def __post_init__(self) -> None:
        self._guards = [_Guard(settings) for settings in self.settings]

    def evaluate(self, signals: Mapping[str, Signal], now_s: float, asleep: Collection[str] = ()) -> list[Trip]:
        """Trips and releases at `now_s`, in the order of the settings; guards on signals `asleep` stay as they are."""
        awake = [guard for guard in self._guards if guard.settings.signal not in asleep]
        trips = [guard.evaluate(signals.get(guard.settings.signal), now_s) for guard in awake]
        return [trip for trip in trips if trip is not None]

    def in_force(self, action: Action) -> list[str]:
        """The tripped guards that demand `action`, each with what is wrong (or was, until it releases)."""
        tripped = [guard for guard in self._guards if guard.tripped and guard.settings.action == action]
        return [f"{guard.settings.name}: {guard.trouble or 'waits for its release'}" for guard in tripped]

    def lights(self) -> list[Light]:
        """All of them, in the order of the settings."""
        return [guard.light() for guard in self._guards]

    def troubles(self) -> list[str]:
        """What was wrong at the last evaluation, tripped already or still within its delay."""
        return [f"{guard.settings.name}: {guard.trouble}" for guard in self._guards if guard.trouble is not None]
