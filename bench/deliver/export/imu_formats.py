"""Files with the calibration of a whole inertial unit: each format is one function from a package to files by name."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from bench.base import InputError, __version__
from bench.deliver.export.autopilots import ardupilot, px4
from bench.deliver.export.ccode import refuse_name, rendered, single
from bench.deliver.export.formats import Files, as_eeprom, as_hex, as_srec
from bench.deliver.export.imu_image import (
    AXES,
    AXIS_WORDS,
    HEADER_WORDS,
    NAMES,
    PASSES,
    VERSION,
    ImuImage,
    image_of,
    read_imu,
    thermometers_of,
    words_of,
)
from bench.deliver.export.imu_noise import kalibr
from bench.record import ImuRecord

AXIS_NAMES = tuple(f"{kind}_{axis}" for kind in ("gyro", "accelerometer") for axis in "xyz")


@dataclass(frozen=True, eq=False)
class ImuPackage:
    """The content for every format: the record, and its image with `address` [byte]."""

    name: str
    record: ImuRecord
    serial: int
    calibration_id: int
    created: int
    address: int = 0

    @cached_property
    def words(self) -> Sequence[int]:
        """The image; InputError where it has no place for a parameter."""
        return words_of(image_of(self.record, self.serial, self.calibration_id, self.created))

    @cached_property
    def refusal(self) -> str:
        """Why there is no image; empty: there is one."""
        try:
            _ = self.words
        except InputError as error:
            return str(error)
        return ""

    @cached_property
    def image(self) -> ImuImage:
        """The image as a unit reads it back."""
        return read_imu(self.words, self.serial)


@dataclass(frozen=True)
class ImuFiles:
    """Files of one format, and what the format cannot hold, one line each."""

    files: Files
    lost: tuple[str, ...] = field(default=())


def as_json(package: ImuPackage) -> ImuFiles:
    """The image as fields and as words, for other programs; the record itself has the covariance."""
    image = package.image
    content = {
        "format": VERSION,
        "unit": package.record.unit,
        "serial": image.serial,
        "calibration_id": image.calibration_id,
        "crc": package.words[-1],
        "rate_unit": "deg/s",
        "acceleration_unit": "m/s^2",
        "thermometers": list(thermometers_of(package.record)),
        "axes": [
            {"name": name, "thermometer": axis.thermometer, "low_degc": axis.low, "high_degc": axis.high,
             "curves": dict(zip(NAMES, map(list, axis.slots), strict=True))}
            for name, axis in zip(AXIS_NAMES, image.axes, strict=True)
        ],
        "words": list(package.words),
    }  # fmt: skip
    return ImuFiles({f"{package.name}.json": (json.dumps(content, indent=1, allow_nan=False) + "\n").encode()})


def as_csv(package: ImuPackage) -> ImuFiles:
    """Every parameter at some temperatures with U (k = 2), and beside it the coefficients of its curve."""
    values, curves = io.StringIO(newline=""), io.StringIO(newline="")
    writer = csv.writer(values, lineterminator="\n")
    writer.writerow(("parameter", "unit", "temperature_degc", "value", "U"))
    for one in package.record.parameters:
        writer.writerow((one.name, one.unit, f"{one.temperature_degc:g}", f"{one.value:.9g}", f"{one.U:.4g}"))
    writer = csv.writer(curves, lineterminator="\n")
    writer.writerow(("parameter", "unit", "low_degc", "high_degc", "curve", "coefficient", "value"))
    for triad in package.record.triads:
        for axis in triad.axes:
            for p in axis.parameters:
                curve = f"B-spline of {p.intervals} intervals" if p.intervals else "Chebyshev"
                for order, value in enumerate(p.coefficients):
                    row = p.name, p.unit, *map(repr, axis.range_degc), curve, order, repr(p.factor * value)
                    writer.writerow(row)
    names = f"{package.name}.csv", f"{package.name}_curves.csv"
    return ImuFiles(dict(zip(names, (values.getvalue().encode(), curves.getvalue().encode()), strict=True)))


def as_c(package: ImuPackage) -> ImuFiles:
    """C99 source and header that compensate one sample."""
    refuse_name(package.name)
    image, numbers = package.image, [value for axis in package.image.axes for slot in axis.slots for value in slot]
    content = {
        "name": package.name,
        "version": __version__,
        "image_version": VERSION,
        "image": image,
        "serial": image.serial,
        "crc": package.words[-1],
        "source": f"{package.record.sources[0].file}, {package.record.created}",
        "thermometers": thermometers_of(package.record),
        "axes": _axes(image),
        "coefficients": [single(value) for value in numbers],
        "passes": PASSES,
    }
    return ImuFiles({f"{package.name}.{kind}": rendered(f"imu.{kind}.j2", content).encode() for kind in ("h", "c")})


def _axes(image: ImuImage) -> list[dict[str, Any]]:
    found, first = [], 0
    for name, axis in zip(AXIS_NAMES, image.axes, strict=True):
        counts = [len(slot) for slot in axis.slots]
        half = 0.5 * (axis.high - axis.low)
        found.append(
            {"text": name, "thermometer": axis.thermometer, "count": counts,
             "first": [first + sum(counts[:i]) for i in range(len(counts))],
             "middle": single(0.5 * (axis.high + axis.low)), "per_half": single(1.0 / half if half > 0.0 else 0.0),
             "low": single(axis.low), "high": single(axis.high)}
        )  # fmt: skip
        first += sum(counts)
    return found


def as_a2l(package: ImuPackage) -> ImuFiles:
    """ASAM MCD-2 MC description of the image: each curve's coefficients by name."""
    at, curves = package.address + 4 * (HEADER_WORDS + AXES * AXIS_WORDS), []
    for name, axis in zip(AXIS_NAMES, package.image.axes, strict=True):
        for slot, own in zip(NAMES, axis.slots, strict=True):
            if own:
                text = f"{name.replace('_', ' ')}: {slot.replace('_', ' ')}, Chebyshev over its temperature"
                curves.append({"name": f"{name}_{slot}", "text": text, "address": at, "count": len(own)})
                at += 4 * len(own)
    content = {"name": package.name, "image": package.image, "version": __version__, "curves": curves,
               "address": package.address, "size": 4 * len(package.words)}  # fmt: skip
    return ImuFiles({f"{package.name}.a2l": rendered("imu.a2l.j2", content).encode()})


def as_kalibr(package: ImuPackage) -> ImuFiles:
    """Kalibr's imu.yaml."""
    text, lost = kalibr(package.record)
    return ImuFiles({"imu.yaml": text.encode()}, lost)


def as_px4(package: ImuPackage) -> ImuFiles:
    """Parameters of PX4."""
    text, lost = px4(package.record)
    return ImuFiles({f"{package.name}_px4.params": text.encode()}, lost)


def as_ardupilot(package: ImuPackage) -> ImuFiles:
    """Parameters of ArduPilot."""
    text, lost = ardupilot(package.record)
    return ImuFiles({f"{package.name}_ardupilot.param": text.encode()}, lost)


IMU_FORMATS: dict[str, Callable[[ImuPackage], ImuFiles]] = {
    "json": as_json,
    "csv": as_csv,
    "c": as_c,
    "hex": lambda package: ImuFiles(as_hex(package)),
    "srec": lambda package: ImuFiles(as_srec(package)),
    "eeprom": lambda package: ImuFiles(as_eeprom(package)),
    "a2l": as_a2l,
    "kalibr": as_kalibr,
    "px4": as_px4,
    "ardupilot": as_ardupilot,
}
