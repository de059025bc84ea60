"""Where the calibration that a unit gets comes from: a run, an inertial unit's record, or a file with an image."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from bench.acquisition import UnitSettings
from bench.base import InputError
from bench.commands.clocks import tell_ahead
from bench.commands.registering import refuse_foreign, seen_in
from bench.deliver import ExportOptions, Image, ImuImage, deliver_imu, prepare, read_either, to_bytes, to_words
from bench.record import CalibrationRecord, ImuRecord, ImuVerificationRecord, LimitsRecord, Manifest, slug

_REFUSED = {"FAIL", "INVALID"}


@dataclass(frozen=True)
class Calibration:
    """An image ready for a unit; `run` is the run folder that it was fitted to, `model` its name there."""

    content: bytes
    image: Image | ImuImage
    run: Path | None = None
    model: str = ""


def from_run(
    folder: Path, unit: UnitSettings, form: str | None = None, model: str | None = None, *, of_lot: bool = False
) -> Calibration:
    """The calibration of a run, or of the unit's lot.

    InputError where it is of another unit, did not pass, or may not be delivered.
    """
    manifest = Manifest.read(folder)
    refuse_foreign(folder)
    if manifest.unit != unit.serial and not of_lot:
        raise InputError(f"is a run of unit {manifest.unit}, this is unit {unit.serial}", folder)
    if manifest.purpose == "verification":
        raise InputError("is a verification: its unit corrected itself, nothing is fitted to it", folder)
    for reason in CalibrationRecord.read(folder).refusals:
        raise InputError(f"not flashed: {reason}", folder)
    judged = LimitsRecord.find(folder)
    if judged is not None and judged.verdict in _REFUSED:
        raise InputError(f"not flashed: the run's verdict against limits {judged.name} is {judged.verdict}", folder)
    package = prepare(folder, ExportOptions(form=form, serial=unit.identity, model=model)).package
    return Calibration(to_bytes(package.words), package.image, folder, package.delivery.model)


def from_imu(folder: Path, unit: UnitSettings) -> Calibration:
    """The calibration of a whole inertial unit; InputError where it is of another unit or may not be delivered."""
    record, verified = ImuRecord.of(folder), ImuVerificationRecord.find(folder)
    if record.unit != unit.serial:
        raise InputError(
            f"is a calibration of unit {record.unit or 'without a serial number'}, this is {unit.serial}", folder
        )
    if verified is not None and verified.verdict in _REFUSED:
        raise InputError(f"not flashed: its verification is {verified.verdict}", folder)
    package = deliver_imu(folder, record, "eeprom", ExportOptions(serial=unit.identity)).package
    return Calibration(to_bytes(package.words), package.image, folder, "inertial unit")


def from_file(path: Path) -> Calibration:
    """The image in a file; InputError where a unit would refuse it."""
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", path) from None
    try:
        return Calibration(content, read_either(to_words(content)))
    except InputError as error:
        raise InputError(str(error), path) from None


def newest_run(out: Path, unit: str) -> Path:
    """The unit's newest run folder that holds a calibration; InputError when there is none."""
    found = [path.parent for path in (out / slug(unit)).glob(f"*/{CalibrationRecord.FILE}")]
    usable = [folder for folder in found if CalibrationRecord.read(folder).calibration is not None]
    raw = [folder for folder in usable if Manifest.read(folder).purpose != "verification"]
    if not raw:
        raise InputError(
            f"no run of unit {unit} with a calibration here; name one with --run or an image with --image", out
        )
    created = {folder: Manifest.read(folder).created for folder in raw}
    tell_ahead((folder.name, when) for folder, when in created.items())
    seen = seen_in(out)
    newest = max(raw, key=lambda folder: (seen.get(f"{slug(unit)}/{folder.name}", (-1, ""))[0], created[folder]))
    later = [
        folder.name
        for folder in raw
        if seen and created[folder] > created[newest] and f"{slug(unit)}/{folder.name}" not in seen
    ]
    if later:
        raise InputError(
            f"run {later[0]} is not registered, so nothing says whether it is newer than {newest.name}; name one with "
            f"--run, or register it with `bench registry rebuild --out {out}`",
            out,
        )
    return newest
