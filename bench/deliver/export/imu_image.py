"""The image of a whole inertial unit: six axes, each with its curves over its own temperature; see docs/eeprom.md.

Equation: y_i = f_i + b_i(T_i) + sum_j m_ij(T_i) f_j + k_i(T_i) f_i^2 of the accelerometers, the same of the gyros with
sum_j g_ij(T_i) f_j in place of the second order (IEEE Std 1293 and 1431). What a unit computes is y - f, which is small
and rounded little.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite

import numpy as np
from numpy.polynomial import chebyshev

from bench.analysis import STANDARD_GRAVITY
from bench.base import DPH_PER_DPS, BoolArray, FloatArray, InputError, IntArray
from bench.deliver.export.words import crc, f32, float_of
from bench.record import ImuAxis, ImuParameter, ImuRecord, ImuTriad

MAGIC = 0x49425447
VERSION = 1
HEADER_WORDS, AXES, SLOTS = 16, 6, 8
AXIS_WORDS = 3 + 2 * SLOTS
MOST_ORDER, MOST_THERMOMETERS = 12, 9
NAMES = ("bias", "input_x", "input_y", "input_z", "force_x", "force_y", "force_z", "second_order")
"""What each slot of an axis holds: what it adds to the output, over what it multiplies."""
PASSES = 3
"""Of the second order, each wins four digits."""
FLAG_NO_VALUE = 1 << 31


@dataclass(frozen=True)
class AxisCurves:
    """One axis: number of its thermometer, range [degC], Chebyshev coefficients of each slot; none stands for zero."""

    thermometer: int
    low: float
    high: float
    slots: tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class ImuImage:
    """An image as read; rates in deg/s, forces in m/s^2, axes x, y, z of the gyros, then of the accelerometers."""

    serial: int
    calibration_id: int
    created: int
    thermometers: int
    axes: tuple[AxisCurves, ...]
    form: str = "imu"
    valid_until: int = 0

    @property
    def label(self) -> str:
        """Calibration id as it is printed."""
        return f"0x{self.calibration_id:08X}"


def thermometers_of(record: ImuRecord) -> tuple[str, ...]:
    """Channels with temperatures in the order in which the unit's code takes them.

    Those called temperature_1 to temperature_9 by their numbers, others in the order of the axes.
    """
    names = dict.fromkeys(axis.thermometer for triad in record.triads for axis in triad.axes)
    numbers = [re.fullmatch("temperature_([1-9])", name) for name in names]
    if not all(numbers):
        return tuple(names)
    return tuple(f"temperature_{k}" for k in range(1, 1 + max(int(found[1]) for found in numbers if found)))


def image_of(record: ImuRecord, serial: int, calibration_id: int, created: int) -> ImuImage:
    """The image of a record, its numbers still in double precision."""
    names = thermometers_of(record)
    axes = tuple(_axis(triad, axis, names.index(axis.thermometer)) for triad in record.triads for axis in triad.axes)
    return ImuImage(serial, calibration_id, created, len(names), axes)


def _axis(triad: ImuTriad, axis: ImuAxis, thermometer: int) -> AxisCurves:
    slots: list[tuple[float, ...]] = [()] * SLOTS
    own = "xyz".index(axis.axis)
    for parameter in axis.parameters:
        slot, size = _place(triad.kind, parameter, own)
        slots[slot] = tuple(size * value for value in parameter.coefficients)
    return AxisCurves(thermometer, *axis.range_degc, tuple(slots))


def _place(kind: str, parameter: ImuParameter, own: int) -> tuple[int, float]:
    """Slot of a parameter, and what turns its coefficients into deg/s and m/s^2."""
    output = 1.0 / DPH_PER_DPS if kind == "gyro" else 1.0
    towards = own if parameter.towards is None else parameter.towards
    places = {
        "bias": (0, output),
        "scale factor": (1 + towards, 1.0),
        "misalignment": (1 + towards, 1.0),
        "g-sensitivity": (4 + towards, output / STANDARD_GRAVITY),
        "second order": (7, 1.0 / STANDARD_GRAVITY),
    }
    if parameter.kind not in places or (kind, parameter.kind) == ("gyro", "second order"):
        raise InputError(f"the image has no place for {parameter.name}; calibrate without `orders: {{surface: …}}`")
    if parameter.intervals:
        raise InputError(f"the image holds polynomials, {parameter.name} is a spline; calibrate it with an order")
    return places[parameter.kind]


def words_of(image: ImuImage) -> list[int]:
    """Words of an image; InputError where it does not fit."""
    if not 0 <= image.serial < 1 << 32:
        raise InputError(f"serial number {image.serial} does not fit the image, allowed is 0 to 4294967295")
    orders = [len(slot) - 1 for axis in image.axes for slot in axis.slots]
    if max(orders) > MOST_ORDER or image.thermometers > MOST_THERMOMETERS:
        raise InputError(
            f"order {max(orders)} and {image.thermometers} thermometers do not fit the image, "
            f"allowed are {MOST_ORDER} and {MOST_THERMOMETERS}"
        )
    numbers = [f32(value) for axis in image.axes for slot in axis.slots for value in slot]
    words = [
        MAGIC, VERSION, 0, HEADER_WORDS + AXES * AXIS_WORDS + len(numbers) + 1, image.serial, image.calibration_id,
        AXES, image.created, 0, image.thermometers, len(numbers), max(orders), 0, 0, 0, 0,
    ]  # fmt: skip
    first = 0
    for axis in image.axes:
        words += [axis.thermometer, f32(axis.low), f32(axis.high)]
        for slot in axis.slots:
            words += [len(slot), first]
            first += len(slot)
    words += numbers
    return [*words, crc(words)]


def read_imu(words: Sequence[int], serial: int | None = None) -> ImuImage:
    """The image in these words. InputError, one line, if a unit would refuse it."""
    if len(words) <= HEADER_WORDS or words[0] != MAGIC:
        raise InputError(f"not an image of an inertial unit: it begins with {words[0] if words else 0:#010x}")
    size = HEADER_WORDS + AXES * AXIS_WORDS + words[10] + 1
    refusals = (
        (words[1] != VERSION, f"its format version is {words[1]}, this bench reads {VERSION}"),
        (not words[3] == len(words) == size,
         f"{len(words)} words, its header states {words[3]}, its counts give {size}"),
        (words[6] != AXES or words[9] > MOST_THERMOMETERS or words[11] > MOST_ORDER,
         f"{words[6]} axes, {words[9]} thermometers, order {words[11]}"),
        (crc(words[:-1]) != words[-1], f"CRC {words[-1]:#010x}, its words give {crc(words[:-1]):#010x}"),
        (serial is not None and words[4] != serial, f"serial number {words[4]}, this unit is {serial}"),
    )  # fmt: skip
    for wrong, text in refusals:
        if wrong:
            raise InputError(f"image refused: {text}")
    numbers = [float_of(word) for word in words[HEADER_WORDS + AXES * AXIS_WORDS : -1]]
    axes = tuple(_read_axis(words, numbers, i) for i in range(AXES))
    if not all(isfinite(value) for value in numbers):
        raise InputError("image refused: a coefficient is not finite")
    return ImuImage(words[4], words[5], words[7], words[9], axes)


def _read_axis(words: Sequence[int], numbers: Sequence[float], number: int) -> AxisCurves:
    own = words[HEADER_WORDS + AXIS_WORDS * number :][:AXIS_WORDS]
    low, high = float_of(own[1]), float_of(own[2])
    pairs = [(own[3 + 2 * slot], own[4 + 2 * slot]) for slot in range(SLOTS)]
    fits = all(count <= words[11] + 1 and first + count <= len(numbers) for count, first in pairs)
    if not fits or own[0] >= words[9] or not low <= high:
        raise InputError(f"image refused: thermometer, range or coefficients of axis {number} are not allowed")
    return AxisCurves(own[0], low, high, tuple(tuple(numbers[first : first + count]) for count, first in pairs))


@dataclass(frozen=True, eq=False)
class Compensated:
    """Rates [deg/s] and forces [m/s^2] (n, 3), and flags (n,): bit i the temperature of axis i was clamped to its
    range, bit 31 an input had no value.
    """

    rate: FloatArray
    force: FloatArray
    flags: IntArray


def compensate(image: ImuImage, rate: FloatArray, force: FloatArray, temperatures: FloatArray) -> Compensated:
    """What a unit makes of raw rates [deg/s] and forces [m/s^2] (n, 3) at temperatures (n, k) [degC].

    In double precision: the reference of the C code. A temperature without a value counts as the middle of its range;
    where an output has none, all six are 0.
    """
    curves, flags = _curves(image, temperatures)
    gone = _lacks(np.hstack([rate, force]))
    flags[gone] |= FLAG_NO_VALUE
    flags[_lacks(temperatures)] |= FLAG_NO_VALUE
    rate, force = np.where(gone[:, None], 0.0, rate), np.where(gone[:, None], 0.0, force)
    own = curves[:, 3:]
    found = force - _correction(own, force, own[:, :, 0])
    for _ in range(PASSES):
        found = force - _correction(own, force, own[:, :, 0] + own[:, :, 7] * found**2)
    own = curves[:, :3]
    turned = rate - _correction(own, rate, own[:, :, 0] + np.einsum("nij,nj->ni", own[:, :, 4:7], found))
    return Compensated(np.where(gone[:, None], 0.0, turned), np.where(gone[:, None], 0.0, found), flags)


def _lacks(values: FloatArray) -> BoolArray:
    """Rows (n,) in which a value is missing."""
    return np.asarray(np.isnan(values).any(axis=1) | np.isinf(values).any(axis=1))


def _correction(own: FloatArray, output: FloatArray, rest: FloatArray) -> FloatArray:
    """Output less input (n, 3): (1 + M)^-1 (M y + rest)."""
    added = np.einsum("nij,nj->ni", own[:, :, 1:4], output) + rest
    return np.asarray(np.linalg.solve(np.eye(3) + own[:, :, 1:4], added[..., None])[..., 0])


def _curves(image: ImuImage, temperatures: FloatArray) -> tuple[FloatArray, IntArray]:
    """Every slot of every axis (n, 6, 8), and the flags."""
    rows = len(temperatures)
    out, flags = np.zeros((rows, AXES, SLOTS)), np.zeros(rows, dtype=np.int64)
    for number, axis in enumerate(image.axes):
        own, half = temperatures[:, axis.thermometer], 0.5 * (axis.high - axis.low)
        middle = 0.5 * (axis.high + axis.low)
        z = (own - middle) / half if half > 0.0 else np.zeros(rows)
        outside: BoolArray = np.asarray((own < axis.low) | (own > axis.high))
        flags[outside] |= 1 << number
        z = np.clip(np.nan_to_num(z), -1.0, 1.0)
        for slot, coefficients in enumerate(axis.slots):
            if coefficients:
                out[:, number, slot] = chebyshev.chebval(z, coefficients)
    return out, flags
