import json

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from bench.base.errors import InputError
from bench.record.dataset import Dataset, Segment
from bench.record.means import write_means
from bench.record.reading import load
from tests.support.analysis_data import thermal_cycle


def raw_record(seconds=600, rate_hz=100, split_s=300.4):
    n = seconds * rate_hz
    rng = np.random.default_rng(1)
    time = np.arange(n) / rate_hz
    rate = 5.0 + rng.normal(size=n)
    frequency = 14000.0 + 1e-4 * rng.normal(size=n)
    rate[rng.random(n) < 0.02] = np.nan
    rate[200 * rate_hz : 203 * rate_hz] = np.nan
    frequency[np.arange(n) % 10 != 0] = np.nan
    segment = np.where(time < split_s, 0, 1)
    return {
        "time": time,
        "rate": rate,
        "temperature": 20.0 + time / 60.0,
        "frequency": frequency,
        "segment": segment.astype(np.int16),
    }


def write_record(path, columns, row_group=7001):
    arrays = {name: pa.array(values, from_pandas=True) for name, values in columns.items()}
    pq.write_table(pa.table(arrays), path, row_group_size=row_group)


def run_folder(folder, columns, segments=()):
    write_record(folder / "data.parquet", columns)
    write_means(folder / "data.parquet", folder / "means.parquet")
    manifest = {"format": 1, "run": "r1", "segments": list(segments)}
    (folder / "manifest.json").write_text(json.dumps(manifest))
    return folder


def pandas_means(columns, key):
    """Independent reference: group by in pandas."""
    frame = pd.DataFrame(columns)
    return frame.groupby(key(frame))


def test_means_agree_with_pandas_and_never_mix_segments(tmp_path):
    columns = raw_record()
    write_record(tmp_path / "data.parquet", columns)
    assert write_means(tmp_path / "data.parquet", tmp_path / "means.parquet") == 601  # one second is split in two
    means = pd.read_parquet(tmp_path / "means.parquet")
    groups = pandas_means(columns, lambda f: [np.floor(f["time"]), f["segment"]])
    for name in ("rate", "temperature", "frequency"):
        np.testing.assert_allclose(means[name], groups[name].mean(), rtol=1e-13)
        np.testing.assert_array_equal(means[f"{name}_count"], groups[name].count())
        shifted = groups[name].apply(lambda values: (values - 14000.0).var())  # pandas' own loses digits at 14 kHz
        np.testing.assert_allclose(means[f"{name}_var"], shifted, rtol=1e-9)
    split = means[np.floor(means["time"]) == 300]
    assert list(split["segment"]) == [0, 1]
    assert list(split["rate_count"] <= [40, 60]) == [True, True]
    assert means["time"].iloc[:3].tolist() == [0.5, 1.5, 2.5]


def test_a_gap_stays_a_gap_in_the_means(tmp_path):
    write_record(tmp_path / "data.parquet", raw_record())
    write_means(tmp_path / "data.parquet", tmp_path / "means.parquet")
    means = pd.read_parquet(tmp_path / "means.parquet")
    assert means["rate"][200:203].isna().all()
    assert (means["rate_count"][200:203] == 0).all()
    assert means["temperature"].notna().all()


def test_means_do_not_depend_on_how_the_file_is_cut_into_row_groups(tmp_path, monkeypatch):
    write_record(tmp_path / "data.parquet", raw_record())
    write_means(tmp_path / "data.parquet", tmp_path / "one.parquet")
    monkeypatch.setattr("bench.record.means._BATCH_ROWS", 333)
    write_means(tmp_path / "data.parquet", tmp_path / "many.parquet")
    pd.testing.assert_frame_equal(pd.read_parquet(tmp_path / "one.parquet"), pd.read_parquet(tmp_path / "many.parquet"))


def test_means_refuse_time_that_runs_backwards_and_files_that_are_not_parquet(tmp_path):
    columns = raw_record(10)
    columns["time"] = columns["time"][::-1].copy()
    write_record(tmp_path / "data.parquet", columns)
    with pytest.raises(InputError, match="runs backwards"):
        write_means(tmp_path / "data.parquet", tmp_path / "out.parquet")
    (tmp_path / "text.parquet").write_text("no")
    with pytest.raises(InputError, match="not a readable Parquet file"):
        write_means(tmp_path / "text.parquet", tmp_path / "out.parquet")


SEGMENTS = [
    {"index": 0, "name": "up", "from_s": 0.0, "to_s": 300.0},
    {"index": 1, "name": "down", "from_s": 300.0, "to_s": 600.0},
]


def test_load_averages_exactly_as_if_the_raw_samples_had_been_averaged(tmp_path):
    columns = raw_record(split_s=300.0)
    dataset = load(run_folder(tmp_path, columns, SEGMENTS), 30.0)
    groups = pandas_means(columns, lambda f: [f["segment"], np.floor(f["time"] / 30.0)])
    np.testing.assert_allclose(dataset.channels["rate"], groups["rate"].mean(), rtol=1e-12)
    np.testing.assert_array_equal(dataset.counts["rate"], groups["rate"].count())
    np.testing.assert_allclose(dataset.variances["rate"], groups["rate"].var(), rtol=1e-9)
    np.testing.assert_allclose(dataset.variances["frequency"], groups["frequency"].var(), rtol=1e-6)
    assert dataset.counts["rate"].sum() == np.isfinite(columns["rate"]).sum()
    assert [s.name for s in dataset.segments] == ["up", "down"]
    assert dataset.interval_s == 30.0
    assert dataset.name == "r1"


