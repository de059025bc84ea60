"""The image of a calibration in a unit's EEPROM, as docs/eeprom.md defines it word for word."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any, cast

from bench.base import InputError
from bench.deliver.export.delivery import INPUTS, MOST_BLOCKS, MOST_ORDER, MOST_SIGNALS, Delivery, Kind, Shape, Signal
from bench.deliver.export.forms import FORMS, rounded
from bench.deliver.export.words import crc, float_of, i32, u32

MAGIC = 0x43425447
VERSION = 1
HEADER_WORDS, SIGNAL_WORDS, BLOCK_WORDS = 24, 10, 5
KINDS = {"polynomial": 1, "regression": 2, "spline": 3, "surface": 4}
COMPOSED = 255


@dataclass(frozen=True, eq=False)
class Image:
    """An image as read: header fields by name, signals, blocks (shape, a, b, n, first) and coefficient words."""

    form: str
    serial: int
    calibration_id: int
    model_kind: int
    created: int
    valid_until: int
    period_ns: int
    output: int
    axis: int
    gain: tuple[int, int]
    gain_f32: float
    fraction_bits: int
    correction: tuple[int, int]
    order: int
    signals: tuple[Signal, ...]
    blocks: tuple[tuple[int, int, int, int, int], ...]
    coefficients: tuple[int, ...]

    @property
    def label(self) -> str:
        """Calibration id as it is printed."""
        return f"0x{self.calibration_id:08X}"

    @property
    def floats(self) -> bool:
        """Whether coefficients are single-precision numbers."""
        return self.form in {"float32", "split"}


def words_of(delivery: Delivery, form: str, serial: int, calibration_id: int) -> list[int]:
    """Words of the image of a delivery in one form."""
    if not 0 <= serial < 1 << 32:
        raise InputError(f"serial number {serial} does not fit the image, allowed is 0 to 4294967295")
    numbers = rounded(delivery, form)
    kind = KINDS.get(delivery.model, COMPOSED)
    size = HEADER_WORDS + SIGNAL_WORDS * len(delivery.signals) + BLOCK_WORDS * len(delivery.blocks)
    words = [
        MAGIC, VERSION, FORMS.index(form), size + len(numbers.words) + 1, serial, calibration_id, kind,
        delivery.created, delivery.valid_until, delivery.period_ns, delivery.output, delivery.axis,
        len(delivery.signals), len(delivery.blocks), len(numbers.words), *numbers.gain, numbers.gain_f32,
        numbers.fraction_bits, *numbers.correction, delivery.order, 0, 0,
    ]  # fmt: skip
    for s in delivery.signals:
        words += [s.kind, s.source, s.low, s.high, s.centre, s.recip, s.shift, *s.p]
    first = 0
    for block in delivery.blocks:
        words += [block.shape, block.a, block.b, block.n, first]
        first += block.coefficients.size
    words = [u32(word) for word in (*words, *numbers.words)]
    return [*words, crc(words)]


def read(words: Sequence[int], serial: int | None = None) -> Image:
    """The image in these words. InputError, one line, if a unit would refuse it."""
    _check_frame(words, serial)
    s, k, n = words[12], words[13], words[14]
    at = HEADER_WORDS
    signals = tuple(_signal(words[at + SIGNAL_WORDS * i :][:SIGNAL_WORDS]) for i in range(s))
    at += SIGNAL_WORDS * s
    blocks = tuple(tuple(words[at + BLOCK_WORDS * i :][:BLOCK_WORDS]) for i in range(k))
    image = Image(
        FORMS[words[2]], words[4], words[5], words[6], words[7], words[8], words[9], words[10], words[11],
        (i32(words[15]), words[16]), float_of(words[17]), words[18], (i32(words[19]), words[20]), words[21],
        signals, cast(Any, blocks), tuple(words[at + BLOCK_WORDS * k : -1]),
    )  # fmt: skip
    if len(image.coefficients) != n:
        raise InputError(f"image has {len(image.coefficients)} coefficients, its header states {n}")
    _check_parts(image)
    return image


def _check_frame(words: Sequence[int], serial: int | None) -> None:
    if len(words) <= HEADER_WORDS or words[0] != MAGIC:
        raise InputError(f"not a calibration image: it begins with {words[0] if words else 0:#010x}, not {MAGIC:#010x}")
    s, k, n = words[12], words[13], words[14]
    size = HEADER_WORDS + SIGNAL_WORDS * s + BLOCK_WORDS * k + n + 1
    refusals = (
        (words[1] != VERSION, f"its format version is {words[1]}, this bench reads {VERSION}"),
        (words[2] >= len(FORMS), f"its form is {words[2]}, allowed is 0 to {len(FORMS) - 1}"),
        (
            not words[3] == len(words) == size,
            f"{len(words)} words, its header states {words[3]}, its counts give {size}",
        ),
        (s > MOST_SIGNALS or k > MOST_BLOCKS, f"{s} signals and {k} blocks, at most {MOST_SIGNALS} and {MOST_BLOCKS}"),
        (words[21] > MOST_ORDER, f"order {words[21]}, at most {MOST_ORDER}"),
        (crc(words[:-1]) != words[-1], f"CRC {words[-1]:#010x}, its words give {crc(words[:-1]):#010x}"),
        (serial is not None and words[4] != serial, f"serial number {words[4]}, this unit is {serial}"),
    )
    for wrong, text in refusals:
        if wrong:
            raise InputError(f"calibration image refused: {text}")


def _signal(words: Sequence[int]) -> Signal:
    kind, source, low, high, centre, recip, shift, p0, p1, p2 = words
    if kind > max(Kind) or shift > 62:
        raise InputError(f"calibration image refused: signal of kind {kind} and shift {shift}")
    return Signal(Kind(kind), source, i32(low), i32(high), i32(centre), i32(recip), shift, (i32(p0), i32(p1), i32(p2)))


def _check_parts(image: Image) -> None:
    known = {entry.id for entry in INPUTS.values()}
    for i, signal in enumerate(image.signals):
        fits = signal.source in known if signal.kind is Kind.CHANNEL else signal.source < i
        filters = signal.kind in {Kind.LAG, Kind.BEHIND}
        if not fits or (filters and not 0 <= signal.p[1] <= 62) or signal.low > signal.high:
            raise InputError(f"calibration image refused: the source, shift or range of signal {i} is not allowed")
    for i, (shape, a, b, n, first) in enumerate(image.blocks):
        size = {1: n + 1, 2: (n + 1) * (n + 2) // 2, 3: 4 * n}.get(shape, len(image.coefficients) + 1)
        most = image.order if shape != Shape.SPLINE else len(image.coefficients)
        within = max(a, b) < len(image.signals) and first + size <= len(image.coefficients) and n <= most
        if not within or (shape == Shape.SPLINE and n == 0):
            raise InputError(f"calibration image refused: block {i} refers to missing signals or coefficients")
    if image.floats and not all(isfinite(float_of(word)) for word in image.coefficients):
        raise InputError("calibration image refused: a coefficient is not finite")
