"""Calibrations of whole inertial units, and the runs beside them that they were fitted to."""

from __future__ import annotations

from pathlib import Path

from bench.record.files import sha256
from bench.record.records.imu import ImuRecord, ImuVerificationRecord
from bench.record.records.manifest import Manifest

_MEANS = "means.parquet"


def fitted_runs(calibration: Path) -> tuple[Path, ...]:
    """Run folders beside a calibration (folder with imu.json) that it was fitted to; empty where there are none.

    InputError where the record is damaged.
    """
    record = ImuRecord.find(calibration)
    names = [source.file.rpartition("/") for source in record.sources] if record else []
    runs = [calibration.parent / run for run, _, file in names if run and file == _MEANS]
    return tuple(run for run in runs if (run / _MEANS).is_file())


def whole_beside(run: Path) -> Path | None:
    """The newest calibration of a whole unit that stands beside a run and was fitted to its means as they are now.

    A run without attitudes, from which none is made, is not looked at closely. InputError where a record is damaged.
    """
    manifest = Manifest.find(run)
    if manifest is None or not any(segment.attitude for segment in manifest.segments):
        return None
    made = [(ImuRecord.read(file.parent), file.parent) for file in run.parent.glob(f"*/{ImuRecord.FILE}")]
    name = f"{run.name}/{_MEANS}"
    mine = [(record, folder) for record, folder in made if name in {source.file for source in record.sources}]
    if not mine or not (run / _MEANS).is_file():
        return None
    own = sha256(run / _MEANS)
    known = [
        (record.created, folder)
        for record, folder in mine
        if any(source.file == name and source.sha256 == own for source in record.sources)
    ]
    return max(known)[1] if known else None


def whole_verified(unit: Path) -> dict[str, ImuVerificationRecord]:
    """The newest verification of a whole unit by each run in the folder of a unit, by the name of the run.

    InputError where a record is damaged.
    """
    made = [ImuVerificationRecord.read(file.parent) for file in unit.glob(f"*/{ImuVerificationRecord.FILE}")]
    return {
        source.file.removesuffix(f"/{_MEANS}"): one
        for one in sorted(made, key=lambda one: one.created)
        for source in one.sources
        if source.file.endswith(f"/{_MEANS}")
    }
