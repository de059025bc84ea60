"""What all effects share: memory of the whole record, gaps that stay gaps, refusals in words, a page in the docs."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench.analysis.effects import catalogue
from bench.analysis.effects import registry as effects
from bench.analysis.effects.example import example
from bench.analysis.effects.signature import signature
from bench.base.errors import InputError

SUSPECTS = tuple(entry.name for entry in catalogue.catalogue() if entry.suspect)


def output(effect, data):
    theta = {parameter.name: parameter.start for parameter in effect.parameters}
    if effect.moves_abscissa:
        return effect.abscissa(data, theta)[:, None]
    return effect.columns(data, theta)


@pytest.mark.parametrize("name", [*SUSPECTS, "surface"])
def test_masked_rows_still_count_for_the_memory(name):
    """What is left out of the fit must not change the regressors of the rows that stay."""
    data = example()
    effect = effects.make(name)
    some = np.arange(len(data)) % 7 < 5
    some[:3] = some[-3:] = True  # the same ranges, so that scales agree
    for channel in effect.needs:
        values = data.channel(channel)
        some[[values.argmin(), values.argmax()]] = True
    whole = output(effect.prepare([data]), data)
    masked = output(effect.prepare([data.select(some)]), data)
    assert_allclose(masked[some], whole[some], atol=1e-9)


@pytest.mark.parametrize("name", [n for n in SUSPECTS if effects.make(n).needs])
def test_a_gap_stays_a_gap_and_does_not_spread(name):
    data = example()
    effect = effects.make(name).prepare([data])
    gap = (data.time > 5000.0) & (data.time < 5600.0)
    channel = effect.needs[0]
    torn = data.with_channel(channel, np.where(gap, np.nan, data.channel(channel)))
    got, whole = output(effect, torn), output(effect, data)
    assert np.isnan(got[gap]).all()
    assert np.isfinite(got[~gap]).all()
    far = data.time > 12000.0
    assert_allclose(got[far], whole[far], atol=0.02 * np.nanmax(np.abs(whole)))


@pytest.mark.parametrize("name", SUSPECTS)
def test_uneven_rows_give_nearly_the_same_regressors(name):
    data = example()
    effect = effects.make(name).prepare([data])
    keep = np.random.default_rng(1).random(len(data)) < 0.8
    keep[0] = True
    # Between kept rows the record is straight to 0.02 degC, save at the corners of the profile.
    thin, whole = output(effect, data.select(keep)), output(effect, data)[keep]
    assert np.median(np.abs(thin - whole)) <= 5e-3 * np.abs(whole).max()


@pytest.mark.parametrize("name", SUSPECTS)
def test_the_second_half_does_not_reach_back(name):
    """Memory is causal: what comes later changes nothing before, the central slope's window apart."""
    data = example()
    effect = effects.make(name).prepare([data])
    early = np.arange(len(data)) < 500
    assert_allclose(output(effect, data.select(early))[:495], output(effect, data)[:495], atol=1e-9)


@pytest.mark.parametrize("name", [n for n in SUSPECTS if set(effects.make(n).needs) - {"temperature"}])
def test_a_channel_that_stands_still_is_refused_by_name(name):
    data = example()
    channel = effects.make(name).needs[0]
    still = data.with_channel(channel, np.full(len(data), 3.0))
    with pytest.raises(InputError, match=f"{channel} moves by 0"):
        effects.make(name).prepare([still])


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("hysteresis", {"shape": "circle"}, "allowed are play, bouc_wen"),
        ("hysteresis", {"shape": "bouc_wen", "count": 2}, "count is 2"),
        ("temperature_rate", {"filter_s": -1}, "allowed is a number from 0 to 36000"),
        ("temperature_rate", {"filter_s": True}, "filter_s is True"),
        ("temperature_rate", {"temperature_slope": 1}, "temperature_slope is 1"),
        ("creep", {"initial": "hot"}, "allowed are settled, free"),
        ("aging", {"law": "cubic"}, "allowed are line, logarithm, both"),
        ("bias_jump", {"run": 3}, "run is 3"),
        ("bias_jump", {"then": "grows"}, "then is 'grows'"),
        ("bias_kink", {"rounding_degc": 0}, "rounding_degc is 0"),
        ("resonance_frequency", {"use": "clock"}, "allowed are term, thermometer"),
        ("surface", {"over": "time"}, "allowed are applied_rate, rate"),
        ("bias_jump", {"span_h": [0, 1]}, "no option 'span_h'"),
        ("polynomial", {"order": 0}, "order is 0, allowed is a whole number from 1 to 12"),
        ("polynomial", {"order": 2.5}, "order is 2.5"),
        ("polynomial", {"order": True}, "order is True"),
        ("regression", {"order": 6}, "from 1 to 5"),
        ("spline", {"intervals": "many"}, "intervals is 'many'"),
        ("spline", {"ends": "clamped"}, "allowed are natural, parabolic, periodic, free"),
    ],
)
def test_a_wrong_option_of_an_effect_is_refused(name, options, message):
    with pytest.raises(InputError, match=message):
        effects.make(name, options)


FIXED = (
    *("polynomial", "regression", "spline", "surface", "thermal_lag", "temperature_rate", "hysteresis", "creep"),
    *("warm_up", "aging", "quadrature_leakage", "drive_amplitude", "resonance_frequency", "supply_voltage"),
    *("compressor", "bias_jump", "bias_kink", "frost", "scale_factor_temperature", "scale_factor_nonlinearity"),
)


def test_the_catalogue_holds_the_fixed_names_and_is_documented():
    entries = {entry.name: entry for entry in catalogue.catalogue()}
    assert set(FIXED) <= set(entries)
    for entry in entries.values():
        assert list(entry.sections) == [
            "Equation",
            "Units",
            "Source",
            "When left out",
            "Look-alikes",
            "Separated by",
        ]
        assert entry.summary
    assert set(entries["thermal_lag"].look_alikes) == {
        "temperature_rate",
        "hysteresis",
        "creep",
        "resonance_frequency",
    }
    assert [name for name, entry in entries.items() if not entry.suspect] == [*FIXED[:4], "expression"]


def test_every_suspect_has_a_family_of_its_own():
    families = [catalogue.entry(name).family for name in SUSPECTS]
    assert len(set(families)) == len(families)


def test_the_page_of_effects_is_up_to_date(request):
    page = request.config.rootpath / "docs" / "effects.md"
    assert page.read_text(encoding="utf-8") == catalogue.markdown(), (
        "run python -m bench.analysis.effects > docs/effects.md"
    )


@pytest.mark.parametrize("name", [name for name in effects.effect_names() if name != "expression"])
def test_every_effect_has_a_signature(name):
    drawn = signature(name)
    assert drawn.time_s.shape == drawn.temperature.shape == drawn.contribution.shape
    assert np.abs(drawn.contribution).max() == pytest.approx(1.0)
    assert np.ptp(drawn.contribution) > 0.1
