"""What of the way from the first run to the certificate a unit's calibration has behind it."""

from __future__ import annotations

import contextlib
from functools import lru_cache
from pathlib import Path

from pydantic import BaseModel

from bench.base import InputError
from bench.record import (
    CalibrationRecord,
    CertificateRecord,
    FlashRecord,
    ImuRecord,
    ImuVerificationRecord,
    Origin,
    origin_of_whole,
    verifications,
    verified_by,
    whole_fitted_to,
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
    with contextlib.suppress(InputError):
        return whole_fitted_to(folder, list(folder.parents)[:3], _origin) or folder
    return folder


def _origin(whole: Path) -> Origin:
    return _known_origin(whole, (whole / ImuRecord.FILE).stat().st_mtime_ns)


@lru_cache(maxsize=256)
def _known_origin(whole: Path, changed_ns: int) -> Origin:
    """That of the calibration in a folder; one that is damaged was made from nothing."""
    try:
        return origin_of_whole(whole)
    except InputError:
        return "", frozenset()


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
    origin = verified_by(folder) or folder
    calibration, flash = sound(CalibrationRecord, origin), sound(FlashRecord, origin)
    certificate = sound(CertificateRecord, origin)
    return Steps(
        calibrated=calibration is not None and calibration.calibration is not None,
        flashed=flash is not None and flash.state == "done",
        verified=any(verifications_of(origin)),
        certified=certificate is not None and not certificate.draft,
    )


def verifications_of(origin: Path) -> list[Path]:
    """Runs that verify the calibration in this run folder and are within limits, oldest first."""
    return [folder for folder, found in verifications(origin) if found.verdict.within]
