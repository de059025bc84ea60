"""Measured data for other programs: asammdf reads every sample, pint converts the noise to the same numbers."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pint
import pyarrow.parquet as pq
import pytest
import yaml

from bench.record import RunFolder
from tests.support.commands import bench
from tests.support.run_folders import ARW, make_run, ramp_run


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run of which some samples of two channels are missing."""
    made = ramp_run(loop_dph=0.0)
    for name, rows in (("rate", slice(1000, 1100)), ("supply", slice(0, None, 2))):
        values = np.array(made["columns"].get(name, np.full(made["columns"]["time"].size, 5.0)))
        values[rows] = np.nan
        made["columns"][name] = values
    return make_run(tmp_path_factory.mktemp("measured") / "run", **made)


def test_another_program_reads_every_sample_with_its_unit_and_no_sample_that_is_missing(run, tmp_path):
    asammdf = pytest.importorskip("asammdf")
    done = bench("export", run, "--format", "mf4", "--out", tmp_path, "--json")
    assert done.exit_code == 0, done.output
    (path,) = json.loads(done.stdout)["files"]
    table = pq.read_table(RunFolder(run).data)
    time = table["time"].to_numpy()
    with asammdf.MDF(path) as file:
        assert file.start_time.isoformat() == "2026-11-21T06:00:00+00:00"
        for name in table.column_names[1:]:
            signal, column = file.get(name), table[name]
            there = column.is_valid().to_numpy()
            assert np.array_equal(signal.timestamps, time[there])
            assert np.array_equal(signal.samples, column.drop_null().to_numpy())
        assert [file.get(name).unit for name in ("rate", "temperature", "supply")] == ["deg/h", "degC", "V"]
    assert not list(tmp_path.glob(".mf4-*"))


def test_what_is_exported_is_imported_again_unchanged(run, tmp_path):
    pytest.importorskip("asammdf")
    (path,) = json.loads(bench("export", run, "--format", "mf4", "--out", tmp_path, "--json").stdout)["files"]
    done = bench("import", path, "--unit", "AGAIN", "--out", tmp_path / "reports", "--json")
    assert done.exit_code == 0, done.output
    again = pq.read_table(RunFolder(Path(json.loads(done.stdout)["run"])).data)
    assert again["rate"].drop_null().to_pylist() == pq.read_table(RunFolder(run).data)["rate"].drop_null().to_pylist()


def test_kalibr_gets_the_noise_in_its_units(run, tmp_path):
    done = bench("export", run, "--format", "kalibr", "--out", tmp_path)
    assert done.exit_code == 0, done.output
    text = (tmp_path / "imu.yaml").read_text()
    known = yaml.safe_load(text)
    found = json.loads(bench("noise", run, "--json").stdout)
    unit = pint.UnitRegistry()
    white = unit.Quantity(found["angle_random_walk"]["value"], "degree/hour**0.5").to("rad/s**0.5").magnitude
    assert known["gyroscope_noise_density"] == pytest.approx(white, rel=1e-6)
    assert found["angle_random_walk"]["value"] == pytest.approx(ARW, rel=0.05)
    walk = found["rate_random_walk"]
    told = walk["value"] or walk["high"]
    wanted = unit.Quantity(told, "degree/hour/hour**0.5").to("rad/s/s**0.5").magnitude
    assert known["gyroscope_random_walk"] == pytest.approx(wanted, rel=1e-6)
    assert ("not told from zero" in text) == (walk["value"] == 0)
    assert known["update_rate"] == 2.0
    assert known["accelerometer_noise_density"] is None
    assert "measured no accelerometer" in text


def test_an_unknown_format_is_refused_with_all_that_there_are(run):
    done = bench("export", run, "--format", "mf5")
    assert done.exit_code == 2
    assert all(name in done.stderr for name in ("json", "mf4", "kalibr"))
