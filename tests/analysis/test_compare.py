import json

import numpy as np
import pytest

from bench.analysis.diagnosis.compare import compare, ladder
from bench.analysis.effects import registry as effects
from bench.analysis.effects.model import Model, load_model
from bench.analysis.judging.completeness import Completeness
from bench.analysis.judging.verdict import judge
from bench.base.errors import InputError
from bench.record.dataset import Dataset
from tests.support.analysis_data import curve, thermal_cycle, white, with_bias


def record(seed=0, loop_dph=0.0, name="cycle"):
    """A curve over temperature, white noise of 0.2 deg/h, and a loop: plus while heating, minus while cooling."""
    base = thermal_cycle()
    bias = curve(base.channels["temperature"]) + white(base, 0.2, seed) + loop_dph * np.sign(base.dT_dt)
    return with_bias(base, bias, name)


def spline(intervals):
    return Model(f"spline {intervals}", (effects.make("spline", {"intervals": intervals}),))


def test_the_ladder_falls_towards_the_floor_in_and_out_of_sample():
    comparison = compare(record(), ladder(), 0.2)
    rms = {score.model.name: score for score in comparison.scores}
    assert list(rms) == [
        "fixed points, line",
        "fixed points, parabola",
        "cubic, heating only",
        "polynomial",
        "regression",
        "spline",
    ]
    assert rms["fixed points, line"].rms_dph > rms["polynomial"].rms_dph > rms["spline"].rms_dph
    assert rms["polynomial"].held_out.rms_dph > 1.5 * rms["spline"].held_out.rms_dph
    assert rms["spline"].rms_dph == pytest.approx(0.2, rel=0.06)
    assert rms["spline"].held_out.rms_dph == pytest.approx(0.2, rel=0.06)


def test_in_sample_error_is_that_of_the_fit_and_held_out_error_is_larger():
    (score,) = compare(record(), [spline(24)], 0.2).scores
    assert score.rms_dph == pytest.approx(score.fit.rms_dph, rel=1e-12)
    assert score.held_out.rms_dph > score.rms_dph
    low, high = score.interval_dph
    assert low < score.rms_dph < high
    assert (high - low) < 0.05


def test_held_out_blocks_agree_with_a_plain_loop_over_numpy():
    data = record()
    (score,) = compare(data, [load_model("polynomial")], 0.2).scores
    scaled = data.channels["temperature"] / 85.0
    square = 0.0
    for rows in np.array_split(np.arange(720), 20):
        rest = np.setdiff1d(np.arange(720), rows)
        fitted = np.polynomial.Polynomial.fit(scaled[rest], data.bias[rest], 3)
        square += np.sum((data.bias[rows] - fitted(scaled[rows])) ** 2)
    counted = score.counted.held_out
    assert counted.out_of_range < 0.03  # a few rows go on along the tangent instead of the cubic
    assert counted.rms_dph == pytest.approx(np.sqrt(square / 720), rel=1e-3)


def test_more_intervals_lower_the_error_of_a_loop_in_sample_but_not_held_out():
    """Measured on a real unit too: block error of a loop rises with the number of intervals."""
    few, many = compare(record(loop_dph=1.0), [spline(8), spline(32)], 0.2).scores
    assert many.rms_dph < few.rms_dph
    assert many.by_segments.rms_dph > few.by_segments.rms_dph * 0.99
    assert few.by_segments.rms_dph > 1.1 * few.rms_dph


def test_a_heating_only_cubic_is_caught_by_its_cooling_segments():
    heating = Model("cubic, heating only", (effects.make("polynomial", {"order": 7}),), "heating")
    (score,) = compare(record(loop_dph=1.0), [heating], 0.2).scores
    segments = {segment.name: segment.rms_dph for segment in score.segments}
    assert segments["down"] > 3 * segments["up"]
    assert score.rms_dph > 2 * score.fit.rms_dph


def test_segments_stand_beside_the_floor():
    (score,) = compare(record(), [spline(24)], 0.2).scores
    assert [segment.name for segment in score.segments] == [s.name for s in record().segments]
    for segment in score.segments:
        assert segment.floor_ratio == pytest.approx(segment.rms_dph / 0.2)
        assert 0.7 < segment.floor_ratio < 1.3


def test_a_check_run_is_the_held_out_error():
    other = record(1, name="other")
    comparison = compare(record(0), [spline(24)], 0.2, with_bias(other, other.bias + 0.5, "other"))
    (score,) = comparison.scores
    assert score.held_out.by == "check"
    assert score.held_out.rms_dph == pytest.approx(np.hypot(0.5, 0.2), rel=0.05)
    assert comparison.check == ("other",)
    assert score.by_blocks.rms_dph < score.held_out.rms_dph


def test_what_a_turn_on_bias_has_in_the_error_on_a_check_run_is_told():
    other = record(1)
    plain, moved = (
        compare(record(0), [spline(24)], 0.2, with_bias(other, other.bias + by_dph, "other")) for by_dph in (0.0, 5.0)
    )
    assert plain.constants == ""
    assert moved.scores[0].held_out.shape_dph == pytest.approx(plain.scores[0].held_out.shape_dph)
    alone = plain.scores[0].held_out.rms_dph
    assert moved.scores[0].held_out.shape_dph == pytest.approx(alone, rel=0.05)
    assert moved.constants.startswith("held-out without a constant of each check run, such as its turn-on bias: spline")


