"""Results of `bench sync`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from bench.commands.results.result import Result

if TYPE_CHECKING:
    from bench.archive import Fetched, Name, Outbox, Released, Scrubbed, Sent


@dataclass(frozen=True)
class RunsSent(Result):
    """What travelled to a centre."""

    centre: str
    done: Sent

    @property
    def exit_code(self) -> int:
        """1 where a folder is damaged and was not sent."""
        return int(bool(self.done.damaged))


@dataclass(frozen=True)
class OutboxFound(Result):
    """What a centre lacks; `error` says why it was not reached, empty where it was."""

    centre: str
    found: Outbox
    error: str

    @property
    def exit_code(self) -> int:
        """1 where a folder is damaged."""
        return int(bool(self.found.damaged))


@dataclass(frozen=True)
class CentreListed(Result):
    """The folders of a centre."""

    centre: str
    names: Sequence[Name]


@dataclass(frozen=True)
class RunsFetched(Result):
    """What came from a centre into an archive."""

    centre: str
    archive: Path
    done: Fetched

    @property
    def exit_code(self) -> int:
        """1 where the centre could not give a folder."""
        return int(bool(self.done.damaged))


@dataclass(frozen=True)
class RunsRestored(Result):
    """How many files each folder got back."""

    folders: Sequence[tuple[Path, int]]


@dataclass(frozen=True)
class RawReleased(Result):
    """Folders whose raw data are at a centre only."""

    centre: str
    done: Released

    @property
    def exit_code(self) -> int:
        """1 where a folder could not be released."""
        return int(bool(self.done.refused))


@dataclass(frozen=True)
class CentreScrubbed(Result):
    """A centre of which every file was hashed anew."""

    centre: str
    done: Scrubbed

    @property
    def exit_code(self) -> int:
        """1 where there is a fault."""
        return int(bool(self.done.faults))
