"""`bench flash` and `bench verify`: a calibration into its unit, and the proof that it is right there."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.acquisition import StationSettings, UnitSettings, open_alone
from bench.analysis import Verification, load_limits, refuse_same_profile
from bench.analysis import verify as verify_run
from bench.base import InputError, read_text
from bench.commands.acquisition import Task, conduct, load_station
from bench.commands.answer import Answer, number
from bench.commands.flash_record import AlreadyThereError, Calibration, from_file, from_run, newest_record, newest_run
from bench.commands.flash_record import flash as flash_unit
from bench.deliver import to_words
from bench.record import RunFolder


@dataclass(frozen=True)
class FlashOptions:
    """What the caller of `bench flash` chooses; without run and image the newest run of the unit."""

    run: Path | None = None
    image: Path | None = None
    form: str | None = None
    model: str | None = None
    older: bool = False


def flash(serial: str, station_path: Path | None, wishes: FlashOptions, out: Path, quiet: bool = False) -> Answer:
    """`bench flash`: write a calibration into its unit, and verify that it is there."""
    settings = load_station(station_path)
    unit = settings.chosen([serial])[0]
    calibration = _calibration(unit, wishes, out)

    def tell(step: str) -> None:
        if not quiet:
            print(f"{step} …", file=sys.stderr, flush=True)

    try:
        record = flash_unit(settings, unit, calibration, out, older=wishes.older, onlooker=tell)
    except AlreadyThereError:
        content = {"unit": serial, "state": "already there", "calibration_id": calibration.label}
        return Answer(
            content, f"unit {serial} has calibration {calibration.label} in force already; nothing was written"
        )
    old = record["old"]["calibration_id"] if record.get("old") else "none"
    lines = [
        f"unit {serial}: calibration {calibration.label} ({calibration.model or 'image'}, {record['form']}, "
        f"{record['new']['words']} words) in force in bank {record['bank']}, before: {old}",
        f"read back equal word by word, CRC {record['crc']}, coefficient set {record['coefficient_set']} on the bus",
        f"record  {record['record']}",
    ]
    return Answer(record, "\n".join(lines))


def _calibration(unit: UnitSettings, wishes: FlashOptions, out: Path) -> Calibration:
    if wishes.image is not None:
        if wishes.run is not None or wishes.form is not None or wishes.model is not None:
            raise InputError("--image is an image as it is: leave out --run, --form and --model")
        return from_file(wishes.image)
    return from_run(wishes.run or newest_run(out, unit.serial), unit, wishes.form, wishes.model)


def verify(
    profile_path: Path, serial: str, station_path: Path | None, limits_path: Path | None, out: Path, quiet: bool
) -> Answer:
    """`bench verify`: another profile with the unit's own correction on; what it leaves, judged."""
    settings = load_station(station_path)
    unit = settings.chosen([serial])[0]
    allowed = None if limits_path is None else load_limits(limits_path)
    record = newest_record(out, serial)
    calibration = Path(record["run"]) if record and record.get("run") else None
    if calibration is not None and not calibration.is_dir():
        calibration = None
    refuse_same_profile(profile_path, calibration)
    inside = in_unit(settings, unit, record, out)
    texts = {} if limits_path is None else {"limits.yaml": read_text(limits_path)}
    result = conduct(profile_path, station_path, Task([serial], texts, out, "on"), quiet)
    if result.error is not None and result.run.manifest().get("rows", 0) == 0:
        raise result.error
    found = verify_run(RunFolder(result.run.path), calibration, allowed, inside)
    content = {**found.to_json(), "run": str(result.run.path)}
    if result.error is not None:
        return Answer({**content, "error": str(result.error)}, f"bench: {result.error}", result.error.exit_code)
    return Answer(content, _told(found), 0 if found.verdict.within else 1)


def in_unit(
    settings: StationSettings, unit: UnitSettings, record: Mapping[str, Any] | None, out: Path
) -> dict[str, Any]:
    """The calibration that is in force in the unit, read over its bus; InputError where there is none."""
    with open_alone(settings.remembering(out), unit) as store:
        bank = store.active()
        image = store.read(bank) if bank else b""
    if not image:
        text = f"unit {unit.serial} holds no calibration; write one with `bench flash {unit.serial}`"
        raise InputError(text)
    label = f"0x{to_words(image)[5]:08X}"
    flashed = (record or {}).get("calibration_id")
    if record is not None and label != flashed:
        text = f"unit {unit.serial} holds calibration {label}, the last one that was flashed from here is {flashed}"
        raise InputError(f"{text}; flash it again, or name the folder of its runs with --out")
    return {"bank": bank, "calibration_id": label, "words": len(image) // 4}


def _told(found: Verification) -> str:
    after, before, floor = found.after, found.before, found.floor.floor_dph
    rows = [f"{'':<18}{'before':>10} {'after':>10}   [deg/h, {after.interval_s:g} s means]"]
    for name in ("rms", "mean", "scatter", "peak", "span"):
        old = None if before is None else getattr(before, f"{name}_dph")
        rows.append(f"{name:<18}{number(old):>10} {number(getattr(after, f'{name}_dph')):>10}")
    rows.append(f"{'noise floor':<18}{'':>10} {number(floor):>10}")
    fell = "" if before is None else f", {found.factor:.1f} times less than before"
    lines = [
        f"{found.verdict.value}: the unit's own output is {found.over_floor:.2f} times its noise floor{fell}",
        "",
        *rows,
        *(f"refused: {text}" for text in found.judged.get("refusals") or ()),
        "",
        f"run     {found.run.path}",
    ]
    if (judged := found.judged.get("limits")) is not None:
        lines += [f"{r['verdict'] or '-':<9} {r['name']} = {number(r['value'])} {r['unit']}" for r in judged["results"]]
    return "\n".join(lines)
