"""Results of commands that meet a live run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench import record
from bench.commands.results.result import Result

REACHED: Mapping[str, tuple[frozenset[str], str]] = {
    "hold": (frozenset({"holding"}), "holding"),
    "pause": (frozenset({"pausing", "holding"}), "will hold after this segment"),
    "resume": (frozenset({"running"}), "goes on"),
}
"""What each request to a live run leads to: states, and the words for it."""


@dataclass(frozen=True)
class LiveRuns(Result):
    """Live runs as they describe themselves (docs/live.md); `place` is where they were looked for."""

    place: str
    states: Sequence[Mapping[str, Any]]

    @property
    def exit_code(self) -> int:
        """4 where a run does not answer."""
        return 4 if any(state["state"] == "silent" for state in self.states) else 0


@dataclass(frozen=True)
class Queue(Result):
    """What waits at a server, first what is next (`start`, `units`, `plan`, `station`, `who`, `not_before`)."""

    server: str
    waiting: Sequence[Mapping[str, Any]]


@dataclass(frozen=True)
class Asked(Result):
    """A live run was asked to hold, pause or resume; `state` is how it describes itself afterwards."""

    action: str
    run: str
    state: Mapping[str, Any]

    @property
    def reached(self) -> bool:
        """The run does what it was asked for."""
        return self.state["state"] in REACHED[self.action][0]

    @property
    def exit_code(self) -> int:
        """1 where it does something else."""
        return int(not self.reached)


@dataclass(frozen=True)
class Aborted(Result):
    """A live run was aborted: its end (`run`, `state`, `cause`, `safe`, `safe_state`)."""

    end: Mapping[str, Any]

    @property
    def safe(self) -> bool:
        """The safe state was reached and verified."""
        return bool(self.end["safe"])

    @property
    def exit_code(self) -> int:
        """4 where the safe state was not verified."""
        return 0 if self.safe else 4


@dataclass(frozen=True)
class Recovered(Result):
    """A run folder made of what a killed run left."""

    run: Path
    manifest: record.Manifest

    @property
    def exit_code(self) -> int:
        """1 where the run is not whole."""
        return 0 if self.manifest.state == "done" else 1

    @property
    def runs(self) -> tuple[Path, ...]:
        """The run."""
        return (self.run,)
