"""Delivered models: what a unit computes is what was fitted, within what each form holds, and never beyond the box."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.analysis.effects.model import Model
from bench.analysis.effects.operators import play, ramp_invariant_lag
from bench.analysis.effects.registry import make
from bench.analysis.fit.fitting import fit_model
from bench.base.channels import DPH_PER_DPS
from bench.base.errors import InputError
from bench.deliver.export.building import deliver
from bench.deliver.export.delivering import counts_of
from bench.deliver.export.delivery import NO_VALUE, ONE, Block, Delivery, Shape
from bench.deliver.export.evaluate import FLAG_NO_VALUE, evaluate
from bench.deliver.export.exact import correction
from bench.deliver.export.forms import FORMS, rounded
from bench.deliver.export.image import read, words_of
from bench.deliver.export.measure import best_form, grid, wander, worst_errors
from bench.deliver.export.signals import channel_signal, lag_signal
from bench.deliver.export.words import crc, i32, u32
from tests.support.analysis_data import curve, thermal_cycle, white, with_bias


def cycle():
    """A unit with a curve in lagged temperature and a loop."""
    record = thermal_cycle(10.0)
    lagged = ramp_invariant_lag(record.time, record.channel("temperature"), 60.0)
    bias = curve(lagged) + 0.5 * (lagged - play(lagged, 4.0)) / 4.0 + white(record, 0.01)
    return with_bias(record, bias)


def turned(interval_s: float = 10.0):
    """A unit on a rate table: a scale factor of 2000 ppm that changes with temperature and rate, and a bias curve."""
    record = thermal_cycle(interval_s)
    applied = 60.0 * np.round(2.2 * np.sin(record.time / 150.0))
    celsius = record.channel("temperature")
    ppm = 2000.0 + 8.0 * (celsius - 25.0) + 0.02 * applied**2
    bias = curve(celsius) + 1e-6 * ppm * DPH_PER_DPS * applied
    made = with_bias(record, bias + DPH_PER_DPS * applied)
    return made.with_channel("applied_rate", applied)


MODELS = {
    "polynomial": ("polynomial",),
    "regression": ("regression",),
    "spline": (("spline", {"intervals": 12}),),
    "lagged spline and loop": (("spline", {"intervals": 12}), "thermal_lag", "hysteresis"),
    "several loops": (("spline", {"intervals": 8}), ("hysteresis", {"count": 3})),
    "creep": (("spline", {"intervals": 8}), "creep"),
    "filtered slope": ("polynomial", ("temperature_rate", {"filter_s": 60.0, "temperature_slope": True})),
    "channels": ("polynomial", "quadrature_leakage", "drive_amplitude", "resonance_frequency"),
    "kink": ("polynomial", "bias_kink"),
    "formulas": (
        "polynomial",
        ("expression", {"formula": "k * sin(2*pi*temperature/9) + k_cos * cos(2*pi*temperature/9)"}),
        ("expression", {"formula": "k * quadrature * temperature**2 + a * above(drive)"}),
    ),
    "thermometer": (("spline", {"intervals": 8}), ("resonance_frequency", {"use": "thermometer"})),
}


@cache
def fitted(name: str):
    effects = [make(e) if isinstance(e, str) else make(*e) for e in MODELS[name]]
    record = cycle()
    return fit_model(Model(name, tuple(effects)), record, covariance="none"), record


@cache
def delivered(name: str, sample_hz: float = 500.0) -> Delivery:
    found, record = fitted(name)
    return deliver(found, [record], sample_hz)


@pytest.mark.parametrize("name", MODELS)
def test_the_delivered_model_is_the_fitted_one(name):
    found, record = fitted(name)
    made = delivered(name, 1.0 / record.interval_s)
    own = DPH_PER_DPS * correction(made, counts_of(record))
    # Counts of 1e-6 degC, 1e-5 Hz and 1e-8 V; a bump in pieces a quarter of its width.
    assert np.abs(own - found.predict(record).bias).max() < 5e-5


@pytest.mark.parametrize("name", MODELS)
def test_every_form_stays_within_what_its_numbers_can_hold(name):
    """Single precision loses 0.2 deg/h at 300 deg/s, Q10.21 some of 2^-21 deg/s, the split forms almost nothing."""
    rows = {row.form: row for row in worst_errors(delivered(name))}
    assert rows["float32"].worst < 0.25
    assert rows["fixed"].worst < 0.02
    assert rows["split"].worst < 1e-3
    assert rows["split_fixed"].worst < 9e-6
    assert best_form(rows.values()).form == "split_fixed"


@pytest.mark.parametrize("form", FORMS)
def test_outside_its_box_a_unit_clamps_and_flags(form):
    made = delivered("spline")
    box = made.signals[0]
    celsius = np.array([box.low, box.low - 1, box.low - 50_000_000, box.high, box.high + 1, NO_VALUE + 1])
    got = evaluate(read(words_of(made, form, 1, 1)), {0: np.zeros(6, dtype=np.int64), 1: celsius}, settled=True)
    assert got.flags.tolist() == [0, 1, 1, 0, 1, 1]
    assert got.value[1] == got.value[0] == got.value[2] == got.value[5]
    assert got.value[4] == got.value[3]


@pytest.mark.parametrize("form", FORMS)
def test_a_sample_without_value_is_flagged_and_moves_no_state(form):
    image = read(words_of(delivered("lagged spline and loop"), form, 1, 1))
    counts = wander(delivered("lagged spline and loop"), 400)
    whole = evaluate(image, counts)
    holed = {0: np.insert(counts[0], 100, 5), 1: np.insert(counts[1], 100, NO_VALUE)}
    got = evaluate(image, holed)
    assert got.flags[100] & FLAG_NO_VALUE
    np.testing.assert_array_equal(np.delete(got.raw, 100), whole.raw)
    lost = evaluate(image, {0: np.full(3, NO_VALUE), 1: counts[1][:3]})
    assert lost.raw.tolist() == [0, 0, 0]
    assert np.all(lost.flags & FLAG_NO_VALUE)


def test_effects_over_the_table_are_delivered_over_the_units_own_output():
    record = turned()
    effects = (
        make("spline", {"intervals": 12}),
        make("scale_factor_temperature"),
        make("scale_factor_nonlinearity", {"constant": False}),
    )
    found = fit_model(Model("turned", effects), record, covariance="none")
    made = deliver(found, [record])
    counts = counts_of(record)
    wanted = found.predict(record).bias
    assert np.ptp(wanted) > 500.0
    assert np.abs(DPH_PER_DPS * correction(made, counts) - wanted).max() < 0.01
    left = (
        record.channel("rate") - DPH_PER_DPS * correction(made, counts) - DPH_PER_DPS * record.channel("applied_rate")
    )
    assert np.abs(left).max() < 0.3


@pytest.mark.parametrize(
    ("effect", "why"),
    [
        (make("aging"), "time since the start of the run"),
        (make("hysteresis", {"shape": "bouc_wen"}), "shape play"),
        (make("temperature_rate"), "filter_s"),
        (make("expression", {"formula": "k * dT_dt * quadrature"}), "'dT_dt \\* quadrature' needs quadrature, dT_dt;"),
        (make("expression", {"formula": "k * lag(drive, 60)"}), "'lag\\(drive, 60\\)' needs drive, lag;"),
        (
            make("expression", {"formula": "k * (temperature - lag(temperature, 60))"}),
            "only as the effect temperature_rate",
        ),
        (make("expression", {"formula": "k * drive * quadrature * frequency"}), "needs frequency, drive, quadrature;"),
        (make("expression", {"formula": "k * sign(temperature - 20.3)"}), "change too fast"),
        (make("expression", {"formula": "k * quadrature * sin(temperature)"}), "change too fast"),
    ],
)
def test_an_effect_that_no_unit_can_evaluate_is_refused_with_what_to_do(effect, why):
    record = cycle()
    found = fit_model(Model("own", (make("polynomial"), effect)), record, covariance="none")
    with pytest.raises(InputError, match=why):
        deliver(found, [record])


# Words and images


def test_the_crc_is_that_of_zlib():
    """Check value of CRC-32/ISO-HDLC: https://reveng.sourceforge.io/crc-catalogue/17plus.htm."""
    import zlib

    assert zlib.crc32(b"123456789") == 0xCBF43926
    assert crc([int.from_bytes(b"1234", "little"), int.from_bytes(b"5678", "little")]) == zlib.crc32(b"12345678")


