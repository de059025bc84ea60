"""The records of changes to what units hold.

Every attempt leaves a record with the old and the new image in `<out>/<unit>/flash/`; one that succeeded stands in the
run folder that the calibration came from, too, as flash.json.
"""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from bench.acquisition import StationSettings, UnitSettings
from bench.base import InputError, __version__, user_name
from bench.commands.flash_source import Calibration
from bench.deliver import Image, ImuImage, read_either, to_words
from bench.record import FlashAction, FlashRecord, StoredImage, chain_of, put, slug
from drivers.errors import DriverError
from drivers.unit_memory import Programmed, UnitMemory


class Attempt:
    """One attempt to change which calibration is in force in a unit, and its record."""

    def __init__(self, settings: StationSettings, unit: UnitSettings, out: Path, action: FlashAction) -> None:
        self.now = datetime.now(UTC)
        self.folder = out / slug(unit.serial) / "flash"
        self.folder.mkdir(parents=True, exist_ok=True)
        self.calibration: Calibration | None = None
        self._stem = _free(self.folder, f"{self.now:%Y%m%dT%H%M%SZ}")
        self._record = FlashRecord(
            unit=unit.serial,
            utc=self.now.isoformat(timespec="seconds"),
            operator=user_name(),
            station=settings.name,
            simulated=settings.simulated,
            protocol=unit.flash.protocol,
            software=__version__,
            action=action,
            state="begun",
        )

    def takes(self, calibration: Calibration) -> None:
        """Say which calibration it is."""
        self.calibration = calibration
        self._change(
            serial=calibration.image.serial,
            run=None if calibration.run is None else str(calibration.run),
            model=calibration.model,
            form=calibration.image.form,
            calibration_id=calibration.image.label,
        )

    def begin(self, old: bytes) -> None:
        """Keep the old and the new image, before the unit is changed."""
        assert self.calibration is not None
        new = self.calibration.content
        files = {f"{self._stem}_{name}.bin": image for name, image in (("old", old), ("new", new)) if image}
        put(self.folder, files)
        before = described(old, f"{self._stem}_old.bin") if old else None
        self._change(old=before, new=described(new, f"{self._stem}_new.bin"))
        self._write()

    @contextmanager
    def recorded(self) -> Iterator[None]:
        """Record what fails."""
        try:
            yield
        except DriverError as error:
            self._change(state="failed", error=str(error))
            self._write()
            raise

    def end(self, done: Programmed) -> FlashRecord:
        """Record what was done; in the run of the calibration, too."""
        assert self.calibration is not None
        self._change(state="done", **_outcome(done), record=str(self.folder / f"{self._stem}.json"))
        if self.calibration.run is not None:  # first: while the record is "begun", the same command completes both
            self._record.write(self.calibration.run)
        self._write()
        return self._record

    def _change(self, **facts: Any) -> None:
        self._record = self._record.model_copy(update=facts)

    def _write(self) -> None:
        self._record.write(self.folder, f"{self._stem}.json")


def complete(store: UnitMemory, folder: Path, content: bytes) -> None:
    """Complete the record of an attempt that put this image in force, and that could not see or record its end."""
    attempt = unfinished(folder, content)
    if attempt is None or attempt.new is None:
        return
    path = folder / attempt.new.file.replace("_new.bin", ".json")
    inside = store.held()
    record = attempt.model_copy(update={
        "state": "done",
        "error": None,
        **({} if inside.bank is None else {"bank": inside.bank, "coefficient_set": inside.number}),
        "read_back": "all words equal, read after an interruption",
        "record": str(path),
    })  # fmt: skip
    if record.run is not None and Path(record.run).is_dir():
        record.write(Path(record.run))
    record.write(folder, path.name)


def unfinished(folder: Path, content: bytes) -> FlashRecord | None:
    """The newest attempt since the last change that was to put this image in force, and did not end."""
    for record in records(folder):
        if record.state == "done":
            return None
        if record.new is not None and record.new.sha256 == digest(content):
            return record
    return None


def records(folder: Path) -> Iterator[FlashRecord]:
    """All attempts, newest first; InputError for one that is listed and lost."""
    known = chain_of(folder)
    order = [] if known is None else list(known.files)
    names = {path.name for path in folder.glob("*.json")} | {name for name in order if name.endswith(".json")}
    # By the order in which they were written; those of an older bench by their names.
    newest = sorted(names, key=lambda name: (order.index(name) if name in order else -1, name), reverse=True)
    found = (FlashRecord.find(folder, name) for name in newest)
    return (record for record in found if record is not None)


def newest_record(out: Path, unit: str) -> FlashRecord | None:
    """The record of the last change of this unit that succeeded; None when there is none."""
    found = next((record for record in records(out / slug(unit) / "flash") if record.state == "done"), None)
    return found and found.model_copy(update={"run": located(found, out)})


def located(record: FlashRecord, out: Path) -> str | None:
    """Where the run folder of a record is, also after the whole folder was moved."""
    if not record.run or Path(record.run).is_dir():
        return record.run
    return str(out / slug(record.unit) / Path(record.run).name)


def _outcome(done: Programmed) -> dict[str, Any]:
    if not done.bank:  # a memory without banks, behind a command
        return {"read_back": "all words equal, after the write and again", "steps_s": done.took_s}
    again = "after the reset" if "write" not in done.took_s else "after the write and again after the reset"
    return {
        "bank": done.bank,
        "old_bank": done.old_bank,
        "coefficient_set": done.new_set,
        "old_coefficient_set": done.old_set,
        "crc": f"0x{done.crc:08X}",
        "read_back": f"all words equal, {again}",
        "steps_s": done.took_s,
    }


def described(content: bytes, file: str) -> StoredImage:
    """An image for a record."""
    image = held(content)
    return StoredImage(
        file=file,
        sha256=digest(content),
        words=len(content) // 4,
        calibration_id=None if image is None else image.label,
        created=None if image is None else date(image.created),
    )


def held(content: bytes) -> Image | ImuImage | None:
    """An image from a unit; None where it is none that this bench can read."""
    try:
        return read_either(to_words(content))
    except (InputError, struct.error, IndexError):
        return None


def date(seconds: int) -> str:
    """A time [s since 1970] in words."""
    return datetime.fromtimestamp(seconds, UTC).isoformat(timespec="seconds")


def digest(content: bytes) -> str:
    """The SHA-256 by which images are told apart."""
    return hashlib.sha256(content).hexdigest()


def _free(folder: Path, stem: str) -> str:
    names = (stem, *(f"{stem}_{n}" for n in range(2, 1000)))
    return next(name for name in names if not list(folder.glob(f"{name}[._]*")))
