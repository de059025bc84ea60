"""`bench imu RUN…`: what runs through attitudes give, against the simulated truth, and against a table and a plan."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml

from bench.analysis import analyse
from bench.base import OUTPUTS, read_yaml
from bench.commands.acquisition import Task, conduct
from bench.record import seconds_of
from benchmarks import imu_data
from drivers.sim.truth.imu.drawn import drawn
from tests.support.commands import bench

STATION = Path(__file__).parents[2] / "profiles" / "stations" / "imu.yaml"
RATES = """\
name: rates
segments:
  - {kind: rate, attitudes: 6, rates_dps: [60, 20], dwell_s: 19}
"""
TUMBLE = """\
name: tumble
segments:
  - {kind: tumble, attitudes: 12, dwell_min: 0.32}
"""
RUNS = {"rates": RATES, "tumble": TUMBLE}
FLAT = {
    "row_s": 18.0,
    "orders": {"bias": 0, "scale_factor": 0, "misalignment": 0, "g_sensitivity": 0, "second_order": 0},
}
"""Options of the fit: one temperature; a row is three turns."""


def conducted(folder, text):
    (folder / "profile.yaml").write_text(text)
    station = dict(read_yaml(STATION).content)
    station["fixture"] = station["fixture"] | {"takes_s": 1}
    (folder / "station.yaml").write_text(json.dumps(station))
    return conduct(folder / "profile.yaml", folder / "station.yaml", Task((), {}, folder), quiet=True).run.path


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """Two runs of the shipped station at one temperature, ten minutes of bench time, and options for them."""
    folder = tmp_path_factory.mktemp("imu")
    for name, text in RUNS.items():
        (folder / name).symlink_to(conducted(folder, text))
    (folder / "flat.yaml").write_text(yaml.safe_dump(FLAT))
    return folder


def asked(folder, *words, plan="flat.yaml"):
    names = [str(folder / word) for word in words]
    answer = bench("imu", *names, "--plan", folder / plan, "--json")
    return answer, json.loads(answer.stdout) if answer.exit_code < 2 else {}


def test_a_whole_run_that_is_for_bench_imu_is_not_outside_limits(place):
    analysis = analyse((place / "tumble").resolve(), diagnose=False)
    assert "`bench imu " in analysis.verdict.sentence
    assert analysis.within_limits


def test_two_runs_find_the_unit_within_the_uncertainty(place):
    answer, found = asked(place, "rates", "tumble")
    assert answer.exit_code == 0, answer.output
    assert found["rows"] == 36
    true = {}
    for number, elements in enumerate(("gyro x", "gyro y", "gyro z", "accelerometer"), 1):
        degc = np.mean([np.nanmean(seconds_of(place / run).channels[f"temperature_{number}"]) for run in RUNS])
        own = imu_data.truth(drawn(1), elements.split()[0], float(degc))
        true |= {name: value for name, value in own if name.startswith(elements)}
    off = {one["name"]: abs(one["value"] - true[one["name"]]) / one["U"] for one in found["parameters"]}
    assert len(off) == 36
    assert sum(value > 1.0 for value in off.values()) <= 5  # 5 % and chance
    # Noise that is slower than the runs is in the biases, and in no uncertainty that they could show.
    assert max(value for name, value in off.items() if not name.endswith("bias")) < 2.0


def test_a_table_and_a_plan_give_the_same_as_the_run(place):
    run = place / "rates"
    record, segments = seconds_of(run), json.loads((run / "manifest.json").read_text())["segments"]
    names = [*(name for name in record.channels if name in OUTPUTS or name.startswith("t")), "applied_rate"]
    pd.DataFrame({"time": record.time, **{name: record.channels[name] for name in names}}).to_parquet(
        place / "table.parquet"
    )
    pairs = zip(segments[::4], segments[3::4], strict=True)  # four rates in each attitude
    stays = [{"from_s": a["from_s"], "to_s": b["to_s"], "attitude": a["attitude"]} for a, b in pairs]
    dies = {"gyro_thermometers": [f"temperature_{n}" for n in (1, 2, 3)],
            "accelerometer_thermometers": ["temperature_4"] * 3}  # fmt: skip
    (place / "plan.yaml").write_text(yaml.safe_dump({"latitude_deg": 45.0, **dies, **FLAT, "stays": stays}))
    mine, theirs = asked(place, "rates")[1], asked(place, "table.parquet", plan="plan.yaml")[1]
    assert len(mine["parameters"]) == 36
    assert mine["parameters"] == theirs["parameters"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("rates", "table.csv"), "table.csv: one table is calibrated at a time, or run folders alone"),
        (("flat.yaml",), "latitude_deg"),
    ],
)
def test_what_does_not_go_together_is_one_line(place, words, said):
    (place / "table.csv").write_text("time\n1\n")
    answer, _ = asked(place, *words)
    assert answer.exit_code == 2
    assert said in answer.stderr


def test_a_table_without_a_plan_is_refused(place):
    (place / "table.csv").write_text("time\n1\n")
    answer = bench("imu", place / "table.csv")
    assert (answer.exit_code, "give a plan with --plan" in answer.stderr) == (2, True)


def test_a_run_that_names_no_attitudes_is_refused(short_run):
    answer = bench("imu", short_run.path)
    assert answer.exit_code == 2
    assert "names no attitudes: run a profile with `attitude`" in answer.stderr


PLAN = """\
name: flat
profile: both.yaml
verification: other.yaml
imu: flat.yaml
limits: limits.yaml
certificate: false
"""


@pytest.mark.slow
def test_an_inertial_unit_goes_from_the_shelf_to_verified(place, tmp_path):
    """Rates and a tumble, its calibration in the unit, judged at a rate that was not fitted."""
    segments = [line for text in RUNS.values() for line in text.splitlines() if "kind" in line]
    (tmp_path / "both.yaml").write_text("\n".join(["name: both", "segments:", *segments]))
    (tmp_path / "other.yaml").write_text(
        "name: other\nsegments:\n  - {kind: rate, attitudes: 6, rates_dps: [40], dwell_s: 19}\n"
    )
    limits = [f"  - {{quantity: {name}, unit: {unit}, upper: {upper}, reason: r}}" for name, unit, upper in (
        ("gyro_error_rms_dph", "deg/h", 60), ("accelerometer_error_rms_mps2", "m/s^2", 0.01))]  # fmt: skip
    (tmp_path / "limits.yaml").write_text("\n".join(["name: flat", "description: d", "limits:", *limits]))
    (tmp_path / "plan.yaml").write_text(PLAN)
    (tmp_path / "flat.yaml").write_text((place / "flat.yaml").read_text())
    order = ["--unit", "IMU-0001", "--plan", tmp_path / "plan.yaml", "--station", place / "station.yaml"]
    said = bench("calibrate", *order, "--out", tmp_path / "out", "--json", "--quiet")
    assert said.exit_code == 0, said.output
    job = json.loads(said.stdout)
    steps = {step["name"]: step for step in job["steps"]}
    assert job["verdict"] == "PASS"
    assert steps["fit"]["facts"]["findings"] == []
    assert "PASS" in steps["verify"]["sentence"]
    (record,) = (tmp_path / "out" / "IMU-0001").glob("*_imu")
    assert {path.name for path in record.iterdir()} >= {"imu.json", "imu_verification.json", "report.html"}
    assert json.loads((record / "imu.json").read_text())["sample_hz"] == 50.0
    assert [case["name"] for case in steps["verify"]["cases"]] == [
        "gyro_error_rms_dph", "accelerometer_error_rms_mps2"
    ]  # fmt: skip


def test_a_plan_says_what_is_fitted(tmp_path):
    for wrong in (PLAN.replace("imu: flat.yaml", ""), PLAN.replace("imu:", "models: [spline]\nimu:")):
        (tmp_path / "plan.yaml").write_text(wrong)
        said = bench("calibrate", "--unit", "U", "--plan", tmp_path / "plan.yaml")
        assert (said.exit_code, "state `imu: true`" in said.stderr) == (2, True)
