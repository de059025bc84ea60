"""Results of commands that prepare a run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bench import acquisition
from bench.commands.results.result import Result

if TYPE_CHECKING:
    from drivers.contract import Outcome


@dataclass(frozen=True)
class Checked(Result):
    """A profile rehearsed on a station."""

    profile: acquisition.Profile
    station: acquisition.StationSettings
    segments: Sequence[acquisition.SegmentResult]
    findings: tuple[acquisition.Finding, ...]
    disk_bytes: int

    @property
    def duration_s(self) -> float:
        """Bench time that the run takes [s]."""
        return self.segments[-1].to_s

    @property
    def late(self) -> tuple[acquisition.SegmentResult, ...]:
        """Segments that would fail."""
        return tuple(segment for segment in self.segments if segment.outcome != "done")

    @property
    def ok(self) -> bool:
        """Nothing prevents the run."""
        return not self.late and all(finding.level != "error" for finding in self.findings)

    @property
    def exit_code(self) -> int:
        """1 where something prevents the run."""
        return int(not self.ok)

    def to_json(self) -> dict[str, Any]:
        """The object of `bench check --json`."""
        return {
            "profile": self.profile.name,
            "station": self.station.name,
            "duration_s": self.duration_s,
            "disk_bytes": self.disk_bytes,
            "segments": [asdict(segment) for segment in self.segments],
            "findings": [asdict(finding) for finding in self.findings],
        }


@dataclass(frozen=True)
class Examined(Result):
    """What the equipment of a station said."""

    examination: acquisition.Examination

    @property
    def exit_code(self) -> int:
        """1 where something disagrees, 4 where something does not answer."""
        return self.examination.exit_code


@dataclass(frozen=True)
class Proposed(Result):
    """A mapping that was proposed, and its file."""

    proposal: acquisition.Proposal
    file: Path


@dataclass(frozen=True)
class NoticesTried(Result):
    """A trial of the notices of a station: what went wrong by recipient, empty where the trial was taken."""

    file: str
    recipients: Mapping[str, str]

    @property
    def exit_code(self) -> int:
        """4 where a trial was not taken."""
        return 4 if any(self.recipients.values()) else 0


@dataclass(frozen=True)
class ContractTried(Result):
    """The contract of register maps, tried with the map of a station."""

    map: str
    behaviours: Sequence[Outcome]

    @property
    def agrees(self) -> bool:
        """Nothing failed."""
        return all(outcome.verdict != "failed" for outcome in self.behaviours)

    @property
    def exit_code(self) -> int:
        """1 where a behaviour failed."""
        return int(not self.agrees)


@dataclass(frozen=True)
class StationServed(Result):
    """A simulated station that was served until its end; buses and their ports."""

    modbus_port: int
    can_ports: Mapping[str, int]


@dataclass(frozen=True)
class Copied(Result):
    """The shipped files, copied; names are relative to the folder above."""

    folder: Path
    files: tuple[str, ...]
