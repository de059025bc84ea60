"""Files that contain a calibration: each format is one function from a package to files by name."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Protocol

import bincopy

from bench.analysis import Coefficient
from bench.base import __version__
from bench.deliver.export.ccode import c_files, rendered
from bench.deliver.export.chebyshev import orders
from bench.deliver.export.delivery import INPUTS, Delivery, Kind, Shape
from bench.deliver.export.image import BLOCK_WORDS, HEADER_WORDS, SIGNAL_WORDS, Image
from bench.deliver.export.measure import Worst
from bench.deliver.export.words import float_of, i32, to_bytes

Files = dict[str, bytes]


@dataclass(frozen=True, eq=False)
class Package:
    """The content for every format: the image as words and as fields, the delivery, physical coefficients, errors."""

    name: str
    words: Sequence[int]
    image: Image
    delivery: Delivery
    physical: Sequence[Coefficient]
    worst: Sequence[Worst]
    unit: str
    address: int = 0


def as_json(package: Package) -> Files:
    """The whole calibration, for other programs."""
    image = package.image
    content = {
        "format": 1,
        "unit": package.unit,
        "serial": image.serial,
        "calibration_id": image.calibration_id,
        "model": package.delivery.model,
        "form": image.form,
        "crc": package.words[-1],
        "period_ns": image.period_ns,
        "output": "deg/s" if image.output == 0 else "m/s^2",
        "inputs": [
            {"name": e.name, "id": e.id, "count": e.count, "unit": e.unit, "low": s.low, "high": s.high}
            for s in image.signals
            for e in INPUTS.values()
            if s.kind is Kind.CHANNEL and s.source == e.id
        ],
        "signals": [{**asdict(signal), "kind": signal.kind.name.lower()} for signal in image.signals],
        "blocks": [
            {"shape": b.shape.name.lower(), "a": b.a, "b": b.b, "n": b.n, "coefficients": b.coefficients.tolist()}
            for b in package.delivery.blocks
        ],
        "physical": [{"key": c.key, "unit": c.unit, "value": c.value} for c in package.physical],
        "worst_error_dph": [asdict(row) for row in package.worst],
        "words": list(package.words),
    }
    return {f"{package.name}.json": (json.dumps(content, indent=1, allow_nan=False) + "\n").encode()}


def as_csv(package: Package) -> Files:
    """Coefficients, one per row: physical ones with units, and the delivered ones exact and as stored."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(("what", "block", "i", "j", "value", "stored", "unit"))
    for coefficient in package.physical:
        writer.writerow((coefficient.key, "", "", "", repr(coefficient.value), "", coefficient.unit))
    image = package.image
    unit = "deg/s" if image.output == 0 else "m/s^2"
    stored = iter(float_of(word) if image.floats else i32(word) for word in image.coefficients)
    for number, block in enumerate(package.delivery.blocks):
        pairs = orders(block.n) if block.shape is Shape.SURFACE else [(k, 0) for k in range(block.coefficients.size)]
        for (i, j), value in zip(pairs, block.coefficients.tolist(), strict=True):
            writer.writerow((block.shape.name.lower(), number, i, j, repr(value), next(stored), unit))
    return {f"{package.name}.csv": out.getvalue().encode()}


def as_c(package: Package) -> Files:
    """C99 source and header."""
    return {name: text.encode() for name, text in c_files(package.image, list(package.words), package.name).items()}


class Placed(Protocol):
    """An image of any kind, to be put into memory."""

    @property
    def name(self) -> str:
        """Of its files."""

    @property
    def words(self) -> Sequence[int]:
        """The image."""

    @property
    def address(self) -> int:
        """Where it stands [byte]."""


def as_eeprom(package: Placed) -> Files:
    """The image as bytes."""
    return {f"{package.name}.bin": to_bytes(package.words)}


def as_hex(package: Placed) -> Files:
    """Intel HEX."""
    return {f"{package.name}.hex": placed(package.words, package.address).as_ihex().encode()}


def as_srec(package: Placed) -> Files:
    """Motorola S-records with 32-bit addresses."""
    return {f"{package.name}.srec": placed(package.words, package.address).as_srec(address_length_bits=32).encode()}


def as_a2l(package: Package) -> Files:
    """ASAM MCD-2 MC description of the image, for a calibration tool."""
    image, at = package.image, package.address + 4 * HEADER_WORDS
    at += 4 * (SIGNAL_WORDS * len(image.signals) + BLOCK_WORDS * len(image.blocks))
    content = {"package": package, "image": image, "version": __version__, "coefficients": at}
    text = rendered("calibration.a2l.j2", {**content, "size": len(package.words) * 4})
    return {f"{package.name}.a2l": text.encode()}


def placed(words: Sequence[int], address: int) -> bincopy.BinFile:
    """Words at their address."""
    memory = bincopy.BinFile()
    memory.add_binary(to_bytes(words), address=address)
    return memory


FORMATS: dict[str, Callable[[Package], Files]] = {
    "json": as_json,
    "csv": as_csv,
    "c": as_c,
    "hex": as_hex,
    "srec": as_srec,
    "eeprom": as_eeprom,
    "a2l": as_a2l,
}
