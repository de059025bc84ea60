"""A calibration into its unit: the image made or read, objections, the way of `drivers.coefficients`, and the record.

Every attempt leaves a record with the old and the new image in `<out>/<unit>/flash/`; one that succeeded stands in the
run folder that the calibration came from, too, as flash.json.
"""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from bench.acquisition import StationSettings, UnitSettings, open_alone
from bench.base import InputError, __version__, user_name
from bench.commands.clocks import FUTURE_S, tell_ahead
from bench.commands.registering import refuse_foreign, seen_in
from bench.deliver import ExportOptions, Image, ImuImage, deliver_imu, prepare, read_either, to_bytes, to_words
from bench.record import (
    CalibrationRecord,
    FlashRecord,
    ImuRecord,
    ImuVerificationRecord,
    LimitsRecord,
    Manifest,
    StoredImage,
    chain_of,
    put,
    slug,
)
from drivers.coefficients import CoefficientStore, Programmed, program
from drivers.errors import DriverError
from drivers.flash_objects import Memory

_REFUSED = {"FAIL", "INVALID"}


@dataclass(frozen=True)
class Calibration:
    """An image ready for a unit; `run` is the run folder that it was fitted to, `model` its name there."""

    content: bytes
    image: Image | ImuImage
    run: Path | None = None
    model: str = ""


class AlreadyThereError(Exception):
    """The unit holds this very image in force."""


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


def objection(new: Image | ImuImage, old: bytes, now_s: float, older: bool) -> str | None:
    """Why the new image must not replace the old one (empty: none) at this time [s since 1970]; None: it may."""
    if new.created > now_s + FUTURE_S:
        return f"the calibration is of {_date(new.created)}, which has not come yet: a clock was or is wrong"
    if new.valid_until and new.valid_until < now_s:
        return f"the calibration was valid until {_date(new.valid_until)}; calibrate again"
    held = _held(old)
    if held is None or older or new.created >= held.created or held.created > now_s + FUTURE_S:
        return None
    return (
        f"stale: the calibration is of {_date(new.created)}, the unit holds a newer one of {_date(held.created)} "
        f"({held.label}); --older writes it all the same"
    )


def flash(
    settings: StationSettings,
    unit: UnitSettings,
    calibration: Calibration,
    out: Path,
    *,
    older: bool = False,
    onlooker: Callable[[str], None] = lambda step: None,
) -> FlashRecord:
    """Program the unit and verify; the record, which is also left on disk.

    InputError for a calibration that must not go into this unit, AlreadyThereError for the one in force, DriverError
    for a step that failed.
    """
    now = datetime.now(UTC)
    folder = out / slug(unit.serial) / "flash"
    folder.mkdir(parents=True, exist_ok=True)
    stem = _free(folder, f"{now:%Y%m%dT%H%M%SZ}")
    record = _record(settings, unit, calibration, now)
    before: list[StoredImage | None] = []

    def archive(old: bytes) -> None:
        if old == calibration.content:
            raise AlreadyThereError
        if text := objection(calibration.image, old, now.timestamp(), older):
            raise InputError(f"not flashed: {text}")
        before.append(_described(old, f"{stem}_old.bin") if old else None)
        for name, content in (("old", old), ("new", calibration.content)):
            if content:
                put(folder, {f"{stem}_{name}.bin": content})
        new = _described(calibration.content, f"{stem}_new.bin")
        record.model_copy(update={**_old(before), "new": new}).write(folder, f"{stem}.json")

    try:
        with open_alone(settings.remembering(out), unit) as store:
            try:
                done = program(store, calibration.content, archive, onlooker)
            except AlreadyThereError:
                _complete(store, folder, calibration)
                raise
    except DriverError as error:
        failed = {**_old(before), "state": "failed", "error": str(error)}
        record.model_copy(update=failed).write(folder, f"{stem}.json")
        raise
    record = record.model_copy(update={
        **_old(before),
        "state": "done",
        "new": _described(calibration.content, f"{stem}_new.bin"),
        **_outcome(done),
        "record": str(folder / f"{stem}.json"),
    })  # fmt: skip
    if calibration.run is not None:  # first: while the record is "begun", the same command completes both
        record.write(calibration.run)
    record.write(folder, f"{stem}.json")
    return record


