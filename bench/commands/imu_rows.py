"""What `bench imu` is given: run folders, or a table and the plan of its attitudes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from bench import acquisition, analysis
from bench.base import FloatArray, InputError
from bench.record import ImuSource, Manifest, sha256


@dataclass(frozen=True, eq=False)
class Measured:
    """Rows that are fitted, their plan, and what they were made of."""

    rows: analysis.ImuRows
    plan: analysis.ImuPlan
    columns: Mapping[str, FloatArray]
    """Channels of the table, or of the first run, which the plan is of."""
    files: tuple[ImuSource, ...]
    """A digest of each source, in their order, and of the plan."""
    unit: str = ""
    """Serial number, where the runs know it."""
    simulated: bool = False
    """Whether one of the runs is simulated; a table does not say."""
    sample_hz: float | None = None
    """Of the unit, of which the runs have means; a table has the samples."""


def measured(sources: Sequence[Path], plan_file: Path | None) -> Measured:
    """What the sources hold; InputError where sources and plan do not go together."""
    tables = [source for source in sources if not source.is_dir()]
    planned = () if plan_file is None else (_digest(plan_file, plan_file.name),)
    if not tables:
        runs = analysis.rows_of_runs(sources, analysis.load_run_options(plan_file))
        files = tuple(_digest(source / "means.parquet", f"{source.name}/means.parquet") for source in sources)
        manifests = [Manifest.read(source) for source in sources]
        simulated, sample_hz = any(one.simulated for one in manifests), manifests[0].sample_rate_hz
        return Measured(runs.rows, runs.plan, runs.columns, (*files, *planned), runs.unit, simulated, sample_hz)
    if len(sources) > 1:
        raise InputError("one table is calibrated at a time, or run folders alone; name one of them", tables[0])
    if plan_file is None:
        raise InputError("is a table, which does not say its attitudes: give a plan with --plan", tables[0])
    plan, document = analysis.load_imu_plan(plan_file)
    columns = acquisition.read_confined(tables[0]).columns
    return Measured(
        analysis.rows_of(columns, plan, document), plan, columns, (_digest(tables[0], tables[0].name), *planned)
    )


def _digest(path: Path, name: str) -> ImuSource:
    return ImuSource(file=name, sha256=sha256(path))
