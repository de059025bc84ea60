"""Every sample of a run is read once, however much is asked of it; a live run is followed from its means."""

import json
import tracemalloc

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from bench.acquisition.run.control import Desk
from bench.analysis.diagnosis.every_sample import of_seconds, sample_floor
from bench.analysis.effects.model import Model
from bench.analysis.effects.polynomial import Polynomial
from bench.analysis.effects.regression import Regression
from bench.analysis.effects.spline import Spline
from bench.analysis.effects.thermal_lag import ThermalLag
from bench.analysis.fit.cells import STRETCH, Cells
from bench.analysis.fit.every_sample import SampledRun, read
from bench.analysis.fit.fitting import fit_model
from bench.analysis.fit.samples import BATCH_ROWS, REACH_S, Samples, between
from bench.analysis.fit.so_far import SoFar
from bench.analysis.fit.state import State
from bench.cli import main
from bench.record.dataset import Dataset
from bench.record.folder import RunFolder
from bench.record.reading import load
from bench.record.samples import read_samples
from tests.support.run_folders import CYCLE, make_run, ramp_run


def test_readings_of_a_slow_channel_are_joined_by_straight_lines_and_not_across_gaps():
    time = np.arange(0.0, 10.0, 0.1)
    values = np.full(time.size, np.nan)
    values[[0, 10, 20, 60, 70]] = [0.0, 1.0, 0.0, 5.0, 6.0]
    found = between(time, values, slice(None))
    assert found[5] == pytest.approx(0.5)
    assert found[15] == pytest.approx(0.5)
    assert time[60] - time[20] > REACH_S
    assert np.all(np.isnan(found[21:60]))
    assert np.all(np.isnan(found[71:]))
    table = between(time, values, slice(None), "applied_rate")  # it accelerates all the time
    assert np.flatnonzero(np.isfinite(table)).tolist() == [0, 10, 20, 60, 70]


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run at 20 Hz whose temperature comes with every fourth sample only."""
    made = ramp_run(CYCLE, rate_hz=20.0)
    columns = made["columns"]
    for name in ("temperature", "frequency", "drive", "quadrature"):
        slow = np.full(columns[name].size, np.nan)
        slow[::4] = columns[name][::4]
        columns[name] = slow
    return RunFolder(make_run(tmp_path_factory.mktemp("runs") / "run", **made))


def as_record(folder):
    return SampledRun(Samples(folder.data), load(folder.path, 1.0), load(folder.path))


def test_every_sample_is_read_once_however_many_models_there_are(run, monkeypatch):
    opened = []
    original = pq.ParquetFile.iter_batches
    monkeypatch.setattr(
        pq.ParquetFile, "iter_batches", lambda self, **given: opened.append(1) or original(self, **given)
    )
    models = [Model("p", (Polynomial(),)), Model("r", (Regression(),)), Model("s", (Spline(),))]
    rows = pq.read_metadata(run.data).num_rows
    assert rows > BATCH_ROWS > STRETCH
    passes = read(models, [as_record(run)])
    assert [one.state.touched for one in passes] == [rows] * 3
    assert len(opened) == 1


def test_memory_does_not_grow_with_the_record(tmp_path):
    """Allocations of Python and numpy while a file is read: four times the samples, the same peak."""
    peaks = []
    for rows in (1 << 19, 1 << 21):
        time = np.arange(rows) / 500.0
        columns = {"time": time, "rate": np.sin(time), "temperature": 20.0 + np.cos(time / 300.0)}
        pq.write_table(pa.table(columns), path := tmp_path / f"{rows}.parquet", row_group_size=1 << 18)
        samples, state = Samples(path), State(Cells(19.0, 21.0, 96))
        tracemalloc.start()
        for batch in samples.read(["temperature"]):
            state.add(batch.time, batch.columns, batch.y)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        assert state.touched == rows
    assert peaks[1] < 1.3 * peaks[0] < 50e6


@pytest.mark.parametrize(
    "effects", [(Polynomial(4),), (Regression(),), (Spline(24),), (Spline(12), ThermalLag())], ids=str
)
def test_a_fit_to_every_sample_is_the_fit_to_the_rows(run, effects):
    """The same rows, joined by straight lines beforehand, through the ordinary fit."""
    (one,) = read([Model("m", effects)], [as_record(run)])
    found = one.fit([as_record(run)])
    table = read_samples(run.data)
    time = table["time"]
    channels = {name: table[name] for name in ("rate", *Regression.needs)}
    for name in Regression.needs:
        known = np.isfinite(channels[name])
        channels[name] = np.interp(time, time[known], channels[name][known], right=np.nan)
    rows = Dataset("all", time, channels, table["segment"].astype(int), interval_s=0.05)
    if len(effects) == 1:
        ours = fit_model(Model("m", effects), rows, covariance="none")
        at = rows.select(np.arange(time.size) % 501 == 0)
        np.testing.assert_allclose(found.predict(at).bias, ours.predict(at).bias, rtol=0, atol=2e-4)
        assert found.rms_dph == pytest.approx(ours.rms_dph, rel=1e-6)
        assert found.rows == ours.rows
    else:  # the lag's columns come from 1 s means
        means = fit_model(Model("m", effects), load(run.path), covariance="none", weights="count")
        at = load(run.path)
        assert np.nanmax(np.abs(found.predict(at).bias - means.predict(at).bias)) < 0.05
        assert found.theta == means.theta


def test_samples_of_a_disturbance_are_in_no_sum(tmp_path):
    made = ramp_run(CYCLE)
    plain = RunFolder(make_run(tmp_path / "plain", **made))
    time = made["columns"]["time"]
    inside = (time >= 4500.0) & (time < 4800.0)
    made["columns"]["rate"] = made["columns"]["rate"] + 20.0 * inside
    struck = RunFolder(make_run(tmp_path / "struck", **made))
    model = Model("m", (Spline(24),))
    one, other = (read([model], [as_record(folder)])[0].fit([as_record(folder)]) for folder in (plain, struck))
    assert other.rows == pytest.approx(one.rows - inside.sum(), abs=60)
    assert other.rms_dph == pytest.approx(one.rms_dph, rel=0.03)


def test_heating_alone_is_fitted_from_the_blocks_that_heat(run):
    both, heating = read([Model("m", (Polynomial(),)), Model("m", (Polynomial(),), "heating")], [as_record(run)])
    assert 0 < heating.solved().rows < both.solved().rows
    assert both.solved(heating.rows).beta == pytest.approx(heating.solved().beta)


def test_compare_every_sample_answers_like_compare(run, capsys):
    def say(*arguments):
        with pytest.raises(SystemExit) as end:
            main(["compare", str(run.path), "--json", "--model", "polynomial", "--model", "spline", *arguments])
        assert end.value.code == 0
        return json.loads(capsys.readouterr().out)

    means, samples = say(), say("--every-sample")
    assert set(means) <= set(samples)
    assert samples["samples"] == pq.read_metadata(run.data).num_rows
    for ours, theirs in zip(samples["models"], means["models"], strict=True):
        assert set(ours) == set(theirs)
        assert ours["rms_dph"] <= ours["held_out_rms_dph"]
        assert [s["name"] for s in ours["segments"]] == [s["name"] for s in theirs["segments"]]
    # White noise of single samples is what is left, and the floor knows it.
    assert samples["models"][1]["rms_dph"] / samples["floor_dph"] == pytest.approx(1.0, abs=0.15)


def test_the_floor_of_single_samples_holds_their_scatter_inside_the_seconds(run):
    seconds = load(run.path, 1.0)
    inside = np.nanmean(seconds.variances["rate"])
    assert sample_floor([seconds], 0.5) == pytest.approx(np.sqrt(0.25 + 0.95 * inside), rel=1e-3)


def test_the_error_of_1_s_means_follows_from_that_of_the_samples(run):
    """Against the residuals of the means themselves."""
    seconds = load(run.path, 1.0)
    (one,) = read([Model("m", (Polynomial(),))], [as_record(run)])
    found = one.fit([as_record(run)])
    residual = seconds.bias - found.predict(seconds).bias
    rms = np.sqrt(np.nansum(seconds.count("rate") * residual**2) / np.sum(seconds.count("rate")))
    assert of_seconds(found.rms_dph, [seconds]) == pytest.approx(rms, rel=1e-3)


def test_a_check_run_is_refused_with_what_to_do(run, capsys):
    with pytest.raises(SystemExit) as end:
        main(["compare", str(run.path), "--every-sample", "--check", str(run.path)])
    assert end.value.code == 2
    assert "a check run is scored on means" in capsys.readouterr().err


def test_a_live_run_is_followed_from_its_means():
    so_far, random = SoFar(-40.0, 85.0), np.random.default_rng(0)
    assert so_far.report() is None
    for second in range(3600):
        degc = -40.0 + second / 60.0
        so_far.add(second + 0.5, degc, 12.0 + 3.0 * np.sin(degc / 5.0) + random.normal(0.0, 0.5))
        so_far.add(second + 0.6, np.nan, 1.0)
    so_far.add(3601.0, 200.0, 1.0)
    report = json.loads(json.dumps(so_far.report(), allow_nan=False))
    polynomial, spline = report["models"]
    assert (report["seconds"], report["outside"]) == (3600, 1)
    assert (report["from_degc"], report["to_degc"]) == (-40.0, pytest.approx(20.0, abs=0.1))
    assert spline["rms_dph"] == pytest.approx(0.5, rel=0.1)
    assert spline["held_out_rms_dph"] >= spline["rms_dph"]
    assert polynomial["rms_dph"] > 1.5


def test_few_rows_are_not_taken_for_a_good_fit():
    """61 seconds over all 24 intervals: a fit of 27 coefficients leaves less than the noise."""
    found = []
    for seed in range(20):
        so_far, random = SoFar(-40.0, 85.0), np.random.default_rng(seed)
        for second in range(61):
            so_far.add(second + 0.5, -40.0 + 2.0 * second, 12.0 + random.normal(0.0, 0.5))
        found.append([model["rms_dph"] for model in so_far.report()["models"]])
    assert np.sqrt(np.mean(np.square(found), axis=0)) == pytest.approx(0.5, rel=0.06)


def test_notes_of_others_are_in_the_status_of_a_live_run():
    desk = Desk()
    desk.notes = lambda: {"fits": {"G-1": {"seconds": 60}}}
    assert desk.status()["fits"] == {"G-1": {"seconds": 60}}


def test_the_answer_says_that_every_sample_counts_alike(run, capsys):
    with pytest.raises(SystemExit):
        main(["compare", str(run.path), "--every-sample", "--model", "polynomial", "--json"])
    (score,) = json.loads(capsys.readouterr().out)["models"]
    assert score["weights"]["by"] == "count"
    assert "do not keep their order in time" in score["weights"]["reason"]