def _complete(store: CoefficientStore, folder: Path, calibration: Calibration) -> None:
    """Complete the record of an attempt that wrote this image and was killed before it could record its end."""
    for path in sorted(folder.glob("*.json"), reverse=True):
        record = FlashRecord.read(folder, path.name)
        if record.state == "done":
            return
        if record.state == "begun" and record.new and record.new.sha256 == _sha256(calibration.content):
            record = record.model_copy(update={
                "state": "done",
                "bank": store.active(),
                "coefficient_set": store.number(Memory.SET),
                "read_back": "all words equal, read after an interruption",
                "record": str(path),
            })  # fmt: skip
            if record.run is not None and Path(record.run).is_dir():
                record.write(Path(record.run))
            record.write(folder, path.name)
            return


def newest_record(out: Path, unit: str) -> FlashRecord | None:
    """The record of the last flash of this unit that succeeded; None when there is none."""
    folder = out / slug(unit) / "flash"
    known = chain_of(folder)
    order = [] if known is None else list(known.files)
    names = {path.name for path in folder.glob("*.json")} | {name for name in order if name.endswith(".json")}
    # By the order in which they were written; those of an older bench by their names.
    newest = sorted(names, key=lambda name: (order.index(name) if name in order else -1, name), reverse=True)
    records = (FlashRecord.find(folder, name) for name in newest)  # one that is listed and lost is refused
    found = next((record for record in records if record is not None and record.state == "done"), None)
    if found is not None and found.run and not Path(found.run).is_dir():
        moved = str(out / slug(unit) / Path(found.run).name)  # with the whole folder
        return found.model_copy(update={"run": moved})
    return found


def _old(before: list[StoredImage | None]) -> dict[str, StoredImage | None]:
    return {"old": before[0]} if before else {}


def _record(settings: StationSettings, unit: UnitSettings, calibration: Calibration, now: datetime) -> FlashRecord:
    addresses = unit.flash.addresses(unit.number)
    return FlashRecord(
        unit=unit.serial,
        serial=calibration.image.serial,
        utc=now.isoformat(timespec="seconds"),
        operator=user_name(),
        station=settings.name,
        simulated=settings.simulated,
        protocol=addresses.protocol,
        run=None if calibration.run is None else str(calibration.run),
        model=calibration.model,
        form=calibration.image.form,
        calibration_id=calibration.image.label,
        software=__version__,
        state="begun",
    )


def _outcome(done: Programmed) -> dict[str, Any]:
    return {
        "bank": done.bank,
        "old_bank": done.old_bank,
        "coefficient_set": done.new_set,
        "old_coefficient_set": done.old_set,
        "crc": f"0x{done.crc:08X}",
        "read_back": "all words equal, after the write and again after the reset",
        "steps_s": done.took_s,
    }


def _described(content: bytes, file: str) -> StoredImage:
    held = _held(content)
    return StoredImage(
        file=file,
        sha256=_sha256(content),
        words=len(content) // 4,
        calibration_id=None if held is None else held.label,
        created=None if held is None else _date(held.created),
    )


def _held(content: bytes) -> Image | ImuImage | None:
    """An image from a unit; None where it is none that this bench can read."""
    try:
        return read_either(to_words(content))
    except (InputError, struct.error, IndexError):
        return None


def _date(seconds: int) -> str:
    return datetime.fromtimestamp(seconds, UTC).isoformat(timespec="seconds")


def _sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _free(folder: Path, stem: str) -> str:
    names = (stem, *(f"{stem}_{n}" for n in range(2, 1000)))
    return next(name for name in names if not list(folder.glob(f"{name}[._]*")))
