"""Verifications of a calibration run, and the calibration run of a verification: runs of one unit, side by side."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from pathlib import Path

from bench.base import InputError
from bench.record.records.judged import VerificationRecord
from bench.record.records.manifest import Manifest


def verified_by(run: Path) -> Path | None:
    """Folder of the run whose calibration this run verifies; None where it verifies none, or its record is damaged."""
    record = _record(run)
    origin = run.parent / Path(record.calibration_run).name if record and record.calibration_run else None
    return origin if origin is not None and (origin / Manifest.FILE).is_file() else None


Verified = Mapping[str, Sequence[tuple[Path, VerificationRecord]]]


def verified_in(unit: Path) -> Verified:
    """The runs of a unit that verify a calibration, with their records, oldest first, by the run of the calibration.

    Without damaged ones. Who asks about many runs of a unit looks into its folders once.
    """
    found: dict[str, list[tuple[Path, VerificationRecord]]] = {}
    for file in sorted(unit.glob(f"*/{VerificationRecord.FILE}")):
        if (record := _record(file.parent)) is not None and record.calibration_run:
            found.setdefault(Path(record.calibration_run).name, []).append((file.parent, record))
    return found


def verifications(calibration: Path) -> Sequence[tuple[Path, VerificationRecord]]:
    """The runs that verify the calibration of this run, with their records, oldest first."""
    return verified_in(calibration.parent).get(calibration.name, ())


def _record(run: Path) -> VerificationRecord | None:
    with contextlib.suppress(InputError):
        return VerificationRecord.find(run)
    return None
