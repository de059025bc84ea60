"""What of the way from the first run to the certificate a unit's calibration has behind it."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

from pydantic import BaseModel

from bench.record import (
    CalibrationRecord,
    CertificateRecord,
    FlashRecord,
    ImuRecord,
    ImuVerificationRecord,
    Manifest,
    VerificationRecord,
    sha256,
)
from bench.web.live.story import sound


class Steps(BaseModel):
    """The steps that are done, in their order."""

    calibrated: bool
    """A model was fitted."""
    flashed: bool
    """It was written into the unit."""
    verified: bool
    """A run that the fit has not seen, with the unit's own correction on, is within the limits."""
    certified: bool
    """It has a certificate that is not a draft."""


def whole_of(folder: Path) -> Path:
    """Where a run's calibration is: of a whole inertial unit made from it (the newest), else in its own folder.

    `bench imu --out` names the folder freely; it is found in that of the unit, of all runs, or where that one is. It
    takes no run without attitudes: for such a run none is looked for, since there may be a million other folders.
    """
    recorded = sound(Manifest, folder)
    if recorded is None or not any(segment.attitude for segment in recorded.segments):
        return folder
    means, places = folder / "means.parquet", list(folder.parents)[:3]
    files = [file for place in places for file in place.glob(f"*/{ImuRecord.FILE}")]
    made = [(*_origin(file.parent, file.stat().st_mtime_ns), file.parent) for file in files]
    name = f"{folder.name}/{means.name}"
    if not any(name == file for _, sources, _ in made for file, _ in sources) or not means.is_file():
        return folder
    own = (name, sha256(means))
    return max(((created, whole) for created, sources, whole in made if own in sources), default=("", folder))[1]


@lru_cache(maxsize=256)
def _origin(whole: Path, changed_ns: int) -> tuple[str, frozenset[tuple[str, str]]]:
    """When the calibration in a folder was made, and from which files: their names and digests."""
    record = sound(ImuRecord, whole)
    return (
        ("", frozenset()) if record is None else (record.created, frozenset((s.file, s.sha256) for s in record.sources))
    )


def steps_of(folder: Path) -> Steps:
    """The steps of the calibration of this run, or of that which the run verifies."""
    if (whole := whole_of(folder)) != folder:
        verified, certificate = sound(ImuVerificationRecord, whole), sound(CertificateRecord, whole)
        flashed = sound(FlashRecord, whole)
        return Steps(
            calibrated=True,
            flashed=flashed is not None and flashed.state == "done",
            verified=verified is not None and verified.verdict.within,
            certified=certificate is not None and not certificate.draft,
        )
    origin = origin_of(folder) or folder
    calibration, flash = sound(CalibrationRecord, origin), sound(FlashRecord, origin)
    certificate = sound(CertificateRecord, origin)
    return Steps(
        calibrated=calibration is not None and calibration.calibration is not None,
        flashed=flash is not None and flash.state == "done",
        verified=any(verifications_of(origin)),
        certified=certificate is not None and not certificate.draft,
    )


def origin_of(folder: Path) -> Path | None:
    """The run whose calibration this run verifies; None for a run that verifies none."""
    own = sound(VerificationRecord, folder)
    return folder.parent / Path(own.calibration_run).name if own and own.calibration_run else None


def verifications_of(origin: Path) -> list[Path]:
    """Runs that verify the calibration in this run folder and are within limits, oldest first."""
    return [folder for folder in sorted(origin.parent.iterdir()) if _verifies(folder, origin)]


def _verifies(folder: Path, origin: Path) -> bool:
    found = sound(VerificationRecord, folder) if (folder / VerificationRecord.FILE).is_file() else None
    return found is not None and found.verdict.within and Path(found.calibration_run or "").name == origin.name