def test_spikes_of_a_check_run_count_and_are_told():
    """The error was 14 x the noise floor, and no word said that three means made it so."""
    other = record(1)
    bias = other.bias.copy()
    bias[[20, 60, 100]] += [20.0, -20.0, 30.0]
    plain, struck = (
        compare(record(0), [spline(24)], 0.2, with_bias(other, own, "other")) for own in (other.bias, bias)
    )
    assert plain.spikes == ""
    held, without = struck.scores[0].held_out, plain.scores[0].held_out
    assert (held.spikes, without.spikes) == (3, 0)
    assert held.rms_dph > 5.0 * without.rms_dph
    assert held.plain_dph == pytest.approx(without.rms_dph, rel=0.02)
    assert held.shape_dph == pytest.approx(without.shape_dph, rel=0.02)
    told = "held-out without rows with spikes (3), which no model describes: spline 24"
    assert struck.spikes == f"{told} {held.plain_dph:.3g}"
    verdict = judge(Completeness("done", samples=1), struck.scores[0], 0.2, "")
    assert verdict.word == "adequate"
    assert "× without rows with spikes: 3)" in verdict.sentence


@pytest.mark.parametrize("struck", ["run", "check"])
def test_a_disturbance_is_in_no_fit_and_no_error_but_in_the_peak(struck):
    """A hand at the chamber for five minutes: 5 deg/h, at temperatures that the run has elsewhere, too."""
    runs = {"run": record(0, name="run"), "check": record(1, name="check")}
    plain = compare(runs["run"], [spline(24)], 0.2, runs["check"])
    away = 5.0 * ((np.arange(720) >= 300) & (np.arange(720) < 310))
    runs[struck] = with_bias(runs[struck], runs[struck].bias + away, struck)
    found = compare(runs["run"], [spline(24)], 0.2, runs["check"])
    (one,), (other,) = found.scores, plain.scores
    assert one.rms_dph == pytest.approx(other.rms_dph, rel=0.02)
    assert one.held_out.rms_dph == pytest.approx(other.held_out.rms_dph, rel=0.02)
    assert one.fit.rows == pytest.approx(other.fit.rows - (10 if struck == "run" else 0), abs=2)
    assert (one.held_out.peak_dph > 4.5) == (struck == "check")
    (told,) = found.left_out
    assert told.startswith(f"{struck} from ")
    assert told in found.warnings
    assert found.to_json()["left_out"] == [told]
    assert plain.left_out == ()


def test_an_automatic_spline_is_compared_as_what_it_chose():
    (score,) = compare(record(), [load_model("spline"), Model("auto", (effects.make("spline"),))], 0.2).scores[1:]
    assert isinstance(score.model.effects[0].intervals, int)


def test_a_model_that_cannot_be_fitted_is_refused_with_its_reason():
    ramp = record().select(thermal_cycle().segment == 1)
    with pytest.raises(InputError, match="needs 2 soaks"):
        compare(ramp, ladder(), 0.2)
    comparison = compare(ramp, ladder(), 0.2, strict=False)
    assert [name for name, _ in comparison.refused] == ["fixed points, line", "fixed points, parabola"]
    assert comparison.scores[-1].by_segments.reason.startswith("the data are one piece")
    assert np.isnan(comparison.scores[-1].by_segments.rms_dph)


def test_two_runs_are_scored_together_and_named_apart():
    comparison = compare([record(0, name="one"), record(1, name="two")], [spline(12)], 0.2)
    assert {segment.run for segment in comparison.scores[0].segments} == {"one", "two"}
    assert comparison.runs == ("one", "two")


def test_gaps_do_not_reach_the_numbers():
    data = record()
    rate = data.channels["rate"].copy()
    rate[100:140] = np.nan
    (score,) = compare(data.with_channel("rate", rate), [spline(12)], 0.2).scores
    assert np.isfinite([score.rms_dph, score.held_out.rms_dph, *score.interval_dph]).all()


def test_json_has_the_keys_of_the_blueprint_and_null_for_what_does_not_exist():
    comparison = compare(record(), [spline(12)], float("nan"))
    content = json.loads(json.dumps(comparison.to_json(), allow_nan=False))
    assert content["runs"] == ["cycle"]
    assert content["floor_dph"] is None
    (model,) = content["models"]
    assert {"name", "effects", "rms_dph", "held_out_rms_dph", "segments"} <= set(model)
    assert model["effects"] == ["spline"]
    assert set(model["segments"][0]) >= {"name", "rms_dph", "floor_ratio"}
    assert model["segments"][0]["floor_ratio"] is None


def test_the_same_data_gives_the_same_numbers():
    first, second = (compare(record(), [spline(12)], 0.2).to_json() for _ in range(2))
    assert first == second


@pytest.mark.parametrize("use", ["fitted", "check"])
def test_an_output_that_never_changes_is_not_scored(use):
    """An error of 0.0000 deg/h would be the best of all models."""
    time = np.arange(0.0, 6000.0, 30.0)
    temperature = 25.0 + 40.0 * np.sin(time / 900.0)
    moving, stuck = (
        Dataset(name, time, {"temperature": temperature, "rate": rate}, np.zeros(time.size, dtype=np.int64), (), 30.0)
        for name, rate in (("moving", 0.01 * temperature + np.cos(time)), ("stuck", np.full(time.size, 1.5)))
    )
    runs, check = ([stuck], None) if use == "fitted" else ([moving], [stuck])
    with pytest.raises(InputError, match=r"stuck: rate is 1\.5 deg/h in every row: no gyro is so quiet"):
        compare(runs, [Model("line", (effects.make("polynomial", {"order": 1}),))], 0.1, check)
