"""What the sequencer asks of others while it runs a profile: one small Protocol for each question.

The runner answers most of them. `commands/` may answer "go on, or stop?", so that an analysis ends a run early without
this half of the bench importing the other one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

from bench.acquisition.profile.guards import Signal
from bench.acquisition.profile.legs import Leg
from bench.acquisition.run.plausible import Plausible
from bench.acquisition.run.status import Status
from bench.acquisition.station.powering import Cycling
from bench.acquisition.station.turning import Turning


@dataclass(frozen=True)
class Continue:
    """The run goes on; `text` and its figures become an event where there is one."""

    text: str = ""
    facts: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Stop:
    """The run has what it was started for: it ends now, and counts as done."""

    reason: str
    who: str
    """Who decided it, for the events: the name of an analysis or of a program."""
    facts: Mapping[str, Any] = field(default_factory=dict)
    """The figures that it was decided by."""

    def __str__(self) -> str:
        return f"ended early by {self.who}: {self.reason}"


class Onlooker(Protocol):
    """Sees each tick."""

    def __call__(self, status: Status) -> None:
        """Take in one tick. What it raises ends the run."""


class Decider(Protocol):
    """Go on, or stop? Asked at each tick of a profile, not on the way home."""

    def decide(self, status: Status) -> Continue | Stop:
        """Called by the loop of the run: a slow answer delays the next tick. What it raises ends the run."""


class Table(Protocol):
    """What turns the units during a leg."""

    def begin(self, leg: Leg) -> Turning:
        """A leg starts now."""


class Power(Protocol):
    """What switches the units' power during a leg."""

    cycling: bool
    """Whether the power is off on purpose, or not all units are heard again."""

    def begin(self, leg: Leg) -> Cycling:
        """A leg that switches the power starts now."""


class Placing(Protocol):
    """What brings the units into their attitudes."""

    @property
    def attitude(self) -> str | None:
        """The one that they stand in; None: nobody said."""

    @property
    def heading_deg(self) -> float:
        """By how much they are turned against the heading that belongs to its name [deg]."""

    @property
    def waiting(self) -> str:
        """What is waited for; empty: nothing."""

    def ask(self, attitude: str) -> None:
        """Bring them into this one."""

    def confirm(self, who: str) -> None:
        """Somebody says that they stand so."""

    def tick(self) -> None:
        """Called at each tick, after the units were heard."""


class Heart(Protocol):
    """Whoever has to know that the bench is alive."""

    def beat(self) -> None:
        """Called at each tick, before anything else."""


class Surroundings(Protocol):
    """Signals for the guards from outside the station, such as the free disk."""

    def __call__(self) -> Mapping[str, Signal]:
        """By name; one that is not known now is left out."""


class _GoesOn:
    def decide(self, status: Status) -> Continue | Stop:
        return Continue()


class _NoHeart:
    def beat(self) -> None:
        """Nobody listens."""


def _nobody(status: Status) -> None:
    """Nobody looks on."""


@dataclass(frozen=True)
class Wiring:
    """Who answers the sequencer; each may be left out."""

    onlooker: Onlooker = _nobody
    decider: Decider = field(default_factory=_GoesOn)
    table: Table | None = None
    power: Power | None = None
    placing: Placing | None = None
    heart: Heart = field(default_factory=_NoHeart)
    surroundings: Surroundings = dict
    plausible: Plausible | None = None
    """What says whether air, set point and units fit together."""
