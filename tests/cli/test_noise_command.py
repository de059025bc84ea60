"""`bench noise`: coefficients of a record whose noise was made by numpy alone."""

import json

import numpy as np
import pytest

from benchmarks.noise_coverage import flicker
from tests.support.commands import bench
from tests.support.run_folders import make_run

KEYS = {"angle_random_walk": "deg/√h", "bias_instability": "deg/h", "rate_random_walk": "deg/h/√h",
        "quantisation": "deg", "rate_ramp": "deg/h/h"}  # fmt: skip


def still(hours=3.0, hz=10.0, noise=(0.02, 0.3, 0.0), ramp_dph_h=0.0, seed=1):
    """Columns of a record at one temperature."""
    rng = np.random.default_rng(seed)
    rows = round(hours * 3600 * hz)
    time = (np.arange(rows) + 0.5) / hz
    n, b, k = noise
    slow = b * flicker(rows // round(hz), rng) + k / 60.0 * np.cumsum(rng.standard_normal(rows // round(hz)))
    rate = n * 60.0 * np.sqrt(hz) * rng.standard_normal(rows) + np.repeat(slow, round(hz)) + ramp_dph_h * time / 3600.0
    return {"time": time, "rate": 5.0 + rate, "temperature": np.full(rows, 25.0)}


def test_it_prints_five_coefficients_with_intervals_that_hold_the_truth(tmp_path):
    run = make_run(tmp_path / "r", still())
    found = json.loads(bench("noise", run, "--json").stdout)
    assert {key: found[key]["unit"] for key in KEYS} == KEYS
    truth = {"angle_random_walk": 0.02, "bias_instability": 0.3, "rate_random_walk": 0.0, "rate_ramp": 0.0}
    for key, value in truth.items():
        assert found[key]["low"] <= value <= found[key]["high"], key
    assert found["angle_random_walk"]["high"] < 1.02 * 0.02
    assert found["quantisation"]["value"] == 0.0
    text = bench("noise", run).stdout
    for words in ("Allan deviation", "bias instability", "below", "noise floor of 30 s means", "read from still at 25"):
        assert words in text


def test_a_ramp_of_the_rate_is_found(tmp_path):
    run = make_run(tmp_path / "r", still(noise=(0.02, 0.0, 0.0), ramp_dph_h=0.5))
    ramp = json.loads(bench("noise", run, "--json").stdout)["rate_ramp"]
    assert ramp["low"] <= 0.5 <= ramp["high"]
    assert ramp["value"] == pytest.approx(0.5, abs=0.05)


def test_an_imported_log_has_its_noise_as_well(tmp_path):
    columns = still(hours=2.0, hz=5.0, noise=(0.05, 0.0, 0.0))
    table = tmp_path / "log.csv"
    rows = np.column_stack([columns["time"], columns["rate"], columns["temperature"]])
    np.savetxt(table, rows, delimiter=",", header="time,rate,temperature", comments="", fmt="%.6f")
    made = json.loads(bench("import", table, "--out", tmp_path / "out", "--json").stdout)
    found = json.loads(bench("noise", made["run"], "--json").stdout)["angle_random_walk"]
    assert found["low"] <= 0.05 <= found["high"]


def test_a_run_that_never_stands_still_is_refused_in_one_line(tmp_path):
    columns = still(hours=1.0)
    columns["temperature"] = columns["time"] / 60.0
    answer = bench("noise", make_run(tmp_path / "r", columns))
    assert answer.exit_code == 2
    (line,) = answer.stderr.splitlines()
    assert "no isothermal stretch" in line
