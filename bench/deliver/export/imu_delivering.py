"""Export of a whole inertial unit: checks its record, makes the image, and then the files."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from bench.analysis import serial_number
from bench.base import InputError
from bench.deliver.export.delivering import ExportOptions, id_of
from bench.deliver.export.image import Image, read
from bench.deliver.export.imu_formats import IMU_FORMATS, ImuFiles, ImuPackage
from bench.deliver.export.imu_image import MAGIC, ImuImage, read_imu
from bench.record import ImuRecord, prove

_OUTPUTS = {"swapped_axes", "wrong_sign", "attitude"}
"""Findings after which the parameters are those of outputs in another order or with another sign."""


@dataclass(frozen=True, eq=False)
class DeliveredImu:
    """Files of one format, the package that they are made of, and what speaks against it."""

    package: ImuPackage
    made: ImuFiles
    objections: tuple[str, ...]


def deliver_imu(path: Path, record: ImuRecord, format_: str, options: ExportOptions) -> DeliveredImu:
    """Files of one format of a record; `path` is its file or folder.

    InputError, one line, where the format does not exist or an option is not for it, where the record is not proven or
    must not be delivered and `force` is not set, and always where outputs were swapped or had a wrong sign.
    """
    if format_ not in IMU_FORMATS:
        raise InputError(f"format is {format_!r}, allowed for an inertial unit are {', '.join(IMU_FORMATS)}")
    if options.model is not None or options.form is not None:
        raise InputError(
            "--model and --form are for a single gyro; an inertial unit's image is float32 with its curves"
        )
    wrong = [finding for finding in record.findings if finding.cause in _OUTPUTS]
    if wrong:
        raise InputError(f"not delivered: {wrong[0].text}; correct the table or the wiring and calibrate again", path)
    if not options.force:
        prove(path if path.is_dir() else path.parent)
    objections = tuple(_objections(record))
    if objections and not options.force:
        more = f" (and {len(objections) - 1} more)" if len(objections) > 1 else ""
        raise InputError(f"not delivered: {objections[0]}{more}; --force delivers it anyway", path)
    serial = options.serial if options.serial is not None else _serial(record, path)
    created = int(datetime.fromisoformat(record.created).timestamp())
    package = ImuPackage(options.name, record, serial, _id(record), created, options.address)
    return DeliveredImu(package, IMU_FORMATS[format_](package), objections)


def read_either(words: Sequence[int]) -> Image | ImuImage:
    """The image of a gyro, or of an inertial unit; InputError, one line, if a unit would refuse it."""
    return read_imu(words) if words and words[0] == MAGIC else read(words)


def _objections(record: ImuRecord) -> Iterator[str]:
    yield from (f"{finding.cause}, {finding.where}: {finding.text}" for finding in record.findings)
    yield from (f"not determined: {text}" for text in record.undetermined)


def _serial(record: ImuRecord, path: Path) -> int:
    number = serial_number(record.unit)
    if number is None:
        raise InputError(f"unit '{record.unit}' has no number in its serial number; give one with --serial", path)
    return number


def _id(record: ImuRecord) -> int:
    """First 32 bits of the SHA-256 of unit and curves."""
    content = [record.unit, *(triad.model_dump(mode="json") for triad in record.triads)]
    return id_of(content)