@pytest.mark.parametrize("form", FORMS)
def test_an_image_reads_back_as_it_was_made(form):
    made = delivered("lagged spline and loop")
    words = words_of(made, form, 1042, 7)
    image = read(words, 1042)
    assert (image.form, image.serial, image.calibration_id) == (form, 1042, 7)
    assert image.signals == made.signals
    assert len(words) == words[3] == 24 + 10 * len(made.signals) + 5 * len(made.blocks) + len(image.coefficients) + 1
    assert words[-1] == crc(words[:-1])


def changed(place: int, value: int, sealed: bool = True) -> list[int]:
    words = words_of(delivered("spline"), "split", 1042, 7)
    words[place] = value
    return [*words[:-1], crc(words[:-1])] if sealed else words


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (changed(0, 1), "not a calibration image"),
        (changed(1, 2), "format version is 2"),
        (changed(2, 9), "form is 9"),
        (changed(3, 5), "its header states 5"),
        (changed(30, 12345, sealed=False), "CRC"),
        (changed(12, 17), "counts give"),
        (changed(24, 1), "signal 0 is not allowed"),
        (changed(25, 99), "signal 0 is not allowed"),
        (changed(30, 63), "shift 63"),
        (changed(38, 999), "block 0 refers"),
        (changed(40, 0x7FC00000), "not finite"),
        ([], "not a calibration image"),
    ],
)
def test_an_image_that_is_wrong_is_refused(words, why):
    with pytest.raises(InputError, match=why):
        read(words)


