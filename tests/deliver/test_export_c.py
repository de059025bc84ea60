"""The generated C code: compiled without a warning, equal to the Python reference on the whole grid, bit for bit."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from bench.base.errors import InputError
from bench.deliver.export.ccode import c_files
from bench.deliver.export.delivery import INPUTS, NO_VALUE, Block, Delivery, Shape
from bench.deliver.export.evaluate import evaluate
from bench.deliver.export.forms import FORMS
from bench.deliver.export.image import read, words_of
from bench.deliver.export.measure import grid, wander
from bench.deliver.export.signals import channel_signal
from tests.deliver.test_export import MODELS, delivered
from tests.support.c_unit import compiled, run

pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="needs gcc")


def accelerometer():
    """A surface over its raw output and the temperature."""
    signals = (channel_signal("acceleration", -20.0, 20.0), channel_signal("temperature", -55.0, 125.0))
    block = Block(Shape.SURFACE, 0, 1, 5, 1e-3 * np.random.default_rng(3).normal(size=21))
    return Delivery("surface", signals, (block,), INPUTS["acceleration"].count, 20.0, output=1)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("name", [*MODELS, "accelerometer"])
def test_the_c_code_is_the_reference_bit_for_bit(tmp_path, name, form):
    made = delivered(name) if name in MODELS else accelerometer()
    words = words_of(made, form, 1042, 7)
    library = compiled(tmp_path, words)
    holed = wander(made, 5000)
    for seed, column in enumerate(holed.values()):
        column[np.random.default_rng(seed).random(5000) < 0.01] = NO_VALUE
    for counts, settled in ((grid(made), True), (wander(made, 5000), False), (holed, False)):
        out, flags = run(library, words, counts, settled=settled)
        wanted = evaluate(read(words), counts, settled=settled)
        np.testing.assert_array_equal(out, wanted.raw)
        np.testing.assert_array_equal(flags, wanted.flags)


@pytest.mark.parametrize("form", FORMS)
def test_extreme_counts_break_nothing(tmp_path, form):
    """With all checks of undefined behaviour of gcc: overflow, shifts, casts, bounds."""
    made = delivered("lagged spline and loop")
    words = words_of(made, form, 1042, 7)
    library = compiled(
        tmp_path, words, ("-fsanitize=undefined,float-cast-overflow", "-fsanitize-undefined-trap-on-error")
    )
    ends = np.array([NO_VALUE, NO_VALUE + 1, -1, 0, 1, -NO_VALUE - 1])
    counts = {0: np.tile(ends, 36), 1: np.repeat(np.tile(ends, 6), 6)}
    out, flags = run(library, words, counts)
    wanted = evaluate(read(words), counts)
    np.testing.assert_array_equal(out, wanted.raw)
    np.testing.assert_array_equal(flags, wanted.flags)


def test_nan_becomes_no_value_and_no_cast_of_it_is_made(tmp_path):
    import ctypes

    code = ctypes.CDLL(str(compiled(tmp_path, words_of(delivered("spline"), "split", 1, 1))))
    code.calibration_count.argtypes = [ctypes.c_float, ctypes.c_float]
    values = [float("nan"), float("inf"), -float("inf"), 1e9, 25.5, -0.4]
    assert [code.calibration_count(v, 1e6) for v in values] == [NO_VALUE] * 4 + [25_500_000, -400_000]


def test_the_code_is_the_same_every_time_and_carries_its_identity(tmp_path):
    words = words_of(delivered("spline"), "split_fixed", 1042, 7)
    header = c_files(read(words), words)["calibration.h"]
    assert c_files(read(words), words)["calibration.h"] == header
    assert f"(0x{words[-1]:08X}UL)" in header
    assert "(1042UL)" in header
    assert "malloc" not in c_files(read(words), words)["calibration.c"]


def test_a_name_that_c_does_not_know_is_refused():
    words = words_of(delivered("spline"), "split", 1, 1)
    with pytest.raises(InputError, match="not a valid C name"):
        c_files(read(words), words, "my unit")
