"""Results of commands on many units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bench import analysis, archive, record
from bench.commands.results.result import Result

if TYPE_CHECKING:
    from datetime import date


@dataclass(frozen=True)
class RegisteredRuns(Result):
    """Runs of a registry, the newest first."""

    registry: str
    rows: Sequence[Mapping[str, Any]]


@dataclass(frozen=True)
class RegistryEntry(Result):
    """All that a registry knows of a unit or a run, by table."""

    tables: Mapping[str, Any]


@dataclass(frozen=True)
class RegistryRebuilt(Result):
    """A registry made from the run folders, or only compared with them."""

    registry: str
    rebuilt: archive.Rebuilt
    only_compared: bool

    @property
    def exit_code(self) -> int:
        """1 where a comparison found a difference, or a folder cannot be read."""
        return int(bool(self.rebuilt.unreadable) or (self.only_compared and bool(self.rebuilt.differences)))


@dataclass(frozen=True)
class Scrubbed(Result):
    """An archive of which every file was read: its folders, the keys that signed, and every fault."""

    archive: Path
    folders: int
    keys: Sequence[str]
    faults: Sequence[str]

    @property
    def exit_code(self) -> int:
        """1 where there is a fault."""
        return int(bool(self.faults))


@dataclass(frozen=True)
class Noted(Result):
    """What a person said, as it stands in the ledger now."""

    ledger: Path
    entry: archive.Entry


@dataclass(frozen=True)
class CertificatesListed(Result):
    """Certificates of a registry; `state` of each says whether it is in force."""

    registry: str
    certificates: Sequence[Mapping[str, Any]]


@dataclass(frozen=True)
class Recalled(Result):
    """Runs since a day that rest on a piece of equipment, each with its unit and the numbers of its certificates."""

    equipment: str
    since: date | None
    recalled: Sequence[Mapping[str, Any]]
    unknown: int
    """Runs of which nobody said what equipment they were made with …"""
    elsewhere: int
    """… and whose folders are not here."""


@dataclass(frozen=True)
class EquipmentListed(Result):
    """Equipment of a registry, judged by a day; `state` of each is valid, overdue or no due date."""

    on: date
    equipment: Sequence[Mapping[str, Any]]

    @property
    def exit_code(self) -> int:
        """1 where a calibration is overdue."""
        return int(any(row["state"] == "overdue" for row in self.equipment))


@dataclass(frozen=True)
class FleetJudged(Result):
    """Statistics of all units, and the files that they were written to."""

    statistics: archive.Statistics
    html: Path | None
    csv: Path | None

    @property
    def exit_code(self) -> int:
        """1 where a unit is outside its limits, or its runs do not allow to judge it."""
        return int(self.statistics.passes.outside + self.statistics.passes.unjudged > 0)


@dataclass(frozen=True)
class FleetDiagnosed(Result):
    """What the model of each unit lacks; `seconds` for those that were diagnosed now."""

    model: str
    diagnosis: archive.FleetDiagnosis
    engine: str
    seconds: float

    @property
    def exit_code(self) -> int:
        """1 where a unit could not be diagnosed."""
        return int(bool(self.diagnosis.failed))


@dataclass(frozen=True)
class GaugeJudged(Result):
    """Repeatability and reproducibility of a quantity, and the runs that were left out."""

    quantity: str
    unit: str
    gauge: archive.Gauge
    left_out: Sequence[str]

    @property
    def exit_code(self) -> int:
        """1 where the stations and repetitions take more than 30 % of the tolerance, or without one of the spread."""
        return int(not self.gauge.acceptable)


@dataclass(frozen=True)
class Refitted(Result):
    """Units refitted with a model. `failures` are the first reasons, `rms_dph` quantiles of the error [deg/h]."""

    model: str
    units: int
    failed: int
    without_moments: Sequence[str]
    left_out: Sequence[str]
    engine: str
    seconds: float
    units_per_s: float
    rms_dph: Mapping[str, float | None]
    failures: Sequence[str]
    weights: Mapping[str, str]
    """How rows count, and why not by the noise."""
    records: Path

    @property
    def exit_code(self) -> int:
        """1 where a unit could not be refitted."""
        return int(bool(self.failed or self.without_moments))


@dataclass(frozen=True)
class LotCalibrated(Result):
    """A run folder with the calibration of a lot, and its record."""

    run: Path
    record: record.LotRecord

    @property
    def runs(self) -> tuple[Path, ...]:
        """The lot's."""
        return (self.run,)


@dataclass(frozen=True)
class LotCompleted(Result):
    """A run folder with the calibration of a unit by its run and its lot, and the error expected of it [deg/h RMS]."""

    run: Path
    lot: str
    error_dph: float
    low_dph: float
    high_dph: float

    @property
    def runs(self) -> tuple[Path, ...]:
        """The unit's."""
        return (self.run,)


@dataclass(frozen=True)
class LotPlanned(Result):
    """A profile for further units of a lot, and the error to expect of their calibration by `bench lot complete`."""

    lot: str
    profile: Path
    target_dph: float
    error_dph: float
    low_dph: float
    """Ends of the 95 % interval."""
    high_dph: float
    hours: float
    whole_hours: float
    """Of the lot's own runs."""


@dataclass(frozen=True)
class LotAudited(Result):
    """How the runs of a lot with `until` ended, and what the audits among them showed."""

    lot: str
    outcomes: Mapping[str, int]
    saved: float
    """Share of the time of whole runs that all these runs together saved."""
    audits: int
    held: int
    """Audits whose error lies in the stated 95 % interval …"""
    held_from: float | None
    """… and the 95 % interval of that share (Clopper, Pearson)."""
    held_to: float | None
    over: int
    """Audits whose error is above the limit."""


@dataclass(frozen=True)
class LotChecked(Result):
    """Which units are like a lot."""

    run: Path
    lot: str
    units: Mapping[str, analysis.Likeness]

    @property
    def exit_code(self) -> int:
        """1 where a unit is unlike it."""
        return int(not all(one.like for one in self.units.values()))
