"""Results of commands that take a calibration to its unit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bench import analysis, base, deliver, record
from bench.commands.results.result import Result

if TYPE_CHECKING:
    from bench.commands.calibration.job import JobFile


@dataclass(frozen=True)
class Exported(Result):
    """Files of a calibration for its unit."""

    run: Path
    format: str
    files: tuple[Path, ...]
    delivered: deliver.Delivered


@dataclass(frozen=True)
class ImuExported(Result):
    """Files of the calibration of a whole inertial unit."""

    run: Path
    format: str
    files: tuple[Path, ...]
    delivered: deliver.DeliveredImu


@dataclass(frozen=True)
class MeasuredExported(Result):
    """Files with what a run measured."""

    run: Path
    format: str
    files: tuple[Path, ...]


@dataclass(frozen=True)
class Certified(Result):
    """A certificate; `facts` are what it says."""

    run: Path
    pdf: Path
    json: Path
    xml: Path
    facts: Mapping[str, Any]

    @property
    def exit_code(self) -> int:
        """1 where what it certifies is outside limits."""
        verdict = self.facts["verdict"]
        return int(verdict is not None and not record.Verdict(verdict).within)

    @property
    def runs(self) -> tuple[Path, ...]:
        """The run."""
        return (self.run,)


class ImuCertified(Certified):
    """A certificate of a whole inertial unit."""

    @property
    def runs(self) -> tuple[Path, ...]:
        """Those that the calibration was fitted to: its folder is no run."""
        return record.fitted_runs(self.run)


@dataclass(frozen=True)
class CertificateChecked(Result):
    """Whether a certificate is as it was signed."""

    checked: deliver.CheckedCertificate
    state: str | None = None
    """Whether it is in force, as far as the archive knows it."""

    @property
    def exit_code(self) -> int:
        """1 where something is wrong with it."""
        return int(not self.checked.sound)


@dataclass(frozen=True)
class Flashed(Result):
    """The record of a calibration that was written into its unit, or was there already."""

    record: Mapping[str, Any]

    @property
    def calibration_id(self) -> str:
        """As it is printed."""
        return str(self.record["calibration_id"])

    @property
    def already_there(self) -> bool:
        """Nothing was written."""
        return str(self.record["state"]) == "already there"


@dataclass(frozen=True)
class Verified(Result):
    """A run with the unit's own correction on, judged; `error` ended it before its time."""

    verification: analysis.Verification
    error: base.BenchError | None = None

    @property
    def exit_code(self) -> int:
        """That of the error, else 1 outside limits."""
        return (0 if self.verification.verdict.within else 1) if self.error is None else self.error.exit_code

    @property
    def runs(self) -> tuple[Path, ...]:
        """The verification."""
        return (self.verification.run.path,)


@dataclass(frozen=True)
class Calibrated(Result):
    """The job of a calibration as it stands; `steps` are the names of all its steps."""

    job: JobFile
    steps: tuple[str, ...]

    def run_of(self, step: str) -> Path | None:
        """Folder of the run that a step made."""
        run = self.job.facts(step).get("run")
        return None if run is None else self.job.folder.parent / str(run)

    @property
    def exit_code(self) -> int:
        """The verdict of the job."""
        return int(self.job.content["exit_code"])

    @property
    def runs(self) -> tuple[Path, ...]:
        """All that it made."""
        return tuple(self.job.runs())


@dataclass(frozen=True)
class CalibratedAll(Result):
    """The jobs of several units that were calibrated together."""

    units: tuple[Calibrated, ...]

    @property
    def exit_code(self) -> int:
        """The worst of them."""
        return max(unit.exit_code for unit in self.units)

    @property
    def runs(self) -> tuple[Path, ...]:
        """All that they made."""
        return tuple(run for unit in self.units for run in unit.runs)
