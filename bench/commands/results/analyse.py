"""Results of commands on recorded runs and models."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bench import acquisition, analysis, base, mystery, record
from bench.commands.results.result import Result

if TYPE_CHECKING:
    from bench.commands.replay.replaying import Replay


WORST_FIRST = (
    "no_data",
    "partial",
    "unproven",
    "model_error",
    "unknown_effect",
    "missing_effect",
    "undecided",
    "measured",
    "adequate",
)
"""Verdicts of an analysis."""


@dataclass(frozen=True)
class Reported(Result):
    """An analysed run; `error` ended it before its time."""

    analysis: analysis.Analysis
    error: base.BenchError | None = None

    @property
    def verdict(self) -> str:
        """Word of the analysis."""
        return self.analysis.verdict.word

    @property
    def exit_code(self) -> int:
        """That of the error, else 1 outside limits."""
        return (0 if self.analysis.within_limits else 1) if self.error is None else self.error.exit_code

    @property
    def runs(self) -> tuple[Path, ...]:
        """The run."""
        return (self.analysis.run.path,)


@dataclass(frozen=True)
class FiguresDrawn(Result):
    """Figures of a run as files; `refused` are models that could not be fitted, each with the reason."""

    run: Path
    files: tuple[Path, ...]
    refused: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True)
class NotAnalysed(Result):
    """A run of which no analysis could be made, and why."""

    run: Path
    error: str
    code: int
    verdict: str = "unproven"

    @property
    def exit_code(self) -> int:
        """That of the error."""
        return self.code

    @property
    def runs(self) -> tuple[Path, ...]:
        """The run."""
        return (self.run,)


@dataclass(frozen=True)
class UnitReport:
    """What became of one output of a unit in a run; `error` is why it left, or what ended the run for it."""

    serial: str
    result: Reported | NotAnalysed
    error: base.BenchError | None = None
    output: str = "rate"
    """Which of the unit's rates it is of."""

    @property
    def name(self) -> str:
        """Serial number, and the output where the unit has several."""
        return self.serial if self.output == "rate" else f"{self.serial} {self.output}"


@dataclass(frozen=True)
class UnitsReported(Result):
    """Several units that went through one run, or several outputs of a unit."""

    units: tuple[UnitReport, ...]

    @property
    def verdict(self) -> str:
        """The worst one."""
        return min((unit.result.verdict for unit in self.units), key=WORST_FIRST.index)

    @property
    def exit_code(self) -> int:
        """The highest one."""
        return max(unit.result.exit_code for unit in self.units)

    @property
    def runs(self) -> tuple[Path, ...]:
        """Those of all units."""
        return tuple(run for unit in self.units for run in unit.result.runs)


@dataclass(frozen=True)
class Imported(Result):
    """A table of somebody else as it was understood; `run` is None for a preview."""

    plan: acquisition.ImportPlan
    run: Path | None

    @property
    def runs(self) -> tuple[Path, ...]:
        """The run that it became."""
        return () if self.run is None else (self.run,)


@dataclass(frozen=True)
class Compared(Result):
    """Models beside the noise floor."""

    comparison: analysis.Comparison


@dataclass(frozen=True)
class ComparedSamples(Compared):
    """The same fitted to every sample; white noise of samples hides differences that their 1 s means show."""

    samples: int
    seconds_floor_dph: float
    """Noise floor of 1 s means [deg/h]."""
    seconds: Mapping[str, tuple[float, float]]
    """In-sample and held-out RMS of 1 s means, by model [deg/h]."""


@dataclass(frozen=True)
class NoiseCoefficient:
    """A coefficient of IEEE 952 with its 95 % interval; zero where the data do not tell it from zero."""

    value: float
    low: float
    high: float
    unit: str


@dataclass(frozen=True)
class NoiseFound(Result):
    """Noise of isothermal stretches: the floor with its Allan curves, and the coefficients by name."""

    names: tuple[str, ...]
    floor: analysis.Floor
    coefficients: Mapping[str, NoiseCoefficient]


