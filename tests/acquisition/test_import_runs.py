"""Branches of a foreign table, and the run folder that it becomes."""

import subprocess
import sys

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

from bench.acquisition.importer.branches import find_branches, segment_of
from bench.acquisition.importer.columns import ChannelSource, ColumnMap
from bench.acquisition.importer.plan import load_columns, write_import
from bench.analysis.noise.floor import noise_floor
from bench.base.errors import InputError
from bench.commands.analysis import usual_means
from bench.record import apart, load
from bench.record.folder import open_run
from bench.record.samples import read_samples
from tests.support.tables import imported, loop, write


def test_branches_follow_the_temperature():
    time, _, degc = loop()
    noisy = degc + np.random.default_rng(4).normal(0, 0.2, degc.size)
    found = find_branches(time, noisy)
    assert [branch.direction for branch in found] == ["cooling", "constant", "heating", "cooling"]
    np.testing.assert_allclose([branch.from_s for branch in found], [0, 5000, 8600, 16000], atol=200)
    assert found[0].rate_degc_per_min == pytest.approx(45 / 5000 * 60, rel=0.05)
    assert found[-1].to_s == time[-1]
    segment = segment_of(found, time)
    assert segment[0] == 0
    assert segment[-1] == 3
    assert np.all(np.diff(segment) >= 0)


def test_a_minor_loop_makes_branches_and_noise_does_not():
    time = np.arange(0, 12000, 1.0)
    degc = np.interp(time, [0, 4000, 6000, 8000, 12000], [85, 0, 50, 20, 25])
    directions = [branch.direction for branch in find_branches(time, degc)]
    assert directions[:3] == ["cooling", "heating", "cooling"]
    flat = 25 + np.random.default_rng(5).normal(0, 0.05, 5000)
    assert [branch.direction for branch in find_branches(np.arange(5000.0), flat)] == ["constant"]


def test_branches_of_a_lagging_unit_keep_their_soaks():
    time = np.arange(0, 30000, 10.0)
    air = np.interp(time, [0, 3000, 9000, 13000, 20000, 23000, 30000], [25, -30, -30, 60, 60, 25, 25])
    unit = np.empty_like(air)
    unit[0] = air[0]
    for i in range(1, air.size):
        unit[i] = unit[i - 1] + (air[i] - unit[i - 1]) * 10 / 480
    directions = [branch.direction for branch in find_branches(time, unit)]
    assert directions == ["cooling", "constant", "heating", "constant", "cooling", "constant"]


def table_of_loop(tmp_path):
    time, rate, degc = loop()
    body = "\n".join(f"{t},{r / 3600!r},{c + 273.15!r}" for t, r, c in zip(*(x.tolist() for x in (time, rate, degc)),
                                                                         strict=True))  # fmt: skip
    return write(tmp_path, f"time_s,gyro_dps,temp_K\n{body}\n")


def test_an_import_is_a_run_folder_that_the_analysis_reads(tmp_path):
    plan = imported(table_of_loop(tmp_path), serial="G 7")
    run = write_import(plan, tmp_path / "reports")
    found = load(run.path)
    time, rate, degc = loop()
    np.testing.assert_allclose(found.channel("rate"), np.interp(found.time, time, rate), rtol=2e-3)
    np.testing.assert_allclose(found.channel("temperature"), np.interp(found.time, time, degc), atol=0.2)
    assert [segment.direction for segment in found.segments] == ["cooling", "constant", "heating", "cooling"]
    assert set(found.segment) == {0, 1, 2, 3}


def steady_log(tmp_path, step_s, name):
    """White noise of 0.01 deg/sqrt(h) in means over `step_s`, at two temperatures."""
    time = np.arange(0.0, 40 * 3600.0, step_s)
    degc = np.interp(time, np.array([0, 18, 19, 40]) * 3600.0, [20, 20, 60, 60])
    rate = 3.0 + np.random.default_rng(1).normal(0.0, 0.01 / np.sqrt(step_s / 3600.0), time.size)
    body = "\n".join(f"{t:g},{r:.6f},{c:.3f}" for t, r, c in zip(time, rate, degc, strict=True))
    plan = imported(write(tmp_path, f"time_s,rate_dph,temp_C\n{body}\n", f"{name}.csv"), serial=name)
    return write_import(plan, tmp_path / "reports").path