def test_averaging_never_crosses_a_segment_and_keeps_every_sample():
    record = thermal_cycle(interval_s=1.0, leg_s=100.0)
    means = record.average(30.0)
    assert len(means) == 6 * 3
    assert means.counts["rate"].tolist() == [34.0, 33.0, 33.0] * 6  # three equal bins of 33.3 s hold whole seconds
    assert means.segment.tolist() == np.repeat(np.arange(6), 3).tolist()
    assert means.time[:3].tolist() == [17.0, 50.5, 83.5]
    np.testing.assert_allclose(means.channels["frequency"][1], record.channels["frequency"][34:67].mean(), rtol=1e-14)


def test_averaging_twice_is_averaging_once():
    record = thermal_cycle(interval_s=1.0, leg_s=600.0)
    once, twice = record.average(60.0), record.average(30.0).average(60.0)
    for name in record.channels:
        np.testing.assert_allclose(twice.channels[name], once.channels[name], rtol=1e-13, atol=1e-15)
        np.testing.assert_allclose(twice.variances[name], once.variances[name], rtol=1e-8, atol=1e-20)


def test_averaging_refuses_to_invent_resolution():
    with pytest.raises(InputError, match="cannot average over 10 s, its rows are 30 s"):
        thermal_cycle().average(10.0)


def test_bias_is_rate_less_what_the_table_turned():
    record = thermal_cycle().with_channel("applied_rate", np.full(720, 0.01)).with_channel("rate", np.full(720, 40.0))
    np.testing.assert_allclose(record.bias, 4.0)


def test_direction_comes_from_the_temperature_itself():
    record = thermal_cycle()
    assert set(record.direction[125:235]) == {1}
    assert set(record.direction[365:475]) == {-1}
    np.testing.assert_allclose(record.dT_dt[130:230], 125.0 / 60.0, atol=0.01)
    still = record.with_channel("temperature", np.full(720, 25.0))
    assert set(still.direction) == {0}
    gap = record.channels["temperature"].copy()
    gap[200] = np.nan
    assert set(record.with_channel("temperature", gap).direction[[199, 201]]) == {0}


def test_a_missing_channel_is_named():
    with pytest.raises(InputError, match=r"channel 'supply' \[V\] is missing; the run has drive, frequency"):
        thermal_cycle().channel("supply")
    empty = thermal_cycle().with_channel("supply", np.full(720, np.nan))
    with pytest.raises(InputError, match=r"'supply' \[V\] is missing; the run has (?!.*supply)"):
        empty.channel("supply")


def test_a_dataset_refuses_columns_of_different_length_and_time_that_stands_still():
    with pytest.raises(InputError, match="'rate' has 2 rows, time has 3"):
        Dataset("d", np.arange(3.0), {"rate": np.zeros(2)}, np.zeros(3, dtype=int))
    with pytest.raises(InputError, match="stands still"):
        Dataset("d", np.zeros(3), {"rate": np.zeros(3)}, np.zeros(3, dtype=int))


def test_segments_carry_what_the_manifest_says(tmp_path):
    entry = {"index": 0, "name": "up", "kind": "ramp", "from_s": 0, "to_s": 300, "direction": "heating"}
    folder = run_folder(tmp_path, raw_record(30), [entry | {"target_degc": 85, "rate_degc_per_min": 1.5}])
    assert load(folder, 1.0).segments == (Segment(0, "up", "ramp", 0.0, 300.0, "heating", 85.0, 1.5),)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda f: (f / "manifest.json").unlink(), "not a run folder: manifest.json is missing"),
        (lambda f: (f / "means.parquet").unlink(), "means.parquet: missing; the run was not finished"),
        (lambda f: (f / "manifest.json").write_text("{"), "manifest.json: is not valid JSON"),
        (lambda f: (f / "manifest.json").write_text("[]"), "not a JSON object"),
        (lambda f: (f / "means.parquet").write_bytes(b"PAR1"), "not a readable Parquet file"),
        (lambda f: write_record(f / "means.parquet", {"time": np.zeros(0)}), "zero rows"),
        (lambda f: write_record(f / "means.parquet", {"time": np.zeros(1)}), "required column 'rate' is missing"),
    ],
)
def test_a_broken_run_folder_is_refused_in_one_line(tmp_path, spoil, message):
    folder = run_folder(tmp_path, raw_record(10))
    spoil(folder)
    with pytest.raises(InputError, match=message) as caught:
        load(folder)
    assert "\n" not in str(caught.value)


def test_a_folder_that_does_not_exist_is_refused(tmp_path):
    with pytest.raises(InputError, match="no such run folder"):
        load(tmp_path / "none")
