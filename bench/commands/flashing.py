"""`bench flash` and `bench verify`: a calibration into its unit, and the proof that it is right there."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench import analysis
from bench.acquisition import StationSettings, UnitSettings, open_alone
from bench.base import Document, InputError, read_yaml
from bench.commands.acquisition import Task, conduct, station_file, station_of
from bench.commands.flash_record import newest_record
from bench.commands.flash_source import Calibration, from_file, from_imu, from_run, newest_run
from bench.commands.flash_unit import AlreadyThereError, flash_previous
from bench.commands.flash_unit import flash as flash_unit
from bench.commands.imu_certifying import is_imu
from bench.commands.lots import refuse_unlike
from bench.commands.results.deliver import Flashed, Verified
from bench.commands.slots import seated
from bench.deliver import read_either, to_words
from bench.record import FlashRecord, LotRecord, RunFolder, faults, prove, slug


@dataclass(frozen=True)
class FlashOptions:
    """What the caller of `bench flash` chooses; without run and image the newest run of the unit."""

    run: Path | None = None
    image: Path | None = None
    form: str | None = None
    model: str | None = None
    older: bool = False
    check: Path | None = None
    """Run of the unit, which shows that it is like the lot whose calibration it gets."""
    previous: bool = False
    """Go back to the calibration that the unit's other bank holds."""


def flash(
    serial: str, station: Path | Document | None, options: FlashOptions, out: Path, quiet: bool = False
) -> Flashed:
    """`bench flash`: write a calibration into its unit, or put the previous one back, and verify that it is there."""
    if options.previous and options != FlashOptions(previous=True):
        raise InputError(
            "--previous goes back to what the unit's other bank holds: leave out --run, --image, --form, --model, "
            "--check and --older"
        )
    place, (serial,) = seated(station_file(station), [serial])
    settings = station_of(place)
    unit = settings.chosen([serial])[0]
    calibration = None if options.previous else _calibration(unit, options, out)
    earlier = out / slug(unit.serial) / "flash"
    for fault in faults(earlier) if earlier.is_dir() else ():  # flashing does not rest on them, verifying does
        print(f"bench: warning: {fault}", file=sys.stderr)

    def tell(step: str) -> None:
        if not quiet:
            print(f"{step} …", file=sys.stderr, flush=True)

    try:
        if calibration is None:
            return Flashed(flash_previous(settings, unit, out, tell).content())
        return Flashed(flash_unit(settings, unit, calibration, out, older=options.older, onlooker=tell).content())
    except AlreadyThereError as found:
        return Flashed({"unit": serial, "state": "already there", "calibration_id": found.label})


def _calibration(unit: UnitSettings, options: FlashOptions, out: Path) -> Calibration:
    if options.image is not None:
        if options.run is not None or options.form is not None or options.model is not None:
            raise InputError("--image is written as it is: leave out --run, --form and --model")
        return from_file(options.image)
    if options.run is not None and is_imu(options.run):
        if options.form is not None or options.model is not None or options.check is not None:
            raise InputError("--form, --model and --check are for a single gyro; leave them out", options.run)
        return from_imu(options.run, unit)
    run = options.run or newest_run(out, unit.serial)
    if of_lot := LotRecord.find(run) is not None:
        refuse_unlike(run, unit.serial, options.check)
    elif options.check is not None:
        raise InputError("--check shows that a unit is like its lot; this is no calibration of a lot", run)
    return from_run(run, unit, options.form, options.model, of_lot=of_lot)


def verify(
    profile_path: Path, serial: str, station_path: Path | None, limits_path: Path | None, out: Path, quiet: bool
) -> Verified:
    """`bench verify`: another profile with the unit's own correction on; what it leaves, judged."""
    station, (serial,) = seated(station_file(station_path), [serial])
    settings = station_of(station)
    unit = settings.chosen([serial])[0]
    limits = None if limits_path is None else read_yaml(limits_path)
    allowed = None if limits is None else analysis.load_limits(limits)
    record = newest_record(out, serial)
    calibration = Path(record.run) if record and record.run else None
    if calibration is not None and not calibration.is_dir():
        calibration = None
    if calibration is not None:
        prove(calibration)
    profile = read_yaml(profile_path)
    analysis.refuse_same_profile(profile, calibration)
    inside = in_unit(settings, unit, record, out)
    texts = {} if limits is None else {"limits.yaml": limits.text}
    result = conduct(profile, station, Task([serial], texts, out, "on"), quiet)
    if result.error is not None and result.run.manifest().rows == 0:
        raise result.error
    return Verified(analysis.verify(RunFolder(result.run.path), calibration, allowed, inside), result.error)


def in_unit(settings: StationSettings, unit: UnitSettings, record: FlashRecord | None, out: Path) -> dict[str, Any]:
    """The calibration in force in the unit, read over its bus or by its command; InputError where there is none."""
    with open_alone(settings.remembering(out), unit) as store:
        inside = store.held()
    content = inside.image
    if not content:
        raise InputError(f"unit {unit.serial} holds no calibration; write one with `bench flash {unit.serial}`")
    try:
        image = read_either(to_words(content))
    except InputError as error:
        raise InputError(f"unit {unit.serial}: {error}; write one with `bench flash {unit.serial}`") from None
    flashed = record.calibration_id if record else None
    if record is not None and image.label != flashed:
        raise InputError(
            f"unit {unit.serial} holds calibration {image.label}, the last one that was flashed from here is "
            f"{flashed}; flash it again, or name the folder of its runs with --out"
        )
    return {"bank": inside.bank, "calibration_id": image.label, "words": len(content) // 4}