@pytest.mark.parametrize("step_s", [10.0, 45.0, 120.0])
def test_rows_that_are_further_apart_than_means_are_means_over_their_distance(tmp_path, step_s):
    run = steady_log(tmp_path, step_s, "S-1")
    means, every_s = load(run), max(step_s, 30.0)
    assert means.interval_s == every_s
    floor = noise_floor([load(run, 1.0)], 30.0, intervals=False)
    assert floor.floor_dph == pytest.approx(0.01 / np.sqrt(every_s / 3600.0), rel=0.05)
    assert floor.floor_dph == pytest.approx(np.std(means.channels["rate"]), rel=0.05)


def test_logs_with_different_distances_of_rows_are_taken_in_means_of_one_length(tmp_path):
    runs = [steady_log(tmp_path, step_s, name) for step_s, name in ((10.0, "S-1"), (120.0, "S-2"))]
    assert [run.interval_s for run in usual_means([load(run, 1.0) for run in runs])] == [120.0, 120.0]


def test_no_branch_of_a_slow_log_is_left_out(tmp_path):
    """A branch of an hour is 30 rows, and no 30 s."""
    time = np.arange(0.0, 12 * 3600.0, 120.0)
    degc = 20.0 + 30.0 * np.abs((time / 3600.0) % 2.0 - 1.0)
    body = "\n".join(f"{t:g},{t % 7},{c:.3f}" for t, c in zip(time, degc, strict=True))
    run = write_import(imported(write(tmp_path, f"time_s,rate_dph,temp_C\n{body}\n")), tmp_path / "reports").path
    (means,) = usual_means([load(run, 1.0)])
    assert len(means) == len(time)


def warmed(tmp_path, rows, *, step=0.001, failed=(), wrong=()):
    """Means of 30 s of a log with a row a second whose thermometer reads in `rows`; a bath heats with two time
    constants of 20 minutes. In rows that are `wrong` it answers with -127 degC.
    """
    time = np.arange(0.0, 3 * 3600.0)
    degc = 80.0 - 100.0 * (1.0 + time / 1200.0) * np.exp(-time / 1200.0)
    read = np.where(np.isin(time, wrong), -127.0, step * np.round(degc / step))
    cells = [f"{c:.3f}" if n in rows and n not in failed else "" for n, c in enumerate(read)]
    body = "\n".join(f"{t:g},{c:.6f},{cell}" for t, c, cell in zip(time, degc, cells, strict=True))
    path = write(tmp_path, f"time_s,rate_dph,temp_C\n{body}\n")
    return load(write_import(imported(path), tmp_path / "reports").path)


@pytest.mark.parametrize(("every_s", "within_degc"), [(60, 0.02), (300, 0.25)])
def test_a_thermometer_that_is_read_rarely_is_known_between_its_readings(tmp_path, every_s, within_degc):
    """The rate of this log is its temperature: both means must be of the same time."""
    means = warmed(tmp_path, range(0, 10801, every_s))
    inside = means.time < 10800 - every_s - 30
    assert len(means) == 360
    np.testing.assert_allclose(means.channel("temperature")[inside], means.channel("rate")[inside], atol=within_degc)
    assert np.isfinite(means.dT_dt[inside]).all()


def test_readings_that_fail_leave_a_gap_and_steps_of_a_slow_thermometer_are_found(tmp_path):
    means = warmed(tmp_path, range(0, 10801, 10), step=0.5, failed=range(3600, 5400))
    gap = (means.time > 3600) & (means.time < 5370)
    assert np.isnan(means.channel("temperature")[gap]).all()
    assert np.isfinite(means.channel("temperature")[~gap]).mean() > 0.98
    assert means.temperature_step == pytest.approx(0.5)


@pytest.mark.parametrize("every_s", [1, 60])
def test_readings_of_a_thermometer_that_are_none_of_a_temperature_are_left_out_and_counted(tmp_path, every_s):
    wrong = (600, 1800, 1980, 7200)
    means = warmed(tmp_path, range(0, 10801, every_s), wrong=wrong)
    inside = means.time < 10800 - every_s - 30
    np.testing.assert_allclose(means.channel("temperature")[inside], means.channel("rate")[inside], atol=0.1)
    assert means.outliers == {"temperature": len(wrong)}


def test_a_thermometer_that_is_read_every_ten_minutes_is_not_known_between(tmp_path):
    means = warmed(tmp_path, range(0, 10801, 600))
    assert np.isfinite(means.channel("temperature")).sum() == 18


