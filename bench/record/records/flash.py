"""Records of `bench flash`: every attempt in `<unit>/flash/`, and flash.json in the run folder that it came from."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field

from bench.record.records.stored import Record, Stored

FlashAction = Literal["written", "previous"]


class StoredImage(Stored):
    """An image of coefficients, before or after."""

    file: str = ""
    sha256: str = ""
    words: int | None = None
    calibration_id: str | None = None
    """Null where this bench cannot read the image."""
    created: str | None = None


class FlashRecord(Record):
    """One attempt to change which calibration is in force in a unit."""

    FILE: ClassVar[str] = "flash.json"
    TITLE: ClassVar[str] = "flash"
    MADE_FROM: ClassVar[tuple[str, ...]] = ("manifest.json", "calibration.json")
    ADVICE: ClassVar[str] = "restore it from a backup, or flash again"

    unit: str = ""
    serial: int | None = None
    utc: str = ""
    operator: str | None = None
    station: str | None = None
    simulated: bool | None = None
    protocol: str | None = None
    run: str | None = None
    """Run folder of the calibration; null for an image from a file."""
    action: FlashAction = "written"
    """written, or previous: the image that the other bank held was put back in force."""
    model: str | None = None
    form: str | None = None
    calibration_id: str | None = None
    software: str | None = None
    old: StoredImage | None = None
    state: str
    """begun (the unit is being changed, or the bench was killed), done or failed."""
    error: str | None = None
    new: StoredImage | None = None
    bank: int | None = None
    old_bank: int | None = None
    coefficient_set: int | None = None
    old_coefficient_set: int | None = None
    crc: str | None = None
    read_back: str | None = None
    steps_s: dict[str, float] = Field(default_factory=dict)
    record: str | None = None
    """Path of the archived record."""
