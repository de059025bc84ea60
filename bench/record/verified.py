"""Verifications of a calibration run, and the calibration run of a verification: runs of one unit, side by side."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

from bench.base import InputError
from bench.record.records.judged import VerificationRecord
from bench.record.records.manifest import Manifest


def verified_by(run: Path) -> Path | None:
    """Folder of the run whose calibration this run verifies; None where it verifies none, or its record is damaged."""
    record = _record(run)
    origin = run.parent / Path(record.calibration_run).name if record and record.calibration_run else None
    return origin if origin is not None and (origin / Manifest.FILE).is_file() else None


def verifications(calibration: Path) -> Iterator[tuple[Path, VerificationRecord]]:
    """The runs that verify the calibration of this run, with their records, oldest first; without damaged ones."""
    for file in sorted(calibration.parent.glob(f"*/{VerificationRecord.FILE}")):
        record = _record(file.parent)
        if record is not None and Path(record.calibration_run or "").name == calibration.name:
            yield file.parent, record


def _record(run: Path) -> VerificationRecord | None:
    with contextlib.suppress(InputError):
        return VerificationRecord.find(run)
    return None