def test_the_manifest_names_the_source_and_every_file(tmp_path):
    path = table_of_loop(tmp_path)
    run = write_import(imported(path, serial="G 7"), tmp_path / "reports")
    manifest = open_run(run.path).manifest()
    assert (manifest.state, manifest.unit, manifest.rows) == ("done", "G 7", 1200)
    assert manifest.files == run.hashes()
    assert set(manifest.files) == {"data.parquet", "means.parquet", "columns.yaml", "events.jsonl"}
    assert manifest.source["columns"]["rate"] == {"column": "gyro_dps", "unit": "dps", "how": "header"}
    assert len(manifest.source["sha256"]) == 64


def test_the_column_map_in_the_run_folder_repeats_the_import(tmp_path):
    path = table_of_loop(tmp_path)
    first = write_import(imported(path), tmp_path / "a")
    second = write_import(imported(path, load_columns(first.path / "columns.yaml")), tmp_path / "b")
    assert pq.read_table(first.data).equals(pq.read_table(second.data))


def test_the_same_import_again_is_the_run_that_is_there(tmp_path):
    path = table_of_loop(tmp_path)
    first = write_import(imported(path, serial="G 7"), tmp_path / "reports")
    assert write_import(imported(path, serial="G 7"), tmp_path / "reports") == first
    assert write_import(imported(path, serial="G 8"), tmp_path / "reports") != first


def test_an_import_that_is_interrupted_leaves_nothing_and_what_a_kill_left_goes(tmp_path, monkeypatch):
    killed = subprocess.Popen([sys.executable, "-c", ""])
    killed.wait()
    left = tmp_path / "reports" / f".staged-{killed.pid}-x" / "G 7"
    left.mkdir(parents=True)
    with monkeypatch.context() as patched:
        patched.setattr("bench.acquisition.importer.plan.write_means", lambda *_: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            write_import(imported(table_of_loop(tmp_path)), tmp_path / "reports")
    assert list((tmp_path / "reports").iterdir()) == []


def test_a_place_that_cannot_be_written_is_refused(tmp_path):
    blocked = write(tmp_path, "x", "reports")
    with pytest.raises(InputError, match="choose another place"):
        write_import(imported(table_of_loop(tmp_path)), blocked)


def test_the_data_of_a_run_folder_can_be_imported_again(tmp_path):
    first = write_import(imported(table_of_loop(tmp_path)), tmp_path / "a")
    again = imported(first.data)
    np.testing.assert_array_equal(again.channels["rate"], imported(table_of_loop(tmp_path)).channels["rate"])


def test_all_axes_and_thermometers_of_a_table_become_one_run(tmp_path):
    """As a log of an inertial unit is: three rates and three forces that only their axis tells apart, two dies."""
    degc = np.linspace(-20.0, 60.0, 400)
    columns = {"time [s]": 10.0 * np.arange(400.0), "temp_1 [degC]": degc, "temperature_2": degc + 1.0}
    columns |= {f"g{axis} [dps]": 0.001 * (n + 1) + 1e-5 * degc for n, axis in enumerate("xyz")}
    columns |= {f"acc_{axis} (g)": np.full(400, 0.5 * n) + 1e-6 * degc for n, axis in enumerate("xyz")}
    path = tmp_path / "imu.csv"
    pd.DataFrame(columns).to_csv(path, index=False)
    run = write_import(
        imported(path, ColumnMap(temperature_1=ChannelSource(column="temp_1 [degC]")), "IMU-1"), tmp_path / "out"
    )
    whole = load(run.path, 60.0)
    assert whole.outputs == ("rate_x", "rate_y", "rate_z", "acceleration_x", "acceleration_y", "acceleration_z")
    assert np.array_equal(whole.channel("temperature"), whole.channel("temperature_1"))
    data = read_samples(run.data)
    assert data["rate_y"] == pytest.approx(3600.0 * columns["gy [dps]"])
    assert data["acceleration_z"] == pytest.approx(9.80665 * columns["acc_z (g)"])
    assert data["temperature_2"] == pytest.approx(degc + 1.0)
    assert [each.manifest().output for each in apart(run)] == ["rate_x", "rate_y", "rate_z"]


def test_a_log_that_is_shorter_than_a_mean_says_so(tmp_path):
    body = "".join(f"{i},1.{i},20\n" for i in range(10))
    run = write_import(imported(write(tmp_path, f"time_s,rate_dph,temp_C\n{body}")), tmp_path / "reports").path
    with pytest.raises(InputError, match="10 rows of 1 s are too few for a mean over 30 s"):
        usual_means([load(run, 1.0)])
