"""The arithmetic of the simulated gyro against the reference: two readers of docs/eeprom.md that know nothing of each
other.
"""

from __future__ import annotations

import struct
import zlib

import numpy as np
import pytest

from bench.deliver.export.delivery import INPUTS, Block, Delivery, Shape
from bench.deliver.export.evaluate import evaluate
from bench.deliver.export.forms import FORMS
from bench.deliver.export.image import read, words_of
from bench.deliver.export.measure import wander
from bench.deliver.export.signals import channel_signal
from bench.deliver.export.words import to_bytes
from drivers.sim.correction import Correction, RefusedImageError
from tests.deliver.test_export import MODELS, delivered
from tests.support import flash_bench

ROOM = 1000


def corrected(words, counts, pieces=(10, 500, 20, 1000)):
    """Output and flags of the simulated gyro, fed in pieces."""
    unit = Correction.read(to_bytes(words), words[4], ROOM)
    total, at, parts, flags = len(counts[0]), 0, [], 0
    while at < total:
        size = pieces[len(parts) % len(pieces)]
        value, raised = unit.apply({id_: column[at : at + size] for id_, column in counts.items()})
        parts.append(value)
        flags |= raised
        at += size
    return np.concatenate(parts), flags


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("name", MODELS)
def test_the_unit_computes_what_the_reference_does_to_the_last_bit(name, form):
    words, counts = words_of(delivered(name), form, 12, 3), wander(delivered(name), 3000)
    value, flags = corrected(words, counts)
    wanted = evaluate(read(words), counts)
    np.testing.assert_array_equal(value, wanted.value)
    assert flags == np.bitwise_or.reduce(wanted.flags)


@pytest.mark.parametrize("form", FORMS)
def test_a_surface_of_rate_and_temperature(form):
    rng = np.random.default_rng(3)
    signals = (channel_signal("rate", -200.0, 200.0), channel_signal("temperature", -55.0, 125.0))
    made = Delivery("surface", signals, (Block(Shape.SURFACE, 0, 1, 5, 1e-3 * rng.normal(size=21)),))
    words, counts = words_of(made, form, 1, 1), wander(made, 2000)
    value, _ = corrected(words, counts)
    np.testing.assert_array_equal(value, evaluate(read(words), counts).value)


def test_a_channel_that_the_unit_does_not_have_gives_nothing_and_a_flag():
    made = Delivery("x", (channel_signal("temperature", 0.0, 1.0),), (Block(Shape.SERIES, 0, 0, 0, np.array([1.0])),))
    value, flags = corrected(words_of(made, "split_fixed", 1, 1), {0: np.zeros(10, dtype=np.int64)})
    np.testing.assert_allclose(value, -1.0, atol=1e-9)
    assert flags & 1 << 31
    assert INPUTS["temperature"].id == 1


def patched(at: int, word: int, again: bool = True) -> bytes:
    content = bytearray(flash_bench.image())
    struct.pack_into("<I", content, 4 * at, word)
    if again:
        struct.pack_into("<I", content, len(content) - 4, zlib.crc32(content[:-4]))
    return bytes(content)


@pytest.mark.parametrize(
    ("at", "word", "why"),
    [
        (0, 1, "no image"),
        (1, 2, "format version"),
        (2, 4, "form"),
        (3, 50, "length"),
        (4, 8, "serial number"),
        (10, 1, "not a rate"),
        (14, 9, "length"),
        (16, 63, "shift"),
        (21, 13, "too large"),
        (24, 9, "signal 0"),
        (25, 6, "signal 0 from 6"),
        (30, 63, "signal 0"),
        (34, 9, "block 0"),
        (35, 1, "block 0 of signals"),
        (37, 12, "block 0"),
        (38, 1, "block 0: coefficients"),
    ],
)
def test_the_unit_refuses_what_the_document_says_it_must(at, word, why):
    with pytest.raises(RefusedImageError, match=why):
        Correction.read(patched(at, word), flash_bench.SERIAL, ROOM)


def test_the_unit_refuses_every_flipped_word():
    content = flash_bench.image()
    for at in range(len(content) // 4):
        flipped = bytearray(content)
        flipped[4 * at] ^= 0x10
        with pytest.raises(RefusedImageError):
            Correction.read(bytes(flipped), flash_bench.SERIAL, ROOM)
    with pytest.raises(RefusedImageError, match="length"):
        Correction.read(content, flash_bench.SERIAL, 20)
    nan = patched(39, 0x7FC00000)
    Correction.read(nan, flash_bench.SERIAL, ROOM)  # an integer there
    floats = bytearray(flash_bench.image(form="float32"))
    struct.pack_into("<I", floats, 4 * 39, 0x7FC00000)
    struct.pack_into("<I", floats, len(floats) - 4, zlib.crc32(floats[:-4]))
    with pytest.raises(RefusedImageError, match="finite"):
        Correction.read(bytes(floats), flash_bench.SERIAL, ROOM)
