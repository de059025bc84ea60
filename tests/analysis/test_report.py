"""The analysis behind a report: its numbers are those of fit and compare, and it says what the run lacks."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest

from bench.analysis.diagnosis.compare import compare, ladder
from bench.analysis.diagnosis.pieces import pieces_of
from bench.analysis.diagnosis.scores import HeldOut
from bench.analysis.effects.model import load_model
from bench.analysis.judging.analysis import Analysis
from bench.analysis.judging.branches import branch_gap
from bench.analysis.judging.calibration import calibration
from bench.analysis.judging.cautions import cautions
from bench.analysis.judging.completeness import Completeness
from bench.analysis.judging.judge import _best, analyse
from bench.analysis.judging.stored import source_of
from bench.analysis.judging.verdict import RunVerdict, judge, with_diagnosis
from bench.base.errors import InputError
from bench.deliver.report.sections_run import losses
from bench.record import CalibrationRecord, Capture, Dataset, UnitClock, load
from tests.support.report_runs import clean, disturbed, looped, quick
from tests.support.run_folders import ARW, CYCLE, UNIT, make_run, ramp_run, truth_dph


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Analysis:
    return looped(tmp_path_factory.getbasetemp())


def aborted(folder: Path) -> Path:
    """A run cut off in its third ramp, with 100 lost samples in its middle."""
    made = ramp_run()
    here = made["columns"]["time"] < 5200.0
    columns = {name: values[here].copy() for name, values in made["columns"].items()}
    columns["rate"][2000:2100] = np.nan
    segments = [dict(segment) for segment in made["segments"] if segment["from_s"] < 5200.0]
    segments[-1] |= {
        "settled": False,
        "outcome": "interrupted",
        "reason": "aborted by operator (Ctrl-C)",
        "to_s": 5200.0,
    }
    losses = {"received": 10300, "lost": 100, "repeated": 2, "corrupt": 3}
    return make_run(folder, columns, segments, state="aborted", cause=segments[-1]["reason"], losses=losses)


def required_only(columns: dict) -> dict:
    return {name: columns[name] for name in ("time", "rate", "temperature")}


def test_ladder_equals_a_comparison_made_by_hand(whole: Analysis) -> None:
    data = load(whole.run.path)
    assert whole.comparison is not None
    byhand = compare(data, ladder()[:4], whole.floor.floor_dph)
    for mine, theirs in zip(whole.comparison.scores, byhand.scores, strict=False):
        assert mine.rms_dph == theirs.rms_dph
        assert mine.held_out == theirs.held_out
    residual = whole.residual()
    assert whole.best is not None
    assert whole.best.rms_dph == pytest.approx(np.sqrt(np.nanmean(residual**2)), rel=1e-3)


def test_best_model_is_the_one_that_predicts_unseen_data_best(whole: Analysis) -> None:
    assert whole.comparison is not None
    assert whole.best is min(whole.comparison.scores, key=lambda score: score.held_out.rms_dph)


def test_floor_of_a_white_unit_is_its_angle_random_walk_over_the_root_of_the_interval(whole: Analysis) -> None:
    assert whole.floor.noise is not None
    assert whole.floor.noise.white == pytest.approx(ARW, rel=0.05)
    assert whole.floor.floor_dph == pytest.approx(ARW / np.sqrt(30.0 / 3600.0), rel=0.1)


def test_branch_gap_is_the_loop_that_was_put_in(whole: Analysis) -> None:
    assert whole.dataset is not None
    gap = branch_gap(whole.dataset)
    assert gap is not None
    # Play of half-width r moves the centre by 2 r between the branches: 2 * loop_dph; the lagging curve is the same.
    assert gap[0] == pytest.approx(0.8, abs=0.15)


def test_bias_span_and_uncompensated_error_are_those_of_the_means(whole: Analysis) -> None:
    assert whole.dataset is not None
    bias = whole.dataset.bias
    assert whole.bias_span_dph == pytest.approx(np.ptp(bias))
    assert whole.uncompensated_dph == pytest.approx(np.std(bias), rel=1e-3)


def evaluate(entry: dict, record: Dataset) -> np.ndarray:
    """Bias from calibration.json by its text alone: powers of channels, or pieces between knots."""
    (effect,) = entry["model"]["effects"]
    terms = {c["key"].split(".", 1)[1]: c["value"] for c in entry["coefficients"]}
    temperature = record.channels["temperature"]
    if effect["effect"] == "polynomial":
        return sum(value * temperature ** int(label[1:]) for label, value in terms.items())
    if effect["effect"] == "regression":
        powers = ((label.split("^"), value) for label, value in terms.items() if "^" in label)
        return terms["b0"] + sum(value * record.channels[name] ** int(power) for (name, power), value in powers)
    knots = np.array(effect["state"]["knots"])
    piece = np.clip(np.searchsorted(knots, temperature, side="right") - 1, 0, len(knots) - 2)
    table = np.array([[terms[f"piece{i + 1}.a{j}"] for j in range(4)] for i in range(len(knots) - 1)])
    return sum(table[piece, j] * (temperature - knots[piece]) ** j for j in range(4))


@pytest.mark.parametrize(("name", "tolerance"), [("polynomial", 1e-9), ("regression", 3e-5), ("spline", 1e-9)])
def test_another_program_can_evaluate_the_calibration(whole: Analysis, name: str, tolerance: float) -> None:
    assert whole.comparison is not None
    assert whole.dataset is not None
    (score,) = [s for s in whole.comparison.scores if s.model.name == name]
    text = json.dumps(calibration(whole.manifest, 30.0, score, whole.floor, whole.to_json()), allow_nan=False)
    entry = json.loads(text)["calibration"]
    predicted = score.fit.predict(whole.dataset).bias
    assert np.nanmax(np.abs(evaluate(entry, whole.dataset) - predicted)) < tolerance


def test_coefficient_uncertainties_follow_from_the_covariance_in_the_file(whole: Analysis) -> None:
    entry = json.loads((whole.run.path / "calibration.json").read_text())["calibration"]
    scaled = entry["scaled"]
    matrix, covariance = np.array(scaled["to_coefficients"]), np.array(scaled["covariance"])
    linear = matrix.shape[1]
    std = np.sqrt(np.diag(matrix @ covariance[:linear, :linear] @ matrix.T))
    np.testing.assert_allclose([c["std"] for c in entry["coefficients"]], std, rtol=1e-9)
    np.testing.assert_allclose(
        [c["value"] for c in entry["coefficients"]], matrix @ scaled["values"][:linear], rtol=1e-9
    )


def test_calibration_names_unit_data_and_range(whole: Analysis) -> None:
    content = json.loads((whole.run.path / "calibration.json").read_text())
    assert content["unit"] == UNIT
    assert content["averaging_s"] == 30.0
    assert content["data"]["means.parquet"] == whole.manifest.files["means.parquet"]
    assert all(c["unit"].startswith("deg/h") for c in content["calibration"]["coefficients"])
    low, high = (content["calibration"]["validity"]["temperature"][end] for end in ("from", "to"))
    assert low == pytest.approx(-40.0, abs=0.1)
    assert high == pytest.approx(85.0, abs=0.1)


def test_compare_json_has_the_keys_of_the_command(whole: Analysis) -> None:
    content = json.loads((whole.run.path / "compare.json").read_text())
    assert {"runs", "floor_dph", "models", "verdict"} <= content.keys()
    assert {"name", "effects", "rms_dph", "held_out_rms_dph", "segments"} <= content["models"][0].keys()
    assert len(content["models"]) == 6


def test_a_check_run_is_what_the_model_is_judged_by(whole: Analysis, tmp_path: Path) -> None:
    shorter = [(name, kind, 60.0 if target == 85.0 else target, amount) for name, kind, target, amount in CYCLE]
    run = make_run(tmp_path / "run", **ramp_run())
    check = make_run(tmp_path / "check", **ramp_run(shorter, seed=2))
    with patch("bench.analysis.judging.judge.noise_floor", return_value=whole.floor):
        judged = analyse(run, [load_model("polynomial")], [check], diagnose=False)
    assert judged.best is not None
    assert judged.best.held_out.by == "check"
    data = load(check)
    left = data.bias - judged.best.fit.predict(data).bias
    assert judged.best.held_out.rms_dph == pytest.approx(np.sqrt(np.mean(left**2)), rel=1e-2)
    other = make_run(tmp_path / "other", **ramp_run(), unit="SIM-0002")
    with pytest.raises(InputError, match="unit SIM-0002"):
        analyse(whole.run.path, (), [other])


def test_an_aborted_run_says_so_and_shows_what_there_is(tmp_path: Path) -> None:
    analysis = quick(aborted(tmp_path / "aborted"))
    assert analysis.verdict.word == "partial"
    assert analysis.verdict.sentence.startswith(
        "Aborted by operator (Ctrl-C) after 1:26:40, 100 frames lost or damaged"
    )
    assert analysis.best is not None
    assert analysis.done.missing == 100
    assert analysis.done.gaps_s == ((1000.0, 1050.0),)
    assert not analysis.within_limits
    assert any("'up to 85' failed" in text for text in analysis.warnings)


def test_an_imported_table_needs_no_segments_losses_or_other_channels(tmp_path: Path) -> None:
    columns = {
        name: values for name, values in ramp_run()["columns"].items() if name in {"time", "rate", "temperature"}
    }
    run = make_run(tmp_path / "imported", columns, losses={}, sample_rate_hz=None)
    analysis = analyse(run, [load_model("polynomial")], diagnose=False)
    assert analysis.best is not None
    assert "frame losses not counted" in analysis.verdict.sentence
    assert analysis.done.missing is None
    # Without segments the floor is read wherever the temperature stood still.
    assert len(analysis.floor.stretches) == 4
    assert analysis.floor.floor_dph == pytest.approx(ARW / np.sqrt(30.0 / 3600.0), rel=0.1)


def test_zero_rows_are_an_answer_not_an_error(tmp_path: Path) -> None:
    columns = {name: values[:0] for name, values in ramp_run()["columns"].items()}
    run = make_run(tmp_path / "zero", columns, state="failed", cause="chamber link lost for 12 s")
    analysis = quick(run)
    assert analysis.verdict.word == "no_data"
    assert "chamber link lost" in analysis.verdict.sentence
    assert json.loads((run / "calibration.json").read_text())["calibration"] is None
    assert json.loads((run / "compare.json").read_text())["models"] == []


@pytest.mark.parametrize("name", ["rate", "temperature"])
def test_a_record_without_one_value_of_a_required_channel_is_no_data(tmp_path: Path, name: str) -> None:
    columns = {key: values[:1000].copy() for key, values in ramp_run()["columns"].items()}
    columns[name][:] = np.nan
    analysis = quick(make_run(tmp_path / "empty", columns))
    assert analysis.verdict.word == "no_data"
    assert f"no value of {name}" in analysis.verdict.sentence


def test_constant_temperature_gives_a_reason_instead_of_a_model(tmp_path: Path) -> None:
    made = ramp_run([("soak", "soak", 25.0, 240.0)])
    made["columns"]["temperature"][:] = 25.0
    analysis = quick(make_run(tmp_path / "constant", **made))
    assert analysis.best is None
    assert analysis.verdict.word == "unproven"
    assert "temperature moves by 0 degC" in analysis.verdict.sentence


def test_a_timed_out_segment_is_never_a_whole_run(tmp_path: Path) -> None:
    made = ramp_run()
    made["segments"][2] |= {"settled": False, "outcome": "timeout", "reason": "slope 0.4 degC/min after 3600 s"}
    analysis = quick(make_run(tmp_path / "timeout", **made))
    assert analysis.verdict.word == "partial"
    assert analysis.verdict.sentence.startswith("1 of 7 segments failed")


def test_means_that_were_changed_after_the_run_are_noticed(tmp_path: Path) -> None:
    run = make_run(tmp_path / "changed", **ramp_run())
    with (run / "means.parquet").open("ab") as file:
        file.write(b"\0")
    with pytest.raises(InputError, match=r"means\.parquet: is not the file that was recorded: its SHA-256 is"):
        quick(run)


def test_the_diagnosis_names_the_loop_that_was_put_in_and_becomes_the_verdict(whole: Analysis) -> None:
    answer = whole.diagnosed.answer
    assert answer is not None
    assert [suspect.effect for suspect in answer.found] == ["hysteresis"]
    assert answer.found[0].parameters["width_degc"].value == pytest.approx(5.0, abs=0.5)
    assert whole.verdict.word == "missing_effect"
    assert whole.verdict.headline == "Missing: hysteresis"
    assert (
        "; spline lacks hysteresis; adding it lowers the error on parts of legs left out from" in whole.verdict.sentence
    )
    said = whole.to_json()
    assert said["verdict"] == said["diagnosis"]["verdict"] == "missing_effect"
    assert said["diagnosis"]["sentence"] == answer.sentence
    assert said["diagnosis"]["suspects"][0] == "hysteresis"


def test_diagnosis_json_is_the_answer_of_bench_diagnose(whole: Analysis) -> None:
    assert whole.diagnosed.answer is not None
    written = json.loads((whole.run.path / "diagnosis.json").read_text())
    assert written == {"format": 1, **json.loads(json.dumps(whole.diagnosed.answer.to_json()))}


def test_the_error_falls_to_the_floor_with_the_effect_and_not_with_its_rival(whole: Analysis) -> None:
    base, added, *others = whole.diagnosed.rungs
    assert (base.name, added.name) == ("spline", "+ hysteresis")
    assert base.held_out_dph > 5 * whole.floor.floor_dph
    assert added.held_out_dph < 1.15 * whole.floor.floor_dph
    assert added.in_sample_dph == pytest.approx(whole.floor.floor_dph, rel=0.1)
    assert all(rung.rival and rung.held_out_dph > 2 * added.held_out_dph for rung in others)


def test_a_run_that_nothing_is_missing_from_is_adequate(tmp_path_factory: pytest.TempPathFactory) -> None:
    analysis = clean(tmp_path_factory.getbasetemp())
    assert analysis.verdict.word == "adequate"
    assert "spline lacks no effect that this run could show" in analysis.verdict.sentence
    assert len(analysis.diagnosed.rungs) == 1


def test_what_the_library_does_not_explain_is_an_unknown_effect(tmp_path_factory: pytest.TempPathFactory) -> None:
    analysis = disturbed(tmp_path_factory.getbasetemp())
    assert analysis.verdict.word == "unknown_effect"
    assert analysis.diagnosed.answer is not None
    assert any("period" in place.note for place in analysis.diagnosed.answer.unexplained)


@pytest.mark.parametrize(
    ("error", "reason"),
    [(InputError("too few rows"), "too few rows"), (ValueError("NaN"), "the diagnosis failed (ValueError: NaN)")],
)
def test_a_diagnosis_that_cannot_be_made_is_a_warning(tmp_path: Path, error: Exception, reason: str) -> None:
    with patch("bench.analysis.judging.diagnosed.diagnose", side_effect=error):
        analysis = quick(make_run(tmp_path / "run", **ramp_run()), diagnose=True)
    assert analysis.verdict.word == "model_error"
    assert f"not diagnosed: {reason}" in analysis.warnings
    assert analysis.to_json()["diagnosis"] == {"verdict": None, "sentence": reason, "suspects": []}


def test_a_partial_run_stays_partial_whatever_it_lacks(whole: Analysis) -> None:
    partial = RunVerdict("partial", "Aborted after 1:00:00.")
    judged = with_diagnosis(partial, whole.diagnosed, whole.floor.floor_dph)
    assert judged.word == "partial"
    assert "lacks hysteresis" in judged.sentence


@pytest.mark.parametrize(
    ("ratio", "word"), [(1.0, "adequate"), (1.49, "adequate"), (1.6, "model_error"), (np.nan, "unproven")]
)
def test_verdict_follows_the_held_out_error_over_the_floor(whole: Analysis, ratio: float, word: str) -> None:
    assert whole.best is not None
    score = replace(whole.best, held_out=HeldOut("blocks", 0.1 * ratio, reason="one piece"))
    assert judge(Completeness("done", samples=1), score, 0.1, "").word == word


def test_without_a_floor_it_is_not_decided_whether_something_is_missing(whole: Analysis) -> None:
    verdict = judge(Completeness("done", samples=1), whole.best, np.nan, "")
    assert verdict.word == "undecided"
    assert "on unseen data; the noise floor is not known" in verdict.sentence


def test_a_model_of_a_part_of_the_rows_is_not_the_best_where_there_is_another(whole: Analysis) -> None:
    assert whole.comparison is not None
    part, other = whole.comparison.scores[2:4]
    assert part.model.rows == "heating"
    better = replace(part, held_out=HeldOut("blocks", 0.5 * other.held_out.rms_dph))
    assert _best([better, other]) is other
    assert _best([better]) is better


def test_blocks_are_finer_where_a_record_reaches_its_ends_once() -> None:
    degc = np.interp(np.arange(240.0), [0, 66, 174, 239], [25, -30, 70, 25])
    once = Dataset("once", 30.0 * np.arange(240.0), {"temperature": degc}, np.zeros(240, dtype=np.int64))
    twice = once.with_channel("temperature", np.tile(degc[::2], 2))
    assert np.unique(pieces_of(once)).size == 40
    assert np.unique(pieces_of(twice)).size == 20


def test_the_synthetic_unit_is_what_its_truth_says() -> None:
    made = ramp_run(loop_dph=0.0)
    columns = made["columns"]
    left = columns["rate"] - truth_dph(columns["temperature"])
    assert np.std(left) == pytest.approx(ARW * np.sqrt(7200.0), rel=0.05)


def test_a_host_that_was_overloaded_is_a_warning_and_the_clock_of_the_unit_is_told(whole: Analysis) -> None:
    clock = UnitClock(offset_s=0.1, offset_u_s=1e-5, drift_ppm=-12.5, drift_u_ppm=0.05, spread_s=0.0012)
    done = replace(whole.done, unit_clock=clock, capture=Capture(most_behind_s=3.2, behind_spells=2))
    assert "the capture was behind its bus 2 times, at most 3.20 s: the host was overloaded" in cautions(
        done, None, None, None
    )
    html = str(losses(replace(whole, done=done)).html)
    assert "its clock runs 12.5 ppm faster than the host's clock (± 0.1 ppm, k = 2)" in html.replace("&#39;", "'")
    assert "the fastest frames lie within 1.2 ms of that line" in html
    assert "No frame waited longer than 3.200 s for the capture." in html
    assert "its clock runs" not in str(losses(whole).html)


def test_the_calibration_of_a_disturbed_run_is_without_the_disturbance(tmp_path: Path) -> None:
    made = ramp_run()
    time = made["columns"]["time"]
    made["columns"]["rate"] = made["columns"]["rate"] + 20.0 * ((time >= 4500.0) & (time < 4800.0))
    analysis = quick(make_run(tmp_path / "run", **made), "spline")
    (told,) = [text for text in analysis.warnings if "no channel moves with it" in text]
    assert told in CalibrationRecord.read(analysis.run.path).calibration.warnings
    fit = source_of(analysis.run.path).fit
    assert fit.rms_dph == analysis.best.fit.rms_dph < 1.0
