"""A calibration into its unit, or the one before it back in force, by the ways of `drivers.coefficients`."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from bench.acquisition import StationSettings, UnitSettings, open_alone
from bench.base import InputError
from bench.commands.clocks import FUTURE_S
from bench.commands.flash_record import Attempt, complete, date, digest, held, located, records, unfinished
from bench.commands.flash_source import Calibration
from bench.deliver import Image, ImuImage
from bench.record import FlashRecord, slug
from drivers.coefficients import CoefficientStore
from drivers.unit_memory import Programmed


class AlreadyThereError(Exception):
    """The unit holds this very image in force."""

    def __init__(self, content: bytes, label: str) -> None:
        super().__init__(label)
        self.content, self.label = content, label


def objection(new: Image | ImuImage, old: bytes, now_s: float, older: bool) -> str | None:
    """Why the new image must not replace the old one (empty: none) at this time [s since 1970]; None: it may."""
    if new.created > now_s + FUTURE_S:
        return f"the calibration is of {date(new.created)}, which has not come yet: a clock was or is wrong"
    if new.valid_until and new.valid_until < now_s:
        return f"the calibration was valid until {date(new.valid_until)}; calibrate again"
    now = held(old)
    if now is None or older or new.created >= now.created or now.created > now_s + FUTURE_S:
        return None
    return (
        f"stale: the calibration is of {date(new.created)}, the unit holds a newer one of {date(now.created)} "
        f"({now.label}); --older writes it all the same"
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
    attempt = Attempt(settings, unit, out, "written")
    attempt.takes(calibration)

    def archive(old: bytes) -> None:
        if old == calibration.content:
            raise AlreadyThereError(old, calibration.image.label)
        if text := objection(calibration.image, old, attempt.now.timestamp(), older):
            raise InputError(f"not flashed: {text}")
        attempt.begin(old)

    with attempt.recorded(), open_alone(settings.remembering(out), unit) as store:
        try:
            done = store.program(calibration.content, archive, onlooker)
        except AlreadyThereError as found:
            complete(store, attempt.folder, found.content)
            raise
    return attempt.end(done)


def flash_previous(
    settings: StationSettings, unit: UnitSettings, out: Path, onlooker: Callable[[str], None] = lambda step: None
) -> FlashRecord:
    """Put the calibration in the unit's other bank back in force; the record, which is also left on disk.

    InputError where there is none, or it must not be in force; AlreadyThereError where an attempt that was interrupted
    went back already, DriverError for a step that failed.
    """
    attempt = Attempt(settings, unit, out, "previous")

    def archive(done: Programmed, previous: bytes) -> None:
        before = unfinished(attempt.folder, done.old)
        if before is not None and before.action == "previous":
            raise AlreadyThereError(done.old, before.calibration_id or "")
        calibration = _previous(unit, done, previous, out)
        if text := objection(calibration.image, done.old, attempt.now.timestamp(), older=True):
            raise InputError(f"not put back: {text}")
        attempt.takes(calibration)
        attempt.begin(done.old)

    with attempt.recorded(), open_alone(settings.remembering(out), unit) as store:
        if not isinstance(store, CoefficientStore):
            kept = f"{attempt.folder}{os.sep}*_old.bin"
            raise InputError(
                f"unit {unit.serial} is flashed by a command, which knows no banks; write an image that was kept at a "
                f"flash: `bench flash {unit.serial} --older --image FILE`, FILE one of {kept}"
            )
        try:
            done = store.restore(archive, onlooker)
        except AlreadyThereError as found:
            complete(store, attempt.folder, found.content)
            raise
    return attempt.end(done)


def _previous(unit: UnitSettings, done: Programmed, content: bytes, out: Path) -> Calibration:
    """The calibration in the bank that is not in force; InputError where none is there, or none that was in force."""
    if not done.old_bank:
        raise InputError(f"unit {unit.serial} has no calibration in force, so it has no previous one")
    bank, image = f"bank {done.bank}", held(content)
    known = list(records(out / slug(unit.serial) / "flash"))
    of_it = [one for one in known if digest(content) in {kept.sha256 for kept in (one.old, one.new) if kept}]
    ended = [one for one in of_it if one.state == "done"]
    why = None
    if not content:
        why = f"{bank} is empty"
    elif image is None:
        why = f"{bank} holds no whole calibration that this bench can read"
    elif image.serial != done.serial:
        why = f"calibration {image.label} in {bank} is of serial number {image.serial}, this unit is {done.serial}"
    elif of_it and not ended:
        why = f"calibration {image.label} in {bank} was written at {of_it[0].utc} and never put in force"
    if image is None or why is not None:
        stays = f"the calibration in bank {done.old_bank} stays in force"
        raise InputError(f"unit {unit.serial} has no previous calibration: {why}; {stays}")
    wrote = next((one for one in ended if one.new and one.new.sha256 == digest(content)), None)
    if wrote is None:
        return Calibration(content, image)
    run = located(wrote, out)
    return Calibration(content, image, Path(run) if run and Path(run).is_dir() else None, wrote.model or "")
