"""A run is made again from its frames: the same bits, or the file, column and row that differ."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from bench.acquisition.run.runner import run_job
from bench.analysis.effects.model import load_model
from bench.analysis.judging.judge import analyse
from tests.acquisition.test_continuation import TWO, go_on, kill_in
from tests.support import acquisition
from tests.support.commands import bench
from tests.support.run_folders import keep, make_run, ramp_run


@pytest.fixture(scope="module")
def analysed(tmp_path_factory):
    """A simulated run over four degrees, with its results; not to be changed."""
    text = """\
name: replayed
segments:
  - {kind: ramp, to_degc: 27, rate_degc_per_min: 2}
  - {kind: soak, duration_min: 2}
  - {kind: ramp, to_degc: 23, rate_degc_per_min: 2}
"""
    job = acquisition.job(tmp_path_factory.mktemp("replayed"), text)
    result = run_job(replace(job, model_texts={"model.yaml": load_model("polynomial").to_yaml()}))
    analyse(result.run.path, [load_model("polynomial")], diagnose=False)
    return result.run.path


@pytest.fixture
def copied(analysed, tmp_path):
    """One that may be changed."""
    return shutil.copytree(analysed, tmp_path / analysed.name)


@pytest.mark.slow
def test_a_run_is_made_again_bit_for_bit_and_left_as_it_was(analysed):
    before = {path: path.stat().st_mtime_ns for path in analysed.rglob("*")}
    answer = bench("replay", analysed, "--json")
    (content,) = json.loads(answer.stdout)["runs"]
    assert (answer.exit_code, content["identical"], content["analysed"]) == (0, True, True)
    assert content["versions"]["then"] == content["versions"]["now"]
    assert {path: path.stat().st_mtime_ns for path in analysed.rglob("*")} == before


def test_an_altered_table_is_named_with_column_row_and_values(copied):
    table = pq.read_table(copied / "means.parquet")
    rate = table["rate"].to_numpy().copy()
    rate[100:103] = np.nextafter(rate[100:103], np.inf)
    pq.write_table(
        table.set_column(table.schema.names.index("rate"), "rate", pa.array(rate, from_pandas=True)),
        copied / "means.parquet",
    )
    answer = bench("replay", copied, "--json")
    (content,) = json.loads(answer.stdout)["runs"]
    (change,) = content["differences"]
    assert answer.exit_code == 1
    assert [entry["file"] for entry in content["tampered"]] == ["means.parquet"]
    assert (change["file"], change["where"], change["row"], change["count"]) == ("means.parquet", "column rate", 100, 3)
    assert change["then"] == rate[100] != change["now"]


def test_the_same_values_in_other_bytes_are_only_another_file(copied):
    pq.write_table(pq.read_table(copied / "data.parquet"), copied / "data.parquet", compression="snappy")
    (content,) = json.loads(bench("replay", copied, "--json").stdout)["runs"]
    assert content["differences"] == []
    assert [entry["file"] for entry in content["tampered"]] == ["data.parquet"]


def test_a_coefficient_that_differs_in_its_last_bit_is_named(copied):
    path = copied / "calibration.json"
    content = json.loads(path.read_text())
    first = content["calibration"]["coefficients"][0]
    first["value"] = float(np.nextafter(first["value"], np.inf))
    keep(path.parent, path.name, content)
    answer = bench("replay", copied)
    assert answer.exit_code == 1
    assert "calibration.json: calibration.coefficients[0].value: then " in answer.stdout


def test_a_frame_that_is_not_the_recorded_one_is_found_by_hash_and_in_the_numbers(copied):
    journal = copied / "journal" / "can0.gtbj"
    data = bytearray(journal.read_bytes())
    data[len(data) // 2] ^= 1
    journal.unlink()
    journal.write_bytes(data)
    (content,) = json.loads(bench("replay", copied, "--json").stdout)["runs"]
    assert [entry["file"] for entry in content["tampered"]] == ["journal/can0.gtbj"]
    assert any(change["where"] == "losses.journal_damaged_bytes" for change in content["differences"])


def test_a_journal_that_is_gone_is_said_and_nothing_is_called_the_same(copied):
    shutil.rmtree(copied / "journal")
    answer = bench("replay", copied)
    assert answer.exit_code == 1
    assert "changed since it was recorded: journal/can0.gtbj" in answer.stdout


@pytest.mark.slow
def test_a_run_of_several_parts_and_units_is_made_again(tmp_path):
    first, second = kill_in(tmp_path, "up", 60, **TWO)
    assert go_on(first, acquisition.station(**TWO)).error is None
    answer = bench("replay", first, second, "--json")
    content = json.loads(answer.stdout)
    assert content["identical"], content["runs"]
    assert all((run / "journal-2").is_dir() for run in (first, second))


def test_an_import_is_made_again_from_its_data(tmp_path):
    run = make_run(tmp_path / "r", **ramp_run())
    answer = bench("replay", run)
    assert answer.exit_code == 0
    assert "an import has no frames" in answer.stdout


@pytest.mark.parametrize("name", ["nothing", "."])
def test_what_is_no_run_is_bad_input(tmp_path, name):
    assert bench("replay", tmp_path / name).exit_code == 2


def test_a_run_of_its_analysis_that_is_not_there_is_asked_for(copied):
    path = copied / "compare.json"
    keep(path.parent, path.name, json.loads(path.read_text()) | {"check": ["elsewhere"]})
    answer = bench("replay", copied)
    assert answer.exit_code == 2
    assert "was analysed with the run 'elsewhere', which is not beside it; name it with --with" in answer.stderr


@pytest.mark.slow
def test_a_later_diagnosis_without_the_isothermal_run_does_not_change_what_the_report_was_made_with(tmp_path):
    loop = """\
name: loop
segments:
  - {kind: ramp, to_degc: 29, rate_degc_per_min: 1}
  - {kind: ramp, to_degc: 23, rate_degc_per_min: 1}
"""
    still = "name: still\nsegments:\n  - {kind: soak, duration_min: 12}\n"
    run, static = (run_job(acquisition.job(tmp_path, text)).run.path for text in (loop, still))
    analyse(run, [load_model("polynomial")], static=static)
    assert bench("diagnose", run, "--model", "regression").exit_code == 0
    answer = bench("replay", run, "--json")
    (content,) = json.loads(answer.stdout)["runs"]
    assert content["differences"] == []
