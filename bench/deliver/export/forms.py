"""Embedded forms of a delivery: the coefficients rounded to the numbers that a unit stores, and those of the header.

`float32` all in single precision; `fixed` coefficients and output in one integer format Qm.n; `split` the nominal gain
in full precision and a correction in single precision; `split_fixed` the same with a correction in 32-bit integers.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, floor, log2

import numpy as np

from bench.base import FloatArray, InputError
from bench.deliver.export.delivery import Delivery
from bench.deliver.export.words import f32, u32

FORMS = ("float32", "fixed", "split", "split_fixed")
PICO = 1e12
"""Counts of the 64-bit output in one output unit."""


@dataclass(frozen=True)
class Rounded:
    """Numbers of one form: header words 15 to 20 and the words of the coefficients of all blocks, in order."""

    form: str
    gain: tuple[int, int]
    gain_f32: int
    fraction_bits: int
    correction: tuple[int, int]
    words: tuple[int, ...]
    step: float
    """Value of the last bit of a coefficient [output unit]; 0 in the float forms."""


def rounded(delivery: Delivery, form: str) -> Rounded:
    """The delivery in one form. InputError: unknown form, or numbers that do not fit it."""
    if form not in FORMS:
        raise InputError(f"form is {form!r}, allowed are {', '.join(FORMS)}")
    coefficients = np.concatenate([block.coefficients for block in delivery.blocks])
    if not np.all(np.isfinite(coefficients)):
        raise InputError("a coefficient of the model is not finite, so the model cannot be delivered")
    bound = max(sum(block.bound for block in delivery.blocks), 1e-30)
    if bound * PICO >= 1 << 62:
        raise InputError(f"coefficients add up to {bound:g}, more than a 64-bit output of 1e-12 can hold")
    if form in {"float32", "split"}:
        words = tuple(f32(value) for value in coefficients.tolist())
        gain = _mantissa(delivery.gain * PICO) if form == "split" else (0, 0)
        return Rounded(form, gain, f32(delivery.gain), 0, (0, 0), words, 0.0)
    if form == "fixed":
        bits = 30 - ceil(log2(max(delivery.full_scale, bound)))
        if not 0 <= bits <= 62:
            raise InputError(f"fixed: a full scale of {delivery.full_scale:g} does not fit 32 bits")
        words = _integers(coefficients, bits, bound)
        return Rounded(form, _mantissa(delivery.gain * 2.0**bits), 0, bits, (0, 0), words, 2.0**-bits)
    bits = 30 - floor(log2(bound))  # the sum of |coefficients| stays below 2^31
    words = _integers(coefficients, bits, bound)
    return Rounded(form, _mantissa(delivery.gain * PICO), 0, 0, _mantissa(PICO * 2.0**-bits), words, 2.0**-bits)


def _integers(coefficients: FloatArray, bits: int, bound: float) -> tuple[int, ...]:
    if bound * 2.0**bits + coefficients.size >= 1 << 31:
        bits_text = f"Q{31 - bits}.{bits}"
        raise InputError(f"coefficients add up to {bound:g}, too much for {bits_text}")
    return tuple(u32(round(value * 2.0**bits)) for value in coefficients.tolist())


def _mantissa(value: float) -> tuple[int, int]:
    """Mantissa below 2^31 and shift of 0 to 62, value = mantissa / 2^shift: exact where the value is a whole number."""
    if value == int(value) and abs(value) < 1 << 31:
        return int(value), 0
    shift = min(30 - floor(log2(abs(value))), 62)
    mantissa = round(value * 2.0**shift)
    if shift < 0 or abs(mantissa) >= 1 << 31:
        raise InputError(f"factor {value:g} does not fit a mantissa of 32 bits and a shift of 0 to 62")
    return mantissa, shift
