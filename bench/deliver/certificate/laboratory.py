"""The files behind the first page of a certificate: the laboratory, its customer, and its instruments."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import date
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, Field, model_validator

from bench.base import STRICT, Document, InputError, dump, load_config
from bench.deliver.certificate.stated import Uncertain


class Instrument(Uncertain):
    """One piece of reference equipment with its own calibration."""

    model: str = ""
    """Maker and model."""
    serial: str
    """Serial number."""
    certificate: str = ""
    """Number of its calibration certificate, and who issued it."""
    calibrated: date | None = None
    """Day of its last calibration."""
    due: date | None = None
    """Last day on which that calibration is valid; without it the instrument only indicates."""

    @model_validator(mode="after")
    def _in_order(self) -> Instrument:
        if self.calibrated and self.due and self.due < self.calibrated:
            raise ValueError(f"{self.name}: due {self.due} is before calibrated {self.calibrated}")
        return self


class InstrumentsFile(BaseModel):
    """An `equipment.yaml`: the reference instruments of a station."""

    model_config = STRICT

    equipment: tuple[Instrument, ...] = Field(min_length=1)
    """Every instrument that a result is traced to."""


class Party(BaseModel):
    """A laboratory or a customer."""

    model_config = STRICT

    name: str
    """Name."""
    address: str = ""
    """Postal address."""
    country: Annotated[str, Field(pattern="^[A-Z]{2}$", examples=["UA"])] | None = None
    """Country, two letters (ISO 3166-1), for the digital certificate."""


class Signatory(BaseModel):
    """Who authorises the certificate."""

    model_config = STRICT

    name: str
    """Name."""
    function: str = ""
    """Function in the laboratory."""


class Item(BaseModel):
    """Facts about the unit that only its owner knows."""

    model_config = STRICT

    model: str = ""
    """Maker and model of the unit."""
    condition: str = ""
    """Condition on receipt."""
    received: date | None = None
    """Day of receipt."""


class Laboratory(BaseModel):
    """The laboratory, its customer, and who signs."""

    model_config = STRICT

    laboratory: Party
    """Who calibrates."""
    place: str = ""
    """Place of the calibration, if it is not the laboratory's address."""
    customer: Party | None = None
    """The customer."""
    item: Item = Item()
    """The unit."""
    authorised_by: Signatory | None = None
    """Person responsible for the certificate."""
    recommended_interval: str = ""
    """Only where agreed with the customer (ISO/IEC 17025, 7.8.4.3)."""
    remarks: tuple[str, ...] = ()
    """Further remarks, such as deviations from the method."""


def load_instruments(source: Path | Document) -> tuple[Instrument, ...]:
    """The instruments of a file; InputError with file and line where something is wrong."""
    return load_config(source, InstrumentsFile).equipment


def instrument_of_registry(row: Mapping[str, Any]) -> Instrument:
    """The instrument of a row of the registry; its kind stands as the model."""
    days = {"calibrated": row["calibrated_on"], "due": row["due_on"]}
    return Instrument.model_construct(name=row["name"], serial=row["serial"], model=row["kind"], **days)


def instruments_yaml(instruments: Sequence[Instrument]) -> str:
    """The text of an `equipment.yaml`."""
    return dump({"equipment": [tool.model_dump(mode="json", exclude_none=True) for tool in instruments]})


def load_laboratory(source: Path | Document) -> Laboratory:
    """The laboratory of a file; InputError with file and line where something is wrong."""
    return load_config(source, Laboratory)


def refuse_overdue(instruments: Sequence[Instrument], on: date, where: Path | str | None = None) -> None:
    """InputError, one line, where an instrument was not calibrated yet on a day, or its calibration had expired."""
    late = [f"{tool.name} {tool.serial}, due {tool.due}" for tool in instruments if tool.due and tool.due < on]
    late += [
        f"{tool.name} {tool.serial}, calibrated later, on {tool.calibrated}"
        for tool in instruments
        if tool.calibrated and tool.calibrated > on
    ]
    if late:
        raise InputError(f"not calibrated on {on}: {'; '.join(late)}; calibrate it, or use another instrument", where)
