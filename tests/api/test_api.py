"""`import bench`: what a program or a notebook gets, and that its numbers are those of everybody else."""

import doctest
import importlib
import subprocess
import sys
from dataclasses import dataclass

import numpy as np
import pandas as pd
import pytest

import bench
from bench.api import words
from bench.commands import import_table
from tests.support import acquisition
from tests.support.run_folders import ARW, make_run, ramp_run

HOURS = 4.0


def cycle(interval_s=30.0, *, lag_dph=0.0):
    """A table of somebody else: two cycles of temperature, a cubic, a little noise, `lag_dph` times the slope."""
    time = np.arange(0.0, 3600.0 * HOURS, interval_s)
    temperature = 20.0 + 50.0 * np.sin(2 * np.pi * time / 7200.0)
    slope = 60.0 * np.gradient(temperature, time)
    rate = 5.0 + 0.1 * temperature - 2e-3 * temperature**2 + 1e-5 * temperature**3 + lag_dph * slope
    rate = rate + np.random.default_rng(0).normal(0.0, 0.01, time.size)
    return pd.DataFrame({"time": time, "rate": rate, "temperature": temperature})


@pytest.fixture(scope="module")
def run():
    return bench.open(cycle())


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A run folder of a unit with hidden hysteresis."""
    return make_run(tmp_path_factory.mktemp("api") / "run", **ramp_run())


@pytest.fixture(scope="module")
def looped(folder):
    return bench.open(folder)


@pytest.fixture(scope="module")
def why(looped):
    """The diagnosis of that run."""
    return bench.diagnose(looped, "spline")


def test_a_csv_is_fitted_with_the_numbers_of_polyfit(tmp_path):
    table = cycle().rename(columns={"rate": "gz [deg/h]", "temperature": "T [degC]"})
    table.to_csv(tmp_path / "log.csv", index=False)
    run = bench.open(tmp_path / "log.csv", {"rate": "gz [deg/h]"})
    fit = run.fit("polynomial", order=3)
    expected = np.polyfit(table["T [degC]"], table["gz [deg/h]"], 3)[::-1]
    assert [c.value for c in fit.coefficients.values()] == pytest.approx(expected, rel=1e-6)
    assert list(fit.coefficients) == [f"polynomial.a{power}" for power in range(4)]
    assert [c.unit for c in fit.coefficients.values()] == ["deg/h", "deg/h/degC", "deg/h/degC^2", "deg/h/degC^3"]
    assert fit.rms_dph == pytest.approx(0.01, rel=0.1)
    assert fit.held_out.rms_dph == pytest.approx(0.01, rel=0.2)


def test_columns_and_units_become_the_channels_of_the_bench():
    table = cycle()
    foreign = pd.DataFrame(
        {"t": table["time"] / 60.0, "gz": table["rate"] / 3600.0, "T": table["temperature"] + 273.15}
    )
    run = bench.open(
        foreign,
        {"time": "t", "rate": "gz", "temperature": "T"},
        {"time": "min", "rate": "deg/s", "temperature": "K"},
    )
    assert run.dataset.time == pytest.approx(table["time"])
    assert run.dataset.channels["rate"] == pytest.approx(table["rate"])
    assert run.dataset.channels["temperature"] == pytest.approx(table["temperature"])


def test_an_index_of_dates_is_the_time():
    table = cycle().set_index(pd.date_range("2026-01-01", periods=480, freq="30s")).drop(columns="time")
    assert bench.open(table).dataset.time == pytest.approx(np.arange(480) * 30.0)


def test_rows_faster_than_the_means_are_averaged_and_slower_ones_are_kept():
    fast, slow = bench.open(cycle(5.0)), bench.open(cycle(60.0))
    assert (fast.interval_s, slow.interval_s) == (30.0, 60.0)
    assert len(fast.dataset) == pytest.approx(480, abs=8)  # each branch is cut into whole means of its own
    assert len(slow.dataset) == 240
    assert len(fast.to_dataframe(60.0)) == pytest.approx(240, abs=8)
    with pytest.raises(bench.InputError, match="cannot average over 30 s, its rows are 60 s"):
        slow.to_dataframe(30.0)


def test_a_table_has_the_numbers_of_its_import(tmp_path):
    cycle(1.0).to_csv(tmp_path / "log.csv", index=False)
    folder = import_table(tmp_path / "log.csv", None, "MINE", None, tmp_path / "reports").run
    direct, imported = (bench.open(source).fit("polynomial") for source in (tmp_path / "log.csv", folder))
    for key, coefficient in direct.coefficients.items():
        assert imported.coefficients[key].value == pytest.approx(coefficient.value, rel=1e-6)


def test_what_is_no_model_is_said(run):
    with pytest.raises(bench.InputError, match="3 is no model: give a name, a YAML file"):
        run.fit(3)
    with pytest.raises(bench.InputError, match="options are those of one effect"):
        run.fit("spline_lag_loop", order=3)


@pytest.mark.parametrize(
    ("columns", "units", "said"),
    [
        ({"rat": "rate"}, None, "DataFrame: 'rat' is not a channel; did you mean 'rate'?"),
        ({"rate": "gz"}, None, "gz"),
        (None, {"rate": "furlong"}, "'furlong' does not measure rate"),
        (None, {"drive": "mV"}, "no column is drive"),
    ],
)
def test_what_cannot_be_understood_is_said_in_one_line(columns, units, said):
    with pytest.raises(bench.InputError, match=said) as caught:
        bench.open(cycle(), columns, units)
    assert "\n" not in str(caught.value)


def test_a_run_as_a_table_has_units_and_gaps():
    table = cycle()
    table.loc[100:109, "rate"] = np.nan
    frame = bench.open(table).to_dataframe()
    assert list(frame.columns) == ["rate", "temperature", "bias", "segment"]
    assert frame.attrs["units"] == {"time": "s", "rate": "deg/h", "temperature": "degC", "bias": "deg/h"}
    assert frame["bias"].isna().sum() == 10


def test_a_run_as_an_xarray_dataset(run):
    found = run.to_xarray()
    assert found["temperature"].attrs == {"units": "degC", "long_name": "the unit's own sensor"}
    assert found["bias"].dims == ("time",)


def test_without_xarray_one_line_says_how_to_get_it(run, monkeypatch):
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(bench.InputError, match=r"pip install 'gyro-thermal-bench\[notebook\]'"):
        run.to_xarray()


def test_a_model_of_temperature_predicts_for_any_temperatures(run):
    fit = run.fit("polynomial")
    predicted = fit.predict(temperature=[-60.0, 0.0, 20.0])
    assert predicted.bias[1:] == pytest.approx([5.0, 6.28], abs=0.01)
    assert predicted.out_of_range.tolist() == [True, False, False]
    assert np.all(predicted.std > 0.0)
    frame = pd.DataFrame({"temperature": [0.0, 20.0]})
    assert fit.predict(frame).bias == pytest.approx(predicted.bias[1:])
    assert fit.predict(run).bias == pytest.approx(fit.to_dataframe()["model"])


def test_a_model_with_memory_wants_the_time(run):
    fit = run.fit("polynomial").add("temperature_rate")
    with pytest.raises(bench.InputError, match="'temperature_rate', which may depend on the course of time"):
        fit.predict(temperature=[0.0, 20.0])
    assert fit.predict(run.to_dataframe()).bias == pytest.approx(fit.predict(run).bias)
    with pytest.raises(bench.InputError, match="channel 'temperature'"):
        fit.predict(time=[0.0, 30.0], drive=[1.0, 1.0])


def test_an_effect_that_is_missing_is_added_and_measured():
    run = bench.open(cycle(lag_dph=0.5))
    short = run.fit("polynomial")
    fit = short.add("temperature_rate")
    slope = next(c for key, c in fit.coefficients.items() if key.startswith("temperature_rate."))
    assert slope.value == pytest.approx(0.5, abs=max(0.01, 5 * slope.std))
    assert fit.held_out.rms_dph < 0.1 * short.held_out.rms_dph
    assert fit.model.name == "polynomial + temperature_rate"
    with pytest.raises(bench.InputError, match="has 'polynomial' already"):
        bench.add("polynomial", short)


def test_a_nonlinear_parameter_is_a_coefficient_with_its_unit(run):
    fit = run.fit("polynomial").add("warm_up")
    assert fit.coefficients["warm_up.tau_s"].unit == "s"


def test_another_run_is_the_check_that_the_held_out_error_is_of(run):
    fit = run.fit("polynomial", check=bench.open(cycle(interval_s=40.0)))
    assert fit.held_out.by == "check"
    assert fit.held_out.rms_dph == pytest.approx(0.01, rel=0.3)


def test_an_effect_of_ones_own_is_like_the_built_in_ones(run):
    @dataclass(frozen=True)
    class Ripple(bench.Effect):
        """A sine over temperature."""

        name = "ripple"
        needs = ("temperature",)
        parameters = (bench.Parameter("period", "degC", 5.0, 20.0, 10.0),)
        amplitudes = (("s", "deg/h"), ("c", "deg/h"))

        def columns(self, record, theta):
            phase = 2 * np.pi * record.channel("temperature") / theta["period"]
            return np.column_stack([np.sin(phase), np.cos(phase)])

    fit = run.fit(bench.add(Ripple(), "polynomial"))
    assert {"ripple.s", "ripple.c", "ripple.period"} <= set(fit.coefficients)


def test_the_noise_floor_is_read_from_the_soaks_or_said_to_be_missing(run, looped):
    assert looped.floor.floor_dph == pytest.approx(ARW / np.sqrt(30.0 / 3600.0), rel=0.2)
    assert np.isnan(run.floor.floor_dph)
    assert "noise floor not known: no isothermal stretch" in run.summary()


@pytest.mark.slow
def test_the_hidden_effect_of_a_run_folder_is_named_and_added(why):
    assert why.verdict == "missing_effect"
    assert why.found[0].effect == "hysteresis"
    assert why.proved is True
    assert why.to_dataframe().loc["hysteresis", "found"]
    better = why.fit()
    assert "hysteresis" in [effect.name for effect in better.model.effects]
    assert better.rms_dph < 0.7 * why.answer.rms_dph


def test_a_comparison_is_a_table_and_gives_its_fits(looped):
    compared = looped.compare(["polynomial", "spline"])
    table = compared.to_dataframe()
    assert list(compared) == ["polynomial", "spline"]
    assert table.loc["spline", "rms_dph"] < table.loc["polynomial", "rms_dph"]
    assert compared["spline"].rms_dph == pytest.approx(compared["spline"].score.fit.rms_dph)
    with pytest.raises(bench.InputError, match="did you mean 'spline'"):
        compared["splin"]
    assert "over floor" in compared.summary()
    assert "noise floor" in compared._repr_html_()


def test_models_that_nobody_asked_for_may_lack_their_channels(run):
    compared = run.compare()
    assert "polynomial" in list(compared)
    assert "not fitted: regression: " in compared.summary()
    with pytest.raises(bench.InputError, match="channel 'frequency'"):
        run.compare(["regression"])


@pytest.mark.slow
def test_no_error_is_told_without_the_floor(why, looped):
    fit = looped.fit("polynomial")
    for text in (fit.summary(), fit._repr_html_(), why.summary(), why._repr_html_()):
        assert "in-sample" in text
        assert "held-out" in text
        assert "noise floor 0.0" in text


def test_a_summary_tells_value_uncertainty_and_unit(run):
    lines = run.fit("polynomial").summary().splitlines()
    assert any(line.split()[0] == "polynomial.a1" and line.endswith("deg/h/degC") for line in lines if line)
    assert any(line.startswith("valid for temperature -30.0 to 70.0 degC") for line in lines)


def test_names_from_outside_cannot_become_html(tmp_path):
    cycle().to_csv(tmp_path / "<b>log&.csv", index=False)
    run = bench.open(tmp_path / "<b>log&.csv")
    for html in (run._repr_html_(), run.fit("polynomial")._repr_html_(), run.compare(["polynomial"])._repr_html_()):
        assert "<b>" not in html
        assert "<table>" in html
    assert "&lt;b&gt;log&amp;" in run._repr_html_()


@pytest.mark.slow
def test_figures_are_plotly_figures_with_the_data_in_them(run, why):
    fit = run.fit("polynomial")
    figures = [run.plot(), run.plot("time"), fit.plot(), fit.plot(run, over="time"), why.plot()]
    figures += [run.compare(["polynomial"]).plot()]
    assert all(type(figure).__name__ == "Figure" and len(figure.data) for figure in figures)
    assert len(why.plot().data) == 2  # before and after
    with pytest.raises(bench.InputError, match="was not diagnosed"):
        why.plot(run)


def test_a_profile_is_checked_and_run_from_python(tmp_path):
    profile = tmp_path / "short.yaml"
    profile.write_text(acquisition.SHORT)
    seen = []
    expected = bench.check(profile)
    run = bench.run(profile, onlooker=lambda status: seen.append(status.t_s), out=tmp_path / "reports")
    assert seen == sorted(seen)
    assert max(seen) == pytest.approx(expected["duration_s"], abs=30.0)
    assert run.folder is not None
    assert run.folder.parent.parent == tmp_path / "reports"
    assert bench.open(run.folder).to_dataframe(1.0).equals(run.to_dataframe(1.0))


def test_a_run_that_an_onlooker_breaks_is_not_lost(tmp_path):
    profile = tmp_path / "short.yaml"
    profile.write_text(acquisition.SHORT)

    def stumble(status):
        if status.t_s > 20.0:
            raise bench.RunAborted("seen enough")

    with pytest.raises(bench.RunAborted, match="seen enough") as caught:
        bench.run(profile, onlooker=stumble, out=tmp_path / "reports")
    folder = caught.value.__notes__[0].removeprefix("what was recorded until then: ")
    assert bench.open(folder).seconds.time[-1] > 15.0


def test_a_station_of_several_units_asks_which(tmp_path):
    profile = tmp_path / "short.yaml"
    profile.write_text(acquisition.SHORT)
    with pytest.raises(bench.InputError, match="has 4 units: give unit=, one of"):
        bench.run(profile, acquisition.STATION.with_name("four_units.yaml"), out=tmp_path)


def test_importing_the_bench_loads_nothing_heavy():
    script = "import sys, bench; dir(bench); print(*sorted({name.split('.')[0] for name in sys.modules}))"
    loaded = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout.split()
    assert not {"numpy", "pandas", "scipy", "plotly", "pydantic", "pyarrow", "can", "pymodbus"} & set(loaded)


def test_every_public_name_is_there_and_says_what_it_is_for():
    for name in bench.__all__:
        assert getattr(bench, name).__doc__ or name == "__version__", name


@pytest.mark.parametrize("name", ["models", "runs", "fits"])
def test_examples_in_the_docstrings_are_true(name):
    done = doctest.testmod(importlib.import_module(f"bench.api.{name}"))
    assert (done.failed, done.attempted > 0) == (0, True)


def test_a_long_list_of_coefficients_is_cut_in_print_only(run):
    fit = run.fit("spline", intervals=12)
    assert len(fit.coefficients) == 48
    assert fit.summary().count("deg/h/degC^3") < 12
    assert "and 24 more in .coefficients" in fit.summary()


def test_tables_line_up():
    assert words.text_table(("a", "b"), [("x", "1.0"), ("long", "10.0")]) == ["a        b", "x      1.0", "long  10.0"]


def test_at_a_prompt_every_object_says_what_it_is(run):
    fit = run.fit("polynomial")
    assert repr(run).startswith("<Run DataFrame: 480 means over 30 s")
    assert repr(fit) == "<Fit polynomial: 480 means over 30 s of DataFrame>"
    assert repr(run.compare([fit])) == "<Comparison of polynomial>"