def test_an_image_of_another_unit_is_refused():
    with pytest.raises(InputError, match="serial number 1042, this unit is 1043"):
        read(words_of(delivered("spline"), "split", 1042, 7), 1043)


@settings(max_examples=60)
@given(st.integers(0, 30), st.data())
def test_one_burst_of_up_to_32_bits_never_passes_the_crc(length, data):
    words = words_of(delivered("polynomial"), "fixed", 1, 1)
    at = data.draw(st.integers(0, 32 * len(words) - 32))
    burst = data.draw(st.integers(1, (1 << (length + 1)) - 1))
    whole = sum(word << (32 * i) for i, word in enumerate(words)) ^ (burst << at)
    with pytest.raises(InputError):
        read([(whole >> (32 * i)) & 0xFFFFFFFF for i in range(len(words))])


# Quantisation


def series(values, low=-40.0, high=85.0) -> Delivery:
    """A series over temperature with these coefficients [deg/s]."""
    block = Block(Shape.SERIES, 0, 0, len(values) - 1, np.array(values))
    return Delivery("x", (channel_signal("temperature", low, high),), (block,))


finite = st.floats(-50.0, 50.0, allow_subnormal=False)


@settings(max_examples=80)
@given(st.lists(finite, min_size=6, max_size=6), st.sampled_from(["fixed", "split_fixed"]))
def test_rounding_a_coefficient_costs_half_a_step_at_most(values, form):
    made = series(values)
    numbers = rounded(made, form)
    stored = np.array([i32(word) for word in numbers.words]) * numbers.step
    assert np.abs(stored - values).max() <= 0.5 * numbers.step
    assert sum(abs(i32(word)) for word in numbers.words) < 1 << 31


@settings(max_examples=40)
@given(st.lists(finite, min_size=6, max_size=6), st.floats(-150.0, 0.0), st.floats(5.0, 150.0))
def test_the_integer_form_follows_the_model_to_its_last_bits(values, low, span):
    """Bound: half a step a coefficient, and T_k of integers, whose error grows as k^2 of 2^-31."""
    made = series(values, low, low + span)
    points = grid(made)
    got = evaluate(read(words_of(made, "split_fixed", 1, 1)), points, settled=True).value
    wanted = made.gain * points[0] - correction(made, points, settled=True)
    step = rounded(made, "split_fixed").step
    assert np.abs(got - wanted).max() < 6 * 0.5 * step + 25 * 2.0**-30 * sum(map(abs, values)) + 1e-12 + 1e-13


@given(st.integers(-(1 << 31), (1 << 31) - 1))
def test_a_signed_number_survives_its_word(value):
    assert i32(u32(value)) == value


@pytest.mark.parametrize("tau_s", [3.0, 60.0, 1e4, 86400.0])
def test_a_filter_of_integers_has_the_time_constant_that_was_fitted(tau_s):
    box = (-40.0, 85.0)
    made = lag_signal(0, box, box, tau_s, 0.002)
    assert made.p[0] * 2.0 ** -made.p[1] == pytest.approx(-np.expm1(-0.002 / tau_s), rel=2e-7)
    assert -ONE <= made.p[2] < 0


@pytest.mark.parametrize(
    ("break_it", "why"),
    [
        (lambda: rounded(delivered("spline"), "float16"), "allowed are float32"),
        (lambda: words_of(delivered("spline"), "split", 1 << 32, 0), "serial number"),
        (lambda: channel_signal("chamber_temperature", 0.0, 1.0), "not an input"),
        (lambda: channel_signal("temperature", 5.0, 5.0), "empty"),
        (lambda: rounded(series([np.nan]), "split"), "not finite"),
        (lambda: rounded(series([1e7]), "split"), "64-bit output"),
        (lambda: rounded(replace(series([1.0]), full_scale=1e10), "fixed"), "full scale of 1e\\+10"),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_refused(break_it, why):
    with pytest.raises(InputError, match=why):
        break_it()