@dataclass(frozen=True)
class Diagnosed(Result):
    """Where a model fails and what is missing."""

    diagnosis: analysis.Diagnosis
    run: Path | None = None
    """Folder that keeps the diagnosis."""
    following: tuple[str, ...] = ()
    """Commands that add what is missing."""
    imported: bool = False
    """Whether the run is of a log: no station of this bench made it."""

    @property
    def runs(self) -> tuple[Path, ...]:
        """That folder."""
        return () if self.run is None else (self.run,)


@dataclass(frozen=True)
class Round:
    """One proposed run of a decision; `run` is None where it was not made, and `why` says why."""

    profile: Path
    use: str
    why: str
    run: Path | None = None


@dataclass(frozen=True)
class Decided(Result):
    """A diagnosis repeated with the runs that it proposed; `reason` says why it ended."""

    diagnosis: analysis.Diagnosis
    decided: bool
    reason: str
    rounds: tuple[Round, ...]

    @property
    def exit_code(self) -> int:
        """1 where it is not decided."""
        return 0 if self.decided else 1

    @property
    def runs(self) -> tuple[Path, ...]:
        """Those that were made."""
        return tuple(one.run for one in self.rounds if one.run is not None)


@dataclass(frozen=True)
class Improved(Result):
    """A model improved step by step; `out` is the file that it was written to."""

    improvement: analysis.Improvement
    out: Path | None


@dataclass(frozen=True)
class EffectAdded(Result):
    """A model file with one more effect."""

    model: Path
    effects: tuple[str, ...]


@dataclass(frozen=True)
class Effects(Result):
    """The catalogue of effects."""

    effects: Sequence[analysis.CatalogueEntry]


@dataclass(frozen=True)
class EffectShown(Result):
    """One effect, its documentation, and what it does to an example run."""

    entry: analysis.CatalogueEntry
    doc: str
    signature: analysis.Signature


@dataclass(frozen=True)
class Replayed(Result):
    """Runs made again from their raw frames."""

    replays: tuple[Replay, ...]

    @property
    def identical(self) -> bool:
        """Every number of every run is the same."""
        return all(replay.identical for replay in self.replays)

    @property
    def exit_code(self) -> int:
        """1 where a number differs."""
        return int(not self.identical)


@dataclass(frozen=True)
class Differs(Result):
    """What differs between two runs (`bench.archive.difference_of`)."""

    difference: Mapping[str, Any]


@dataclass(frozen=True)
class MysteryMade(Result):
    """A recorded unit with something hidden, in `folder`."""

    seed: int
    run: Path
    check: Path
    static: Path
    folder: Path


@dataclass(frozen=True)
class Revealed(Result):
    """A model scored against the truth."""

    score: mystery.Score


@dataclass(frozen=True)
class ImuCalibrated(Result):
    """A whole inertial unit: its parameters at some temperatures, and what is wrong."""

    table: Path
    out: Path | None
    rows: int
    left_out: int
    range_degc: tuple[float, float]
    parameters: tuple[analysis.Estimate, ...]
    undetermined: tuple[str, ...]
    findings: tuple[analysis.Finding, ...]
    files: tuple[Path, ...] = ()

    @property
    def exit_code(self) -> int:
        """1 where something is wrong, or is not determined."""
        return 1 if self.findings or self.undetermined else 0

    @property
    def runs(self) -> tuple[Path, ...]:
        """Those beside it that it was fitted to."""
        return record.fitted_runs(self.out) if self.out is not None and self.out.is_dir() else ()


@dataclass(frozen=True)
class ImuVerified(Result):
    """The calibration of an inertial unit against another table."""

    table: Path
    calibration: Path
    verification: record.ImuVerificationRecord
    files: tuple[Path, ...] = ()

    @property
    def exit_code(self) -> int:
        """1 outside limits."""
        return int(not self.verification.verdict.within)

    @property
    def runs(self) -> tuple[Path, ...]:
        """Those that the calibration was fitted to."""
        return record.fitted_runs(self.calibration) if self.calibration.is_dir() else ()
