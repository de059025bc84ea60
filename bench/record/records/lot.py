"""lot.json: the units behind a lot's calibration, what each loses by it, and which unit is like them."""

from __future__ import annotations

from typing import ClassVar

from bench.record.records.stored import Record, Stored


class LotUnit(Stored):
    """A unit of the lot; errors in deg/h RMS."""

    unit: str
    own_rms_dph: float
    """By its own calibration, on the data that it was fitted to."""
    lot_rms_dph: float
    """By the lot's calibration, fitted without this unit."""
    levelled_rms_dph: float
    """The same with a constant of its own."""
    cells_dph: tuple[float | None, ...] = ()
    """Mean bias in each cell of temperature, cooling before heating; null where it was not."""


class LotRecord(Record):
    """A calibration for a lot, in a run folder that holds the means of all its units."""

    FILE: ClassVar[str] = "lot.json"
    TITLE: ClassVar[str] = "lot"
    MADE_FROM: ClassVar[tuple[str, ...]] = ("manifest.json", "calibration.json")
    ADVICE: ClassVar[str] = "calibrate the lot again with `bench lot calibrate`"

    lot: str
    model: str
    runs: tuple[str, ...]
    borders_degc: tuple[float, ...]
    """Borders of the cells of temperature."""
    units: tuple[LotUnit, ...]
