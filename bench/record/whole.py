"""Calibrations of whole inertial units, and the runs that they were fitted to."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

from bench.record.files import sha256
from bench.record.records.imu import ImuRecord, ImuSource, ImuVerificationRecord
from bench.record.records.manifest import Manifest

_MEANS = "means.parquet"
Origin = tuple[str, frozenset[tuple[str, str]]]
"""When a calibration was made, and from which files: their names and digests."""


def origin_of_whole(calibration: Path) -> Origin:
    """The origin of the calibration in a folder; InputError where its record is damaged."""
    record = ImuRecord.read(calibration)
    return record.created, frozenset((source.file, source.sha256) for source in record.sources)


def whole_fitted_to(
    run: Path, places: Iterable[Path] | None = None, origin: Callable[[Path], Origin] = origin_of_whole
) -> Path | None:
    """The newest calibration of a whole unit that was fitted to a run's means as they are now, in a folder of one of
    the `places` (default: beside the run).

    It takes no run without attitudes: for such a run none is looked for, since there may be a million other folders.
    InputError as `origin`, and where the run's manifest is damaged.
    """
    manifest, means = Manifest.find(run), run / _MEANS
    if manifest is None or not any(segment.attitude for segment in manifest.segments):
        return None
    files = [file.parent for place in places or [run.parent] for file in place.glob(f"*/{ImuRecord.FILE}")]
    made = [(*origin(folder), folder) for folder in files]
    name = f"{run.name}/{_MEANS}"
    if not means.is_file() or not any(name == file for _, sources, _ in made for file, _ in sources):
        return None
    own = (name, sha256(means))
    return max(((created, folder) for created, sources, folder in made if own in sources), default=("", None))[1]


def fitted_runs(calibration: Path) -> tuple[Path, ...]:
    """Run folders beside a calibration (folder with imu.json) that it was fitted to; empty where there are none.

    InputError where the record is damaged.
    """
    record = ImuRecord.find(calibration)
    runs = [calibration.parent / run for run in _runs(record.sources)] if record else []
    return tuple(run for run in runs if (run / _MEANS).is_file())


def whole_verified(unit: Path) -> dict[str, ImuVerificationRecord]:
    """The newest verification of a whole unit by each run in the folder of a unit, by the name of the run.

    InputError where a record is damaged.
    """
    made = [ImuVerificationRecord.read(file.parent) for file in unit.glob(f"*/{ImuVerificationRecord.FILE}")]
    return {run: one for one in sorted(made, key=lambda one: one.created) for run in _runs(one.sources)}


def _runs(sources: Iterable[ImuSource]) -> list[str]:
    """Names of the run folders among the sources."""
    return [source.file.removesuffix(f"/{_MEANS}") for source in sources if source.file.endswith(f"/{_MEANS}")]
